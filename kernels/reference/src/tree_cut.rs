//! Cuts of the vertex tree, and their triangles (docs/algorithm.md#8-cuts-of-the-vertex-tree).

use rustc_hash::{FxHashMap as HashMap, FxHashSet as HashSet};
use std::collections::{BTreeMap, BTreeSet};

use isopeel_kernels::{CutParams, TreeGoal};

use crate::cut::importance_of;
use crate::interest::{CellBox, raise};
pub use crate::tree::TreeLeaf;
use crate::tree::{BlockId, FullMesh, LATTICE, Node, NodeId, Tree, vanishing_level};

/// Minimum weight: at the maximum importance, the tolerance is multiplied by this.
const MIN_WEIGHT: f32 = 1.0 / 64.0;
/// Keys below this one are not distinguished, and neither are keys from [`ALL_KEYS`] on.
const FIRST_KEY: f32 = 1.0 / (1u64 << 40) as f32;
/// See [`FIRST_KEY`].
const ALL_KEYS: f32 = (1u64 << 40) as f32;
/// The share 1 / `REPAIR_SHARE` of a budget's triangles is reserved for merges that repairs undo.
const REPAIR_SHARE: u64 = 64;
/// Maximum number of cuts that are tried.
const MAX_REPAIRS: usize = 64;

/// A number of each node, by block.
pub type OfNodes = BTreeMap<BlockId, Vec<f32>>;

/// Triangles between leaves, by region.
pub type Triangles = BTreeMap<[u32; 3], Vec<[TreeLeaf; 3]>>;

/// A tree and the mesh that it is of.
#[derive(Clone, Copy)]
pub struct Cutter<'a> {
    /// The mesh.
    pub mesh: &'a FullMesh,
    /// Its tree.
    pub tree: &'a Tree,
    /// Nodes that are never merged: those of parts that the mesh is without.
    pub removed: &'a BTreeSet<NodeId>,
    /// Whether small parts may vanish. If not, their vanishing nodes are never merged.
    pub may_vanish: bool,
    /// Weights of regions, beside those of importance.
    pub weights: Option<&'a Weights>,
}

/// Weights of regions, and how they count.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Of each region that the surface crosses.
    pub of_regions: BTreeMap<[u32; 3], f32>,
    /// Whether errors count as the next power of four.
    pub in_steps: bool,
    /// Nodes whose error over the weight of importance alone is above this are never merged.
    pub guard: f32,
}

impl Weights {
    /// The number that is compared with a tolerance. `error`: over the weight of importance; `weight`: of the node.
    fn key(&self, error: f32, weight: f32) -> f32 {
        if error > self.guard {
            return f32::INFINITY;
        }
        let power_above = |x: f32| {
            let powers = (-63..64).map(|exponent| 4f32.powi(exponent));
            powers.into_iter().find(|&power| power >= x).unwrap_or(f32::INFINITY)
        };
        (if self.in_steps { power_above(error) } else { error }) / weight
    }
}

/// A cut without faults.
#[derive(Clone, Debug)]
pub struct TreeCut {
    /// Nodes with keys up to this one are merged.
    pub tolerance: f32,
    /// The leaf of each point.
    pub leaves: Vec<TreeLeaf>,
    /// The remaining triangles of the mesh.
    pub triangles: Triangles,
    /// Nodes that are not merged: because that would change the topology, because they are of removed parts, or because they are vanishing
    /// nodes and no part may vanish.
    pub marks: BTreeSet<NodeId>,
}

impl Cutter<'_> {
    /// Returns a node of the tree.
    pub fn node(&self, id: NodeId) -> &Node {
        self.tree.node(id)
    }

    /// Position of a leaf in the volume, 1/[`crate::tree::LATTICE`] cell.
    pub fn position(&self, leaf: TreeLeaf) -> [i32; 3] {
        match leaf {
            TreeLeaf::Point(point) => self.mesh.points[point].position,
            TreeLeaf::Node(id) => self.node(id).position,
        }
    }

    /// The level of the smallest cube as large as the cells that a leaf represents.
    pub fn level(&self, leaf: TreeLeaf) -> u8 {
        match leaf {
            TreeLeaf::Point(_) => 0,
            TreeLeaf::Node(id) => self.node(id).level,
        }
    }

    /// The block of the vanishing nodes.
    fn vanishing_block(&self) -> BlockId {
        BlockId {
            level: vanishing_level(&self.mesh.grid),
            coords: [0; 3],
        }
    }

    /// Whether a leaf is a node above a whole part, which has vanished if the node is merged.
    pub fn is_vanishing(&self, leaf: TreeLeaf) -> bool {
        node_of(leaf).is_some_and(|id| id.block == self.vanishing_block())
    }

    /// Number of parts that have vanished in a cut. `leaves`: the leaf of each point.
    pub fn vanished_parts(&self, leaves: &[TreeLeaf]) -> u64 {
        let vanished = leaves.iter().filter(|&&leaf| self.is_vanishing(leaf));
        vanished.collect::<BTreeSet<_>>().len() as u64
    }

    /// The nodes that are never merged, whatever the topology: those of removed parts, and all vanishing nodes if no part may vanish.
    pub fn first_marks(&self) -> BTreeSet<NodeId> {
        let mut marks = self.removed.clone();
        if !self.may_vanish {
            let block = self.vanishing_block();
            let nodes = self.tree.blocks.get(&block).map_or(0, |of_block| of_block.nodes.len());
            marks.extend((0..nodes).map(|index| NodeId { block, index }));
        }
        marks
    }

    /// Whether the triangles around a leaf are too few, or the border at it has closed. A vanished part has no triangles.
    fn is_broken(&self, leaf: TreeLeaf, around: &[[TreeLeaf; 3]]) -> bool {
        if self.is_vanishing(leaf) && around.is_empty() {
            return false;
        }
        let on_border = match leaf {
            TreeLeaf::Point(point) => self.mesh.points[point].on_border,
            TreeLeaf::Node(id) => self.node(id).on_border,
        };
        // The corners `behind` places after the leaf in its triangles; sorted, as leaves may meet along an edge more than once.
        let corners = |behind: usize| {
            let corner = |t: &[TreeLeaf; 3]| t.iter().position(|&c| c == leaf).map(|at| t[(at + behind) % 3]);
            let mut corners: Vec<_> = around.iter().map(corner).collect();
            corners.sort_unstable();
            corners
        };
        let is_open = || corners(1) != corners(2);
        if on_border { !is_open() } else { around.len() < 3 }
    }

    /// Of each node the maximum importance of its points; of a vanishing node that of the whole part.
    pub fn importances(&self, params: &CutParams) -> OfNodes {
        let mut importances: OfNodes = (self.tree.blocks.iter())
            .map(|(&id, block)| (id, vec![0.0; block.nodes.len()]))
            .collect();
        for (i, point) in self.mesh.points.iter().enumerate() {
            let own = importance_of(point.s, point.f, params).clamp(0.0, 1.0);
            let at = point.position.map(|x| x as f32 / LATTICE as f32);
            let own = raise(own, params, CellBox::point(at));
            for NodeId { block, index } in self.tree.above(i) {
                let of_nodes = importances.get_mut(&block).expect("one a block");
                of_nodes[index] = of_nodes[index].max(own);
            }
        }
        self.make_equal_where_parts_vanish(&mut importances);
        importances
    }

    /// Gives the vanishing nodes of a part the number of the topmost one: the part vanishes as a whole.
    fn make_equal_where_parts_vanish(&self, numbers: &mut OfNodes) {
        let block = self.vanishing_block();
        if let Some(of_nodes) = numbers.get_mut(&block) {
            // From the top of each chain down.
            for index in (0..of_nodes.len()).rev() {
                if let Some(parent) = self.node(NodeId { block, index }).parent {
                    of_nodes[index] = of_nodes[parent.index];
                }
            }
        }
    }

    /// Of each node the minimum weight of the regions that its points are in; `None` if regions have no weights.
    fn node_weights(&self) -> Option<OfNodes> {
        let weights = self.weights?;
        let mut of_all: OfNodes = (self.tree.blocks.iter())
            .map(|(&id, block)| (id, vec![f32::INFINITY; block.nodes.len()]))
            .collect();
        for (i, point) in self.mesh.points.iter().enumerate() {
            for NodeId { block, index } in self.tree.above(i) {
                let of_nodes = of_all.get_mut(&block).expect("one a block");
                of_nodes[index] = of_nodes[index].min(weights.of_regions[&point.region]);
            }
        }
        self.make_equal_where_parts_vanish(&mut of_all);
        Some(of_all)
    }

    /// Of each node the tolerance from which on it is merged. Nodes in `marks` never are.
    pub fn keys(&self, importances: Option<&OfNodes>, marks: &BTreeSet<NodeId>) -> OfNodes {
        let mut keys = OfNodes::new();
        let weights = self.weights.zip(self.node_weights());
        // Parents first: they are in blocks of higher levels, or later in the same block.
        for (&id, block) in self.tree.blocks.iter().rev() {
            let mut of_nodes = vec![f32::INFINITY; block.nodes.len()];
            for (index, node) in block.nodes.iter().enumerate().rev() {
                let weight = importances.map_or(1.0, |of| (1.0 - of[&id][index]).max(MIN_WEIGHT));
                let own = if marks.contains(&NodeId { block: id, index }) {
                    f32::INFINITY
                } else {
                    let error = node.error / weight;
                    let of_node = weights.as_ref().map(|(of, all)| of.key(error, all[&id][index]));
                    of_node.unwrap_or(error)
                };
                of_nodes[index] = match node.parent {
                    Some(parent) if parent.block == id => own.min(of_nodes[parent.index]),
                    Some(parent) => own.min(keys[&parent.block][parent.index]),
                    None => own,
                };
            }
            keys.insert(id, of_nodes);
        }
        keys
    }

    /// For each node that can merge, its key and the number of triangles that it removes, sorted by key.
    fn merges(&self, keys: &OfNodes) -> Vec<(f32, u64)> {
        let of_block = |(id, of_nodes): (&BlockId, &Vec<f32>)| {
            let nodes = &self.tree.blocks[id].nodes;
            let removed = nodes.iter().map(|node| u64::from(node.removed));
            of_nodes.iter().copied().zip(removed).collect::<Vec<_>>()
        };
        let mut merges: Vec<(f32, u64)> = keys
            .iter()
            .flat_map(of_block)
            .filter(|(key, _)| key.is_finite())
            .collect();
        merges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        merges
    }

    fn full_triangles(&self) -> u64 {
        self.mesh.triangles.values().map(|t| t.len() as u64).sum()
    }

    /// Triangles of the cut to a tolerance, before repairs.
    pub fn triangles_at(&self, keys: &OfNodes, tolerance: f32) -> u64 {
        let merges = self.merges(keys).into_iter();
        let removed: u64 = merges.take_while(|(key, _)| *key <= tolerance).map(|(_, n)| n).sum();
        self.full_triangles() - removed
    }

    /// Returns the tolerance for a budget. Reserves triangles for repairs, except if many merges share one tolerance.
    fn fit(&self, keys: &OfNodes, max_triangles: u64) -> f32 {
        if self.full_triangles() <= max_triangles {
            return f32::NEG_INFINITY;
        }
        let spare = max_triangles / REPAIR_SHARE;
        let spared = self.tolerance_of(keys, max_triangles - spare);
        if self.triangles_at(keys, spared) + 2 * spare >= max_triangles {
            return spared;
        }
        self.tolerance_of(keys, max_triangles)
    }

    /// Returns the minimum tolerance whose cut has at most `max_triangles` before repairs; the maximum tolerance if no cut has so few.
    pub fn tolerance_of(&self, keys: &OfNodes, max_triangles: u64) -> f32 {
        let wanted = self.full_triangles().saturating_sub(max_triangles);
        let mut sum = 0;
        let last = self.merges(keys).into_iter().find(|&(_, removed)| {
            sum += removed;
            sum >= wanted
        });
        match last {
            _ if wanted == 0 => f32::NEG_INFINITY,
            Some((key, _)) if key < FIRST_KEY => FIRST_KEY.next_down(),
            Some((key, _)) if key < ALL_KEYS => key,
            _ => f32::MAX,
        }
    }

    /// The leaf of each point: the topmost node above it with a key up to the tolerance.
    pub fn leaves(&self, keys: &OfNodes, tolerance: f32) -> Vec<TreeLeaf> {
        let leaf = |point| {
            let above = self.tree.above(point);
            above
                .filter(|id| keys[&id.block][id.index] <= tolerance)
                .last()
                .map_or(TreeLeaf::Point(point), TreeLeaf::Node)
        };
        (0..self.mesh.points.len()).map(leaf).collect()
    }

    /// The full mesh's triangles between leaves, without degenerate ones: by level of the finest corner, finest first.
    pub fn triangles(&self, leaves: &[TreeLeaf]) -> Triangles {
        let of_region = |triangles: &Vec<[usize; 3]>| {
            let mut left: Vec<_> = triangles.iter().map(|t| t.map(|c| leaves[c])).collect();
            left.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
            left.sort_by_key(|t| t.map(|leaf| self.level(leaf)).into_iter().min());
            left
        };
        let regions = self.mesh.triangles.iter();
        regions
            .map(|(&region, triangles)| (region, of_region(triangles)))
            .collect()
    }

    /// Nodes to mark, because leaves meet along more than one line, have too few triangles around them or close the border.
    pub fn faults(&self, triangles: &Triangles, leaves: &[TreeLeaf]) -> BTreeSet<NodeId> {
        let mut marks = BTreeSet::new();
        let corners = || {
            triangles
                .values()
                .flatten()
                .flat_map(|t| (0..3).map(move |i| (t[i], t[(i + 1) % 3], *t)))
        };
        let mut around: HashMap<TreeLeaf, Vec<[TreeLeaf; 3]>> = leaves.iter().map(|&leaf| (leaf, vec![])).collect();
        corners().for_each(|(leaf, _, t)| around.entry(leaf).or_default().push(t));
        for (leaf, fan) in around.into_iter().filter(|(leaf, fan)| self.is_broken(*leaf, fan)) {
            match leaf {
                TreeLeaf::Node(id) => drop(marks.insert(id)),
                TreeLeaf::Point(_) => marks.extend(fan.into_iter().flatten().filter_map(node_of)),
            }
        }
        // Directed edges of a surface differ.
        let mut edges = HashSet::default();
        for (a, b, _) in corners().filter(|&(a, b, _)| !edges.insert([a, b])) {
            marks.extend(node_of(a.max(b)));
        }
        marks
    }

    /// Cuts to a tolerance, and beyond it to a number of triangles. Repeats without the merges that change the topology until there are
    /// none. The tolerance grows only if repairs exceed the budget. Returns `None` if that takes too many cuts.
    /// `importances`: those of [`Self::importances`]; none if all are 0.
    pub fn cut(&self, importances: Option<&OfNodes>, goal: &TreeGoal) -> Option<TreeCut> {
        // Finite, because keys of nodes in `marks` are infinite. With weights of regions, the guard is in the keys.
        let limit = if self.weights.is_some() {
            f32::MAX
        } else {
            goal.max_tolerance.min(f32::MAX)
        };
        let fit = |keys: &OfNodes| {
            let fitted = self.fit(keys, goal.max_triangles);
            goal.tolerance.max(fitted).min(limit)
        };
        let mut marks = self.first_marks();
        let mut keys = self.keys(importances, &marks);
        let mut tolerance = fit(&keys);
        for _ in 0..MAX_REPAIRS {
            let leaves = self.leaves(&keys, tolerance);
            let triangles = self.triangles(&leaves);
            let faults = self.faults(&triangles, &leaves);
            if faults.is_empty() {
                return Some(TreeCut {
                    tolerance,
                    leaves,
                    triangles,
                    marks,
                });
            }
            marks.extend(faults);
            keys = self.keys(importances, &marks);
            if self.triangles_at(&keys, tolerance) > goal.max_triangles {
                tolerance = tolerance.max(fit(&keys));
            }
        }
        None
    }
}

pub(crate) fn node_of(leaf: TreeLeaf) -> Option<NodeId> {
    match leaf {
        TreeLeaf::Point(_) => None,
        TreeLeaf::Node(id) => Some(id),
    }
}
