//! The mesh of one block of the vertex tree while its points merge (docs/algorithm.md#7-vertex-tree). Its own points come first.
//! They are followed by points of neighbouring blocks that are corners of its triangles; these points do not move.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::cluster::{Cluster, Quadric, Vector, add, cross, dot, edge_hash, join_faces, merge, subtract};
use crate::tree::{FullMesh, LATTICE, Node, Point};

/// Triangles around a cluster that merges.
const MAX_FAN: usize = 60;
/// Cosine of the angle by which a triangle may turn.
const MIN_TURN: f32 = 0.5;
/// Minus the cosine between the normals of two triangles that share an edge, around a cluster that has merged.
const MAX_FOLD: f32 = 0.8;

/// The triangles around a vertex: of each the next corner and the one before, counter-clockwise.
type Fan = Vec<[usize; 2]>;

/// A block and the rounds so far.
pub(crate) struct Block {
    low_corner: [i32; 3],
    /// World units of a step of the lattice.
    scale: Vector,
    /// Range of positions of merged clusters, from the low corner.
    range: [[i32; 3]; 2],
    per_length: f32,
    clusters: Vec<Cluster>,
    /// Sums of s and f by area, beside `clusters`.
    features: Vec<[f32; 2]>,
    /// Positions of other blocks' points, by number behind `clusters`.
    foreign: Vec<Vector>,
    triangles: Vec<[usize; 3]>,
    fans: Vec<Fan>,
    /// Pairs that would fold the surface, the smaller number first: not tried again until one of the two merges.
    aside: BTreeSet<[usize; 2]>,
    /// Pairs that may not merge, the smaller number first: not tried again until a cluster around one of the two merges.
    refused: BTreeSet<[usize; 2]>,
    /// Remaining clusters, ascending.
    pub(crate) alive: Vec<usize>,
    /// The node that each own point merged into.
    pub(crate) point_parents: Vec<Option<usize>>,
}

impl Block {
    /// The points `own` of a region, each a cluster, and all triangles with a corner at one.
    pub(crate) fn new(mesh: &FullMesh, region: [u32; 3], own: &[usize]) -> Self {
        let low_corner = region.map(|r| r as i32 * 32 * LATTICE);
        let last = mesh.grid.dims.map(|n| (n as i32 - 1) * LATTICE);
        let margin = if mesh.cap { LATTICE } else { 0 };
        let mut block = Self {
            low_corner,
            scale: mesh.grid.spacing.map(|s| s / LATTICE as f32),
            range: [
                std::array::from_fn(|i| (margin - low_corner[i]).max(0)),
                std::array::from_fn(|i| (last[i] - margin - low_corner[i]).min(32 * LATTICE)),
            ],
            per_length: 1.0 / mesh.grid.smallest_spacing(),
            clusters: Vec::new(),
            features: Vec::new(),
            foreign: Vec::new(),
            triangles: Vec::new(),
            fans: Vec::new(),
            aside: BTreeSet::new(),
            refused: BTreeSet::new(),
            alive: (0..own.len()).collect(),
            point_parents: vec![None; own.len()],
        };
        block.clusters = own.iter().map(|&i| block.lone_cluster(&mesh.points[i])).collect();
        let mut on_border: Vec<bool> = own.iter().map(|&i| mesh.points[i].on_border).collect();
        block.gather(mesh, region, own, &mut on_border);
        block.make_fans();
        for (i, &point) in own.iter().enumerate() {
            block.classify(i, &on_border, mesh.points[point].position, last);
            let area = block.clusters[i].quadric.k;
            block
                .features
                .push([mesh.points[point].s * area, mesh.points[point].f * area]);
        }
        block
    }

    fn relative_to_block(&self, at: [i32; 3]) -> Vector {
        std::array::from_fn(|i| (at[i] - self.low_corner[i]) as f32 * self.scale[i])
    }

    fn lone_cluster(&self, point: &Point) -> Cluster {
        Cluster {
            quadric: Quadric::default(),
            position: self.relative_to_block(point.position),
            cells: [point.cell; 2],
            faces: [[false; 2]; 3],
            on_border: false,
            is_locked: false,
            node: None,
        }
    }

    /// Triangles with a corner in the block. A polygon is emitted in the region of the last of its cells, so they are the region's own
    /// and those of its six neighbours towards higher coordinates that are not across its corner.
    fn gather(&mut self, mesh: &FullMesh, region: [u32; 3], own: &[usize], on_border: &mut Vec<bool>) {
        let mut numbers: BTreeMap<usize, usize> = own.iter().enumerate().map(|(i, &point)| (point, i)).collect();
        for n in 0..7 {
            let at = std::array::from_fn(|i| region[i] + (n >> i & 1));
            for corners in mesh.triangles.get(&at).into_iter().flatten() {
                if !corners.iter().any(|&c| mesh.points[c].region == region) {
                    continue;
                }
                for &corner in corners {
                    let next = numbers.len();
                    if *numbers.entry(corner).or_insert(next) == next {
                        self.foreign.push(self.relative_to_block(mesh.points[corner].position));
                        on_border.push(mesh.points[corner].on_border);
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

    /// Derives a point's quadric and whether it is on the border or may not merge from the triangles around it.
    fn classify(&mut self, at: usize, on_border: &[bool], position: [i32; 3], last: [i32; 3]) {
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
        let ends = fan_ends(&self.fans[at]);
        let cluster = &mut self.clusters[at];
        cluster.quadric = quadric;
        match ends {
            Ends::Closed if !on_border[at] => {}
            Ends::Open { first, last: end } if on_border[at] => {
                let beside = [self.fans[at][first][0], self.fans[at][end][1]];
                if !beside.iter().all(|&vertex| on_border[vertex]) {
                    self.clusters[at].is_locked = true;
                    return;
                }
                for (vertex, normal) in beside.into_iter().zip([normals[first], normals[end]]) {
                    self.add_border_plane(at, vertex, normal);
                }
                let cluster = &mut self.clusters[at];
                cluster.on_border = true;
                cluster.faces = std::array::from_fn(|i| [position[i] == 0, position[i] == last[i]]);
            }
            _ => cluster.is_locked = true,
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

    /// A third of the triangles around each point, summed.
    pub(crate) fn area(&self) -> f32 {
        self.clusters.iter().fold(0.0, |sum, cluster| sum + cluster.quadric.k)
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

    /// Whether merging keeps the topology (the link condition) and turns no triangle too far.
    fn may_merge(&self, a: usize, b: usize) -> bool {
        let (a, b) = (a.min(b), a.max(b));
        let [first, second] = [a, b].map(|i| &self.clusters[i]);
        let [around_first, around_second] = [a, b].map(|i| self.fans[i].len());
        if around_first > MAX_FAN || around_second > MAX_FAN {
            return false;
        }
        let both_on_border = first.on_border && second.on_border;
        // On the border the edge between them has to lie on it as well.
        if both_on_border && self.fans[a].iter().filter(|t| t.contains(&b)).count() != 1 {
            return false;
        }
        let of_second = self.neighbours(b);
        let common = self
            .neighbours(a)
            .into_iter()
            .filter(|v| *v != b && of_second.contains(v));
        if common.count() != if both_on_border { 1 } else { 2 } {
            return false;
        }
        // A tetrahedron, or a triangle alone.
        let smallest = if both_on_border { 1 } else { 3 };
        if around_first == smallest && around_second == smallest {
            return false;
        }
        let to = add(first.position, merge(first, second).to);
        !self.turns_triangle(a, b, to) && !self.turns_triangle(b, a, to)
    }

    /// Whether a triangle around a cluster, except those with `other`, turns too far if the cluster moves to `to`.
    fn turns_triangle(&self, at: usize, other: usize, to: Vector) -> bool {
        let from = self.position(at);
        self.fans[at].iter().filter(|t| !t.contains(&other)).any(|&[p, q]| {
            let [at_p, at_q] = [self.position(p), self.position(q)];
            let [before, after] = [from, to].map(|x| cross(subtract(at_p, x), subtract(at_q, x)));
            let turn = dot(before, after);
            turn < 0.0 || turn * turn < MIN_TURN * MIN_TURN * dot(before, before) * dot(after, after)
        })
    }

    /// The neighbours with which a cluster may merge by their costs, the minimum cost first; for equal costs the smaller hash decides.
    fn candidates(&self, at: usize) -> VecDeque<usize> {
        if self.clusters[at].is_locked {
            return VecDeque::new();
        }
        let mut candidates = Vec::new();
        for other in self.neighbours(at).into_iter().filter(|&v| self.is_own(v)) {
            let (a, b) = (at.min(other), at.max(other));
            let cost = self.cost(a, b);
            if cost < f32::INFINITY && !self.aside.contains(&[a, b]) && !self.refused.contains(&[a, b]) {
                candidates.push((cost, edge_hash(a, b), other));
            }
        }
        candidates.sort_unstable_by(|x, y| by_cost(x.0, y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        candidates.into_iter().map(|(_, _, other)| other).collect()
    }

    fn cost(&self, a: usize, b: usize) -> f32 {
        merge(&self.clusters[a.min(b)], &self.clusters[a.max(b)]).cost
    }

    /// Pairs of clusters that are each other's best neighbour and pass the pair test; the smaller number first, ascending. A pair is tested
    /// once both have chosen each other. If it may not merge, both choose again, and the pair is excluded until a cluster around them
    /// merges.
    pub(crate) fn find_pairs(&mut self) -> Vec<[usize; 2]> {
        let mut candidates = vec![VecDeque::new(); self.clusters.len()];
        for &at in &self.alive {
            candidates[at] = self.candidates(at);
        }
        let mut pairs = BTreeSet::new();
        let mut chosen_again = self.alive.clone();
        while let Some(at) = chosen_again.pop() {
            let Some(&other) = candidates[at].front() else { continue };
            let pair = [at.min(other), at.max(other)];
            if candidates[other].front() != Some(&at) || pairs.contains(&pair) {
                continue;
            }
            if self.may_merge(at, other) {
                pairs.insert(pair);
                continue;
            }
            self.refused.insert(pair);
            for cluster in pair {
                candidates[cluster].pop_front();
                chosen_again.push(cluster);
            }
        }
        let pairs: Vec<[usize; 2]> = pairs.into_iter().collect();
        let folding = self.folding_pairs(&pairs);
        let mut failed = self.failed_pairs(&pairs);
        failed.extend(folding.iter().map(|pair| pair[0]));
        self.aside.extend(folding);
        let changed: BTreeSet<usize> = pairs
            .iter()
            .flatten()
            .flat_map(|&at| self.neighbours(at).into_iter().chain([at]))
            .collect();
        self.refused.retain(|pair| !pair.iter().any(|at| changed.contains(at)));
        pairs.into_iter().filter(|pair| !failed.contains(&pair[0])).collect()
    }

    /// Pairs that fold the surface if all pairs merge: around the merged cluster, one triangle folds back over the next.
    fn folding_pairs(&self, pairs: &[[usize; 2]]) -> Vec<[usize; 2]> {
        let merged: BTreeMap<usize, (usize, Vector)> = pairs
            .iter()
            .flat_map(|&[a, b]| {
                let [first, second] = [a, b].map(|i| &self.clusters[i]);
                let position = add(first.position, merge(first, second).to);
                [a, b].map(|i| (i, (a, position)))
            })
            .collect();
        let after = |v: usize| merged.get(&v).copied().unwrap_or((v, self.position(v)));
        let folds = |&[a, b]: &[usize; 2]| {
            let is_open = self.clusters[a].on_border || self.clusters[b].on_border;
            let mut ring: Vec<_> = self.joined_ring(a, b, is_open).into_iter().map(after).collect();
            ring.dedup_by_key(|corner| corner.0);
            if !is_open {
                if ring.len() > 1 && ring[0].0 == ring[ring.len() - 1].0 {
                    ring.pop();
                }
                ring.extend_from_within(..2.min(ring.len()));
            }
            let centre = after(a).1;
            let normals: Vec<Vector> = ring
                .windows(2)
                .map(|corners| cross(subtract(corners[0].1, centre), subtract(corners[1].1, centre)))
                .collect();
            normals.windows(2).any(|pair| folds_back(pair[0], pair[1]))
        };
        pairs.iter().copied().filter(folds).collect()
    }

    /// The ring around two neighbours, counter-clockwise; on the border from one end to the other.
    fn joined_ring(&self, a: usize, b: usize, is_open: bool) -> Vec<usize> {
        let steps: BTreeMap<usize, usize> = [(a, b), (b, a)]
            .into_iter()
            .flat_map(|(own, other)| self.fans[own].iter().filter(move |t| !t.contains(&other)))
            .map(|&[p, q]| (p, q))
            .collect();
        let is_end = |p: &&usize| !is_open || steps.values().all(|q| q != *p);
        let start = steps.keys().find(is_end).copied();
        let mut ring: Vec<usize> = std::iter::successors(start, |p| steps.get(p).copied())
            .take(steps.len() + 1)
            .collect();
        if !is_open {
            ring.truncate(steps.len());
        }
        ring
    }

    /// The pair test: first clusters of pairs that would keep too few triangles, would close the border, or would meet another pair along
    /// more than one line and cost more than that.
    fn failed_pairs(&self, pairs: &[[usize; 2]]) -> BTreeSet<usize> {
        let second_to_first: BTreeMap<usize, usize> = pairs.iter().map(|&[a, b]| (b, a)).collect();
        let costs: BTreeMap<usize, f32> = pairs.iter().map(|&[a, b]| (a, self.cost(a, b))).collect();
        let merged = |v: usize| second_to_first.get(&v).copied().unwrap_or(v);
        let mut failed = BTreeSet::new();
        for &[a, b] in pairs {
            let all: Fan = [a, b]
                .iter()
                .flat_map(|&i| &self.fans[i])
                .map(|t| t.map(merged))
                .collect();
            let left: Fan = all
                .iter()
                .copied()
                .filter(|&[p, q]| p != a && q != a && p != q)
                .collect();
            let on_border = self.clusters[a].on_border || self.clusters[b].on_border;
            // On the border one triangle is enough, but the border may not close.
            let ring = self.joined_ring(a, b, on_border);
            let is_closed = ring.first().map(|&v| merged(v)) == ring.last().map(|&v| merged(v));
            if if on_border { is_closed } else { left.len() < 3 } {
                failed.insert(a);
            }
            for other in all.iter().map(|t| t[0]).filter(|v| *v != a && costs.contains_key(v)) {
                let lines = [0, 1].map(|side| left.iter().filter(|t| t[side] == other).count());
                if lines.into_iter().max() > Some(1) {
                    let order = by_cost(costs[&a], costs[&other]).then(a.cmp(&other));
                    failed.insert(if order == Ordering::Greater { a } else { other });
                }
            }
        }
        failed
    }

    /// Makes the node of a pair; the pair's first cluster becomes the merged one.
    pub(crate) fn commit(&mut self, [a, b]: [usize; 2], nodes: &mut [Node]) -> Node {
        let index = nodes.len();
        let [first, second] = [a, b].map(|i| self.clusters[i].clone());
        let merge = merge(&first, &second);
        let wanted = add(first.position, merge.to);
        let at: [i32; 3] = std::array::from_fn(|i| {
            let steps = (wanted[i] / self.scale[i]).round_ties_even() as i32;
            steps.clamp(self.range[0][i], self.range[1][i])
        });
        let position: Vector = std::array::from_fn(|i| at[i] as f32 * self.scale[i]);
        let mut quadric = merge.quadric.shifted(subtract(position, first.position));
        quadric.c = quadric.c.max(0.0);
        for (own, cluster) in [(a, &first), (b, &second)] {
            match cluster.node {
                Some(node) => nodes[node].parent = Some(index),
                None => self.point_parents[own] = Some(index),
            }
        }
        let cells = [
            std::array::from_fn(|i| first.cells[0][i].min(second.cells[0][i])),
            std::array::from_fn(|i| first.cells[1][i].max(second.cells[1][i])),
        ];
        let on_border = first.on_border || second.on_border;
        self.clusters[a] = Cluster {
            quadric,
            position,
            cells,
            faces: join_faces(&first, &second),
            on_border,
            is_locked: false,
            node: Some(index),
        };
        let other = self.features[b];
        self.features[a] = std::array::from_fn(|i| self.features[a][i] + other[i]);
        let per_area = 1.0 / quadric.k.max(1e-30);
        let longest = (0..3).map(|i| cells[1][i] - cells[0][i]).max().unwrap_or(0);
        Node {
            parent: None,
            position: std::array::from_fn(|i| at[i] + self.low_corner[i]),
            error: quadric.c.sqrt() * self.per_length,
            removed: if first.on_border && second.on_border { 1 } else { 2 },
            level: (32 - longest.leading_zeros()) as u8,
            on_border,
            s: self.features[a][0] * per_area,
            f: self.features[a][1] * per_area,
        }
    }

    /// Replaces the second cluster of each pair by the first, and drops degenerate triangles.
    pub(crate) fn compact(&mut self, pairs: &[[usize; 2]]) {
        let second_to_first: BTreeMap<usize, usize> = pairs.iter().map(|&[a, b]| (b, a)).collect();
        let merged = |v: usize| second_to_first.get(&v).copied().unwrap_or(v);
        self.triangles = self
            .triangles
            .iter()
            .map(|t| t.map(merged))
            .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
            .collect();
        self.alive.retain(|at| !second_to_first.contains_key(at));
        let merges = |at: &usize| merged(*at) != *at || pairs.iter().any(|pair| pair[0] == *at);
        self.aside.retain(|pair| !pair.iter().any(merges));
        self.make_fans();
    }
}

/// Whether one of two triangles that share an edge folds back over the other. `a`, `b`: their normals.
fn folds_back(a: Vector, b: Vector) -> bool {
    let product = dot(a, b);
    product < 0.0 && product * product > MAX_FOLD * MAX_FOLD * dot(a, a) * dot(b, b)
}

/// Order of costs: finite numbers; a zero may have either sign.
fn by_cost(x: f32, y: f32) -> Ordering {
    x.partial_cmp(&y).unwrap_or(Ordering::Equal)
}

/// How the triangles around a vertex lie.
enum Ends {
    /// One fan, closed.
    Closed,
    /// One fan from a first to a last triangle, by index.
    Open { first: usize, last: usize },
    /// None, or several fans.
    Other,
}

/// Follows a fan from triangle to triangle.
fn fan_ends(fan: &Fan) -> Ends {
    let before_none = (0..fan.len()).rfind(|&i| !fan.iter().any(|t| t[1] == fan[i][0]));
    let first = before_none.unwrap_or(0);
    let mut at = first;
    for steps in 1..=fan.len() {
        let next = fan.iter().position(|t| t[0] == fan[at][1]);
        match next {
            Some(next) if next != first => at = next,
            _ if steps < fan.len() => return Ends::Other,
            Some(_) if before_none.is_none() => return Ends::Closed,
            None if before_none.is_some() => return Ends::Open { first, last: at },
            _ => return Ends::Other,
        }
    }
    Ends::Other
}
