//! The vertex tree of a surface on the device.

use crate::buffer::Buffer;
use crate::layout::{RegionMesh, TreeNode, TreeRegion};
use crate::{Pyramid, RemovedParts};
use std::cell::OnceCell;
use std::rc::Rc;

/// A hierarchy over the vertices of a pyramid's full dual mesh (`docs/algorithm.md#7-vertex-tree`): cut it as often as tolerance, budget
/// or importance change ([`crate::Engine::tree_surface`]).
pub struct VertexTree {
    /// Which pyramid it belongs to.
    pub(crate) pyramid: u64,
    /// Whether the pyramid's volume is padded by a sample on each side.
    pub(crate) cap: bool,
    pub(crate) host_regions: Vec<TreeRegion>,
    pub(crate) built: Built,
    /// Position of each point in the volume, 1/2048 cell, and its slot.
    pub(crate) points: Buffer<[i32; 4]>,
    /// Points of cells and sheets; behind them come those on the volume's faces.
    pub(crate) cell_points: u32,
    /// Three points a triangle of the full mesh.
    pub(crate) corners: Buffer<u32>,
    pub(crate) meshes: Buffer<RegionMesh>,
    pub(crate) full_triangles: u64,
    /// The area of each point's part, world units, negative for the first point of a part; found when it is first asked for.
    pub(crate) part_areas: OnceCell<Rc<Buffer<f32>>>,
}

/// What a cut leaves out.
pub(crate) struct SmallParts {
    /// As in [`VertexTree`].
    pub areas: Rc<Buffer<f32>>,
    /// Parts of a smaller area are left out, world units.
    pub min_part: f32,
    pub removed: RemovedParts,
    /// Triangles of the full dual mesh.
    pub triangles: u64,
    /// World units.
    pub area: f64,
}

/// What is built.
pub(crate) struct Built {
    /// What the tree has in each region.
    pub regions: Buffer<TreeRegion>,
    pub nodes: Buffer<TreeNode>,
    /// The node that each point merges into, or [`crate::layout::NONE`].
    pub point_parents: Buffer<u32>,
    /// Of each region, nodes after each round.
    pub round_ends: Buffer<u32>,
}

impl VertexTree {
    /// Whether it is the tree of this pyramid.
    pub fn is_of(&self, pyramid: &Pyramid) -> bool {
        self.pyramid == pyramid.id
    }

    /// Triangles of the full dual mesh.
    pub fn full_triangles(&self) -> u64 {
        self.full_triangles
    }

    /// Bytes it holds on the device.
    pub fn device_bytes(&self) -> u64 {
        self.built.regions.bytes()
            + self.built.nodes.bytes()
            + self.built.point_parents.bytes()
            + self.built.round_ends.bytes()
            + self.points.bytes()
            + self.corners.bytes()
            + self.meshes.bytes()
            + self.part_areas.get().map_or(0, |areas| areas.bytes())
    }

    pub(crate) fn point_count(&self) -> u32 {
        self.points.len() as u32
    }

    /// Points and nodes.
    pub(crate) fn leaf_count(&self) -> usize {
        self.points.len() + self.built.nodes.len()
    }
}
