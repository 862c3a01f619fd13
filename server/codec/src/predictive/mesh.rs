//! The part of a mesh that was coded so far, and the prediction of the next vertex from it.
//!
//! The predictions use IEEE doubles, and only sums, products, quotients and square roots, so that encoder and decoder get the same bits.

use super::super::chunk::WireVertex;
use super::super::range_coder::length;

/// Number of contexts (probability models of the range coder) for positions. The size of the triangle in front of the edge selects one.
pub(super) const SIZE_CONTEXTS: usize = 12;
/// Number of contexts of a feature, which depend on the difference between both ends of the edge.
pub(super) const DIFFERENCE_CONTEXTS: usize = 10;
/// Maximum number of triangles that is counted at a vertex.
const MAX_TRIANGLES: u8 = 7;
/// Maximum magnitude of a coordinate that is predicted from a plane, in lattice units.
const MAX_PREDICTED: f64 = 65536.0;

/// Converts a feature to the step that is coded. Features are multiples of 256, or 65535.
pub(super) fn feature_step(value: u16) -> i32 {
    i32::from(value >> 8) + i32::from(value == u16::MAX)
}

/// Converts a coded step to a feature; `None` if the step is out of range.
pub(super) fn feature_from_step(step: i32) -> Option<u16> {
    match step {
        0..256 => Some((step as u16) << 8),
        256 => Some(u16::MAX),
        _ => None,
    }
}

/// The vertices and triangles that were coded so far.
#[derive(Default)]
pub(super) struct Mesh {
    pub vertices: Vec<WireVertex>,
    /// Triangles in the order in which they were coded.
    pub triangles: Vec<[u32; 3]>,
    /// Level of each triangle.
    pub levels: Vec<u8>,
    /// For each vertex, the sum of the cross products of its triangles.
    normals: Vec<[f64; 3]>,
    /// For each vertex, the number of its triangles, up to [`MAX_TRIANGLES`].
    counts: Vec<u8>,
}

impl Mesh {
    pub fn position(&self, vertex: u32) -> [i32; 3] {
        self.vertices[vertex as usize].position.map(i32::from)
    }

    pub fn add_vertex(&mut self, vertex: WireVertex) {
        self.vertices.push(vertex);
        self.normals.push([0.0; 3]);
        self.counts.push(0);
    }

    pub fn add_triangle(&mut self, corners: [u32; 3], level: u8) {
        let [a, b, c] = corners.map(|corner| self.position(corner).map(f64::from));
        let (u, v) = (minus(b, a), minus(c, a));
        let normal = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        for corner in corners.map(|corner| corner as usize) {
            let sum = &mut self.normals[corner];
            *sum = [0, 1, 2].map(|axis| sum[axis] + normal[axis]);
            self.counts[corner] = (self.counts[corner] + 1).min(MAX_TRIANGLES);
        }
        self.triangles.push(corners);
        self.levels.push(level);
    }

    /// Returns the context for coding whether the third vertex behind an edge is new, right, left or another. It depends on the numbers of
    /// triangles at the edge's ends.
    pub fn edge_context(&self, from: u32, to: u32) -> usize {
        usize::from(self.counts[from as usize]) + 8 * usize::from(self.counts[to as usize])
    }

    /// Returns the unit normal of the triangles that a vertex has so far, or zeros.
    fn unit_normal(&self, vertex: u32) -> [f64; 3] {
        unit(self.normals[vertex as usize])
    }

    /// Predicts the normal of a vertex from its triangles, as octahedral coordinates. `weights`: factors of the normal's components, which
    /// stand for the spacing of the grid.
    pub fn predicted_normal(&self, vertex: usize, weights: [u16; 3]) -> [i32; 2] {
        let sum = self.normals[vertex];
        octahedral([0, 1, 2].map(|axis| sum[axis] * f64::from(weights[axis])))
    }

    /// Returns the weights with which the predicted normals are close to those of `vertices`.
    pub fn normal_weights(&self, vertices: &[WireVertex]) -> [u16; 3] {
        let given: Vec<[f64; 3]> = vertices.iter().map(|vertex| from_octahedral(vertex.normal)).collect();
        let sum_of = |normals: &mut dyn Iterator<Item = [f64; 3]>| {
            normals.fold([0.0; 3], |sum, normal| {
                [0, 1, 2].map(|axis| sum[axis] + normal[axis].abs())
            })
        };
        let target = sum_of(&mut given.iter().copied());
        let mut weights = [1.0; 3];
        for _ in 0..4 {
            let mut normals = (self.normals.iter()).map(|n| unit([0, 1, 2].map(|axis| n[axis] * weights[axis])));
            let current = sum_of(&mut normals);
            for axis in 0..3 {
                if current[axis] > 0.0 {
                    weights[axis] *= target[axis] / current[axis];
                }
            }
        }
        let highest = weights.into_iter().fold(0.0, f64::max);
        weights.map(|weight| (weight / highest * f64::from(u16::MAX)).clamp(1.0, f64::from(u16::MAX)) as u16)
    }
}

/// Predicts the position of the third vertex behind an edge, from the triangle in front of the edge.
pub(super) struct VertexPrediction {
    /// The position by the parallelogram rule, with the new triangle three quarters as high as the one in front: (7(a + b) − 6o) / 8.
    pub parallelogram: [i32; 3],
    /// Context of positions, from the size of the triangle in front of the edge.
    pub size: usize,
    /// The axis that is closest to the normals at both ends of the edge.
    pub depth: usize,
    normal: [f64; 3],
    ends: [[i32; 3]; 2],
}

impl VertexPrediction {
    pub fn new(mesh: &Mesh, from: u32, to: u32, opposite: u32) -> Self {
        let [a, b, o] = [from, to, opposite].map(|vertex| mesh.position(vertex));
        let edge = [0, 1, 2].map(|axis| (a[axis] - b[axis]).abs());
        let double_height = [0, 1, 2].map(|axis| (a[axis] + b[axis] - 2 * o[axis]).abs());
        let largest = |lengths: [i32; 3]| lengths.into_iter().max().unwrap_or_default();
        let [n, m] = [from, to].map(|vertex| mesh.unit_normal(vertex));
        let normal = [0, 1, 2].map(|axis| n[axis] + m[axis]);
        let mut depth = 0;
        for axis in 1..3 {
            if normal[axis].abs() > normal[depth].abs() {
                depth = axis;
            }
        }
        Self {
            parallelogram: [0, 1, 2].map(|axis| (7 * (a[axis] + b[axis]) - 6 * o[axis] + 4) >> 3),
            size: length(largest(edge) + largest(double_height) / 2).min(SIZE_CONTEXTS - 1),
            depth,
            normal,
            ends: [a, b],
        }
    }

    /// Returns the coordinate along `depth` that the surface has at the other two coordinates of `position`: the mean of two planes, one
    /// through each end of the edge, both perpendicular to the sum of the normals at the ends.
    pub fn in_plane(&self, position: [i32; 3]) -> i32 {
        let (n, depth) = (self.normal, self.depth);
        let (x, y) = ((depth + 1) % 3, (depth + 2) % 3);
        let plane = |end: [i32; 3]| {
            let rise = n[x] * f64::from(position[x] - end[x]) + n[y] * f64::from(position[y] - end[y]);
            f64::from(end[depth]) - rise / n[depth]
        };
        let mean = ((plane(self.ends[0]) + plane(self.ends[1])) * 0.5 + 0.5).floor();
        // If there is no normal, the mean is NaN or infinite and the comparison false.
        if mean.abs() <= MAX_PREDICTED {
            mean as i32
        } else {
            self.parallelogram[depth]
        }
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn unit(n: [f64; 3]) -> [f64; 3] {
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    if length > 0.0 { n.map(|v| v / length) } else { [0.0; 3] }
}

/// Returns `value` with the sign of another number.
fn with_sign(value: f64, sign_of: f64) -> f64 {
    if sign_of < 0.0 { -value } else { value }
}

/// Converts a normal to octahedral coordinates, rounded to multiples of 1/127.
fn octahedral(n: [f64; 3]) -> [i32; 2] {
    let sum = n[0].abs() + n[1].abs() + n[2].abs();
    if sum == 0.0 {
        return [0; 2];
    }
    let (x, y) = (n[0] / sum, n[1] / sum);
    let (x, y) = if n[2] < 0.0 {
        (with_sign(1.0 - y.abs(), x), with_sign(1.0 - x.abs(), y))
    } else {
        (x, y)
    };
    [x, y].map(|v| (v * 127.0 + 0.5).floor() as i32)
}

/// Converts octahedral coordinates to a unit normal.
fn from_octahedral(normal: [i8; 2]) -> [f64; 3] {
    let [x, y] = normal.map(|v| f64::from(v) / 127.0);
    let z = 1.0 - x.abs() - y.abs();
    unit(if z < 0.0 {
        [with_sign(1.0 - y.abs(), x), with_sign(1.0 - x.abs(), y), z]
    } else {
        [x, y, z]
    })
}
