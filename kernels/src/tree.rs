//! The vertex tree of a surface on the device.

use crate::buffer::Buffer;
use crate::layout::{RegionMesh, TreeNode, TreeRegion};
use crate::lock::lock;
use crate::{CurvePoint, CutParams, Pyramid, RemovedParts};
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

/// A hierarchy over the vertices of a pyramid's full dual mesh (`docs/algorithm.md#7-vertex-tree`). If tolerance, budget or importance
/// change, the same tree is cut again ([`crate::Engine::tree_surface`]).
pub struct VertexTree {
    /// Id, unique in the process.
    pub(crate) id: u64,
    /// Id of its pyramid.
    pub(crate) pyramid: u64,
    /// Whether the pyramid's volume is padded by a sample on each side.
    pub(crate) cap: bool,
    /// Ranges of the tree in each region, then in the blocks of the levels above.
    pub(crate) blocks: Vec<TreeRegion>,
    /// The blocks of each level; those of the first one are the regions.
    pub(crate) block_levels: Vec<Range<usize>>,
    /// The last block, if its nodes are those at which small parts vanish.
    pub(crate) vanishing: Option<usize>,
    pub(crate) built: Built,
    /// Position of each point in the volume, 1/2048 cell, and its slot.
    pub(crate) points: Buffer<[i32; 4]>,
    /// Number of points of cells and sheets; the points on the volume's faces follow them.
    pub(crate) cell_points: u32,
    /// Three points a triangle of the full mesh.
    pub(crate) corners: Buffer<u32>,
    pub(crate) meshes: Buffer<RegionMesh>,
    /// The node that each triangle collapses with, or [`crate::layout::NONE`].
    pub(crate) collapsed_by: Buffer<u32>,
    /// Region by region, point by point, numbers of the full mesh's corners.
    pub(crate) point_corners: Buffer<u32>,
    /// Of each point, the end of its range in `point_corners`.
    pub(crate) corner_ends: Buffer<u32>,
    /// Of each leaf, the rounds during which it existed (`cl/lib/tree_leaf.h`).
    pub(crate) lives: Buffer<u8>,
    /// Region by region, numbers of triangles of other regions' meshes that have a corner in it.
    pub(crate) beside: Buffer<u32>,
    pub(crate) full_triangles: u64,
    /// Points that are in no triangle: they are leaves of every cut except those that leave parts out.
    pub(crate) isolated_points: u64,
    /// Its parts; computed at the first use.
    pub(crate) parts: OnceLock<Arc<TreeParts>>,
    /// How the estimated error grows with the tolerance, if all weights are 1; computed at the first use.
    pub(crate) uniform_curve: OnceLock<Vec<CurvePoint>>,
    /// Cache of the last removal: a view is cut many times without the same parts.
    pub(crate) left_out: Mutex<Option<Arc<LeftOut>>>,
    /// The last cut, for queries on its surface.
    pub(crate) last_cut: Mutex<Option<Arc<TreeCut>>>,
    /// Cache of the last importances of nodes: users change budgets and tolerances many times with the same importance.
    pub(crate) importances: Mutex<Option<Importances>>,
}

/// The maximum importance of the points below each node.
#[derive(Clone)]
pub struct Importances {
    /// What it was made for; importance alone counts.
    pub(crate) params: CutParams,
    /// Bits of floats of 0 or more, which are ordered as the floats are.
    pub(crate) bits: Arc<Buffer<u32>>,
}

/// Target of a cut of a tree.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeGoal {
    /// A node is merged if its error over its weight is at most this, world units; below 0 no node is.
    pub tolerance: f32,
    /// Budget: more nodes are merged until at most this number of triangles remains.
    pub max_triangles: u64,
    /// Guard: no node is merged whose error over its weight exceeds this, world units. Weights of regions do not count.
    pub max_tolerance: f32,
    /// Parts that are left out before the cut.
    pub without: PartFilter,
    /// Whether small parts may vanish: each does if its size is below the tolerance.
    pub may_vanish: bool,
    /// Weights of regions, beside those of importance.
    pub weights: Option<Arc<RegionWeights>>,
}

impl TreeGoal {
    /// Maximum tolerance of a cut.
    pub(crate) fn limit(&self) -> f32 {
        match &self.weights {
            // The guard is in the keys.
            Some(_) => f32::MAX,
            None => self.max_tolerance.min(f32::MAX),
        }
    }
}

/// How much more error each region may have: a node is merged up to the tolerance times the minimum weight of the regions that its points
/// are in (`docs/algorithm.md#81-cuts-for-a-camera`).
#[derive(Clone, Debug, PartialEq)]
pub struct RegionWeights {
    /// Finite numbers above 0, in the order of [`Pyramid::region_coords`].
    pub of_regions: Vec<f32>,
    /// Whether tolerances are powers of four: errors count as the next one. Then regions whose weight changes by a little keep their cut.
    pub in_steps: bool,
}

/// Parts of the surface that are chosen by positions, in cells: each chooses the part of the vertex that [`crate::Engine::probe`] finds
/// next to it. `None`, outside the volume, chooses nothing.
#[derive(Clone, Debug, PartialEq)]
pub enum ChosenParts {
    /// The parts at these positions are left out.
    Hide(Vec<Option<[f32; 3]>>),
    /// All other parts are left out.
    Keep(Vec<Option<[f32; 3]>>),
}

impl ChosenParts {
    /// The positions that choose parts.
    pub fn positions(&self) -> &[Option<[f32; 3]>] {
        match self {
            Self::Hide(positions) | Self::Keep(positions) => positions,
        }
    }
}

/// Which parts of the surface a cut leaves out. By default none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PartFilter {
    /// Parts of a smaller area are left out, world units; 0: none are.
    pub min_area: f32,
    /// Parts chosen by positions.
    pub chosen: Option<ChosenParts>,
}

impl PartFilter {
    /// Whether it leaves out any.
    pub fn removes(&self) -> bool {
        self.min_area > 0.0 || self.chosen.is_some()
    }
}

/// A cut of a vertex tree, without its mesh.
pub struct TreeCut {
    /// What it was made for; importance alone counts.
    pub(crate) params: CutParams,
    pub(crate) goal: TreeGoal,
    /// Of each node (`cl/lib/tree_key.h`).
    pub(crate) keys: Buffer<u32>,
    /// Of each point (`cl/lib/tree_leaf.h`).
    pub(crate) leaves: Buffer<u32>,
    /// Parts that it leaves out.
    pub(crate) left_out: Option<Arc<LeftOut>>,
}

impl TreeCut {
    /// Whether this is the cut of a goal with the importance of these parameters.
    pub(crate) fn is_for(&self, params: &CutParams, goal: &TreeGoal) -> bool {
        self.goal == *goal && self.params.has_importance_of(params)
    }
}

/// The parts of a tree's surface.
pub(crate) struct TreeParts {
    /// The first point of each point's part.
    pub firsts: Buffer<u32>,
    /// The area of each point's part, world units, negative for the first point of a part; 0 if a point belongs to none.
    pub areas: Buffer<f32>,
}

/// The parts that a cut leaves out.
pub(crate) struct LeftOut {
    pub filter: PartFilter,
    /// 1: the point's part is left out.
    pub points: Buffer<u8>,
    pub removed: RemovedParts,
    /// Triangles of the full dual mesh.
    pub triangles: u64,
    /// Area of the remaining parts, world units. Summed directly, because a difference of two large sums would be too inexact.
    pub area_left: f64,
}

/// The levels of a tree.
pub(crate) struct TreeLevels {
    pub built: Built,
    /// As in [`VertexTree`].
    pub blocks: Vec<TreeRegion>,
    pub block_levels: Vec<Range<usize>>,
    pub vanishing: Option<usize>,
}

impl TreeLevels {
    /// Numbers the points of each region, once no launch's working memory is needed.
    pub fn number_points(&mut self) {
        let mut points = 0;
        for block in &mut self.blocks[..self.block_levels[0].end] {
            block.cluster_base = points;
            points += block.points;
        }
    }
}

/// Buffers of the built nodes.
pub(crate) struct Built {
    /// Ranges of the tree in each block.
    pub regions: Buffer<TreeRegion>,
    /// How many nodes there are: fewer than the buffers have space for.
    pub node_count: u32,
    pub nodes: Buffer<TreeNode>,
    /// Their errors, as keys (`cl/lib/tree_key.h`).
    pub node_errors: Buffer<u32>,
    /// Their levels, as in `nodes`.
    pub node_levels: Buffer<u8>,
    /// The node that each node merges into, or [`crate::layout::NONE`].
    pub node_parents: Buffer<u32>,
    /// The same of each point.
    pub point_parents: Buffer<u32>,
    /// Of each block, nodes after each round.
    pub round_ends: Buffer<u32>,
}

/// How far relaxation may move a node, smallest spacings: half of the root mean square distance of the planes below it, by area, or 0.04
/// if that is more; to 3 per cent (`cl/lib/tree_node.h`).
pub(crate) fn max_move(node: &TreeNode) -> f32 {
    f32::from_bits(0.04f32.to_bits() + ((node.position[1] >> 19 & 511) << 18))
}

impl VertexTree {
    /// Whether it is the tree of this pyramid.
    pub fn is_of(&self, pyramid: &Pyramid) -> bool {
        self.pyramid == pyramid.id
    }

    /// Area of the full dual mesh in each region, world units, in the order of [`Pyramid::region_coords`].
    pub fn region_areas(&self) -> impl Iterator<Item = f32> {
        self.blocks[..self.block_levels[0].end].iter().map(|region| region.area)
    }

    /// Triangles of the full dual mesh.
    pub fn full_triangles(&self) -> u64 {
        self.full_triangles
    }

    /// Bytes it holds on the device, with those that its last cut and the importances of its nodes take.
    pub fn device_bytes(&self) -> u64 {
        let last_cut = (self.leaf_count() + self.built.nodes.len()) * size_of::<u32>();
        last_cut as u64
            + self.built.regions.allocated_bytes()
            + self.built.nodes.allocated_bytes()
            + self.built.node_errors.allocated_bytes()
            + self.built.node_levels.allocated_bytes()
            + self.built.node_parents.allocated_bytes()
            + self.built.point_parents.allocated_bytes()
            + self.built.round_ends.allocated_bytes()
            + self.points.allocated_bytes()
            + self.corners.allocated_bytes()
            + self.meshes.allocated_bytes()
            + self.collapsed_by.allocated_bytes()
            + self.point_corners.allocated_bytes()
            + self.corner_ends.allocated_bytes()
            + self.lives.allocated_bytes()
            + self.beside.allocated_bytes()
            + self.parts.get().map_or(0, |parts| {
                parts.firsts.allocated_bytes() + parts.areas.allocated_bytes()
            })
            + lock(&self.left_out)
                .as_ref()
                .map_or(0, |left_out| left_out.points.allocated_bytes())
    }

    pub(crate) fn point_count(&self) -> u32 {
        self.points.len() as u32
    }

    /// Leaves before those that are nodes of levels above the regions.
    pub(crate) fn first_above(&self) -> u32 {
        let regions = &self.blocks[..self.block_levels[0].end];
        self.point_count() + regions.iter().map(|region| region.nodes).sum::<u32>()
    }

    /// Nodes of levels above the regions, without those at which parts vanish.
    pub(crate) fn nodes_above(&self) -> u32 {
        let vanishing = self.vanishing_nodes().len() as u32;
        self.point_count() + self.built.node_count - vanishing - self.first_above()
    }

    /// Nodes at which parts vanish.
    pub(crate) fn vanishing_nodes(&self) -> Range<usize> {
        self.vanishing.map_or(0..0, |block| {
            let of = &self.blocks[block];
            of.node_base as usize..(of.node_base + of.nodes) as usize
        })
    }

    /// Points and nodes.
    pub(crate) fn leaf_count(&self) -> usize {
        self.points.len() + self.built.nodes.len()
    }
}
