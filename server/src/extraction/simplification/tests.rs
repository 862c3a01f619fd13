use std::collections::HashMap;

use isopeel_kernels::{Level, Region, SurfaceStatistics};

use super::welded::{REGION_LATTICE, Welded};
use super::*;
use crate::math::DVec3;
use crate::view::TransferFunctionJson;

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
                    region.indices.to_mut().push(region.vertices.len() as u32);
                    let position = [0, 1, 2].map(|axis| (p[axis] - i64::from(coords[axis]) * REGION_LATTICE) as i32);
                    region.vertices.to_mut().push(Vertex {
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
        remade: None,
        regions: regions.into_values().collect(),
        prefix: Level::FINEST,
        statistics: SurfaceStatistics {
            triangles: (2 * around * across) as u64,
            ..SurfaceStatistics::default()
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
fn a_simplified_surface_is_closed_manifold_and_within_its_budget() {
    for thin in [false, true] {
        for blocks in [Blocks::Regions, Blocks::Cubes(1), Blocks::EXPORT] {
            let surface = torus(300, 40, thin);
            assert!(uses(&surface).iter().all(|&n| n == 2));
            let wanted = 8_000;
            let never = CancellationToken::new();
            let simplified = simplify(
                surface,
                [1.0, 0.5, 2.0],
                &importance(),
                Goal::Triangles(wanted),
                blocks,
                &never,
            )
            .unwrap();
            let counted: usize = simplified.regions.iter().map(|region| region.indices.len() / 3).sum();
            assert_eq!(simplified.statistics.triangles, counted as u64);
            assert!(counted as u64 <= wanted, "{counted} triangles, thin {thin}, {blocks:?}");
            assert!(
                counted as u64 >= wanted / 2,
                "{counted} triangles, thin {thin}, {blocks:?}"
            );
            assert!(uses(&simplified).iter().all(|&n| n == 2), "thin {thin}, {blocks:?}");
            for region in &simplified.regions {
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
    split_sheets(&mut welded, &mut triangles, [1.0; 3]);
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
fn a_cancelled_simplification_has_no_result() {
    let token = CancellationToken::new();
    token.cancel();
    let goal = Goal::Error(0.1);
    assert!(
        simplify(
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

/// A flat sheet of `n` by `n` quads with a bump in its middle, and beside it a small closed part.
fn bump() -> Surface {
    let n = 28;
    let unit = Vertex::LATTICE;
    let vertex = |x: f64, y: f64, z: f64| Vertex {
        position: [x, y, z].map(|c| (c * f64::from(unit)) as i32),
        normal: [0, 0],
        smoothness: 0,
        feature: 0,
    };
    let mut region = Region {
        error: Some(SurfaceError { rms: 0.25, max: 0.5 }),
        ..Region::default()
    };
    for j in 0..=n {
        for i in 0..=n {
            let (x, y) = (f64::from(i), f64::from(j));
            let off = (x - 14.0).powi(2) + (y - 14.0).powi(2);
            region
                .vertices
                .to_mut()
                .push(vertex(x + 1.0, y + 1.0, 10.0 + 3.0 * (-off / 20.0).exp()));
        }
    }
    for j in 0..n as u32 {
        for i in 0..n as u32 {
            let a = j * (n as u32 + 1) + i;
            let (b, c, d) = (a + 1, a + n as u32 + 2, a + n as u32 + 1);
            region.indices.to_mut().extend([a, b, c, a, c, d]);
        }
    }
    let first = region.vertices.len() as u32;
    for [x, y, z] in [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.4, 0.4, 0.4],
    ] {
        region.vertices.to_mut().push(vertex(20.0 + x, 20.0 + y, 25.0 + z));
    }
    for t in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [2, 3, 4], [3, 1, 4]] {
        region.indices.to_mut().extend(t.map(|v| first + v));
    }
    region.level_triangles[0] = region.indices.len() as u32 / 3;
    Surface {
        remade: None,
        statistics: SurfaceStatistics {
            triangles: u64::from(region.level_triangles[0]),
            error: region.error,
            ..SurfaceStatistics::default()
        },
        regions: vec![region],
        prefix: Level::FINEST,
    }
}

fn positions(region: &Region) -> Vec<DVec3> {
    (region.vertices.iter())
        .map(|v| DVec3::from(v.position.map(f64::from)) / f64::from(Vertex::LATTICE))
        .collect()
}

fn corners(region: &Region) -> Vec<[u32; 3]> {
    region.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect()
}

#[test]
fn small_parts_stay_and_the_stated_error_bounds_what_simplification_adds() {
    let never = CancellationToken::new();
    let (source, goal) = (bump(), Goal::Triangles(60));
    let before = source.regions[0].clone();
    let simplified = simplify(source, [1.0; 3], &importance(), goal, Blocks::Regions, &never).expect("not cancelled");
    let after = &simplified.regions[0];
    assert!(simplified.statistics.triangles <= 60);
    let small = positions(after).iter().filter(|p| p[2] > 20.0).count();
    assert!(small >= 4, "{small} vertices are left of the small part");

    // Many points on either surface, by their distance to all triangles of the other.
    let (there, back) = (positions(&before), positions(after));
    let points = |positions: &[DVec3], triangles: &[[u32; 3]]| -> Vec<DVec3> {
        let weights = (0..=6).flat_map(|i| (0..=6 - i).map(move |j| [i, j, 6 - i - j].map(|w| f64::from(w) / 6.0)));
        let of = |t: [u32; 3], w: [f64; 3]| (0..3).map(|k| w[k] * positions[t[k] as usize]).sum::<DVec3>();
        (triangles.iter())
            .flat_map(|&t| weights.clone().map(move |w| of(t, w)))
            .collect()
    };
    let (old, new) = (corners(&before), corners(after));
    let off = distance::Triangles::new(&back, &new).distances(&points(&there, &old));
    let max_deviation = off.iter().copied().fold(0.0, f64::max);
    assert!(max_deviation > 0.01, "it was simplified");
    let stated = simplified.statistics.error.expect("stated");
    assert_eq!(after.error, Some(stated), "one region");
    assert!(
        f64::from(stated.max) >= 0.5 + 0.95 * max_deviation,
        "{stated:?}, {max_deviation} away"
    );
    let rms = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
    assert!(
        f64::from(stated.rms) > 0.25 && f64::from(stated.rms) < 0.25 + 2.0 * rms,
        "{stated:?}, {rms} away"
    );
}

#[test]
fn distances_are_to_the_nearest_of_all_triangles() {
    let region = torus(24, 10, false).regions.swap_remove(0);
    let (positions, triangles) = (positions(&region), corners(&region));
    let all = distance::Triangles::new(&positions, &triangles);
    let one = |t: &[u32; 3], p| distance::Triangles::new(&positions, std::slice::from_ref(t)).distances(&[p])[0];
    for i in 0..200 {
        let p = DVec3::from([7 * i % 90, 13 * i % 90, 29 * i % 70].map(|c| f64::from(c) - 10.0));
        let want = triangles.iter().map(|t| one(t, p)).fold(f64::INFINITY, f64::min);
        assert!((all.distances(&[p])[0] - want).abs() < 1e-9, "{p:?}");
    }
}
