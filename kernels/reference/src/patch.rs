//! Crack patching: vertices of finer leaves move onto the contour that a coarser leaf has on its face
//! (docs/algorithm.md#52-crack-patching).

use crate::{Cut, Field, FineEdge, Leaf, Mesh, Node, Pyramid, march};
use isopeel_kernels::Vertex;
use isopeel_kernels::tables::{cases, cube};

/// The leaves of a level around a fine edge, in the order of [`FineEdge::active_cells`], each once.
fn leaves_around(edge: FineEdge, pyramid: &Pyramid, cut: &Cut) -> Vec<Leaf> {
    let mut leaves = Vec::new();
    for cell in edge.active_cells(pyramid) {
        let leaf = cut.leaf_of[&cell];
        if !leaves.contains(&leaf) {
            leaves.push(leaf);
        }
    }
    leaves
}

/// Level of the coarsest leaf around a fine edge.
fn coarsest_level(edge: FineEdge, pyramid: &Pyramid, cut: &Cut) -> u8 {
    leaves_around(edge, pyramid, cut)
        .iter()
        .map(|l| l.level)
        .max()
        .unwrap_or(0)
}

/// Whether a fine edge lies in the closed rectangle of a leaf's face.
fn on_face(field: &Field, leaf: Leaf, face: usize, edge: FineEdge) -> bool {
    let samples = field.cube_samples(usize::from(leaf.level), leaf.cube);
    let axis = face / 2;
    [edge.low, edge.high()]
        .iter()
        .all(|p| p[axis] == samples[face & 1][axis] && (0..3).all(|i| (samples[0][i]..=samples[1][i]).contains(&p[i])))
}

/// Whether a fine edge carries one of a leaf's own vertices.
fn is_own_vertex(field: &Field, iso: f32, leaf: Leaf, node: &Node, edge: FineEdge) -> bool {
    (0..12).any(|e| {
        let [low, high] = cube::edge_corners(e);
        (node.signs >> low ^ node.signs >> high) & 1 == 1 && march::refine(field, iso, leaf, e) == edge
    })
}

/// The contour segments of a leaf on those of its faces that hold a fine edge: pairs of the leaf's own vertices.
pub fn segments_at(field: &Field, iso: f32, leaf: Leaf, node: &Node, edge: FineEdge) -> Vec<[FineEdge; 2]> {
    (0..6)
        .filter(|&face| on_face(field, leaf, face, edge))
        .flat_map(|face| cases::face_segments(face, cube::face_signs(face, node.signs)))
        .map(|ends| ends.map(|e| march::refine(field, iso, leaf, usize::from(e))))
        .collect()
}

/// The point of segment `ab` nearest to `p`, and its squared distance; all in cells.
fn nearest_on_segment(p: [f32; 3], [a, b]: [[f32; 3]; 2]) -> ([f32; 3], f32) {
    let minus = |p: [f32; 3], q: [f32; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
    let dot = |p: [f32; 3], q: [f32; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    let d = minus(b, a);
    let length = dot(d, d);
    let t = if length > 0.0 {
        (dot(minus(p, a), d) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let q = std::array::from_fn(|i| a[i] + t * d[i]);
    (q, dot(minus(p, q), minus(p, q)))
}

/// Moves every vertex that lies on a face of a coarser leaf, and is not that leaf's own, to the nearest point of the
/// nearest segment of the coarsest leaves around it. From level 5 down to 1, so the ends of segments are final.
/// Vertices that find no segment stay and are counted.
pub fn patch(field: &Field, pyramid: &Pyramid, iso: f32, cut: &Cut, mesh: &mut Mesh) {
    let mut by_level: [Vec<FineEdge>; 6] = Default::default();
    for &edge in mesh.vertices.keys() {
        by_level[usize::from(coarsest_level(edge, pyramid, cut))].push(edge);
    }
    for level in (1..=5u8).rev() {
        for &edge in &by_level[usize::from(level)] {
            let mut leaves = leaves_around(edge, pyramid, cut);
            leaves.retain(|l| l.level == level);
            if leaves
                .iter()
                .any(|l| is_own_vertex(field, iso, *l, &cut.leaves[l], edge))
            {
                continue;
            }
            let mut best: Option<([i64; 3], f32)> = None;
            for leaf in leaves {
                let origin = leaf.cube.map(|c| i64::from(c << level) * i64::from(Vertex::LATTICE));
                // Exact: at most 2²² lattice units.
                let local = |edge: &FineEdge| {
                    let position = mesh.vertices[edge].position;
                    std::array::from_fn(|i| (position[i] - origin[i]) as f32 / Vertex::LATTICE as f32)
                };
                for ends in segments_at(field, iso, leaf, &cut.leaves[&leaf], edge) {
                    let (point, distance) = nearest_on_segment(local(&edge), [local(&ends[0]), local(&ends[1])]);
                    if best.is_none_or(|(_, nearest)| distance < nearest) {
                        let position = std::array::from_fn(|i| origin[i] + march::to_lattice(point[i]));
                        best = Some((position, distance));
                    }
                }
            }
            match best {
                Some((position, _)) => mesh.vertices.get_mut(&edge).expect("it is a vertex").position = position,
                None => mesh.unpatched += 1,
            }
        }
    }
}
