//! Marching cubes over the leaves of a cut, with vertices refined to full-resolution crossings
//! (docs/algorithm.md#5-marching-cubes-mesher).

use std::collections::BTreeMap;

use crate::{Cut, Field, Leaf, Pyramid};
use isopeel_kernels::Vertex;
use isopeel_kernels::tables::{cases, cube};

/// An edge of the grid between two neighbouring samples; the identity of the vertex on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FineEdge {
    /// The sample at its low end.
    pub low: [u32; 3],
    /// The axis it runs along.
    pub axis: u8,
}

impl FineEdge {
    /// The sample at its high end.
    pub fn high(&self) -> [u32; 3] {
        let mut high = self.low;
        high[usize::from(self.axis)] += 1;
        high
    }

    /// The cells around the edge that are active, in the order of offsets (0,0), (1,0), (0,1), (1,1) down the axes
    /// `(axis + 1) % 3` and `(axis + 2) % 3`.
    pub fn active_cells(&self, pyramid: &Pyramid) -> Vec<[u32; 3]> {
        let axis = usize::from(self.axis);
        let cell = |i: u32| {
            let mut cell = self.low;
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            cell[b] = cell[b].checked_sub(i & 1)?;
            cell[c] = cell[c].checked_sub(i >> 1)?;
            pyramid.nodes[0].contains_key(&cell).then_some(cell)
        };
        (0..4).filter_map(cell).collect()
    }
}

/// A vertex of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshVertex {
    /// From the volume's first sample, in 1/[`Vertex::LATTICE`] cell.
    pub position: [i64; 3],
    /// Parameter of the surface's crossing on the fine edge, 0 at its low end; not changed by patching.
    pub t: f32,
}

/// A triangle, counter-clockwise seen from the side of lower values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// The leaf that emits it.
    pub leaf: Leaf,
    /// Its vertices.
    pub vertices: [FineEdge; 3],
}

/// The surface of a cut.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Every vertex once.
    pub vertices: BTreeMap<FineEdge, MeshVertex>,
    /// Leaf by leaf, in the order of the case table.
    pub triangles: Vec<Triangle>,
    /// Vertices on the face of a coarser leaf that has no segment there to move them to; see [`crate::patch`].
    pub unpatched: u64,
}

/// A length in cells on the lattice of vertices, rounded half to even.
pub fn to_lattice(cells: f32) -> i64 {
    (cells * Vertex::LATTICE as f32).round_ties_even() as i64
}

/// The fine edge at which the surface crosses an edge of a leaf, found by a binary search for a sign change.
pub fn refine(field: &Field, iso: f32, leaf: Leaf, edge: usize) -> FineEdge {
    let samples = field.cube_samples(usize::from(leaf.level), leaf.cube);
    let axis = cube::edge_axis(edge);
    let up = cube::corner_offset(cube::edge_corners(edge)[0]);
    let mut at: [u32; 3] = std::array::from_fn(|i| samples[up[i]][i]);
    let (mut lo, mut hi) = (samples[0][axis], samples[1][axis]);
    let inside = |mut p: [u32; 3], along: u32| {
        p[axis] = along;
        field.at(p) >= iso
    };
    let low_sign = inside(at, lo);
    while hi - lo > 1 {
        let mid = (lo + hi) / 2;
        if inside(at, mid) == low_sign {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    at[axis] = lo;
    FineEdge {
        low: at,
        axis: axis as u8,
    }
}

/// The vertex on a fine edge whose ends differ in sign, before patching.
fn crossing(field: &Field, iso: f32, edge: FineEdge) -> MeshVertex {
    let (a, b) = (field.at(edge.low), field.at(edge.high()));
    let t = (iso - a) / (b - a);
    // An infinite low end gives ∞/∞.
    let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) };
    let mut position = edge.low.map(|c| i64::from(c) * i64::from(Vertex::LATTICE));
    position[usize::from(edge.axis)] += to_lattice(t);
    MeshVertex { position, t }
}

/// Triangles of every leaf: the case table at its corner signs, with refined vertices.
pub fn march(field: &Field, pyramid: &Pyramid, iso: f32, cut: &Cut) -> Mesh {
    debug_assert_eq!(pyramid.nodes[0].len(), cut.leaf_of.len());
    let table = cases::case_triangles();
    let mut mesh = Mesh::default();
    for (&leaf, node) in &cut.leaves {
        let entry = &table[usize::from(node.signs)];
        for triangle in entry[1..1 + 3 * usize::from(entry[0])].chunks_exact(3) {
            let vertices = [0, 1, 2].map(|i| refine(field, iso, leaf, usize::from(triangle[i])));
            for edge in vertices {
                mesh.vertices.entry(edge).or_insert_with(|| crossing(field, iso, edge));
            }
            mesh.triangles.push(Triangle { leaf, vertices });
        }
    }
    mesh
}
