//! The mesh of one block of the vertex tree while its clusters merge (docs/algorithm.md#7-vertex-tree). Its own clusters come first.
//! They are followed by clusters of neighbouring blocks that are corners of its triangles; these do not move.

mod fan;
mod pair_test;
mod pairs;

use std::collections::{BTreeMap, BTreeSet};

use crate::cluster::{Cluster, Quadric, Vector, add, cross, dot, join_faces, merge, penalty, subtract};
use crate::levels::{LevelMesh, Members};
use crate::tree::{BlockId, BlockTree, LATTICE, Node, NodeId, TreeLeaf, decode_max_move, encode_max_move};
use fan::{Ends, Fan, fan_ends};

/// Rounds at most.
const MAX_ROUNDS: usize = 64;
/// Below the last level, the last round is the first that merges less than 1 / `MIN_PROGRESS` of the clusters.
const MIN_PROGRESS: usize = 64;
/// The first level whose tests are soft: merges that turn or fold triangles too far are penalised, not forbidden. The last level's are too.
const FIRST_SOFT_LEVEL: u8 = 3;
/// Maximum level of a node.
const MAX_NODE_LEVEL: u32 = 5;

/// A block and the rounds so far.
pub(crate) struct Block {
    pub(crate) id: BlockId,
    is_last: bool,
    is_soft: bool,
    /// Points of the full mesh in the block.
    points: u64,
    /// World units of a step of the lattice.
    scale: Vector,
    /// Range of positions of merged clusters, from the low corner, in 2^level steps of the lattice.
    range: [[i32; 3]; 2],
    per_length: f32,
    pub(crate) clusters: Vec<Cluster>,
    /// Positions of other blocks' clusters, by number behind `clusters`.
    foreign: Vec<Vector>,
    /// Remaining triangles, corners by number.
    pub(crate) triangles: Vec<[usize; 3]>,
    fans: Vec<Fan>,
    /// Pairs that would fold the surface or that other blocks exclude, the smaller number first: not tried again until one of the two merges.
    aside: BTreeSet<[usize; 2]>,
    /// Pairs that may not merge, the smaller number first: not tried again until a cluster around one of the two merges.
    refused: BTreeSet<[usize; 2]>,
    /// Costs of the pairs that may turn and fold triangles further, the smaller number first: until one of the two merges.
    penalised: BTreeMap<[usize; 2], f32>,
    /// Remaining clusters that may merge, ascending.
    pub(crate) alive: Vec<usize>,
    /// Those that never merge here, ascending.
    idle: Vec<usize>,
    /// The remaining cluster that each own cluster has merged into.
    pub(crate) roots: Vec<usize>,
    /// The nodes and rounds so far.
    pub(crate) tree: BlockTree,
    /// What has merged, and into which node.
    pub(crate) parents: Vec<(TreeLeaf, NodeId)>,
}

impl Block {
    /// The clusters of a block at the start of a level, and all triangles with a corner at one.
    pub(crate) fn new(level: &LevelMesh<'_>, id: BlockId, members: &Members) -> Self {
        let mut block = Self::without_clusters(level, id, members);
        let own = &members.clusters;
        let placed = |&number: &usize| Cluster {
            position: block.relative_to_block(level.clusters[number].lattice_position),
            ..level.clusters[number].clone()
        };
        block.clusters = own.iter().map(placed).collect();
        let mut on_border: Vec<bool> = own.iter().map(|&i| level.clusters[i].on_border).collect();
        block.gather(level, own, &mut on_border);
        block.make_fans();
        for at in 0..own.len() {
            if id.level == 0 {
                block.classify_point(at, &on_border, level.mesh.grid.dims);
            } else if !block.may_go_on(at, &on_border) {
                block.clusters[at].is_locked = true;
            }
        }
        (block.idle, block.alive) = (0..own.len()).partition(|&at| block.is_idle(at));
        if block.id.level == 0 {
            block.tree.area = block.clusters.iter().fold(0.0, |sum, cluster| sum + cluster.quadric.k);
        }
        block
    }

    fn without_clusters(level: &LevelMesh<'_>, id: BlockId, members: &Members) -> Self {
        let grid = &level.mesh.grid;
        let low_corner = id.low_corner();
        let last = grid.dims.map(|n| (n as i32 - 1) * LATTICE);
        let margin = if level.mesh.cap { LATTICE } else { 0 };
        Self {
            id,
            is_last: level.is_last(),
            is_soft: level.is_last() || id.level >= FIRST_SOFT_LEVEL,
            points: members.points,
            scale: grid.spacing.map(|s| s / LATTICE as f32),
            range: [
                std::array::from_fn(|i| (margin - low_corner[i]).max(0) >> id.level),
                std::array::from_fn(|i| (last[i] - margin - low_corner[i]).min(id.extent()) >> id.level),
            ],
            per_length: 1.0 / grid.smallest_spacing(),
            clusters: Vec::new(),
            foreign: Vec::new(),
            triangles: Vec::new(),
            fans: Vec::new(),
            aside: BTreeSet::new(),
            refused: BTreeSet::new(),
            penalised: BTreeMap::new(),
            alive: Vec::new(),
            idle: Vec::new(),
            roots: (0..members.clusters.len()).collect(),
            tree: BlockTree::default(),
            parents: Vec::new(),
        }
    }

    fn relative_to_block(&self, at: [i32; 3]) -> Vector {
        let low_corner = self.id.low_corner();
        std::array::from_fn(|i| (at[i] - low_corner[i]) as f32 * self.scale[i])
    }

    /// Triangles with a corner in the block. A polygon is emitted in the region of the last of its cells, so they are the block's own and
    /// those of its six neighbours towards higher coordinates that are not across its corner.
    fn gather(&mut self, level: &LevelMesh<'_>, own: &[usize], on_border: &mut Vec<bool>) {
        let mut numbers: BTreeMap<usize, usize> = own.iter().enumerate().map(|(i, &number)| (number, i)).collect();
        for n in 0..7 {
            let at = std::array::from_fn(|i| self.id.coords[i] + (n >> i & 1));
            for corners in level.triangles.get(&at).into_iter().flatten() {
                if !corners.iter().any(|&c| level.block_of[c] == self.id.coords) {
                    continue;
                }
                for &corner in corners {
                    let next = numbers.len();
                    if *numbers.entry(corner).or_insert(next) == next {
                        let cluster = &level.clusters[corner];
                        self.foreign.push(self.relative_to_block(cluster.lattice_position));
                        on_border.push(cluster.on_border);
                    }
                }
                self.triangles.push(corners.map(|c| numbers[&c]));
            }
        }
    }

    fn make_fans(&mut self) {
        self.fans = vec![Fan::new(); self.clusters.len()];
        for t in &self.triangles {
            for i in 0..3 {
                if let Some(fan) = self.fans.get_mut(t[i]) {
                    fan.push([t[(i + 1) % 3], t[(i + 2) % 3]]);
                }
            }
        }
    }

    fn is_own(&self, vertex: usize) -> bool {
        vertex < self.clusters.len()
    }

    fn position(&self, vertex: usize) -> Vector {
        self.clusters
            .get(vertex)
            .map_or_else(|| self.foreign[vertex - self.clusters.len()], |c| c.position)
    }

    /// Derives a point's quadric and features, and whether it is on the border or may not merge, from the triangles around it. `on_border`:
    /// of the points, own ones first; `dims`: samples of the volume.
    fn classify_point(&mut self, at: usize, on_border: &[bool], dims: [u32; 3]) {
        let own = self.clusters[at].position;
        let mut quadric = Quadric::default();
        let mut normals = Vec::new();
        for &[next, before] in &self.fans[at] {
            let normal = cross(subtract(self.position(next), own), subtract(self.position(before), own));
            let length = dot(normal, normal).sqrt();
            if length > 0.0 {
                quadric.add_plane(normal, 1.0 / (6.0 * length));
            }
            quadric.k += length / 6.0;
            normals.push(normal);
        }
        let beside = match fan_ends(&self.fans[at]) {
            Ends::Open { first, last } if on_border[at] => {
                let beside = [self.fans[at][first][0], self.fans[at][last][1]];
                let may_merge = beside.iter().all(|&vertex| on_border[vertex]);
                may_merge.then_some([(beside[0], normals[first]), (beside[1], normals[last])])
            }
            _ => None,
        };
        let is_inside = matches!(fan_ends(&self.fans[at]), Ends::Closed) && !on_border[at];
        let cluster = &mut self.clusters[at];
        cluster.features = cluster.features.map(|x| x * quadric.k);
        cluster.quadric = quadric;
        cluster.is_locked = !is_inside && beside.is_none();
        // A border point that may not merge is not on the border to the clusters beside it from level 1 on.
        cluster.on_border = beside.is_some();
        if cluster.on_border {
            let ends = dims.map(|n| (n as i32 - 1) * LATTICE);
            let position = cluster.lattice_position;
            cluster.faces = std::array::from_fn(|i| [position[i] == 0, position[i] == ends[i]]);
        }
        for (vertex, normal) in beside.into_iter().flatten() {
            self.add_border_plane(at, vertex, normal);
        }
    }

    /// Adds the plane through an edge on the border, at right angles to the triangle with this normal.
    fn add_border_plane(&mut self, at: usize, other: usize, normal: Vector) {
        let edge = subtract(self.position(other), self.position(at));
        let across = cross(edge, normal);
        let length2 = dot(across, across);
        if length2 > 0.0 {
            self.clusters[at].quadric.add_plane(across, dot(edge, edge) / length2);
        }
    }

    /// Whether a cluster may merge from level 1 on: the triangles around it have to be one fan without a repeated neighbour. `on_border`:
    /// of the clusters, own ones first.
    fn may_go_on(&self, at: usize, on_border: &[bool]) -> bool {
        let fan = &self.fans[at];
        let all_differ = || {
            let neighbours = self.neighbours(at);
            neighbours.iter().collect::<BTreeSet<_>>().len() == neighbours.len()
        };
        match fan_ends(fan) {
            Ends::Closed => !on_border[at] && fan.len() >= 3 && all_differ(),
            Ends::Open { first, last } => {
                on_border[at] && on_border[fan[first][0]] && on_border[fan[last][1]] && all_differ()
            }
            Ends::Other => false,
        }
    }

    /// Neighbours of a cluster, each once unless a fan is not manifold.
    fn neighbours(&self, at: usize) -> Vec<usize> {
        let fan = &self.fans[at];
        let mut all: Vec<usize> = fan.iter().map(|t| t[0]).collect();
        if self.clusters[at].on_border {
            all.extend(fan.iter().map(|t| t[1]).find(|v| !fan.iter().any(|t| t[0] == *v)));
        }
        all
    }

    /// Whether a cluster has no merge to expect in the block: it is locked, or it is one of four that are all that is left of a part.
    fn is_idle(&self, at: usize) -> bool {
        let has_three = |v: usize| {
            self.is_own(v) && !self.clusters[v].is_locked && !self.clusters[v].on_border && self.fans[v].len() == 3
        };
        self.clusters[at].is_locked || (has_three(at) && self.neighbours(at).into_iter().all(has_three))
    }

    /// The clusters that remain: those that may have merged, then the idle ones.
    pub(crate) fn left(&self) -> impl Iterator<Item = usize> {
        self.alive.iter().chain(&self.idle).copied()
    }

    /// Runs the rounds.
    pub(crate) fn build(&mut self) {
        while self.tree.round_ends.len() < MAX_ROUNDS && !self.rests() {
            let before = self.alive.len();
            let pairs = self.find_pairs();
            for &pair in &pairs {
                self.commit(pair);
            }
            self.tree.round_ends.push(self.tree.nodes.len());
            self.compact(&pairs);
            if pairs.is_empty() || (!self.is_last && pairs.len() * MIN_PROGRESS < before) {
                break;
            }
        }
    }

    /// Whether the block leaves all further merges to larger blocks: if at most 4^−(level + 1) of its points remain.
    fn rests(&self) -> bool {
        !self.is_last && ((self.alive.len() + self.idle.len()) as u64) << (2 * (self.id.level + 1)) <= self.points
    }

    /// Position of a merged cluster: in 2^level steps of the lattice from the low corner, and in world units.
    fn rounded(&self, wanted: Vector) -> ([i32; 3], Vector) {
        let scale = self.scale.map(|s| s * (1 << self.id.level) as f32);
        let at: [i32; 3] = std::array::from_fn(|i| {
            let steps = (wanted[i] / scale[i]).round_ties_even() as i32;
            steps.clamp(self.range[0][i], self.range[1][i])
        });
        (at, std::array::from_fn(|i| at[i] as f32 * scale[i]))
    }

    /// Makes the node of a pair; the pair's first cluster becomes the merged one.
    fn commit(&mut self, [a, b]: [usize; 2]) {
        let id = NodeId {
            block: self.id,
            index: self.tree.nodes.len(),
        };
        let [first, second] = [a, b].map(|i| self.clusters[i].clone());
        let merge = merge(&first, &second);
        let (at, position) = self.rounded(add(first.position, merge.to));
        let mut quadric = merge.quadric.shifted(subtract(position, first.position));
        quadric.c = quadric.c.max(first.quadric.c + second.quadric.c);
        if self.penalised.contains_key(&[a, b]) {
            quadric.c += penalty(&first, &second);
        }
        self.parents.extend([(first.leaf, id), (second.leaf, id)]);
        let low_corner = self.id.low_corner();
        let merged = Cluster {
            quadric,
            position,
            lattice_position: std::array::from_fn(|i| (at[i] << self.id.level) + low_corner[i]),
            cells: [
                std::array::from_fn(|i| first.cells[0][i].min(second.cells[0][i])),
                std::array::from_fn(|i| first.cells[1][i].max(second.cells[1][i])),
            ],
            faces: join_faces(&first, &second),
            on_border: first.on_border || second.on_border,
            is_locked: false,
            features: std::array::from_fn(|i| first.features[i] + second.features[i]),
            leaf: TreeLeaf::Node(id),
        };
        let removed = if first.on_border && second.on_border { 1 } else { 2 };
        self.tree.nodes.push(self.node_of(&merged, removed));
        self.clusters[a] = merged;
    }

    /// The node of a merged cluster. `removed`: triangles that the merge takes away.
    fn node_of(&self, merged: &Cluster, removed: u32) -> Node {
        let area = merged.quadric.k.max(1e-30);
        let per_area = 1.0 / area;
        let [low, high] = merged.cells;
        let longest = (0..3).map(|i| high[i] - low[i]).max().unwrap_or(0);
        let level = 32 - longest.leading_zeros() + u32::from(self.id.level);
        let limit = (merged.quadric.c / area).sqrt() * self.per_length * 0.5;
        Node {
            parent: None,
            position: merged.lattice_position,
            error: merged.quadric.c.sqrt() * self.per_length,
            removed,
            level: level.min(MAX_NODE_LEVEL) as u8,
            on_border: merged.on_border,
            s: merged.features[0] * per_area,
            f: merged.features[1] * per_area,
            max_move: decode_max_move(encode_max_move(limit)),
        }
    }

    /// Replaces the second cluster of each pair by the first, and drops degenerate triangles.
    fn compact(&mut self, pairs: &[[usize; 2]]) {
        let second_to_first: BTreeMap<usize, usize> = pairs.iter().map(|&[a, b]| (b, a)).collect();
        let merged = |v: usize| second_to_first.get(&v).copied().unwrap_or(v);
        self.triangles = self
            .triangles
            .iter()
            .map(|t| t.map(merged))
            .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
            .collect();
        self.alive.retain(|at| !second_to_first.contains_key(at));
        self.roots.iter_mut().for_each(|root| *root = merged(*root));
        let merges: BTreeSet<usize> = pairs.iter().flatten().copied().collect();
        self.aside.retain(|pair| !pair.iter().any(|at| merges.contains(at)));
        self.penalised
            .retain(|pair, _| !pair.iter().any(|at| merges.contains(at)));
        self.make_fans();
    }
}
