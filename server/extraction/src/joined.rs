//! Joins the regions of a surface into one mesh.

use std::collections::hash_map::Entry;

use isopeel_geometry::{DVec3, IndexSpace};
use isopeel_kernels::{Region, Vertex};
use rayon::prelude::*;
use rustc_hash::{FxBuildHasher, FxHashMap, FxHashSet};

/// All attributes of a vertex, with the position on the lattice of the whole volume. Vertices with equal keys are joined.
type Key = ([i64; 3], [i16; 2], u16, u16);

/// Why regions cannot be joined.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// There are more vertices than 32-bit indices can address.
    #[error("vertices: {0}, a 32-bit index allows {max}", max = u32::MAX)]
    TooManyVertices(u64),
    /// A region is not consistent.
    #[error("region {region:?}: {why}")]
    BadRegion {
        /// The region.
        region: [u32; 3],
        /// What was found and what was expected.
        why: String,
    },
    /// The caller has cancelled the work.
    #[error("cancelled")]
    Cancelled,
}

/// The vertices and triangles of a surface as one mesh.
#[derive(Debug)]
pub struct Joined {
    /// For each vertex, the position of its region in the list of regions, and its number in this region.
    pub vertices: Vec<[u32; 2]>,
    /// Triangles, counter-clockwise seen from the side of lower values in index space, finest level first.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles of each level, 0 (finest) first.
    pub level_triangles: [u64; 6],
}

impl Joined {
    /// Joins regions. Vertices of different regions whose attributes are all equal become one. All triangles stay, including degenerate
    /// ones. Polls `is_cancelled` for each region. Works in parallel, except for the numbering of the vertices.
    ///
    /// # Errors
    /// [`JoinError`].
    pub fn new(regions: &[Region], is_cancelled: &dyn Fn() -> bool) -> Result<Self, JoinError> {
        regions.par_iter().try_for_each(check)?;
        let vertex_count: u64 = regions.iter().map(|region| region.vertices.len() as u64).sum();
        u32::try_from(vertex_count).map_err(|_| JoinError::TooManyVertices(vertex_count))?;
        let shared = shared_vertices(regions);
        let mut vertices = Vertices::with_capacity(vertex_count as usize, shared.iter().map(Vec::len).sum());
        for (number, (region, shared)) in (0..).zip(regions.iter().zip(&shared)) {
            if is_cancelled() {
                return Err(JoinError::Cancelled);
            }
            vertices.join(number, region, shared);
        }
        let mut level_triangles = [0; 6];
        for region in regions {
            for (sum, count) in level_triangles.iter_mut().zip(region.level_triangles) {
                *sum += u64::from(count);
            }
        }
        Ok(Self {
            triangles: triangles(regions, &vertices.joined, level_triangles),
            vertices: vertices.sources,
            level_triangles,
        })
    }
}

/// Returns the triangles of all regions, finest level first. `numbers`: the numbers of the vertices of all regions, one region after
/// another.
fn triangles(regions: &[Region], numbers: &[u32], level_triangles: [u64; 6]) -> Vec<[u32; 3]> {
    let mut triangles = vec![[0; 3]; level_triangles.iter().sum::<u64>() as usize];
    let mut rest = &mut triangles[..];
    let mut levels = level_triangles.map(|count| rest.split_off_mut(..count as usize).unwrap_or_default());
    let mut rest = numbers;
    // Each region fills its part of the triangles of each level.
    let parts: Vec<_> = regions
        .iter()
        .map(|region| {
            let of_region = rest.split_off(..region.vertices.len()).unwrap_or_default();
            let counts = region.level_triangles;
            let targets = [0, 1, 2, 3, 4, 5].map(|level: usize| {
                let count = counts[level] as usize;
                levels[level].split_off_mut(..count).unwrap_or_default()
            });
            (region, of_region, targets)
        })
        .collect();
    parts.into_par_iter().for_each(|(region, numbers, targets)| {
        let corners = region.indices.chunks_exact(3);
        for (triangle, corner) in targets.into_iter().flatten().zip(corners) {
            *triangle = [0, 1, 2].map(|i| numbers[corner[i] as usize]);
        }
    });
    triangles
}

/// A surface in the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldMesh {
    /// Positions of the vertices, world units.
    pub positions: Vec<[f64; 3]>,
    /// Triangles, counter-clockwise seen from the side of lower values, finest level first.
    pub triangles: Vec<[u32; 3]>,
}

impl WorldMesh {
    /// Joins regions of a surface. `space`: position of the surface's index space in the world.
    ///
    /// # Errors
    /// There are more vertices than 32-bit indices can address, or the indices or levels of a region do not match its vertices and
    /// triangles.
    pub fn new(regions: &[Region], space: &IndexSpace) -> Result<Self, JoinError> {
        let joined = Joined::new(regions, &|| false)?;
        let position = |&[region, vertex]: &[u32; 2]| {
            let region = &regions[region as usize];
            let lattice = region.position_of(&region.vertices[vertex as usize]);
            let index = DVec3::from(lattice.map(|coordinate| coordinate as f64)) / f64::from(Vertex::LATTICE);
            space.world(index).to_array()
        };
        let positions = joined.vertices.iter().map(position).collect();
        let mut triangles = joined.triangles;
        if space.world_from_even.matrix3.determinant() < 0.0 {
            triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        }
        Ok(Self { positions, triangles })
    }
}

/// Returns for each region the vertices that another region may have too: those on its faces, those outside of it, and those that another
/// region has outside of itself.
fn shared_vertices(regions: &[Region]) -> Vec<Vec<u32>> {
    let outside_of = |region: &Region| {
        let edge = region.key().lattice();
        let (mut outside, mut overhang) = (Vec::new(), 0);
        for vertex in &region.vertices {
            let beyond = -distance_inside(edge, vertex);
            if beyond > 0 {
                outside.push(key(region, vertex));
                overhang = overhang.max(beyond);
            }
        }
        (outside, overhang)
    };
    let outside: Vec<_> = regions.par_iter().map(outside_of).collect();
    // A vertex that is farther inside its region than any vertex is outside is in no other region.
    let overhang = outside.iter().map(|&(_, overhang)| overhang).max().unwrap_or(0);
    let count = outside.iter().map(|(outside, _)| outside.len()).sum();
    let mut of_any = FxHashSet::with_capacity_and_hasher(count, FxBuildHasher);
    of_any.extend(outside.into_iter().flat_map(|(outside, _)| outside));
    let shared_of = |region: &Region| {
        let edge = region.key().lattice();
        let is_shared = |vertex: &Vertex| {
            let inside = distance_inside(edge, vertex);
            inside <= 0 || (inside <= overhang && of_any.contains(&key(region, vertex)))
        };
        let numbered = region.vertices.iter().zip(0..);
        numbered
            .filter_map(|(vertex, number)| is_shared(vertex).then_some(number))
            .collect()
    };
    regions.par_iter().map(shared_of).collect()
}

/// The vertices that were joined so far.
struct Vertices {
    /// Region and number in the region of each vertex so far.
    sources: Vec<[u32; 2]>,
    /// Vertices that regions may share, by their keys.
    shared: FxHashMap<Key, Shared>,
    /// Numbers of the second and further copies of vertices that regions may share, by their keys and the numbers of the copies.
    copies: FxHashMap<(Key, u32), u32>,
    /// Numbers of the vertices of all regions so far, one region after another.
    joined: Vec<u32>,
}

/// A vertex that regions may share.
struct Shared {
    /// Number of the first copy.
    number: u32,
    /// The last region that has the vertex.
    region: u32,
    /// Further copies in this region.
    copies: u32,
}

impl Vertices {
    fn with_capacity(vertices: usize, shared: usize) -> Self {
        Self {
            sources: Vec::with_capacity(vertices),
            shared: FxHashMap::with_capacity_and_hasher(shared, FxBuildHasher),
            copies: FxHashMap::default(),
            joined: Vec::with_capacity(vertices),
        }
    }

    /// Joins the vertices of the region with a number. `shared`: those that another region may have too.
    fn join(&mut self, number: u32, region: &Region, shared: &[u32]) {
        let mut first = 0;
        for &vertex in shared {
            self.add(number, first..vertex);
            first = vertex + 1;
            let new = self.sources.len() as u32;
            let known = self.number_of(key(region, &region.vertices[vertex as usize]), number, new);
            if known == new {
                self.add(number, vertex..first);
            } else {
                self.joined.push(known);
            }
        }
        self.add(number, first..region.vertices.len() as u32);
    }

    /// Returns the number of a vertex that regions may share. This is `new` if no earlier region has it.
    ///
    /// Equal vertices of one region are not joined, because they are crossings on several edges of a sample that the surface passes
    /// through. The first copy is joined with the first copies of other regions, the second with the second, and so on.
    fn number_of(&mut self, key: Key, region: u32, new: u32) -> u32 {
        let first = Shared {
            number: new,
            region,
            copies: 0,
        };
        let shared = match self.shared.entry(key) {
            Entry::Vacant(entry) => return entry.insert(first).number,
            Entry::Occupied(entry) => entry.into_mut(),
        };
        if shared.region != region {
            (shared.region, shared.copies) = (region, 0);
            return shared.number;
        }
        shared.copies += 1;
        *self.copies.entry((key, shared.copies)).or_insert(new)
    }

    /// Adds vertices that no earlier region has.
    fn add(&mut self, region: u32, vertices: std::ops::Range<u32>) {
        let new = self.sources.len() as u32;
        self.joined.extend(new..new + vertices.len() as u32);
        self.sources.extend(vertices.map(|vertex| [region, vertex]));
    }
}

/// Returns the distance of a vertex from the nearest face of its region, in lattice units; negative if the vertex is outside the region.
/// `edge`: length of the region's edges.
fn distance_inside(edge: i32, vertex: &Vertex) -> i32 {
    let [x, y, z] = vertex.position.map(|coordinate| coordinate.min(edge - coordinate));
    x.min(y).min(z)
}

fn key(region: &Region, vertex: &Vertex) -> Key {
    (
        region.position_of(vertex),
        vertex.normal,
        vertex.smoothness,
        vertex.feature,
    )
}

/// Refuses a region whose indices would be out of bounds.
fn check(region: &Region) -> Result<(), JoinError> {
    let bad = |why| {
        Err(JoinError::BadRegion {
            region: region.coords,
            why,
        })
    };
    let levels: u64 = region.level_triangles.iter().map(|&count| u64::from(count)).sum();
    if region.indices.len() as u64 != 3 * levels {
        return bad(format!(
            "{} indices, expected 3 for each of {levels} triangles",
            region.indices.len()
        ));
    }
    let vertices = region.vertices.len();
    if let Some(index) = region.indices.iter().find(|&&i| i as usize >= vertices) {
        return bad(format!("index {index}, expected less than {vertices}, its vertices"));
    }
    Ok(())
}
