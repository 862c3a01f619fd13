//! Regions of indexed triangles with normals and attributes: the form in which a surface leaves the device.

use std::collections::BTreeMap;

use crate::{Cut, Field, FineEdge, Mesh, Pyramid, construct, cut, octahedral};
use isopeel_kernels::{CutParams, Level, Region, Surface, SurfaceStatistics, Vertex};

/// Unit normal at the crossing of a fine edge, towards lower values, in world lengths; `[0, 0, 1]` if the gradient
/// is zero.
pub fn normal(field: &Field, edge: FineEdge, t: f32) -> [f32; 3] {
    let (a, b) = (field.gradient(edge.low), field.gradient(edge.high()));
    let normal = construct::normalised(std::array::from_fn(|i| -(a[i] + (b[i] - a[i]) * t)));
    if normal == [0.0; 3] { [0.0, 0.0, 1.0] } else { normal }
}

/// A number in [0, 1] over 65535.
fn unorm16(v: f32) -> u16 {
    (v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16
}

/// `s` and `f̂` of a vertex: those of the coarsest leaf around its fine edge, of several the first.
pub fn attributes(edge: FineEdge, pyramid: &Pyramid, cut: &Cut, params: &CutParams) -> [f32; 2] {
    let mut coarsest: Option<cut::Leaf> = None;
    for cell in edge.active_cells(pyramid) {
        let leaf = cut.leaf_of[&cell];
        if coarsest.is_none_or(|c| leaf.level > c.level) {
            coarsest = Some(leaf);
        }
    }
    // A vertex lies on an edge of an active cell: if of no other cell, of a cell of its own leaf.
    let node = &cut.leaves[&coarsest.expect("an active cell around every vertex")];
    [node.s, cut::normalised_feature(node.f, params)]
}

/// Sorts the mesh into regions, x fastest; inside one, vertices in the order of fine edges and triangles by level.
pub fn pack(field: &Field, pyramid: &Pyramid, cut: &Cut, mesh: &Mesh, params: &CutParams, prefix: Level) -> Surface {
    // Leaves, and so triangles, already come finest level first.
    let mut by_region: BTreeMap<[u32; 3], Vec<&crate::Triangle>> = BTreeMap::new();
    for triangle in &mesh.triangles {
        let [x, y, z] = triangle.leaf.region();
        by_region.entry([z, y, x]).or_default().push(triangle);
    }
    let regions = by_region
        .into_iter()
        .map(|([z, y, x], triangles)| {
            let mut region = Region {
                coords: [x, y, z],
                ..Region::default()
            };
            let mut index: BTreeMap<_, u32> = triangles.iter().flat_map(|t| t.vertices).map(|e| (e, 0)).collect();
            for (i, (edge, place)) in index.iter_mut().enumerate() {
                *place = i as u32;
                region
                    .vertices
                    .to_mut()
                    .push(vertex(field, pyramid, cut, mesh, params, region.coords, *edge));
            }
            for triangle in triangles {
                region.indices.to_mut().extend(triangle.vertices.map(|e| index[&e]));
                region.level_triangles[usize::from(triangle.leaf.level)] += 1;
            }
            region
        })
        .collect();
    let statistics = SurfaceStatistics {
        full_triangles: pyramid.full_triangles(),
        active_cells: pyramid.cells.len() as u64,
        leaves: cut.counts(),
        triangles: mesh.triangles.len() as u64,
        vertices: mesh.vertices.len() as u64,
        lost_cubes: cut.lost_cubes(),
        unpatched_vertices: mesh.unpatched,
        ..SurfaceStatistics::default()
    };
    Surface {
        remade: None,
        regions,
        prefix,
        statistics,
    }
}

fn vertex(
    field: &Field,
    pyramid: &Pyramid,
    cut: &Cut,
    mesh: &Mesh,
    params: &CutParams,
    region: [u32; 3],
    edge: FineEdge,
) -> Vertex {
    let at = &mesh.vertices[&edge];
    let origin = region.map(|c| i64::from(c * isopeel_kernels::REGION_CELLS) * i64::from(Vertex::LATTICE));
    let [smoothness, feature] = attributes(edge, pyramid, cut, params).map(unorm16);
    Vertex {
        position: std::array::from_fn(|i| (at.position[i] - origin[i]) as i32),
        normal: octahedral::encode(normal(field, edge, at.t)).map(|v| (v * 32767.0).round_ties_even() as i16),
        smoothness,
        feature,
    }
}
