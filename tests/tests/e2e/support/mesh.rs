//! Properties of every mesh of isopeel, measured on its triangles.

use isopeel_client::{Chunk, LATTICE};
use isopeel_reference::edges::{self, Edge};

/// Edges that have different numbers of triangles in their two directions, by the bits of their ends' positions across all regions.
/// Edges in the volume's own faces, at which a surface may end, are left out.
pub fn open_edges<'a>(chunks: impl IntoIterator<Item = &'a Chunk>, dims: [u32; 3]) -> Vec<Edge> {
    let last = dims.map(|n| (n as i32 - 1) * LATTICE);
    let on_the_rim =
        |p: [i32; 3], q: [i32; 3]| (0..3).any(|axis| p[axis] == q[axis] && (p[axis] == 0 || p[axis] == last[axis]));
    let mut edges = Vec::new();
    for chunk in chunks {
        for triangle in &chunk.triangles {
            let [a, b, c] = triangle.map(|vertex| chunk.lattice(vertex));
            let inside = [[a, b], [b, c], [c, a]].into_iter().filter(|&[p, q]| !on_the_rim(p, q));
            edges.extend(inside.map(|edge| edge.map(|p| p.map(i64::from))));
        }
    }
    edges::open(edges)
}

/// Share of the area whose triangles are turned as their vertices' normals say: counter-clockwise seen from the side of
/// lower values. Index space; the demo's axes are the world's.
pub fn area_turned_right<'a>(chunks: impl IntoIterator<Item = &'a Chunk>) -> f64 {
    let (mut right, mut all) = (0.0, 0.0);
    for chunk in chunks {
        for triangle in &chunk.triangles {
            let [a, b, c] = triangle.map(|vertex| chunk.position(vertex));
            let (u, v) = (subtract(b, a), subtract(c, a));
            let area = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            let size = dot(area, area).sqrt();
            let normals = triangle.map(|vertex| chunk.vertices[vertex as usize].unit_normal());
            let towards: f64 = normals.iter().map(|&normal| dot(normal, area)).sum();
            all += size;
            right += if towards > 0.0 { size } else { 0.0 };
        }
    }
    right / all
}

/// Low and high corner of all vertices in index space.
pub fn extent<'a>(chunks: impl IntoIterator<Item = &'a Chunk>) -> [[f64; 3]; 2] {
    let mut extent = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for chunk in chunks {
        for vertex in 0..chunk.vertices.len() as u32 {
            for (axis, value) in chunk.position(vertex).into_iter().enumerate() {
                extent[0][axis] = extent[0][axis].min(value);
                extent[1][axis] = extent[1][axis].max(value);
            }
        }
    }
    extent
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
