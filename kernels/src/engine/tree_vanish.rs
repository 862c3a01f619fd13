//! Nodes of the vertex tree at which small parts of the surface vanish (docs/algorithm.md#7-vertex-tree).

use crate::constants::{CLUSTER_BORDER, KEY_SINGLE, MAX_CUBE_LEVEL, NODE_BORDER, NONE, TREE_ROUNDS, VERTEX_LATTICE};
use crate::layout::{Grid, TreeCluster, TreeMembers, TreeNode};

/// Maximum number of clusters of a part that may vanish.
const MAX_CLUSTERS: usize = 32;
/// A part vanishes at this share of its second moment, which the planes of its triangles do not see: at three times its root mean square
/// radius, by area.
const MOMENT_SHARE: f64 = 9.0;

/// What all levels have left of a surface.
pub struct Remains {
    pub clusters: Vec<TreeCluster>,
    pub members: Vec<TreeMembers>,
    /// Position in the volume, and flags.
    pub points: Vec<[i32; 4]>,
    /// Three clusters a triangle.
    pub corners: Vec<u32>,
}

/// Nodes at which parts vanish, in rounds.
#[derive(Default)]
pub struct Vanishing {
    pub nodes: Vec<TreeNode>,
    pub errors: Vec<u32>,
    /// Pairs of a leaf and the node above it.
    pub parents: Vec<[u32; 2]>,
    pub round_ends: Vec<u32>,
}

/// The parts of a surface: sets of clusters that chains of triangles join, in order of their first clusters.
struct Parts {
    /// The part of each cluster, or `NONE`.
    of_clusters: Vec<u32>,
    sums: Vec<Sums>,
}

/// Sums over a part.
#[derive(Clone, Copy, Default)]
struct Sums {
    clusters: usize,
    triangles: usize,
    area: f64,
    /// World units.
    centroid: [f64; 3],
    /// Second moment about the centroid.
    moment: f64,
}

/// A part that may vanish: all of its nodes have the same error.
struct Chain {
    clusters: Vec<usize>,
    node: TreeNode,
    error: u32,
    /// How many nodes it has.
    length: usize,
    /// Whether the first one takes away one triangle instead of two.
    is_odd: bool,
}

impl Sums {
    /// Whether the part is small enough for a chain.
    fn fits(&self) -> bool {
        self.clusters <= MAX_CLUSTERS && self.area > 0.0 && self.chain_length() <= TREE_ROUNDS as usize
    }

    /// How many nodes take away all triangles: two each, the first one of an odd number one.
    fn chain_length(&self) -> usize {
        self.triangles.div_ceil(2)
    }
}

impl Remains {
    /// The nodes at which parts vanish. `level`: that of their block; `points`: of the surface; `first`: the number of the first node.
    pub fn vanishing(&self, grid: &Grid, level: u32, points: u32, first: u32) -> Vanishing {
        let chains = self.chains(grid, level);
        let mut vanishing = Vanishing::default();
        let rounds = chains.iter().map(|chain| chain.length).max().unwrap_or(0);
        // The node that each chain has reached.
        let mut tops = vec![0; chains.len()];
        for round in 0..rounds {
            for (chain, top) in chains.iter().zip(&mut tops) {
                if round >= chain.length {
                    continue;
                }
                let number = first + vanishing.nodes.len() as u32;
                vanishing.nodes.push(chain.node);
                let is_single = round == 0 && chain.is_odd;
                vanishing
                    .errors
                    .push(chain.error | if is_single { KEY_SINGLE } else { 0 });
                if round == 0 {
                    let leaves = chain.clusters.iter().map(|&at| self.clusters[at].ring_first);
                    vanishing.parents.extend(leaves.map(|leaf| [leaf, number]));
                } else {
                    vanishing.parents.push([*top, number]);
                }
                *top = points + number;
            }
            vanishing.round_ends.push(vanishing.nodes.len() as u32);
        }
        // The last node of a chain has no parent.
        vanishing.parents.extend(tops.into_iter().map(|top| [top, NONE]));
        vanishing
    }

    /// The parts that may vanish, in order of their first clusters. The one of the largest moment never does.
    fn chains(&self, grid: &Grid, level: u32) -> Vec<Chain> {
        let parts = self.parts(grid);
        let mut largest = 0;
        for (i, sums) in parts.sums.iter().enumerate() {
            if sums.moment > parts.sums[largest].moment {
                largest = i;
            }
        }
        let may_vanish = |part: usize| part != largest && parts.sums[part].fits();
        let mut clusters: Vec<Vec<usize>> = vec![Vec::new(); parts.sums.len()];
        for (i, &part) in parts.of_clusters.iter().enumerate() {
            if part != NONE && may_vanish(part as usize) {
                clusters[part as usize].push(i);
            }
        }
        let vanishing = clusters
            .into_iter()
            .zip(&parts.sums)
            .filter(|(clusters, _)| !clusters.is_empty());
        vanishing
            .map(|(clusters, sums)| self.chain(clusters, sums, grid, level))
            .collect()
    }

    fn chain(&self, clusters: Vec<usize>, sums: &Sums, grid: &Grid, level: u32) -> Chain {
        let smallest = grid.spacing.into_iter().fold(f32::INFINITY, f32::min);
        let squared: f64 = clusters.iter().map(|&i| f64::from(self.clusters[i].quadric.c)).sum();
        let error = squared.max(MOMENT_SHARE * sums.moment).sqrt() / f64::from(smallest);
        let step = |axis: usize| step(grid, axis) * f64::from(1u32 << level);
        // Beyond 1024 cells the position does not fit. Nothing shows it: a vanished part has no triangle.
        let at: [u32; 3] =
            std::array::from_fn(|axis| (sums.centroid[axis] / step(axis)).round_ties_even().clamp(0.0, 65536.0) as u32);
        let mean = |of: fn(&TreeMembers) -> f32| {
            let sum: f64 = clusters.iter().map(|&i| f64::from(of(&self.members[i]))).sum();
            (sum / sums.area) as f32
        };
        let s = (mean(|members| members.s).clamp(0.0, 1.0) * 65535.0 + 0.5) as u32;
        let on_border = clusters.iter().any(|&i| self.points[i][3] as u32 & CLUSTER_BORDER != 0);
        let node = TreeNode {
            position: [at[0] | at[1] << 17, at[1] >> 15 | at[2] << 2 | level << 28],
            normal_s: s << 16,
            f: mean(|members| members.f),
            meta: MAX_CUBE_LEVEL | if on_border { NODE_BORDER } else { 0 },
        };
        Chain {
            clusters,
            node,
            error: (error as f32).to_bits(),
            length: sums.chain_length(),
            is_odd: sums.triangles % 2 == 1,
        }
    }

    fn parts(&self, grid: &Grid) -> Parts {
        let mut labels: Vec<u32> = (0..self.clusters.len() as u32).collect();
        for corners in self.corners.chunks_exact(3) {
            let firsts = [0, 1, 2].map(|k| first_of(&mut labels, corners[k]));
            let lowest = firsts[0].min(firsts[1]).min(firsts[2]);
            firsts.into_iter().for_each(|first| labels[first as usize] = lowest);
        }
        let mut triangles = vec![0usize; labels.len()];
        for corners in self.corners.chunks_exact(3) {
            triangles[first_of(&mut labels, corners[0]) as usize] += 1;
        }
        let mut sums: Vec<Sums> = Vec::new();
        let mut of_clusters = vec![NONE; labels.len()];
        for i in 0..labels.len() {
            let first = first_of(&mut labels, i as u32) as usize;
            if triangles[first] == 0 {
                continue;
            }
            // The first cluster comes before the others.
            if first == i {
                of_clusters[i] = sums.len() as u32;
                sums.push(Sums {
                    triangles: triangles[i],
                    ..Default::default()
                });
            }
            of_clusters[i] = of_clusters[first];
        }
        self.add_up(&of_clusters, &mut sums, grid);
        Parts { of_clusters, sums }
    }

    /// Adds each part's clusters to its sums.
    fn add_up(&self, of_clusters: &[u32], sums: &mut [Sums], grid: &Grid) {
        let steps: [f64; 3] = std::array::from_fn(|axis| step(grid, axis));
        let position =
            |i: usize| -> [f64; 3] { std::array::from_fn(|axis| f64::from(self.points[i][axis]) * steps[axis]) };
        let area = |i: usize| f64::from(self.clusters[i].quadric.k);
        let members = || of_clusters.iter().enumerate().filter(|&(_, &part)| part != NONE);
        for (i, &part) in members() {
            let (sums, at) = (&mut sums[part as usize], position(i));
            sums.clusters += 1;
            sums.area += area(i);
            (0..3).for_each(|axis| sums.centroid[axis] += area(i) * at[axis]);
        }
        for sums in &mut *sums {
            let area = if sums.area > 0.0 { sums.area } else { f64::INFINITY };
            sums.centroid = sums.centroid.map(|sum| sum / area);
        }
        for (i, &part) in members() {
            let (sums, at) = (&mut sums[part as usize], position(i));
            let distance2: f64 = (0..3).map(|axis| (at[axis] - sums.centroid[axis]).powi(2)).sum();
            sums.moment += area(i) * distance2;
        }
    }
}

/// World units of a step of a vertex' position.
fn step(grid: &Grid, axis: usize) -> f64 {
    f64::from(grid.spacing[axis]) / f64::from(VERTEX_LATTICE)
}

/// The first cluster of a cluster's part, as far as is known. Shortens the way to it.
fn first_of(labels: &mut [u32], mut at: u32) -> u32 {
    while labels[at as usize] != at {
        labels[at as usize] = labels[labels[at as usize] as usize];
        at = labels[at as usize];
    }
    at
}
