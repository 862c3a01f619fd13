//! Relaxed positions of the vertex tree's nodes in a cut (docs/algorithm.md#83-relaxation).

use std::collections::BTreeMap;

use isopeel_kernels::Grid;

use crate::quadric::{Vector, dot, unit};
use crate::tree::{LATTICE, NodeId};
use crate::tree_cut::{Cutter, TreeLeaf, node_of};

/// Parts of a smallest spacing that an offset is rounded to.
const OFFSET_STEPS: f64 = 8192.0;
/// Maximum of an offset, in smallest spacings: larger offsets count as this.
const OFFSET_MAX: f64 = 4.0;
/// The share of the mean offset by which a node moves.
const OFFSET_SHARE: f64 = 0.7;

/// Offsets around a node.
#[derive(Clone, Copy, Default)]
struct Sum {
    offsets: i64,
    count: i64,
}

/// Inputs of the relaxation of a cut.
#[derive(Clone, Copy)]
pub struct Relaxer<'a> {
    /// The cut's tree.
    pub cutter: Cutter<'a>,
    /// Extent of the volume, padded if the mesh is of a capped one.
    pub grid: &'a Grid,
    /// Unit normals of nodes in world units.
    pub normals: &'a BTreeMap<NodeId, [f32; 3]>,
}

impl Relaxer<'_> {
    /// Positions of the nodes of a cut, 1/[`LATTICE`] cell. `leaves`: the leaf of each point.
    pub fn positions(&self, leaves: &[TreeLeaf]) -> BTreeMap<NodeId, [i32; 3]> {
        let mut sums = BTreeMap::<NodeId, Sum>::new();
        for points in self.cutter.mesh.triangles.values().flatten() {
            let corners = points.map(|point| leaves[point]);
            if corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] {
                continue;
            }
            let offset = self.offset(points, &corners);
            for node in corners.into_iter().filter_map(node_of) {
                let sum = sums.entry(node).or_default();
                sum.offsets += offset;
                sum.count += 1;
            }
        }
        sums.into_iter()
            .map(|(node, sum)| (node, self.moved(node, sum)))
            .collect()
    }

    fn padding(&self) -> i32 {
        i32::from(self.cutter.mesh.cap)
    }

    /// Height of the centroid of a full-mesh triangle above the triangle between its leaves, in smallest spacings /
    /// [`OFFSET_STEPS`]. 0 if that triangle has no plane.
    fn offset(&self, points: &[usize; 3], corners: &[TreeLeaf; 3]) -> i64 {
        // As fine as the full mesh.
        if corners.iter().any(|&leaf| self.cutter.level(leaf) == 0) {
            return 0;
        }
        let spacing = self.grid.spacing.map(f64::from);
        let world =
            |at: [i32; 3]| -> Vector { std::array::from_fn(|i| f64::from(at[i]) / f64::from(LATTICE) * spacing[i]) };
        let [a, b, c] = corners.map(|leaf| world(self.cutter.position(leaf)));
        let full = points.map(|point| world(self.cutter.mesh.points[point].position));
        let way = |to: Vector| -> Vector { std::array::from_fn(|i| to[i] - a[i]) };
        let (u, v) = (way(b), way(c));
        let normal = unit(std::array::from_fn(|i| {
            let [j, k] = [(i + 1) % 3, (i + 2) % 3];
            u[j] * v[k] - u[k] * v[j]
        }));
        let centroid = std::array::from_fn(|i| (full[0][i] + full[1][i] + full[2][i]) / 3.0);
        let height = dot(way(centroid), normal) / f64::from(self.grid.smallest_spacing());
        let rounded = (height.clamp(-OFFSET_MAX, OFFSET_MAX) * OFFSET_STEPS).round_ties_even();
        rounded as i64
    }

    fn moved(&self, node: NodeId, sum: Sum) -> [i32; 3] {
        let at = self.cutter.position(TreeLeaf::Node(node));
        let grid = self.grid;
        let margin = self.padding() * LATTICE;
        let faces: [[i32; 2]; 3] = std::array::from_fn(|i| [margin, (grid.dims[i] as i32 - 1) * LATTICE - margin]);
        if (0..3).any(|i| at[i] <= faces[i][0] || at[i] >= faces[i][1]) {
            return at;
        }
        let max_move = f64::from(self.cutter.node(node).max_move);
        let low_corner = node.block.low_corner();
        let mean = sum.offsets as f64 / OFFSET_STEPS / sum.count.max(1) as f64;
        let way = (OFFSET_SHARE * mean).clamp(-max_move, max_move) * f64::from(grid.smallest_spacing());
        std::array::from_fn(|i| {
            let step = f64::from(self.normals[&node][i]) * way / f64::from(grid.spacing[i]) * f64::from(LATTICE);
            let [low, high] = [0, node.block.extent()].map(|end| low_corner[i] + end);
            (at[i] + step.round_ties_even() as i32).clamp(faces[i][0].max(low), faces[i][1].min(high))
        })
    }
}
