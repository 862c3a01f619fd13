//! The vertex tree: a binary hierarchy over the vertices of the full dual mesh, made by merging pairs of them in rounds
//! (docs/algorithm.md#7-vertex-tree).

use std::collections::BTreeMap;

use isopeel_kernels::Grid;
use rayon::prelude::*;

use crate::block::Block;

/// Steps of a position in a cell.
pub const LATTICE: i32 = 2048;

/// Rounds at most.
const MAX_ROUNDS: usize = 64;
/// The last round is the first that merges less than 1 / `MIN_PROGRESS` of the clusters.
const MIN_PROGRESS: usize = 64;

/// A vertex of the full dual mesh.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// In the volume, 1/[`LATTICE`] cell.
    pub position: [i32; 3],
    /// Its cell.
    pub cell: [u32; 3],
    /// Its region, which is its block.
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

/// A merge of two clusters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// The node of the same block that it merges into.
    pub parent: Option<usize>,
    /// In the volume, 1/[`LATTICE`] cell.
    pub position: [i32; 3],
    /// Root of the summed squared distances to the planes, each by its area, over the smallest spacing.
    pub error: f32,
    /// Triangles that the merge takes away.
    pub removed: u32,
    /// Level of the smallest cube as large as the cells of its points.
    pub level: u8,
    /// On the surface's border on the volume's faces.
    pub on_border: bool,
    /// Mean smoothness feature of its points, by area.
    pub s: f32,
    /// Mean user feature.
    pub f: f32,
}

/// A region and the number of a node in it.
pub type NodeId = ([u32; 3], usize);

/// The nodes of one region, those of earlier rounds first: a parent comes after its children.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlockTree {
    /// The nodes.
    pub nodes: Vec<Node>,
    /// Number of nodes after each round.
    pub round_ends: Vec<usize>,
    /// A third of the triangles around each point, summed.
    pub area: f32,
}

/// The vertex tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tree {
    /// Of each region.
    pub blocks: BTreeMap<[u32; 3], BlockTree>,
    /// The node, in its region, that each point merges into.
    pub point_parents: Vec<Option<usize>>,
}

impl Tree {
    /// The nodes above a point, the lowest first.
    pub(crate) fn above(&self, mesh: &FullMesh, point: usize) -> impl Iterator<Item = NodeId> {
        let region = mesh.points[point].region;
        let parent = move |&node: &usize| self.blocks[&region].nodes[node].parent;
        std::iter::successors(self.point_parents[point], parent).map(move |node| (region, node))
    }

    /// The node that a triangle collapses with: the lowest one above two of its corners.
    pub fn collapsed_by(&self, mesh: &FullMesh, [a, b, c]: [usize; 3]) -> Option<NodeId> {
        let meeting = |[p, q]: [usize; 2]| {
            let above: Vec<NodeId> = self.above(mesh, p).collect();
            self.above(mesh, q).find(|node| above.contains(node))
        };
        // In one tree, the lower of two meetings has the lower number. All meetings are in the same tree.
        [[a, b], [b, c], [c, a]].into_iter().filter_map(meeting).min()
    }
}

/// Builds the tree.
pub fn build(mesh: &FullMesh) -> Tree {
    let mut tree = Tree {
        blocks: BTreeMap::new(),
        point_parents: vec![None; mesh.points.len()],
    };
    let of_region = |region| {
        let own: Vec<usize> = (0..mesh.points.len())
            .filter(|&i| mesh.points[i].region == region)
            .collect();
        (build_block(mesh, region, &own), own)
    };
    let regions: Vec<[u32; 3]> = mesh.triangles.keys().copied().collect();
    let blocks: Vec<_> = regions.par_iter().map(|&region| of_region(region)).collect();
    for (region, ((built, parents), own)) in regions.into_iter().zip(blocks) {
        tree.blocks.insert(region, built);
        for (point, parent) in own.into_iter().zip(parents) {
            tree.point_parents[point] = parent;
        }
    }
    tree
}

/// A block's nodes, and the parents of its points.
fn build_block(mesh: &FullMesh, region: [u32; 3], own: &[usize]) -> (BlockTree, Vec<Option<usize>>) {
    let mut block = Block::new(mesh, region, own);
    let mut built = BlockTree {
        area: block.area(),
        ..BlockTree::default()
    };
    while built.round_ends.len() < MAX_ROUNDS {
        let before = block.alive.len();
        let pairs = block.find_pairs();
        for &pair in &pairs {
            let node = block.commit(pair, &mut built.nodes);
            built.nodes.push(node);
        }
        built.round_ends.push(built.nodes.len());
        block.compact(&pairs);
        if pairs.is_empty() || pairs.len() * MIN_PROGRESS < before {
            break;
        }
    }
    (built, block.point_parents)
}
