//! Parts of the surface that vanish: what the last level of the vertex tree leaves of a small part becomes a chain of nodes of one error
//! (docs/algorithm.md#7-vertex-tree). In f64.

use std::collections::BTreeMap;

use isopeel_kernels::Grid;

use crate::cluster::Cluster;
use crate::levels::LevelMesh;
use crate::tree::{BlockId, BlockTree, LATTICE, Node, NodeId, TreeLeaf, decode_max_move};

/// Maximum number of clusters of a part that may vanish.
const MAX_CLUSTERS: usize = 32;
/// Maximum number of its nodes.
const MAX_NODES: usize = 64;
/// The squared error of a vanished part is at least this times its second moment about its centroid.
const VANISHING_MOMENT: f64 = 9.0;
/// Level of the nodes: that of the largest cubes.
const NODE_LEVEL: u8 = 5;

/// A connected part of the surface that the last level leaves.
#[derive(Debug, Default)]
struct Part<'a> {
    /// In order of their numbers.
    clusters: Vec<&'a Cluster>,
    /// Number of its triangles.
    triangles: usize,
}

/// Sums over the clusters of a part.
#[derive(Clone, Copy, Debug)]
struct Sums {
    area: f64,
    /// World units.
    centroid: [f64; 3],
    /// Second moment about the centroid.
    moment: f64,
}

/// The nodes of a part, without their parents.
#[derive(Debug)]
struct Chain {
    leaves: Vec<TreeLeaf>,
    nodes: Vec<Node>,
}

/// The block of the vanishing nodes.
#[derive(Debug)]
pub(crate) struct Vanishing {
    pub(crate) id: BlockId,
    pub(crate) tree: BlockTree,
    /// What merges, and into which node.
    pub(crate) parents: Vec<(TreeLeaf, NodeId)>,
}

/// Builds the nodes of all parts that may vanish, if there are any. `left`: what the blocks of the last level have left.
pub(crate) fn build(left: &LevelMesh<'_>) -> Option<Vanishing> {
    let id = BlockId {
        level: left.level,
        coords: [0; 3],
    };
    let chains = chains(left, id);
    let rounds = chains.iter().map(|chain| chain.nodes.len()).max()?;
    let mut tree = BlockTree::default();
    let mut parents = Vec::new();
    // What merges into the next node of each chain: the clusters, then the node before it.
    let mut below: Vec<Vec<TreeLeaf>> = chains.iter().map(|chain| chain.leaves.clone()).collect();
    for round in 0..rounds {
        for (chain, below) in chains.iter().zip(&mut below) {
            if let Some(&node) = chain.nodes.get(round) {
                let index = tree.nodes.len();
                let merged = NodeId { block: id, index };
                parents.extend(below.drain(..).map(|leaf| (leaf, merged)));
                tree.nodes.push(node);
                below.push(TreeLeaf::Node(merged));
            }
        }
        tree.round_ends.push(tree.nodes.len());
    }
    Some(Vanishing { id, tree, parents })
}

/// The chains of the parts that may vanish. The part of the largest moment, of equal ones the first, may not.
fn chains(left: &LevelMesh<'_>, id: BlockId) -> Vec<Chain> {
    let grid = &left.mesh.grid;
    let parts: Vec<(Part<'_>, Sums)> = (parts(left).into_iter())
        .map(|part| {
            let sums = part.sums(grid);
            (part, sums)
        })
        .collect();
    let mut largest = 0;
    for (i, (_, sums)) in parts.iter().enumerate() {
        if sums.moment > parts[largest].1.moment {
            largest = i;
        }
    }
    let others = parts.iter().enumerate().filter(|&(i, _)| i != largest);
    others
        .filter_map(|(_, (part, sums))| part.chain(sums, grid, id))
        .collect()
}

/// The parts that have triangles, in order of their first clusters.
fn parts<'a>(left: &'a LevelMesh<'_>) -> Vec<Part<'a>> {
    // Another cluster of the part with a smaller number, or the cluster itself.
    let mut smaller: Vec<usize> = (0..left.clusters.len()).collect();
    let first_of = |smaller: &[usize], mut at: usize| {
        while smaller[at] != at {
            at = smaller[at];
        }
        at
    };
    let triangles = || left.triangles.values().flatten();
    for &[a, b, c] in triangles() {
        for (p, q) in [(a, b), (b, c)] {
            let [p, q] = [p, q].map(|at| first_of(&smaller, at));
            smaller[p.max(q)] = p.min(q);
        }
    }
    let mut parts: BTreeMap<usize, Part<'_>> = BTreeMap::new();
    for &[a, ..] in triangles() {
        parts.entry(first_of(&smaller, a)).or_default().triangles += 1;
    }
    for (number, cluster) in left.clusters.iter().enumerate() {
        if let Some(part) = parts.get_mut(&first_of(&smaller, number)) {
            part.clusters.push(cluster);
        }
    }
    parts.into_values().collect()
}

/// Position in world units.
fn position(cluster: &Cluster, grid: &Grid) -> [f64; 3] {
    let spacing = grid.spacing.map(f64::from);
    std::array::from_fn(|i| f64::from(cluster.lattice_position[i]) * spacing[i] / f64::from(LATTICE))
}

impl Part<'_> {
    /// A part without area has no centroid; its moment is 0.
    fn sums(&self, grid: &Grid) -> Sums {
        let mut sums = Sums {
            area: 0.0,
            centroid: [0.0; 3],
            moment: 0.0,
        };
        for cluster in &self.clusters {
            let (k, x) = (f64::from(cluster.quadric.k), position(cluster, grid));
            sums.area += k;
            (0..3).for_each(|i| sums.centroid[i] += k * x[i]);
        }
        if sums.area <= 0.0 {
            return sums;
        }
        sums.centroid = sums.centroid.map(|x| x / sums.area);
        for cluster in &self.clusters {
            let (k, x) = (f64::from(cluster.quadric.k), position(cluster, grid));
            let [dx, dy, dz]: [f64; 3] = std::array::from_fn(|i| x[i] - sums.centroid[i]);
            sums.moment += k * (dx * dx + dy * dy + dz * dz);
        }
        sums
    }

    /// The nodes that merge the whole part: the first one merges all clusters, and each takes away two triangles, the first one of an odd
    /// number of triangles one. `None` if the part may not vanish.
    fn chain(&self, sums: &Sums, grid: &Grid, id: BlockId) -> Option<Chain> {
        let nodes = self.triangles.div_ceil(2);
        if self.clusters.len() > MAX_CLUSTERS || nodes > MAX_NODES || sums.area <= 0.0 {
            return None;
        }
        let node = self.node(sums, grid, id);
        let removed = |index| if index == 0 { 2 - self.triangles as u32 % 2 } else { 2 };
        Some(Chain {
            leaves: self.clusters.iter().map(|cluster| cluster.leaf).collect(),
            nodes: (0..nodes)
                .map(|index| Node {
                    removed: removed(index),
                    ..node
                })
                .collect(),
        })
    }

    /// What all nodes of the part have in common.
    fn node(&self, sums: &Sums, grid: &Grid, id: BlockId) -> Node {
        let total = |of: fn(&Cluster) -> f32| self.clusters.iter().fold(0.0, |sum, c| sum + f64::from(of(c)));
        let squared_error = total(|cluster| cluster.quadric.c).max(VANISHING_MOMENT * sums.moment);
        // The lattice of the block has 2^16 steps along each axis.
        let steps = id.extent() >> id.level;
        let position = std::array::from_fn(|i| {
            let step = f64::from(grid.spacing[i]) / f64::from(LATTICE) * f64::from(1 << id.level);
            let at = (sums.centroid[i] / step).round_ties_even() as i32;
            at.clamp(0, steps) << id.level
        });
        Node {
            parent: None,
            position,
            error: (squared_error.sqrt() / f64::from(grid.smallest_spacing())) as f32,
            removed: 0,
            level: NODE_LEVEL,
            on_border: self.clusters.iter().any(|cluster| cluster.on_border),
            s: (total(|cluster| cluster.features[0]) / sums.area) as f32,
            f: (total(|cluster| cluster.features[1]) / sums.area) as f32,
            max_move: decode_max_move(0),
        }
    }
}
