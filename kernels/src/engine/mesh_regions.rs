//! The regions in which a cut is meshed: larger ones where it has few triangles (`docs/algorithm.md#91-regions-that-grow`).

use super::peel::triangles;
use crate::layout::{NONE, RegionMesh};
use crate::pyramid::morton;
use crate::{Pyramid, Region, RegionKey, Vertex};
use rustc_hash::{FxHashMap, FxHashSet};

/// Exponent of the size of the largest regions. The stream has 16 bits for a coordinate, and a vertex may lie far outside of its region.
const MAX_SIZE: u8 = 2;

/// Maximum triangles of a region that consists of several.
const MAX_JOINED_TRIANGLES: u32 = 1000;

/// Regions are joined if they have fewer triangles than this, on average.
const SPARSE_TRIANGLES: u32 = 100;

/// Regions of a mesh, each with the active regions that it consists of.
#[derive(Default)]
pub(super) struct MeshRegions {
    pub keys: Vec<RegionKey>,
    /// Numbers of active regions, in ascending order within a region.
    members: Vec<u32>,
    /// Of each region, the end of its members.
    ends: Vec<u32>,
}

/// What the surface of a cut of a vertex tree is in each region. Tells in which regions the surface of another cut of the same tree differs.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeRegions {
    /// Id of the tree.
    tree: u64,
    /// Minimum and span of the feature's range, on which values at vertices depend.
    feature: [f32; 2],
    /// Each region that has triangles with its signature, in ascending order. Equal signatures mean equal meshes; the probability that those
    /// of different meshes are equal is 10⁻¹⁹.
    signatures: Vec<(RegionKey, u64)>,
}

impl MeshRegions {
    /// Returns all active regions, including empty ones.
    pub fn all(pyramid: &Pyramid) -> Self {
        let count = pyramid.host_regions.len() as u32;
        Self {
            keys: pyramid.region_coords().map(RegionKey::smallest).collect(),
            members: (0..count).collect(),
            ends: (1..=count).collect(),
        }
    }

    /// Returns the regions that have triangles, joined where they are sparse. `coords`, `meshes`: of each active region.
    pub fn joined(coords: impl Iterator<Item = [u32; 3]>, meshes: &[RegionMesh]) -> Self {
        let counts: Vec<u32> = meshes.iter().map(|mesh| triangles(mesh) as u32).collect();
        let filled = (0u32..).zip(coords).filter(|(number, _)| counts[*number as usize] > 0);
        let mut order: Vec<(u64, u32, [u32; 3])> = filled
            .map(|(number, coords)| (morton(coords), number, coords))
            .collect();
        order.sort_unstable();
        let mut groups = Vec::new();
        join(&order, MAX_SIZE, &counts, &mut groups);
        groups.sort_unstable_by_key(|(_, members)| members.first().copied());
        let mut joined = Self::default();
        for (key, members) in groups {
            joined.push(key, &members);
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
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        let ranges = begins.zip(&self.ends).map(|(begin, &end)| begin as usize..end as usize);
        self.keys.iter().copied().zip(ranges.map(|range| &self.members[range]))
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
    /// `remade`: active regions whose mesh may differ.
    pub fn since(&self, before: &Self, remade: &[bool]) -> (Self, Vec<RegionKey>) {
        let shown: FxHashMap<RegionKey, &[u32]> = before.iter().collect();
        let is_kept = |key: RegionKey, members: &[u32]| {
            shown.get(&key) == Some(&members) && !members.iter().any(|&member| remade[member as usize])
        };
        let (mut made, mut kept) = (Self::default(), FxHashSet::default());
        for (key, members) in self.iter() {
            if is_kept(key, members) {
                kept.insert(key);
            } else {
                made.push(key, members);
            }
        }
        let gone = before.keys.iter().filter(|key| !kept.contains(key));
        let mut different: Vec<RegionKey> = gone.chain(&made.keys).copied().collect();
        different.sort_unstable();
        different.dedup();
        (made, different)
    }

    /// All members, region by region.
    pub fn members(&self) -> &[u32] {
        &self.members
    }

    /// Returns the signatures of a surface. `of_members`: two words for each active region.
    pub fn signatures(&self, of_members: &[u32], tree: u64, feature: [f32; 2]) -> TreeRegions {
        let word = |member: u32| {
            let [low, high] = [0, 1].map(|i| u64::from(of_members[2 * member as usize + i]));
            low | high << 32
        };
        let signature = |members: &[u32]| {
            let step =
                |all: u64, &member: &u32| (all.rotate_left(23) ^ word(member)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            members.iter().fold(0, step)
        };
        let mut signatures: Vec<_> = self.iter().map(|(key, members)| (key, signature(members))).collect();
        signatures.sort_unstable();
        TreeRegions {
            tree,
            feature,
            signatures,
        }
    }

    /// Returns the regions that are not the same in `shown`. `now`: signatures of these regions.
    pub fn without_those_of(&self, shown: &TreeRegions, now: &TreeRegions) -> Self {
        let mut changed = Self::default();
        for (key, members) in self.iter() {
            let signature = now
                .signatures
                .binary_search_by_key(&key, |(key, _)| *key)
                .map(|at| now.signatures[at]);
            if signature.is_ok_and(|signature| !shown.contains(&signature)) {
                changed.push(key, members);
            }
        }
        changed
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

    /// Returns the first member of each region, and the number of the region of 32³ cells at its low corner. `regions`: those of the grid
    /// along each axis.
    pub fn places(&self, [rx, ry, _]: [u32; 3]) -> Vec<[u32; 2]> {
        let place = |(key, members): (RegionKey, &[u32])| {
            let [x, y, z] = key.coords;
            [members[0], x + rx * (y + ry * z)]
        };
        self.iter().map(place).collect()
    }
}

impl TreeRegions {
    /// Whether the signatures of two surfaces can be compared.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.tree == other.tree && self.feature == other.feature
    }

    fn contains(&self, entry: &(RegionKey, u64)) -> bool {
        self.signatures.binary_search(entry).is_ok()
    }

    /// Returns the regions in which the surfaces differ, of both.
    pub(super) fn differences(&self, other: &Self) -> Vec<RegionKey> {
        let only = |of: &Self, other: &Self| -> Vec<RegionKey> {
            let missing = of.signatures.iter().filter(|entry| !other.contains(entry));
            missing.map(|(key, _)| *key).collect()
        };
        let mut different = only(self, other);
        different.extend(only(other, self));
        different.sort_unstable();
        different.dedup();
        different
    }

    /// Bytes on the host.
    pub fn bytes(&self) -> u64 {
        (size_of::<Self>() + self.signatures.len() * size_of::<(RegionKey, u64)>()) as u64
    }
}

/// Joins the meshes of the members of a region. Vertices of several members that are equal become one. Equal vertices of one member stay
/// apart, because they are of different sheets.
pub(super) fn join_meshes(key: RegionKey, members: &[Region]) -> Region {
    let vertex_count = members.iter().map(|member| member.vertices.len()).sum();
    let (mut vertices, mut level_indices) = (Vec::with_capacity(vertex_count), [const { Vec::new() }; 6]);
    let mut known: FxHashMap<Vertex, (u32, usize)> = FxHashMap::default();
    let mut numbers = Vec::new();
    for (number, member) in members.iter().enumerate() {
        let shift = [0, 1, 2].map(|axis| (member.key().origin()[axis] - key.origin()[axis]) as i32);
        numbers.clear();
        for vertex in member.vertices.iter() {
            let position = [0, 1, 2].map(|axis| vertex.position[axis] + shift[axis]);
            let moved = Vertex { position, ..*vertex };
            let new = vertices.len() as u32;
            let (index, last_member) = known.entry(moved).or_insert((new, usize::MAX));
            let is_joined = *index != new && *last_member != number;
            *last_member = number;
            if !is_joined {
                vertices.push(moved);
            }
            numbers.push(if is_joined { *index } else { new });
        }
        let mut indices = &member.indices[..];
        for (of_level, count) in level_indices.iter_mut().zip(member.level_triangles) {
            let (level, coarser) = indices.split_at(3 * count as usize);
            of_level.extend(level.iter().map(|&index| numbers[index as usize]));
            indices = coarser;
        }
    }
    Region {
        coords: key.coords,
        size: key.size,
        level_triangles: [0, 1, 2, 3, 4, 5].map(|level: usize| level_indices[level].len() as u32 / 3),
        vertices: vertices.into(),
        indices: level_indices.concat().into(),
        error: None,
    }
}

/// Joins sparse regions within each cube of this size, and otherwise within smaller ones. `order`: regions with triangles, in Morton order.
fn join(order: &[(u64, u32, [u32; 3])], size: u8, counts: &[u32], groups: &mut Vec<(RegionKey, Vec<u32>)>) {
    for cube in order.chunk_by(|a, b| a.0 >> (3 * size) == b.0 >> (3 * size)) {
        if let [(_, number, coords)] = *cube {
            groups.push((RegionKey::smallest(coords), vec![number]));
            continue;
        }
        let triangles: u32 = cube.iter().map(|(_, number, _)| counts[*number as usize]).sum();
        if triangles > MAX_JOINED_TRIANGLES || triangles >= SPARSE_TRIANGLES * cube.len() as u32 {
            join(cube, size - 1, counts, groups);
            continue;
        }
        let coords = cube[0].2.map(|c| c >> size << size);
        let mut members: Vec<u32> = cube.iter().map(|(_, number, _)| *number).collect();
        members.sort_unstable();
        groups.push((RegionKey { coords, size }, members));
    }
}

#[cfg(test)]
mod tests {
    use super::{MAX_JOINED_TRIANGLES, MeshRegions, TreeRegions, join_meshes};
    use crate::layout::RegionMesh;
    use crate::{Region, RegionKey, Vertex};
    use std::collections::BTreeMap;

    fn key(coords: [u32; 3], size: u8) -> RegionKey {
        RegionKey { coords, size }
    }

    /// The joined regions of these counts, x fastest, as numbers of active regions.
    fn joined(regions: &[([u32; 3], u32)]) -> BTreeMap<RegionKey, Vec<u32>> {
        let meshes: Vec<RegionMesh> = regions.iter().map(|(_, count)| mesh(*count)).collect();
        let of = MeshRegions::joined(regions.iter().map(|(coords, _)| *coords), &meshes);
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
        let uneven = joined(&row([900, 200, 5, 0, 0, 0, 7, 0]));
        let expected = [
            (key([0, 5, 2], 0), vec![0]),
            (key([1, 5, 2], 0), vec![1]),
            (key([2, 5, 2], 0), vec![2]),
            (key([6, 5, 2], 0), vec![6]),
        ];
        assert_eq!(uneven, BTreeMap::from(expected));
        let halves = joined(&row([300, 300, 50, 60, 0, 0, 0, 0]));
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
                        regions.push(([x, y, z], if dense { random(3000) } else { random(150) }));
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
    fn differences_name_regions_of_both_surfaces() {
        let coords = [[0, 0, 0], [1, 0, 0], [4, 0, 0]];
        let of = |counts: [u32; 3], words: [u32; 6]| -> (MeshRegions, TreeRegions) {
            let regions = MeshRegions::joined(coords.into_iter(), &counts.map(mesh));
            let signatures = regions.signatures(&words, 7, [0.0, 1.0]);
            (regions, signatures)
        };
        let (_, before) = of([10, 20, 30], [1, 2, 3, 4, 5, 6]);
        let (same, again) = of([10, 20, 30], [1, 2, 3, 4, 5, 6]);
        assert!(same.without_those_of(&before, &again).keys.is_empty() && before.differences(&again).is_empty());
        let (changed, after) = of([10, 20, 30], [1, 2, 3, 5, 5, 6]);
        assert_eq!(changed.without_those_of(&before, &after).keys, [key([0, 0, 0], 2)]);
        let (split, after) = of([10, 1000, 30], [1, 2, 3, 5, 5, 6]);
        assert_eq!(
            split.without_those_of(&before, &after).keys,
            [key([0, 0, 0], 0), key([1, 0, 0], 0)]
        );
        let keys = [key([0, 0, 0], 0), key([0, 0, 0], 2), key([1, 0, 0], 0)];
        assert_eq!(before.differences(&after), keys);
        assert_eq!(after.differences(&before), keys);
    }

    #[test]
    fn regions_are_made_again_as_a_whole() {
        let coords = [[0, 0, 0], [1, 0, 0], [4, 0, 0], [5, 0, 0]];
        let of = |counts: [u32; 4]| MeshRegions::joined(coords.into_iter(), &counts.map(mesh));
        let (left, right) = (key([0, 0, 0], 2), key([4, 0, 0], 2));
        let before = of([10, 20, 30, 40]);
        let mut marks = [false, true, false, false];
        before.complete(&mut marks);
        assert_eq!(marks, [true, true, false, false]);
        let (made, different) = of([10, 21, 30, 40]).since(&before, &[false, true, false, false]);
        assert_eq!((made.keys, different), (vec![left], vec![left]));
        // One member has become empty, the others stay as they are.
        let (made, different) = of([10, 0, 30, 40]).since(&before, &[false, true, false, false]);
        assert_eq!(
            (made.keys, different),
            (vec![key([0, 0, 0], 0)], vec![key([0, 0, 0], 0), left])
        );
        let (made, different) = of([10, 20, 900, 40]).since(&before, &[false, false, true, false]);
        let apart = [key([4, 0, 0], 0), key([5, 0, 0], 0)];
        assert_eq!(
            (made.keys, different),
            (apart.to_vec(), vec![apart[0], right, apart[1]])
        );
        let (made, different) = of([10, 20, 30, 40]).since(&before, &[false; 4]);
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
        let joined = join_meshes(key([2, 0, 0], 1), &members);
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
        let regions = MeshRegions::joined([[0, 0, 0], [1, 0, 0], [9, 0, 0]].into_iter(), &members);
        let mut meshes = regions.meshes(&members);
        assert_eq!(meshes.iter().map(|mesh| mesh.triangles[0]).collect::<Vec<_>>(), [5, 1]);
        meshes[1].triangle_base = 10;
        let starts = regions.level_starts(&meshes, &members);
        let of = |member: usize| [starts[6 * member], starts[6 * member + 1]];
        assert_eq!([of(0), of(1), of(2)], [[0, 5], [2, 7], [10, 11]]);
        assert_eq!(regions.places([12, 3, 3]), [[0, 0], [2, 9]]);
    }
}
