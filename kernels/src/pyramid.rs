//! The pyramid: all data that depends on the isovalue and the feature alone.

use crate::buffer::Buffer;
use crate::layout::{self, Brick, Node, VertexRecord};
use crate::{Grid, Level, StageTime};

/// Active bricks and nodes of levels 0 to 5 (`docs/algorithm.md#3-pyramid`). Depends on the isovalue and the feature alone: if α, β
/// or the transfer function change, the same pyramid is peeled again.
pub struct Pyramid {
    /// Id, unique in the process.
    pub(crate) id: u64,
    pub(crate) iso: f32,
    pub(crate) grid: Grid,
    /// Whether levels 1 to 5 were built.
    pub(crate) whole: bool,
    /// Compact index of every region of the grid, or [`layout::NONE`].
    pub(crate) region_index: Buffer<u32>,
    /// The same on the host.
    pub(crate) host_index: Vec<u32>,
    pub(crate) regions: Buffer<layout::Region>,
    pub(crate) bricks: Buffer<Brick>,
    /// The bricks around each brick: compact index or [`layout::NONE`], x + 3 y + 9 z, itself at 13.
    pub(crate) near: Buffer<u32>,
    pub(crate) nodes: Buffer<Node>,
    pub(crate) vertex_records: Buffer<VertexRecord>,
    /// Copy of the active regions on the host.
    pub(crate) host_regions: Vec<layout::Region>,
    /// Their positions, in units of 32 cells.
    pub(crate) coords: Vec<[u32; 3]>,
    pub(crate) full_triangles: u64,
    pub(crate) active_cells: u64,
    pub(crate) stages: Vec<StageTime>,
    pub(crate) peak_bytes: u64,
    pub(crate) feature_bytes: u64,
}

impl Pyramid {
    /// Isovalue it was built for, in the field's units.
    pub fn iso(&self) -> f32 {
        self.iso
    }

    /// Whether any surface can be peeled from it. From a pyramid of [`Engine::build_cells`] only the full surface can.
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// Triangles of the undecimated surface.
    pub fn full_triangles(&self) -> u64 {
        self.full_triangles
    }

    /// Cells that the surface crosses.
    pub fn active_cells(&self) -> u64 {
        self.active_cells
    }

    /// Regions of 32³ cells that the surface touches.
    pub fn active_regions(&self) -> usize {
        self.host_regions.len()
    }

    /// Nodes of a level: cubes that the surface crosses, except those above missing samples.
    pub fn nodes(&self, level: Level) -> u64 {
        let level = usize::from(level.get());
        let of = |region: &layout::Region| u64::from(region.level_base[level + 1] - region.level_base[level]);
        self.host_regions.iter().map(of).sum()
    }

    /// Position of each active region, in units of 32 cells.
    pub fn region_coords(&self) -> impl Iterator<Item = [u32; 3]> {
        self.coords.iter().copied()
    }

    /// Indices of the active regions in Morton order: neighbours follow each other.
    pub fn regions_in_morton_order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.coords.len()).collect();
        order.sort_by_cached_key(|&index| morton(self.coords[index]));
        order
    }

    /// Active bricks: those that the surface may cross.
    pub fn active_bricks(&self) -> u64 {
        self.bricks.len() as u64
    }

    /// Stage times of building it.
    pub fn stages(&self) -> &[StageTime] {
        &self.stages
    }

    /// Bytes it holds on the device.
    pub fn device_bytes(&self) -> u64 {
        self.region_index.allocated_bytes()
            + self.regions.allocated_bytes()
            + self.bricks.allocated_bytes()
            + self.near.allocated_bytes()
            + self.nodes.allocated_bytes()
            + self.vertex_records.allocated_bytes()
    }
}

/// Returns the place of a region in Morton order.
fn morton(coords: [u32; 3]) -> u64 {
    let spread = |c: u32| (0..21).fold(0u64, |bits, i| bits | (u64::from(c) >> i & 1) << (3 * i));
    spread(coords[0]) | spread(coords[1]) << 1 | spread(coords[2]) << 2
}
