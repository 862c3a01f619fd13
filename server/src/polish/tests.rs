use std::collections::HashMap;

use isopeel_kernels::{Level, Statistics};

use super::*;
use crate::edit::TransferFunctionJson;

/// Cells along the torus' bounding box.
const SIDE: i64 = 80;

/// A closed torus over several regions, made of quads cut in two; `thin` makes its tube narrower than its mesh is fine.
fn torus(around: usize, across: usize, thin: bool) -> Surface {
    let tube = if thin { 0.4 } else { 8.0 };
    let point = |i: usize, j: usize| {
        let (u, v) = (
            i as f64 / around as f64 * std::f64::consts::TAU,
            j as f64 / across as f64 * std::f64::consts::TAU,
        );
        let radius = 26.0 + tube * v.cos();
        let at = [radius * u.cos(), radius * u.sin(), tube * v.sin()].map(|p| p + SIDE as f64 / 2.0);
        at.map(|p| (p * f64::from(Vertex::LATTICE)) as i64)
    };
    let mut regions: HashMap<[u32; 3], Region> = HashMap::new();
    for i in 0..around {
        for j in 0..across {
            // The last row closes on the first, bit for bit.
            let [a, b, c, d] =
                [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| point(i % around, j % across));
            for triangle in [[a, b, c], [a, c, d]] {
                let coords = triangle[0].map(|p| (p / REGION_LATTICE) as u32);
                let region = regions.entry(coords).or_insert_with(|| Region {
                    coords,
                    ..Region::default()
                });
                for p in triangle {
                    region.indices.push(region.vertices.len() as u32);
                    let position = [0, 1, 2].map(|axis| (p[axis] - i64::from(coords[axis]) * REGION_LATTICE) as i32);
                    region.vertices.push(Vertex {
                        position,
                        normal: [0, 0],
                        smoothness: 0,
                        feature: 0,
                    });
                }
                region.level_triangles[0] += 1;
            }
        }
    }
    Surface {
        regions: regions.into_values().collect(),
        prefix: Level::FINEST,
        statistics: Statistics {
            triangles: (2 * around * across) as u64,
            ..Statistics::default()
        },
    }
}

fn importance() -> Importance {
    let points = TransferFunctionJson::default()
        .points
        .iter()
        .map(|p| (p.x, p.importance))
        .collect();
    Importance { alpha: 0.0, points }
}

/// How many triangles each edge has, by position.
fn uses(surface: &Surface) -> Vec<usize> {
    let mut edges: HashMap<[[i64; 3]; 2], usize> = HashMap::new();
    for region in &surface.regions {
        let corner = region.coords.map(|c| i64::from(c) * REGION_LATTICE);
        for t in region.indices.chunks_exact(3) {
            let at = |i: usize| {
                let position = region.vertices[t[i] as usize].position;
                [0, 1, 2].map(|axis| corner[axis] + i64::from(position[axis]))
            };
            for (a, b) in [(at(0), at(1)), (at(1), at(2)), (at(2), at(0))] {
                *edges.entry([a.min(b), a.max(b)]).or_default() += 1;
            }
        }
    }
    edges.into_values().collect()
}

#[test]
fn a_polished_surface_is_closed_manifold_and_within_its_budget() {
    for thin in [false, true] {
        for blocks in [Blocks::Regions, Blocks::Cubes(1), Blocks::EXPORT] {
            let surface = torus(300, 40, thin);
            assert!(uses(&surface).iter().all(|&n| n == 2));
            let wanted = 8_000;
            let never = CancellationToken::new();
            let polished = polish(
                surface,
                [1.0, 0.5, 2.0],
                &importance(),
                Goal::Triangles(wanted),
                blocks,
                &never,
            )
            .unwrap();
            let counted: usize = polished.regions.iter().map(|region| region.indices.len() / 3).sum();
            assert_eq!(polished.statistics.triangles, counted as u64);
            assert!(counted as u64 <= wanted, "{counted} triangles, thin {thin}, {blocks:?}");
            assert!(
                counted as u64 >= wanted / 2,
                "{counted} triangles, thin {thin}, {blocks:?}"
            );
            assert!(uses(&polished).iter().all(|&n| n == 2), "thin {thin}, {blocks:?}");
            for region in &polished.regions {
                let levels: u32 = region.level_triangles.iter().sum();
                assert_eq!(region.indices.len(), 3 * levels as usize);
            }
        }
    }
}

#[test]
fn sheets_that_share_an_edge_are_parted_where_they_are() {
    // Two tetrahedra on one edge, as thin necks end: that edge has four triangles.
    let unit = i64::from(Vertex::LATTICE);
    let points = [[0, 0, 0], [0, 0, 4], [4, 0, 0], [4, 1, 4], [-4, 0, 0], [-4, -1, 4]];
    let mut welded: Vec<Welded> = points
        .iter()
        .map(|p| Welded {
            position: p.map(|v: i64| (v + 8) * unit),
            vertex: Vertex {
                position: [0; 3],
                normal: [0; 2],
                smoothness: 0,
                feature: 0,
            },
            level: 0,
            block: 0,
            shared: false,
        })
        .collect();
    let tetrahedron = |c: u32, d: u32| [[0, 1, c], [1, 0, d], [0, c, d], [c, 1, d]];
    let mut triangles: Vec<Triangle> = (tetrahedron(2, 3).into_iter().chain(tetrahedron(4, 5)))
        .map(|corners| Triangle { block: 0, corners })
        .collect();
    separate(&mut welded, &mut triangles, [1.0; 3]);
    assert_eq!((welded.len(), triangles.len()), (7, 10));
    assert_eq!(welded[6].position, [8, 8, 10].map(|v| v * unit), "on the edge");
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    for t in &triangles {
        let [a, b, c] = t.corners;
        for (a, b) in [(a, b), (b, c), (c, a)] {
            *edges.entry((a.min(b), a.max(b))).or_default() += 1;
        }
    }
    assert!(edges.values().all(|&n| n == 2), "{edges:?}");
}

#[test]
fn a_cancelled_polish_has_no_result() {
    let token = CancellationToken::new();
    token.cancel();
    let goal = Goal::Error(0.1);
    assert!(
        polish(
            torus(30, 8, false),
            [1.0; 3],
            &importance(),
            goal,
            Blocks::Regions,
            &token
        )
        .is_none()
    );
}
