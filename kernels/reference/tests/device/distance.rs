//! Distances of the vertices of any cut to the surface, against brute force.

use super::recipes::{Pattern, recipes};
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{DistanceOf, SampleType};
use isopeel_reference::distance::distances;

/// Extents for which every vertex can be compared with every point of the surface.
const DIMS: [[u32; 3]; 4] = [[2, 9, 13], [7, 34, 5], [12, 12, 12], [35, 6, 7]];

/// Distances are not less than those by brute force, within the spacing of its points. They are not much more either: a search along the
/// gradient may end at another part of the surface, but only if no vertex of the surface is nearer.
fn check(engine: &Engine, recipe: &Recipe, seed: u64) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let pyramid = build(engine, &loaded, Feature::None);
    let host = HostPyramid::read(engine, &pyramid);
    let state = host.random_state(seed, Topology::Free);
    let surface = mesh(engine, &loaded, &pyramid, &dual_params(), &state);
    let got = engine
        .vertex_distances(&loaded.volume, &pyramid, &surface.regions, DistanceOf::Vertex, &Never)
        .expect("distances");
    prop_assert_eq!(got.len(), surface.regions.len());
    let in_cells = |at: [i64; 3]| at.map(|x| (x as f64 / f64::from(Vertex::LATTICE)) as f32);
    let cells = host.slots.iter().filter(|(leaf, _)| leaf.level == 0);
    let vertices: Vec<[f32; 3]> = cells.map(|(_, &slot)| in_cells(host.position(slot))).collect();
    let diagonal = recipe.spacing.iter().map(|s| s * s).sum::<f32>().sqrt();
    for (region, got) in surface.regions.iter().zip(got) {
        prop_assert_eq!(region.vertices.len(), got.len());
        let points: Vec<[f32; 3]> = (region.vertices.iter())
            .map(|vertex| in_cells(absolute(region, vertex)))
            .collect();
        let (want, between) = distances(&loaded.field, loaded.iso, &vertices, &points);
        for ((got, want), at) in got.iter().zip(want).zip(&points) {
            let minimum = want - between - 2e-3 * f64::from(diagonal);
            prop_assert!(
                f64::from(*got) >= 0.98 * minimum,
                "{} at {:?}, expected {}",
                got,
                at,
                want
            );
            prop_assert!(
                *got == f32::INFINITY || *got <= 3.0 * want as f32 + 2.0 * diagonal,
                "{} at {:?}, expected {}",
                got,
                at,
                want
            );
        }
    }
    Ok(())
}

/// Surfaces that the samples resolve. If noise is as large as what it lies on, or samples have the isovalue itself, the field may come as
/// near to it as one likes without crossing it, and the slope then promises a surface that brute force does not find.
fn resolved() -> impl Strategy<Value = Pattern> {
    prop_oneof![Just(Pattern::Blocks), Just(Pattern::Waves(0)), Just(Pattern::Waves(15))]
}

#[test]
fn vertices_are_as_far_as_brute_force_finds() {
    let Some(engine) = device() else { return };
    let dims = proptest::sample::select(DIMS.to_vec());
    proptest!(config(10), |(recipe in recipes(resolved()), dims in dims, seed in any::<u64>())| {
        check(&engine, &Recipe { dims, ..recipe }, seed)?;
    });
}

/// Of several slabs, and by the kernels of a GPU: on vertices of a ball that were moved off it.
#[test]
fn distances_to_a_ball_are_known() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, Some(50 * 50 * 75 * 4));
    let dims = [50u32, 50, 110];
    let value = |i: u32| {
        let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]].map(|x| x as f32);
        20.0 - ((at[0] - 24.5).powi(2) + (at[1] - 24.5).powi(2) + (at[2] - 54.5).powi(2)).sqrt()
    };
    let samples = isopeel_kernels::Samples::F32((0..dims.iter().product()).map(value).collect());
    let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
    for engine in [&*engine, &of_gpu] {
        let volume = engine.upload(grid, &samples, None).expect("upload");
        let iso = Isovalue::new(0.0).expect("finite");
        let pyramid = engine
            .build_pyramid(&volume, Feature::None, iso, &Never)
            .expect("a pyramid");
        let mut surface = engine
            .peel(&volume, &pyramid, &dual_params(), Level::FINEST, &Never)
            .expect("a surface");
        let distance = |region: &Region, vertex: &Vertex| {
            let at = absolute(region, vertex).map(|x| x as f64 / f64::from(Vertex::LATTICE));
            let squares = [24.5, 24.5, 54.5].iter().zip(at).map(|(c, x)| (x - c).powi(2));
            (squares.sum::<f64>().sqrt() - 20.0).abs() as f32
        };
        for moved in [0, 40_000, 3 << 16] {
            for region in &mut surface.regions {
                let moved: Vec<Vertex> = region
                    .vertices
                    .iter()
                    .map(|&vertex| Vertex {
                        position: vertex.position.map(|x| x + moved),
                        ..vertex
                    })
                    .collect();
                region.vertices = moved.into();
            }
            let found = engine
                .vertex_distances(&volume, &pyramid, &surface.regions, DistanceOf::Vertex, &Never)
                .expect("distances");
            for (region, found) in surface.regions.iter().zip(found) {
                for (vertex, found) in region.vertices.iter().zip(found) {
                    let want = distance(region, vertex);
                    assert!(
                        (found - want).abs() <= 0.05 + 0.1 * want,
                        "{found}, expected {want}, moved {moved}"
                    );
                }
            }
        }
    }
    let pattern = Recipe::plain([12, 14, 13], Pattern::Waves(15), 9);
    check(&of_gpu, &pattern, 4).expect("brute force's distances");
}

/// Of a triangle with its corners on a ball: the corners are no distance away, what is between them is.
#[test]
fn distances_around_vertices_include_their_triangles() {
    let Some(engine) = device() else { return };
    let dims = [50u32; 3];
    let value = |i: u32| {
        let at = [i % 50, i / 50 % 50, i / 2500].map(|x| (x as f32 - 24.5).powi(2));
        20.0 - at.iter().sum::<f32>().sqrt()
    };
    let samples = isopeel_kernels::Samples::F32((0..dims.iter().product()).map(value).collect());
    let volume = engine
        .upload(Grid::new(dims, [1.0; 3]).expect("a grid"), &samples, None)
        .expect("upload");
    let iso = Isovalue::new(0.0).expect("finite");
    let pyramid = engine
        .build_pyramid(&volume, Feature::None, iso, &Never)
        .expect("a pyramid");
    let surface = engine
        .peel(&volume, &pyramid, &dual_params(), Level::FINEST, &Never)
        .expect("a surface");
    let known = surface.regions[0].vertices[0];
    // An equilateral triangle whose corners are a third of a radian off the axis.
    let (sin, cos) = (1.0f64 / 3.0).sin_cos();
    let corner = |k: u32, home: [u32; 3]| {
        let (y, x) = (f64::from(k) * std::f64::consts::TAU / 3.0).sin_cos();
        let at = [24.5 + 20.0 * sin * x, 24.5 + 20.0 * sin * y, 24.5 + 20.0 * cos];
        let of = |i: usize| ((at[i] - f64::from(home[i] * 32)) * f64::from(Vertex::LATTICE)).round() as i32;
        Vertex {
            position: [of(0), of(1), of(2)],
            ..known
        }
    };
    let region = |coords: [u32; 3], count: u32, indices: Vec<u32>| Region {
        coords,
        vertices: (0..count).map(|k| corner(k, coords)).collect::<Vec<_>>().into(),
        indices: indices.into(),
        ..Region::default()
    };
    // The other region has two of the corners and no triangle.
    let regions = [region([0, 0, 1], 3, vec![0, 1, 2]), region([0; 3], 2, Vec::new())];
    let distances = |of| {
        engine
            .vertex_distances(&volume, &pyramid, &regions, of, &Never)
            .expect("distances")
    };
    let own = distances(DistanceOf::Vertex);
    assert!(own.iter().flatten().all(|&distance| distance < 0.02), "{own:?}");
    let around = distances(DistanceOf::Around);
    let farthest = (20.0 * (1.0 - cos)) as f32;
    for distance in around.iter().flatten() {
        assert!(
            (0.9 * farthest..=1.02 * farthest).contains(distance),
            "{distance}, expected nearly {farthest}"
        );
    }
    assert_eq!(around[1], around[0][..2]);
}

/// Between samples of noise the slope promises surfaces that are not there.
#[test]
fn a_slope_next_to_an_extreme_value_is_no_surface() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        kind: SampleType::U8,
        missing: true,
        ..Recipe::plain([7, 34, 5], Pattern::Waves(60), 8648002623507633323)
    };
    check(&engine, &recipe, 14708321924768383943).expect("brute force's distances");
}
