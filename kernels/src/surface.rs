//! The result: regions of indexed triangles.

use crate::interned::StaticText;
use crate::{Level, REGION_CELLS, SharedSlice};

/// One vertex as it leaves the device: 20 bytes, on a lattice that all regions share.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Position from the region's low corner in units of 1/[`Vertex::LATTICE`] cell. Mostly inside of the region; a patched
    /// vertex, or one of a neighbour's leaf, may lie outside.
    pub position: [i32; 3],
    /// Unit normal towards lower values, octahedral, two signed 16-bit numbers over 32767; grid axes, world lengths.
    pub normal: [i16; 2],
    /// Smoothness feature `s` of eq. 1, times 65535.
    pub smoothness: u16,
    /// Normalised user feature `f̂`, times 65535.
    pub feature: u16,
}

impl Vertex {
    /// Lattice units per cell.
    pub const LATTICE: i32 = 1 << 16;

    /// Unit normal towards lower values, along the grid's axes in world lengths.
    pub fn unit_normal(&self) -> [f32; 3] {
        unit_of_octahedral(self.normal.map(|v| (f32::from(v) / 32767.0).max(-1.0)))
    }
}

/// The unit vector of octahedral coordinates, each within ±1.
pub(crate) fn unit_of_octahedral([x, y]: [f32; 2]) -> [f32; 3] {
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let (x, y) = (x - fold.copysign(x), y - fold.copysign(y));
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// Distance between a mesh and the full-resolution surface, in world units (`docs/algorithm.md#67-measured-error`): of each
/// full-resolution crossing to the mesh, and of points on each triangle to the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SurfaceError {
    /// Root of the mean of the two mean squares.
    pub rms: f32,
    /// Maximum over both.
    pub max: f32,
}

/// Estimated distance of a surface from the full one, from the quadrics of its leaves, in world units. Known before the surface is made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ErrorEstimate {
    /// Root mean square over the leaves, each weighted by the undecimated triangles that it represents.
    pub rms: f32,
    /// Root mean square of the worst leaf. Not a maximum: a leaf's own crossings may lie further off.
    pub worst_leaf: f32,
}

/// A region: an aligned cube of 32·2ˢ cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct RegionKey {
    /// Low corner in units of 32 cells, multiples of 2ˢ.
    pub coords: [u32; 3],
    /// The exponent s: 0, except where a surface has few triangles (`docs/algorithm.md#91-regions-that-grow`).
    pub size: u8,
}

#[cfg(feature = "serde")]
crate::checked_serde!(RegionKey, RegionKey::check);

impl RegionKey {
    /// The region of 32 cells with this low corner.
    pub fn smallest(coords: [u32; 3]) -> Self {
        Self { coords, size: 0 }
    }

    /// Checks that the positions of the region fit their types.
    #[cfg(feature = "serde")]
    fn check(&self) -> Result<(), &'static str> {
        let is_inside = self.coords.iter().all(|&c| c.checked_mul(REGION_CELLS).is_some());
        let largest = (i32::MAX / (REGION_CELLS as i32 * Vertex::LATTICE)).ilog2();
        let is_usable = is_inside && u32::from(self.size) <= largest;
        is_usable.then_some(()).ok_or("a region beyond the largest volume")
    }

    /// Length of an edge in units of a vertex position.
    #[inline]
    pub fn lattice(self) -> i32 {
        (REGION_CELLS << self.size) as i32 * Vertex::LATTICE
    }

    /// Low corner in units of a vertex position.
    #[inline]
    pub fn origin(self) -> [i64; 3] {
        self.coords
            .map(|c| i64::from(c * REGION_CELLS) * i64::from(Vertex::LATTICE))
    }
}

/// The part of a surface in one region. Triangles of the region share vertices. A vertex of several regions has identical bits in each,
/// except that positions are relative to the region's origin.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct Region {
    /// Low corner of the region in units of 32 cells: [`RegionKey::coords`].
    pub coords: [u32; 3],
    /// Size of the region: [`RegionKey::size`].
    pub size: u8,
    /// Vertices.
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    pub vertices: SharedSlice<Vertex>,
    /// Three per triangle, counter-clockwise seen from the side of lower values; ordered by level, finest first.
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    pub indices: SharedSlice<u32>,
    /// The value of a field at each vertex ([`crate::Engine::vertex_values`]), NaN beside missing samples; empty if none was asked for.
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    pub values: SharedSlice<f32>,
    /// Triangles of each level, 0 (finest) first.
    pub level_triangles: [u32; 6],
    /// Measured distance from the full surface, if [`crate::CutParams::state_error`] requests it.
    pub error: Option<SurfaceError>,
}

#[cfg(feature = "serde")]
crate::checked_serde!(Region, Region::check);

impl Region {
    /// Checks that the triangles are those of the levels, and that their vertices exist.
    ///
    /// # Errors
    /// What is wrong with the region.
    #[cfg(feature = "serde")]
    pub fn check(&self) -> Result<(), &'static str> {
        self.key().check()?;
        let triangles: u64 = self.level_triangles.iter().map(|&n| u64::from(n)).sum();
        if self.indices.len() as u64 != 3 * triangles {
            return Err("a region with more or fewer triangles than its levels");
        }
        if !self.values.is_empty() && self.values.len() != self.vertices.len() {
            return Err("a region with more or fewer values than vertices");
        }
        let largest = self.indices.iter().fold(0, |largest, &index| index.max(largest));
        let is_usable = self.indices.is_empty() || (largest as usize) < self.vertices.len();
        is_usable
            .then_some(())
            .ok_or("a region with triangles of missing vertices")
    }

    /// Which region it is.
    #[inline]
    pub fn key(&self) -> RegionKey {
        RegionKey {
            coords: self.coords,
            size: self.size,
        }
    }

    /// Position of a vertex in the volume, in units of a vertex position.
    #[inline]
    pub fn position_of(&self, vertex: &Vertex) -> [i64; 3] {
        let origin = self.key().origin();
        [0, 1, 2].map(|axis| origin[axis] + i64::from(vertex.position[axis]))
    }
}

/// Time that one stage spent on the device.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StageTime {
    /// Name of the stage.
    #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::interned::deserialize"))]
    pub stage: StaticText,
    /// Milliseconds between the start and the end of its kernels, summed over launches.
    pub milliseconds: f64,
}

/// The parts of the surface that a cut leaves out ([`crate::PartFilter`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RemovedParts {
    /// Number of removed parts.
    pub parts: u64,
    /// Their triangles in the undecimated marching-cubes surface; all triangles of a cell count for the part of its first sheet.
    pub full_triangles: u64,
    /// Positions that should choose a part but have no part next to them.
    pub unmatched: u64,
}

/// Counts, error, times and memory of one extraction.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SurfaceStatistics {
    /// Triangles of the undecimated marching-cubes surface, without removed parts.
    pub full_triangles: u64,
    /// Triangles of the undecimated surface by the mesher of this one, without removed parts; `None`: not counted.
    pub mesher_triangles: Option<u64>,
    /// Removed parts; `None` if no removal was requested.
    pub removed: Option<RemovedParts>,
    /// Number of parts that decimation has made vanish ([`crate::TreeGoal::may_vanish`]).
    pub vanished_parts: u64,
    /// Cells that the surface crosses.
    pub active_cells: u64,
    /// Leaves of the cut at each level, 0 (finest) first.
    pub leaves: [u64; 6],
    /// Triangles of this surface.
    pub triangles: u64,
    /// Distinct vertices of this surface: a vertex shared by regions counts once.
    pub vertices: u64,
    /// Decimated cubes whose corners all have one sign: marching cubes emits nothing for them
    /// (`docs/algorithm.md#5-marching-cubes-mesher`).
    pub lost_cubes: u64,
    /// Vertices on the face of a coarser leaf that has no segment there to move them to.
    pub unpatched_vertices: u64,
    /// Estimate of its distance from the undecimated surface.
    pub estimate: ErrorEstimate,
    /// Measured distance from the full surface, if [`crate::CutParams::state_error`] requests it.
    pub error: Option<SurfaceError>,
    /// Device time by stage, in order of execution.
    pub stages: Vec<StageTime>,
    /// Peak of the bytes allocated on the device beyond resident volumes.
    pub device_bytes: u64,
    /// Bytes of the resident volumes this surface was made from.
    pub volume_bytes: u64,
}

/// Error of a surface, measured without reading it back.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredError {
    /// Of the whole surface.
    pub whole: SurfaceError,
    /// Of each region that has triangles, in units of 32 cells.
    pub regions: Vec<([u32; 3], SurfaceError)>,
    /// Device time by stage, in order of execution.
    pub stages: Vec<StageTime>,
}

/// Counts of a surface, without meshing it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Triangles.
    pub triangles: u64,
    /// Vertices of all regions; a shared vertex counts in each.
    pub vertices: u64,
    /// Leaves of the cut at each level, 0 (finest) first.
    pub leaves: [u64; 6],
}

/// A whole surface: one prefix, or the final one.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Surface {
    /// The non-empty regions that were meshed, x fastest; a region of several ones is in the place of its first one.
    pub regions: Vec<Region>,
    /// All regions in which the surface may differ from the shown one, including those that are empty now; `None`: all regions.
    pub remade: Option<Vec<RegionKey>>,
    /// Undecided cubes of this level counted as leaves; [`Level::FINEST`] is the final surface.
    pub prefix: Level,
    /// Counts, error, times and memory.
    pub statistics: SurfaceStatistics,
}

/// A cut of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Tolerance or β.
    pub threshold: f32,
    /// Triangles of its surface.
    pub triangles: u64,
    /// Estimated error, root mean square in world units.
    pub rms: f32,
}
