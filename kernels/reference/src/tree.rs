//! The vertex tree: a binary hierarchy over the vertices of the full dual mesh, made by merging pairs of them in rounds
//! (docs/algorithm.md#7-vertex-tree).
//!
//! Pairs merge within blocks. A block of level l has 32·2^l cells along each axis; one block of the last level holds the whole volume. The
//! clusters that remain in the blocks of a level go on in those of the next one. A further block above the last level merges what remains
//! of each part that may vanish.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use isopeel_kernels::Grid;

use crate::levels::LevelMesh;
use crate::vanishing;

/// Steps of a position in a cell.
pub const LATTICE: i32 = 2048;

/// Minimum of [`Node::max_move`], smallest spacings.
const MIN_MOVE: f32 = 0.04;
/// Maximum code of [`Node::max_move`].
const LAST_MOVE_CODE: u32 = 511;

/// A vertex of the full dual mesh.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// In the volume, 1/[`LATTICE`] cell.
    pub position: [i32; 3],
    /// Its cell.
    pub cell: [u32; 3],
    /// Its region, which is its block of level 0.
    pub region: [u32; 3],
    /// A border vertex, on a face of the volume.
    pub on_border: bool,
    /// Smoothness feature.
    pub s: f32,
    /// User feature, not yet normalised.
    pub f: f32,
}

/// The full dual mesh: triangles between points.
#[derive(Clone, Debug)]
pub struct FullMesh {
    /// Extent of the volume.
    pub grid: Grid,
    /// The volume is padded by a sample on every side.
    pub cap: bool,
    /// Points; those of a region are numbered in an order that decides between equal costs.
    pub points: Vec<Point>,
    /// Triangles that each region emits, corners by number.
    pub triangles: BTreeMap<[u32; 3], Vec<[usize; 3]>>,
}

/// A block, ordered by level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlockId {
    /// The block has 32·2^level cells along each axis. That of [`vanishing_level`] has the nodes of vanishing parts.
    pub level: u8,
    /// Coordinates of its regions >> `level`.
    pub coords: [u32; 3],
}

impl Ord for BlockId {
    /// The order of the blocks' nodes: by level, then by linear index.
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |id: &Self| (id.level, id.coords[2], id.coords[1], id.coords[0]);
        key(self).cmp(&key(other))
    }
}

impl PartialOrd for BlockId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl BlockId {
    /// The block of a level that holds a region.
    pub fn of_region(level: u8, region: [u32; 3]) -> Self {
        Self {
            level,
            coords: region.map(|r| r >> level),
        }
    }

    /// Extent along each axis, 1/[`LATTICE`] cell.
    pub fn extent(self) -> i32 {
        (32 << self.level) * LATTICE
    }

    /// Low corner in the volume, 1/[`LATTICE`] cell.
    pub fn low_corner(self) -> [i32; 3] {
        self.coords.map(|c| c as i32 * self.extent())
    }
}

/// A node, by its block and its number in it. A parent comes after its children.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId {
    /// The block whose rounds made the node.
    pub block: BlockId,
    /// Index in [`BlockTree::nodes`].
    pub index: usize,
}

/// A point, or a node above points; in a cut, what represents a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TreeLeaf {
    /// A point of the full mesh.
    Point(usize),
    /// A node.
    Node(NodeId),
}

/// A merge of two clusters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// The node that it merges into: of the same block or of one of a higher level.
    pub parent: Option<NodeId>,
    /// In the volume, 1/[`LATTICE`] cell.
    pub position: [i32; 3],
    /// Root of the summed squared distances to the planes, each by its area, over the smallest spacing.
    pub error: f32,
    /// Triangles that the merge takes away.
    pub removed: u32,
    /// Level of the smallest cube as large as the cells of its points, at most 5.
    pub level: u8,
    /// On the surface's border on the volume's faces.
    pub on_border: bool,
    /// Mean smoothness feature of its points, by area.
    pub s: f32,
    /// Mean user feature.
    pub f: f32,
    /// Maximum distance by which relaxation moves it, smallest spacings.
    pub max_move: f32,
}

/// The code of the maximum distance, in smallest spacings, by which relaxation may move a node.
pub(crate) fn encode_max_move(limit: f32) -> u32 {
    ((limit.max(MIN_MOVE).to_bits() - MIN_MOVE.to_bits()) >> 18).min(LAST_MOVE_CODE)
}

/// The distance that a code of [`Node::max_move`] stands for, smallest spacings.
pub fn decode_max_move(code: u32) -> f32 {
    f32::from_bits((code << 18) + MIN_MOVE.to_bits())
}

/// The nodes of one block, those of earlier rounds first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlockTree {
    /// The nodes.
    pub nodes: Vec<Node>,
    /// Number of nodes after each round.
    pub round_ends: Vec<usize>,
    /// A third of the triangles of the full mesh around each point, summed.
    pub area: f32,
}

/// The vertex tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tree {
    /// The nodes of each block.
    pub blocks: BTreeMap<BlockId, BlockTree>,
    /// The node that each point merges into.
    pub point_parents: Vec<Option<NodeId>>,
}

impl Tree {
    /// Returns a node.
    pub fn node(&self, id: NodeId) -> &Node {
        &self.blocks[&id.block].nodes[id.index]
    }

    /// The nodes above a point, the lowest first.
    pub fn above(&self, point: usize) -> impl Iterator<Item = NodeId> {
        std::iter::successors(self.point_parents[point], |&id| self.node(id).parent)
    }

    /// The node that a triangle collapses with: the lowest one above two of its corners.
    pub fn collapsed_by(&self, [a, b, c]: [usize; 3]) -> Option<NodeId> {
        let meeting = |[p, q]: [usize; 2]| {
            let above: Vec<NodeId> = self.above(p).collect();
            self.above(q).find(|node| above.contains(node))
        };
        // All meetings are above one point. Of the nodes above a point, a lower one comes first in order.
        [[a, b], [b, c], [c, a]].into_iter().filter_map(meeting).min()
    }

    fn set_parent(&mut self, leaf: TreeLeaf, parent: NodeId) {
        match leaf {
            TreeLeaf::Point(point) => self.point_parents[point] = Some(parent),
            TreeLeaf::Node(id) => {
                let block = self.blocks.get_mut(&id.block).expect("a block of this level or below");
                block.nodes[id.index].parent = Some(parent);
            }
        }
    }
}

/// The last level of volumes that no block of it holds.
const LAST_LEVEL: u8 = 3;

/// The lowest level at which one block holds all regions of a grid, or [`LAST_LEVEL`].
pub fn last_level(grid: &Grid) -> u8 {
    let last_region = grid.regions().into_iter().max().map_or(0, |n| n.saturating_sub(1));
    LAST_LEVEL.min((32 - last_region.leading_zeros()) as u8)
}

/// The level of the block whose nodes merge what remains of parts that may vanish.
pub fn vanishing_level(grid: &Grid) -> u8 {
    last_level(grid) + 1
}

/// Builds the tree.
pub fn build(mesh: &FullMesh) -> Tree {
    let mut tree = Tree {
        blocks: BTreeMap::new(),
        point_parents: vec![None; mesh.points.len()],
    };
    let mut level = LevelMesh::of_points(mesh);
    loop {
        let mut blocks = level.build_blocks();
        for block in &mut blocks {
            tree.blocks.insert(block.id, std::mem::take(&mut block.tree));
        }
        for &(leaf, parent) in blocks.iter().flat_map(|block| &block.parents) {
            tree.set_parent(leaf, parent);
        }
        let is_last = level.is_last();
        level = level.rise(&blocks);
        if is_last {
            if let Some(above) = vanishing::build(&level) {
                tree.blocks.insert(above.id, above.tree);
                (above.parents.into_iter()).for_each(|(leaf, parent)| tree.set_parent(leaf, parent));
            }
            return tree;
        }
    }
}
