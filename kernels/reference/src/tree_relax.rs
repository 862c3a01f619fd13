//! Where nodes of the vertex tree move to in a cut (docs/algorithm.md#82-relaxation).

use std::collections::{BTreeMap, BTreeSet};

use crate::Field;
use crate::quadric::{Vector, dot, unit};
use crate::tree::{LATTICE, NodeId};
use crate::tree_cut::{Cutter, TreeLeaf, Triangles, node_of};
use crate::trilinear::{corners, interpolate};

/// Parts of a smallest spacing that an offset is rounded to.
const OFFSET_STEPS: f64 = 8192.0;
/// Smallest spacings: offsets beyond count for less and less.
const OFFSET_MAX: f64 = 0.25;
/// Smallest spacings that a node moves at most.
const MOVED_MAX: f64 = 0.04;
/// Cells: nearer to a face of a capped volume a triangle lies in the face.
const FACE_MARGIN: f32 = 1.0 / 256.0;
/// Part of the mean offset that a node moves.
const OFFSET_SHARE: f64 = 0.7;
/// Steps of a vertex' position in a cell.
const VERTEX_STEPS: f32 = 65536.0;

/// Offsets around a node.
#[derive(Clone, Copy, Default)]
struct Sum {
    offsets: i64,
    count: i64,
}

/// A volume and the isosurface that a cut is of.
#[derive(Clone, Copy)]
pub struct Relaxer<'a> {
    /// The cut's tree.
    pub cutter: Cutter<'a>,
    /// The volume, padded where the mesh is of a capped one.
    pub field: &'a Field,
    /// Isovalue.
    pub iso: f32,
    /// Unit normals of nodes in world units.
    pub normals: &'a BTreeMap<NodeId, [f32; 3]>,
}

impl Relaxer<'_> {
    /// Where the nodes of a cut lie, 1/[`LATTICE`] cell.
    pub fn positions(&self, triangles: &Triangles) -> BTreeMap<NodeId, [i32; 3]> {
        let mut sums = BTreeMap::<NodeId, Sum>::new();
        for (&region, triangles) in triangles {
            for triangle in triangles {
                // As fine as the full mesh.
                let is_fine = triangle.iter().any(|&leaf| self.cutter.level(leaf) == 0);
                let measured = if is_fine {
                    Some(0)
                } else {
                    self.offset(region, triangle)
                };
                let Some(offset) = measured else { continue };
                for leaf in triangle {
                    let TreeLeaf::Node(node) = *leaf else { continue };
                    let sum = sums.entry(node).or_default();
                    sum.offsets += offset;
                    sum.count += 1;
                }
            }
        }
        let of_cut: BTreeSet<NodeId> = triangles
            .values()
            .flatten()
            .flatten()
            .filter_map(|&leaf| node_of(leaf))
            .collect();
        of_cut
            .into_iter()
            .map(|node| (node, self.moved(node, sums.get(&node).copied().unwrap_or_default())))
            .collect()
    }

    fn padding(&self) -> i32 {
        i32::from(self.cutter.mesh.cap)
    }

    /// How far it is from the centroid of a region's triangle to the surface along the triangle's normal, smallest spacings /
    /// [`OFFSET_STEPS`].
    fn offset(&self, region: [u32; 3], triangle: &[TreeLeaf; 3]) -> Option<i64> {
        let grid = &self.field.grid;
        let origin = region.map(|r| 32 * r as i32);
        // Rounded as the device does, which decides in which cell the centroid is.
        let steps = VERTEX_STEPS as i32 / LATTICE;
        let at = triangle.map(|leaf| self.cutter.position(leaf));
        let at = at.map(|p| [0, 1, 2].map(|i| ((p[i] - origin[i] * LATTICE) * steps) as f32));
        let x: [f32; 3] = std::array::from_fn(|i| (at[0][i] + at[1][i] + at[2][i]) * (1.0 / (3.0 * VERTEX_STEPS)));
        let side =
            |to: usize| -> Vector { std::array::from_fn(|i| f64::from((at[to][i] - at[0][i]) * grid.spacing[i])) };
        let (a, b) = (side(1), side(2));
        let normal = unit(std::array::from_fn(|i| {
            let [j, k] = [(i + 1) % 3, (i + 2) % 3];
            a[j] * b[k] - a[k] * b[j]
        }));
        let (first, last) = (self.padding(), grid.dims.map(|n| n as i32 - 2 - self.padding()));
        let low: [i32; 3] = std::array::from_fn(|i| (x[i].floor() as i32 + origin[i]).clamp(first, last[i]));
        let place = std::array::from_fn(|i| f64::from(x[i] - (low[i] - origin[i]) as f32));
        let (per_cell, value) = interpolate(corners(self.field, low.map(|i| i as u32)), place);
        let value = value - f64::from(self.iso);
        let in_face = |i: usize| {
            x[i] < (1 - origin[i]) as f32 + FACE_MARGIN || x[i] > (last[i] + 1 - origin[i]) as f32 - FACE_MARGIN
        };
        if self.cutter.mesh.cap && (0..3).any(in_face) && !value.is_nan() {
            return Some(0);
        }
        let gradient: Vector = std::array::from_fn(|i| per_cell[i] / f64::from(grid.spacing[i]));
        let offset = -value * dot(gradient, normal) / dot(gradient, gradient) / f64::from(grid.smallest_spacing());
        let near = offset
            .abs()
            .min(2.0 * OFFSET_MAX - offset.abs())
            .max(0.0)
            .copysign(offset);
        (!offset.is_nan()).then(|| (near * OFFSET_STEPS).round_ties_even() as i64)
    }

    fn moved(&self, node: NodeId, sum: Sum) -> [i32; 3] {
        let at = self.cutter.position(TreeLeaf::Node(node));
        let grid = &self.field.grid;
        let margin = self.padding() * LATTICE;
        let faces: [[i32; 2]; 3] = std::array::from_fn(|i| [margin, (grid.dims[i] as i32 - 1) * LATTICE - margin]);
        if (0..3).any(|i| at[i] <= faces[i][0] || at[i] >= faces[i][1]) {
            return at;
        }
        let mean = sum.offsets as f64 / OFFSET_STEPS / sum.count.max(1) as f64;
        let way = (OFFSET_SHARE * mean).clamp(-MOVED_MAX, MOVED_MAX) * f64::from(grid.smallest_spacing());
        std::array::from_fn(|i| {
            let step = f64::from(self.normals[&node][i]) * way / f64::from(grid.spacing[i]) * f64::from(LATTICE);
            let region = [0, 32].map(|cells| (node.0[i] as i32 * 32 + cells) * LATTICE);
            (at[i] + step.round_ties_even() as i32).clamp(faces[i][0].max(region[0]), faces[i][1].min(region[1]))
        })
    }
}
