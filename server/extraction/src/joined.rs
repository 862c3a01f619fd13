//! Joins the regions of a surface into one mesh.

use isopeel_geometry::{DVec3, IndexSpace};
use isopeel_kernels::{Region, Vertex};
use rustc_hash::{FxHashMap, FxHashSet};

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

/// Triangles of a surface as one mesh.
#[derive(Debug)]
pub struct Joined {
    /// Triangles, counter-clockwise seen from the side of lower values in index space, finest level first.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles of each level, 0 (finest) first.
    pub level_triangles: [u64; 6],
}

/// Joins regions. Vertices of different regions whose attributes are all equal become one. All triangles stay, including degenerate ones.
/// `add` is called once for each vertex, in the order of their numbers, with the position on the lattice of the whole volume:
/// [`Vertex::LATTICE`] units a cell, from sample (0, 0, 0). Polls `is_cancelled` for each region.
///
/// # Errors
/// [`JoinError`], and the errors of `add`.
pub fn join<E: From<JoinError>>(
    regions: &[Region],
    is_cancelled: &dyn Fn() -> bool,
    mut add: impl FnMut([i64; 3], &Vertex) -> Result<(), E>,
) -> Result<Joined, E> {
    let mut level_triangles = [0; 6];
    for region in regions {
        check(region)?;
        for (sum, count) in level_triangles.iter_mut().zip(region.level_triangles) {
            *sum += u64::from(count);
        }
    }
    let vertex_count: u64 = regions.iter().map(|region| region.vertices.len() as u64).sum();
    u32::try_from(vertex_count).map_err(|_| JoinError::TooManyVertices(vertex_count))?;
    // Index of the next triangle of each level.
    let mut next = [0usize; 6];
    for level in 1..6 {
        next[level] = next[level - 1] + level_triangles[level - 1] as usize;
    }
    let mut triangles = vec![[0; 3]; level_triangles.iter().sum::<u64>() as usize];
    let mut vertices = Vertices::new(regions);
    for region in regions {
        if is_cancelled() {
            return Err(JoinError::Cancelled.into());
        }
        let numbers = vertices.join(region, &mut add)?;
        let mut corners = region.indices.chunks_exact(3);
        for (level, &count) in region.level_triangles.iter().enumerate() {
            for corner in corners.by_ref().take(count as usize) {
                triangles[next[level]] = [0, 1, 2].map(|i| numbers[corner[i] as usize]);
                next[level] += 1;
            }
        }
    }
    Ok(Joined {
        triangles,
        level_triangles,
    })
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
        let mut positions = Vec::new();
        let joined = join(regions, &|| false, |lattice, _| {
            let index = DVec3::from(lattice.map(|coordinate| coordinate as f64)) / f64::from(Vertex::LATTICE);
            positions.push(space.world(index).to_array());
            Ok::<_, JoinError>(())
        })?;
        let mut triangles = joined.triangles;
        if space.world_from_even.matrix3.determinant() < 0.0 {
            triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        }
        Ok(Self { positions, triangles })
    }
}

/// The vertices that were joined so far.
#[derive(Default)]
struct Vertices {
    /// Number of vertices so far, which is the number of the next vertex.
    count: u32,
    /// Keys of the vertices that lie outside the region that lists them. Another region may list the same vertex inside.
    outside: FxHashSet<Key>,
    /// Maximum distance of a vertex in `outside` from its region, lattice units. A vertex that is farther inside its region is in no other
    /// region, and so is not looked up. Of the vertices nearer to the faces, only those on a face or in `outside` are looked up.
    overhang: i32,
    /// Numbers of the vertices that regions may share, by their keys and the numbers of their copies. See [`Vertices::join`].
    shared: FxHashMap<(Key, u32), u32>,
    /// For each key in the current region, the number of its last copy.
    copies: FxHashMap<Key, u32>,
    /// Numbers of the current region's vertices.
    joined: Vec<u32>,
}

impl Vertices {
    fn new(regions: &[Region]) -> Self {
        let (mut outside, mut overhang) = (FxHashSet::default(), 0);
        for region in regions {
            let edge = region.key().lattice();
            for vertex in &region.vertices {
                let beyond = -distance_inside(edge, vertex);
                if beyond > 0 {
                    outside.insert(key(region, vertex));
                    overhang = overhang.max(beyond);
                }
            }
        }
        Self {
            outside,
            overhang,
            ..Self::default()
        }
    }

    /// Joins the vertices of a region, and returns their numbers.
    fn join<E>(
        &mut self,
        region: &Region,
        add: &mut impl FnMut([i64; 3], &Vertex) -> Result<(), E>,
    ) -> Result<&[u32], E> {
        self.joined.clear();
        self.copies.clear();
        let edge = region.key().lattice();
        for vertex in &region.vertices {
            let key = key(region, vertex);
            let new = self.count;
            let inside = distance_inside(edge, vertex);
            let index = if inside > self.overhang || (inside > 0 && !self.outside.contains(&key)) {
                new
            } else {
                // Equal vertices of one region are not joined, because they are crossings on several edges of a sample that the surface
                // passes through. The first copy is joined with the first copies of other regions, the second with the second, and so on.
                let copy = self.copies.entry(key).and_modify(|copy| *copy += 1).or_insert(0u32);
                *self.shared.entry((key, *copy)).or_insert(new)
            };
            if index == new {
                add(key.0, vertex)?;
                self.count += 1;
            }
            self.joined.push(index);
        }
        Ok(&self.joined)
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
