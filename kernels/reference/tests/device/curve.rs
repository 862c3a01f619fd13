//! Curves of estimated error against triangles: the twin's sums, and what the surfaces have that are really made.

use super::host_tree::HostTree;
use super::recipes::{Pattern, Random, recipes, surfaces};
use super::tree::{Planted, plant, plant_in};
use super::tree_cut::cut;
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{CURVE_POINTS, CurvePoint, PartFilter, Samples, ShownCut, TreeGoal};
use isopeel_reference::curve::squared_error;
use isopeel_reference::tree_cut::Cutter;
use isopeel_reference::tree_part::total_area;
use std::collections::BTreeSet;

fn goal(tolerance: f32) -> TreeGoal {
    TreeGoal {
        tolerance,
        max_triangles: u64::MAX,
        max_tolerance: f32::INFINITY,
        without: PartFilter::default(),
        may_vanish: false,
        weights: None,
    }
}

fn tree_curve(engine: &Engine, planted: &Planted, params: &CutParams, goal: &TreeGoal) -> Vec<CurvePoint> {
    let (volume, pyramid) = (&planted.loaded.volume, &planted.pyramid);
    let shown = engine
        .shown_tree_cut(volume, pyramid, &planted.tree, params, goal, &Never)
        .expect("the cut");
    engine
        .error_curve(volume, pyramid, params, &shown, &Never)
        .expect("a curve")
}

fn check_tree(engine: &Engine, recipe: &Recipe, seed: u64) -> Result<(), TestCaseError> {
    let planted = plant(engine, recipe, false);
    let params = CutParams {
        alpha: Random(seed).unit(),
        feature_range: [0.0, 1.5],
        ..planted.params.clone()
    };
    let goal = goal(0.1);
    let points = tree_curve(engine, &planted, &params, &goal);
    let host = HostTree::read(engine, &planted);
    let removed = BTreeSet::new();
    let cutter = Cutter {
        mesh: &host.mesh,
        tree: &host.tree,
        removed: &removed,
        may_vanish: false,
        weights: None,
    };
    let importances = host.importances(engine, &planted, &cutter, &params)?;
    let want = cutter.cut(importances.as_ref(), &goal).expect("a cut without faults");
    let keys = cutter.keys(importances.as_ref(), &want.marks);
    let spacing = host.mesh.grid.smallest_spacing();
    let area = total_area(&host.mesh);
    prop_assert!(points.len() <= CURVE_POINTS);
    prop_assert_eq!(
        points.first().map(|point| point.triangles),
        Some(planted.tree.full_triangles())
    );
    for point in points {
        prop_assert_eq!(
            point.triangles,
            cutter.triangles_at(&keys, point.threshold),
            "{:?}",
            point
        );
        let error2 = squared_error(&cutter, &keys, point.threshold);
        let rms = if area > 0.0 {
            f64::from(spacing) * (error2 / area).sqrt()
        } else {
            0.0
        };
        prop_assert!(near(point.rms, rms as f32, 2e-3), "{:?}, expected {}", point, rms);
    }
    Ok(())
}

#[test]
fn curves_of_the_tree_are_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(5), |(recipe in recipes(surfaces()), seed in any::<u64>())| check_tree(&engine, &recipe, seed)?);
}

/// The kernels of a GPU on any device: work-groups of many.
#[test]
fn work_groups_of_a_gpu_sum_the_same() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    let recipe = Recipe::plain([38, 20, 35], Pattern::Waves(15), 9);
    check_tree(&of_gpu, &recipe, 4).expect("the twin's curve");
    check_cubes(&of_gpu, &recipe, None).expect("the cuts' errors");
}

/// Each point's error is that of the cut to its threshold.
fn check_cubes(engine: &Engine, recipe: &Recipe, tolerance: Option<f32>) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let pyramid = build(engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
    let params = CutParams {
        beta: 0.05,
        tolerance,
        topology: Topology::Preserve,
        ..dual_params()
    };
    let own = engine
        .cut(&loaded.volume, &pyramid, &params, Level::FINEST)
        .expect("a cut");
    let points = engine
        .error_curve(&loaded.volume, &pyramid, &params, &ShownCut::Cubes(&own), &Never)
        .expect("a curve");
    for point in points {
        let at = CutParams {
            beta: point.threshold,
            tolerance: tolerance.map(|_| point.threshold),
            ..params.clone()
        };
        let cut = engine.cut(&loaded.volume, &pyramid, &at, Level::FINEST).expect("a cut");
        let rms = cut.estimate().rms;
        prop_assert!(near(point.rms, rms, 2e-3), "{:?}, expected {}", point, rms);
    }
    Ok(())
}

#[test]
fn curves_of_cubes_have_the_errors_of_cuts() {
    let Some(engine) = device() else { return };
    proptest!(config(6), |(recipe in recipes(surfaces()))| {
        check_cubes(&engine, &recipe, None)?;
        check_cubes(&engine, &recipe, Some(0.1))?;
    });
}

/// Plane waves, and a noisy ball with a layer of bone in it, as computed tomography sees a head.
fn volumes(engine: &Engine) -> [Planted; 2] {
    let waves = plant(engine, &Recipe::plain([96; 3], Pattern::Waves(0), 5), false);
    let (dims, mut random) = ([96u32; 3], Random(7));
    let value = |i: u32| {
        let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]].map(|x| x as f32 - 47.5);
        let radius = (at[0] * at[0] + 1.3 * at[1] * at[1] + at[2] * at[2]).sqrt() + 1.5 * (at[0] / 6.0).sin();
        let tissue = 1.0 / (1.0 + (radius - 40.0).exp());
        let bone = 1.0 / (1.0 + ((radius - 33.0).abs() * 2.0 - 6.0).exp());
        -1000.0 + 1040.0 * tissue + 1000.0 * bone + 40.0 * (random.unit() - 0.5)
    };
    let grid = Grid::new(dims, [0.5, 0.5, 0.9]).expect("a grid");
    let samples = Samples::F32((0..dims.iter().product()).map(value).collect());
    let head = load_samples(engine, grid, &samples, None, 300.0);
    let gradient = Feature::Derived(DerivedFeature::GradientMagnitude);
    [waves, plant_in(engine, head, gradient, dual_params())]
}

/// At three points of a curve that is made at another cut, the surface has these triangles and this error.
#[test]
fn surfaces_are_where_the_curve_says() {
    let Some(engine) = device() else { return };
    for (name, planted) in ["waves", "head"].into_iter().zip(volumes(&engine)) {
        let params = CutParams {
            alpha: 0.3,
            feature_range: [0.0, 400.0],
            state_error: true,
            ..planted.params.clone()
        };
        let spacing = planted.loaded.field.grid.smallest_spacing();
        let points = tree_curve(&engine, &planted, &params, &goal(0.1 * spacing));
        for share in [0.5, 0.25, 0.1] {
            let wanted = share * planted.tree.full_triangles() as f64;
            let point = points
                .iter()
                .find(|point| point.triangles as f64 <= wanted)
                .expect("a cut as small");
            let (surface, _) = cut(&engine, &planted, &params, &goal(point.threshold));
            let made = &surface.statistics;
            let triangles = made.triangles as f64 / point.triangles as f64;
            let estimated = made.estimate.rms / point.rms;
            let measured = made.error.map_or(f32::NAN, |error| error.rms);
            println!(
                "{name} at {share}: {} triangles ({triangles:.3}), rms {} ({estimated:.3}), measured {measured}",
                point.triangles, point.rms
            );
            assert!(
                (triangles - 1.0).abs() < 0.05,
                "{name}: {point:?}, made {}",
                made.triangles
            );
            assert!(
                (estimated - 1.0).abs() < 0.2,
                "{name}: {point:?}, made {:?}",
                made.estimate
            );
        }
    }
}

/// The same of cubes, whose triangles the curve does not count.
#[test]
fn cubes_are_where_the_curve_says() {
    let Some(engine) = device() else { return };
    for (name, planted) in ["waves", "head"].into_iter().zip(volumes(&engine)) {
        let (volume, pyramid) = (&planted.loaded.volume, &planted.pyramid);
        let spacing = planted.loaded.field.grid.smallest_spacing();
        let params = CutParams {
            tolerance: Some(0.2 * spacing),
            topology: Topology::Preserve,
            ..planted.params.clone()
        };
        let own = engine.cut(volume, pyramid, &params, Level::FINEST).expect("a cut");
        let points = engine
            .error_curve(volume, pyramid, &params, &ShownCut::Cubes(&own), &Never)
            .expect("a curve");
        for share in [0.7, 0.4, 0.25] {
            let wanted = share * pyramid.full_triangles() as f64;
            let point = points
                .iter()
                .find(|point| point.triangles as f64 <= wanted)
                .expect("a cut as small");
            let at = CutParams {
                tolerance: Some(point.threshold),
                ..params.clone()
            };
            let cut = engine.cut(volume, pyramid, &at, Level::FINEST).expect("a cut");
            let made = engine.count(volume, pyramid, &cut, &Never).expect("a count").triangles;
            println!(
                "{name} at {share}: {} triangles, made {made}, rms {} and {}",
                point.triangles,
                point.rms,
                cut.estimate().rms
            );
            assert!(
                (made as f64 / point.triangles as f64 - 1.0).abs() < 0.05,
                "{name}: {point:?}, made {made}"
            );
        }
    }
}
