//! The regions in which a cut is meshed: larger ones where it has few triangles (`docs/algorithm.md#91-regions-that-grow`).

use crate::layout::{NONE, RegionMesh};
use crate::{Pyramid, Region, RegionKey, SharedSlice, Vertex};
use rustc_hash::FxHashMap;
use std::collections::hash_map::Entry;

/// Exponents of the sizes of regions that consist of several, the largest first. The stream has 16 bits for a coordinate, and a vertex may
/// lie far outside of its region.
const JOINED_SIZES: [usize; 2] = [2, 1];

/// Maximum triangles of a region that consists of several.
const MAX_JOINED_TRIANGLES: u32 = 2000;

/// Regions are joined if they have fewer triangles than this, on average.
pub const SPARSE_TRIANGLES: u32 = 150;

/// Regions of a mesh, each with the active regions that it consists of.
#[derive(Clone, Debug, Default)]
pub(crate) struct MeshRegions {
    pub keys: Vec<RegionKey>,
    /// Numbers of active regions, in ascending order within a region.
    members: Vec<u32>,
    /// Of each region, the end of its members.
    ends: Vec<u32>,
}

/// Signatures of the meshes of a cut of a vertex tree. They tell in which regions the surface of another cut of the same tree differs.
#[derive(Clone, Debug)]
pub struct TreeRegions {
    /// Id of the tree.
    tree: u64,
    /// Range of the feature, on which values at vertices depend.
    feature: [f32; 2],
    regions: MeshRegions,
    /// Of each active region. Equal signatures mean equal meshes; the probability that those of different meshes are equal is 10⁻¹⁹.
    signatures: Vec<u64>,
}

/// Triangles and regions with triangles in each cube of some size.
struct Cubes {
    size: usize,
    /// Cubes along x and y.
    counts: [usize; 2],
    triangles: Vec<u32>,
    regions: Vec<u32>,
    /// Number of the cube's region in the mesh, once it has one.
    numbers: Vec<u32>,
}

impl Cubes {
    fn new(size: usize, grid: [u32; 3]) -> Self {
        let [x, y, z] = grid.map(|regions| (regions as usize >> size) + 1);
        let cubes = x * y * z;
        Self {
            size,
            counts: [x, y],
            triangles: vec![0; cubes],
            regions: vec![0; cubes],
            numbers: vec![NONE; cubes],
        }
    }

    fn index(&self, coords: [u32; 3]) -> usize {
        let [x, y, z] = coords.map(|c| c as usize >> self.size);
        x + self.counts[0] * (y + self.counts[1] * z)
    }

    fn add(&mut self, coords: [u32; 3], triangles: u32) {
        let cube = self.index(coords);
        self.triangles[cube] += triangles;
        self.regions[cube] += 1;
    }

    /// Whether the regions in a cube are joined.
    fn is_joined(&self, cube: usize) -> bool {
        let (triangles, regions) = (self.triangles[cube], self.regions[cube]);
        regions > 1 && triangles <= MAX_JOINED_TRIANGLES && triangles < SPARSE_TRIANGLES * regions
    }
}

impl MeshRegions {
    /// Returns all active regions, including empty ones.
    pub fn all(pyramid: &Pyramid) -> Self {
        let count = pyramid.host_regions.len() as u32;
        Self {
            keys: keys(pyramid),
            members: (0..count).collect(),
            ends: (1..=count).collect(),
        }
    }

    /// Returns the regions that have triangles; sparse ones are joined. `grid`: regions of the volume along each axis; `coords`,
    /// `meshes`: of each active region.
    pub fn joined(grid: [u32; 3], coords: &[[u32; 3]], meshes: &[RegionMesh]) -> Self {
        let mut sizes = JOINED_SIZES.map(|size| Cubes::new(size, grid));
        let mut filled = Vec::with_capacity(coords.len());
        for ((number, &coords), mesh) in (0u32..).zip(coords).zip(meshes) {
            let count = triangles(mesh) as u32;
            if count > 0 {
                sizes.iter_mut().for_each(|cubes| cubes.add(coords, count));
                filled.push((number, coords));
            }
        }
        let mut joined = Self {
            members: vec![0; filled.len()],
            ..Self::default()
        };
        // Of each region, the index of its next member.
        let mut next = Vec::with_capacity(filled.len());
        let mut end = 0;
        for (number, coords) in filled {
            let cube_of = |cubes: &mut Cubes| {
                let cube = cubes.index(coords);
                cubes.is_joined(cube).then_some(cube)
            };
            let cube = sizes.iter_mut().find_map(|cubes| Some((cube_of(cubes)?, cubes)));
            let known = cube.as_ref().map_or(NONE, |(cube, cubes)| cubes.numbers[*cube]);
            let region = if known == NONE {
                joined.keys.len()
            } else {
                known as usize
            };
            if known == NONE {
                let (size, count) = cube.map_or((0, 1), |(cube, cubes)| {
                    cubes.numbers[cube] = region as u32;
                    (cubes.size, cubes.regions[cube])
                });
                joined.keys.push(RegionKey {
                    coords: coords.map(|c| c >> size << size),
                    size: size as u8,
                });
                next.push(end as usize);
                end += count;
                joined.ends.push(end);
            }
            joined.members[next[region]] = number;
            next[region] += 1;
        }
        joined
    }

    fn push(&mut self, key: RegionKey, members: &[u32]) {
        self.keys.push(key);
        self.members.extend_from_slice(members);
        self.ends.push(self.members.len() as u32);
    }

    /// Each region with its members.
    pub fn iter(&self) -> impl Iterator<Item = (RegionKey, &[u32])> {
        (0..self.keys.len()).map(|region| self.get(region))
    }

    /// A region with its members.
    pub fn get(&self, region: usize) -> (RegionKey, &[u32]) {
        let begin = region.checked_sub(1).map_or(0, |before| self.ends[before]);
        (
            self.keys[region],
            &self.members[begin as usize..self.ends[region] as usize],
        )
    }

    /// Marks all members of regions of which one member is marked.
    pub fn complete(&self, marks: &mut [bool]) {
        for (_, members) in self.iter() {
            if members.iter().any(|&member| marks[member as usize]) {
                members.iter().for_each(|&member| marks[member as usize] = true);
            }
        }
    }

    /// Returns the regions that are made again after `before`, and the keys of all regions in which the surface may differ, of both.
    /// `differs`: whether the mesh of each active region may.
    pub fn since(&self, before: &Self, differs: &[bool]) -> (Self, Vec<RegionKey>) {
        // The region of each active region.
        let mut shown = vec![NONE; differs.len()];
        for (number, (_, members)) in (0u32..).zip(before.iter()) {
            members.iter().for_each(|&member| shown[member as usize] = number);
        }
        let mut is_kept = vec![false; before.keys.len()];
        let mut made = Self::default();
        for (key, members) in self.iter() {
            let earlier = shown[members[0] as usize] as usize;
            let is_same = earlier != NONE as usize && before.get(earlier) == (key, members);
            if is_same && !members.iter().any(|&member| differs[member as usize]) {
                is_kept[earlier] = true;
            } else {
                made.push(key, members);
            }
        }
        let gone = before
            .keys
            .iter()
            .zip(is_kept)
            .filter(|(_, is_kept)| !is_kept)
            .map(|(key, _)| key);
        let mut different: Vec<RegionKey> = gone.chain(&made.keys).copied().collect();
        different.sort_unstable();
        different.dedup();
        (made, different)
    }

    /// All members, region by region.
    pub fn members(&self) -> &[u32] {
        &self.members
    }

    /// Returns the meshes of these regions, counted but without vertices. `of_members`: of each active region.
    pub fn meshes(&self, of_members: &[RegionMesh]) -> Vec<RegionMesh> {
        let sum = |(_, members): (RegionKey, &[u32])| {
            let mut mesh = RegionMesh::default();
            for &member in members {
                for (sum, count) in mesh.triangles.iter_mut().zip(of_members[member as usize].triangles) {
                    *sum += count;
                }
            }
            mesh
        };
        self.iter().map(sum).collect()
    }

    /// Returns for each active region where its triangles of each level begin in the mesh; `NONE` if it is not made. `meshes`: of these
    /// regions, with their ranges.
    pub fn level_starts(&self, meshes: &[RegionMesh], of_members: &[RegionMesh]) -> Vec<u32> {
        let mut starts = vec![NONE; 6 * of_members.len()];
        for ((_, members), mesh) in self.iter().zip(meshes) {
            let mut next = mesh.triangle_base;
            for level in 0..6 {
                for &member in members {
                    starts[6 * member as usize + level] = next;
                    next += of_members[member as usize].triangles[level];
                }
            }
        }
        starts
    }

    /// Returns the first member of each region, and the number of the region of 32³ cells at its low corner. `grid`: regions of the volume
    /// along each axis.
    pub fn corner_regions(&self, [rx, ry, _]: [u32; 3]) -> Vec<[u32; 2]> {
        let place = |(key, members): (RegionKey, &[u32])| {
            let [x, y, z] = key.coords;
            [members[0], x + rx * (y + ry * z)]
        };
        self.iter().map(place).collect()
    }
}

impl TreeRegions {
    /// `words`: of each active region, two words of its signature.
    pub(crate) fn new(tree: u64, feature: [f32; 2], regions: MeshRegions, words: &[u32]) -> Self {
        let words = words.as_chunks::<2>().0.iter();
        Self {
            tree,
            feature,
            regions,
            signatures: words
                .map(|&[low, high]| u64::from(low) | u64::from(high) << 32)
                .collect(),
        }
    }

    pub(crate) fn regions(&self) -> &MeshRegions {
        &self.regions
    }

    /// As [`MeshRegions::since`]; `None` if the cuts are not of one tree, or have not the same feature.
    pub(crate) fn since(&self, before: &Self) -> Option<(MeshRegions, Vec<RegionKey>)> {
        if (self.tree, self.feature) != (before.tree, before.feature) {
            return None;
        }
        let pairs = self.signatures.iter().zip(&before.signatures);
        let differs: Vec<bool> = pairs.map(|(now, before)| now != before).collect();
        Some(self.regions.since(&before.regions, &differs))
    }

    /// Bytes on the host.
    pub fn bytes(&self) -> u64 {
        let MeshRegions { keys, members, ends } = &self.regions;
        (size_of::<Self>()
            + size_of_val(&keys[..])
            + size_of_val(&members[..])
            + size_of_val(&ends[..])
            + size_of_val(&self.signatures[..])) as u64
    }
}

/// Keys of the active regions.
pub(crate) fn keys(pyramid: &Pyramid) -> Vec<RegionKey> {
    pyramid.region_coords().map(RegionKey::smallest).collect()
}

/// Triangles of a region's mesh.
pub(crate) fn triangles(mesh: &RegionMesh) -> usize {
    mesh.triangles.iter().sum::<u32>() as usize
}

/// Working memory of [`join_meshes`].
#[derive(Default)]
pub(crate) struct Joining {
    /// The number in the joined mesh of each vertex, and of its second and further copies in a member.
    known: FxHashMap<(Vertex, u32), u32>,
    /// Of each vertex of the joined mesh, the last member that has it.
    last_members: Vec<usize>,
    /// The number of each vertex of a member.
    numbers: Vec<u32>,
}

/// Joins the meshes of the members of a region. Vertices of several members that are equal become one. Equal vertices of one member stay
/// apart, because they are of different sheets: the second copy of a member is joined with the second copies of others, and so on.
pub(crate) fn join_meshes(joining: &mut Joining, key: RegionKey, members: &[&Region]) -> Region {
    let Joining {
        known,
        last_members,
        numbers,
    } = joining;
    known.clear();
    last_members.clear();
    let count = |of: fn(&Region) -> usize| members.iter().map(|member| of(member)).sum::<usize>();
    let mut vertices = Vec::with_capacity(count(|member| member.vertices.len()));
    let mut indices = vec![0; count(|member| member.indices.len())];
    let level_triangles =
        [0, 1, 2, 3, 4, 5].map(|level| members.iter().map(|member| member.level_triangles[level]).sum());
    // Where the next triangle of each level goes.
    let mut next = [0; 6];
    for level in 1..6 {
        next[level] = next[level - 1] + 3 * level_triangles[level - 1] as usize;
    }
    for (number, member) in members.iter().enumerate() {
        let shift = [0, 1, 2].map(|axis| (member.key().origin()[axis] - key.origin()[axis]) as i32);
        numbers.clear();
        for vertex in member.vertices.iter() {
            let position = [0, 1, 2].map(|axis| vertex.position[axis] + shift[axis]);
            let moved = Vertex { position, ..*vertex };
            let mut copy = 0;
            let index = loop {
                match known.entry((moved, copy)) {
                    Entry::Occupied(entry) if last_members[*entry.get() as usize] == number => copy += 1,
                    Entry::Occupied(entry) => break *entry.get(),
                    Entry::Vacant(entry) => {
                        vertices.push(moved);
                        last_members.push(number);
                        break *entry.insert(vertices.len() as u32 - 1);
                    }
                }
            };
            last_members[index as usize] = number;
            numbers.push(index);
        }
        let mut own = &member.indices[..];
        for (next, count) in next.iter_mut().zip(member.level_triangles) {
            let (level, coarser) = own.split_at(3 * count as usize);
            for (to, &index) in indices[*next..].iter_mut().zip(level) {
                *to = numbers[index as usize];
            }
            *next += level.len();
            own = coarser;
        }
    }
    Region {
        coords: key.coords,
        size: key.size,
        vertices: vertices.into(),
        indices: indices.into(),
        values: SharedSlice::default(),
        level_triangles,
        error: None,
    }
}

#[cfg(test)]
mod tests {
    use super::{Joining, MAX_JOINED_TRIANGLES, MeshRegions, TreeRegions, join_meshes};
    use crate::layout::RegionMesh;
    use crate::{Region, RegionKey, Vertex};
    use std::collections::BTreeMap;

    fn key(coords: [u32; 3], size: u8) -> RegionKey {
        RegionKey { coords, size }
    }

    const GRID: [u32; 3] = [12, 8, 9];

    /// The joined regions of these counts, x fastest, as numbers of active regions.
    fn joined(regions: &[([u32; 3], u32)]) -> BTreeMap<RegionKey, Vec<u32>> {
        let meshes: Vec<RegionMesh> = regions.iter().map(|(_, count)| mesh(*count)).collect();
        let coords: Vec<[u32; 3]> = regions.iter().map(|(coords, _)| *coords).collect();
        let of = MeshRegions::joined(GRID, &coords, &meshes);
        let firsts: Vec<u32> = of.iter().map(|(_, members)| members[0]).collect();
        assert!(firsts.is_sorted(), "in the order of their first members: {firsts:?}");
        of.iter().map(|(key, members)| (key, members.to_vec())).collect()
    }

    fn mesh(triangles: u32) -> RegionMesh {
        RegionMesh {
            triangles: [triangles / 2, triangles - triangles / 2, 0, 0, 0, 0],
            ..Default::default()
        }
    }

    #[test]
    fn sparse_regions_are_joined_in_the_largest_cube_that_has_few_triangles() {
        // A row of eight regions: two cubes of four, the first of which is dense at one end.
        let row =
            |counts: [u32; 8]| -> Vec<([u32; 3], u32)> { (0..8).map(|x| ([x, 5, 2], counts[x as usize])).collect() };
        let all = joined(&row([50; 8]));
        let expected = [
            (key([0, 4, 0], 2), vec![0, 1, 2, 3]),
            (key([4, 4, 0], 2), vec![4, 5, 6, 7]),
        ];
        assert_eq!(all, BTreeMap::from(expected));
        let uneven = joined(&row([1900, 200, 5, 0, 0, 0, 7, 0]));
        let expected = [
            (key([0, 5, 2], 0), vec![0]),
            (key([1, 5, 2], 0), vec![1]),
            (key([2, 5, 2], 0), vec![2]),
            (key([6, 5, 2], 0), vec![6]),
        ];
        assert_eq!(uneven, BTreeMap::from(expected));
        let halves = joined(&row([1300, 700, 50, 60, 0, 0, 0, 0]));
        let expected = [
            (key([0, 5, 2], 0), vec![0]),
            (key([1, 5, 2], 0), vec![1]),
            (key([2, 4, 2], 1), vec![2, 3]),
        ];
        assert_eq!(halves, BTreeMap::from(expected));
    }

    #[test]
    fn joined_regions_cover_those_with_triangles_once_and_stay_small() {
        let mut state = 1u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 16) % below
        };
        let mut regions = Vec::new();
        for z in 0..9 {
            for y in 0..7 {
                for x in 0..11 {
                    if random(3) > 0 {
                        let dense = random(20) == 0;
                        regions.push(([x, y, z], if dense { random(5000) } else { random(150) }));
                    }
                }
            }
        }
        let all = joined(&regions);
        let mut seen = vec![0; regions.len()];
        for (key, members) in &all {
            let triangles: u32 = members.iter().map(|&i| regions[i as usize].1).sum();
            assert!(
                key.size == 0 || triangles <= MAX_JOINED_TRIANGLES,
                "{key:?}: {triangles}"
            );
            assert_eq!(key.size == 0, members.len() == 1);
            for &member in members {
                seen[member as usize] += 1;
                assert_eq!(
                    regions[member as usize].0.map(|c| c >> key.size << key.size),
                    key.coords
                );
            }
        }
        for ((_, triangles), seen) in regions.iter().zip(seen) {
            assert_eq!(seen, u32::from(*triangles > 0));
        }
        assert!(all.keys().any(|key| key.size == 1) && all.keys().any(|key| key.size == 2));
    }

    #[test]
    fn cuts_of_a_tree_differ_where_a_signature_does() {
        let coords = [[0, 0, 0], [1, 0, 0], [4, 0, 0]];
        let of = |tree, feature, counts: [u32; 3], words: [u32; 6]| {
            let regions = MeshRegions::joined(GRID, &coords, &counts.map(mesh));
            TreeRegions::new(tree, [0.0, feature], regions, &words)
        };
        let (counts, words) = ([10, 20, 30], [1, 2, 3, 4, 5, 6]);
        let before = of(7, 1.0, counts, words);
        let since = |after: &TreeRegions| after.since(&before).map(|(made, different)| (made.keys, different));
        assert_eq!(since(&before), Some((vec![], vec![])));
        assert_eq!(since(&of(8, 1.0, counts, words)), None, "another tree");
        assert_eq!(since(&of(7, 2.0, counts, words)), None, "another feature");
        let left = vec![key([0, 0, 0], 2)];
        assert_eq!(
            since(&of(7, 1.0, counts, [1, 2, 3, 5, 5, 6])),
            Some((left.clone(), left))
        );
        let apart = [key([0, 0, 0], 0), key([1, 0, 0], 0)];
        let split = since(&of(7, 1.0, [10, 3000, 30], [1, 2, 3, 5, 5, 6]));
        assert_eq!(
            split,
            Some((apart.to_vec(), vec![apart[0], key([0, 0, 0], 2), apart[1]]))
        );
    }

    #[test]
    fn regions_are_made_again_as_a_whole() {
        let coords = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0]];
        let of = |counts: [u32; 5]| MeshRegions::joined(GRID, &coords, &counts.map(mesh));
        let (left, right) = (key([0, 0, 0], 2), key([4, 0, 0], 2));
        let counts = [10, 20, 0, 30, 40];
        let before = of(counts);
        let mut marks = [false, true, false, false, false];
        before.complete(&mut marks);
        assert_eq!(marks, [true, true, false, false, false]);
        let since = |after: [u32; 5], differs: usize| {
            let mut marks = [false; 5];
            marks[differs] = true;
            let (made, different) = of(after).since(&before, &marks);
            (made.keys, different)
        };
        assert_eq!(since([10, 21, 0, 30, 40], 1), (vec![left], vec![left]));
        // One member has become empty, the other one is alone.
        let alone = key([0, 0, 0], 0);
        assert_eq!(since([10, 0, 0, 30, 40], 1), (vec![alone], vec![alone, left]));
        // A region that was empty is in the cube of a joined one.
        assert_eq!(since([10, 20, 5, 30, 40], 2), (vec![left], vec![left]));
        let apart = [key([4, 0, 0], 0), key([5, 0, 0], 0)];
        assert_eq!(
            since([10, 20, 0, 5000, 40], 3),
            (apart.to_vec(), vec![apart[0], right, apart[1]])
        );
        let (made, different) = before.since(&of([10, 20, 0, 5000, 40]), &[false, false, false, true, false]);
        assert_eq!((made.keys, different), (vec![right], vec![apart[0], right, apart[1]]));
        let (made, different) = of(counts).since(&before, &[false; 5]);
        assert!(made.keys.is_empty() && different.is_empty());
    }

    #[test]
    fn vertices_of_several_members_become_one() {
        let vertex = |x: i32, feature: u16| Vertex {
            position: [x, 7, 9],
            normal: [1, 2],
            smoothness: 3,
            feature,
        };
        let member = |coords, vertices: Vec<Vertex>, indices: Vec<u32>, levels: [u32; 6]| Region {
            coords,
            vertices: vertices.into(),
            indices: indices.into(),
            level_triangles: levels,
            ..Default::default()
        };
        let cells = 32 * Vertex::LATTICE;
        // The second one has two equal vertices, one of which is the first one's.
        let members = [
            member(
                [2, 0, 0],
                vec![vertex(5, 0), vertex(cells, 1), vertex(8, 2)],
                vec![0, 1, 2, 2, 1, 0],
                [1, 0, 1, 0, 0, 0],
            ),
            member(
                [3, 0, 0],
                vec![vertex(0, 1), vertex(0, 1), vertex(3, 1)],
                vec![0, 2, 1, 1, 2, 0],
                [0, 1, 1, 0, 0, 0],
            ),
        ];
        let joined = join_meshes(&mut Joining::default(), key([2, 0, 0], 1), &[&members[0], &members[1]]);
        let expected = [
            vertex(5, 0),
            vertex(cells, 1),
            vertex(8, 2),
            vertex(cells, 1),
            vertex(cells + 3, 1),
        ];
        assert_eq!(*joined.vertices, expected);
        assert_eq!(*joined.indices, [0, 1, 2, 1, 4, 3, 2, 1, 0, 3, 4, 1]);
        assert_eq!(
            (joined.level_triangles, joined.key()),
            ([1, 1, 2, 0, 0, 0], key([2, 0, 0], 1))
        );
    }

    #[test]
    fn triangles_of_a_joined_region_are_in_order_of_their_levels() {
        let members = [mesh(4), mesh(6), mesh(2)];
        let regions = MeshRegions::joined(GRID, &[[0, 0, 0], [1, 0, 0], [9, 0, 0]], &members);
        let mut meshes = regions.meshes(&members);
        assert_eq!(meshes.iter().map(|mesh| mesh.triangles[0]).collect::<Vec<_>>(), [5, 1]);
        meshes[1].triangle_base = 10;
        let starts = regions.level_starts(&meshes, &members);
        let of = |member: usize| [starts[6 * member], starts[6 * member + 1]];
        assert_eq!([of(0), of(1), of(2)], [[0, 5], [2, 7], [10, 11]]);
        assert_eq!(regions.corner_regions([12, 3, 3]), [[0, 0], [2, 9]]);
    }
}
