//! Volumes in several slabs: the same surface, byte for byte.

use super::recipes::{Pattern, recipes, surfaces};
use super::*;
use isopeel_kernels::expression::{Binary, Expression, Op};
use isopeel_kernels::testing::{Device, LAYER_PLANES, limit_allocations, slab_count};
use isopeel_kernels::{Mesher, SampleType, Surface};
use isopeel_reference::construct;

/// Loads in one slab, or with a limit that one layer of regions and the planes around it just keep. Only the load is
/// limited: a pyramid of noise is larger than its volume.
pub(super) fn load_in(engine: &mut Device, recipe: &Recipe, several: bool) -> Loaded {
    let [x, y, _] = recipe.dims.map(u64::from);
    let before = several.then(|| limit_allocations(engine, x * y * 4 * u64::from(LAYER_PLANES)));
    let loaded = load(engine, recipe);
    if let Some(before) = before {
        limit_allocations(engine, before);
    }
    assert_eq!(slab_count(&loaded.volume) > 1, several);
    loaded
}

fn peel(engine: &Engine, loaded: &Loaded, mesher: Mesher, beta: f32) -> [Surface; 2] {
    let pyramid = build(engine, loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
    let params = CutParams {
        mesher,
        alpha: 0.25,
        feature_range: [0.0, 30.0],
        ..CutParams::paper(beta)
    };
    [0, 2].map(|prefix| {
        let prefix = Level::new(prefix).expect("a level");
        engine
            .peel(&loaded.volume, &pyramid, &params, prefix, &Never)
            .expect("peel")
    })
}

fn compare(engine: &mut Device, recipe: &Recipe, beta: f32) -> Result<(), TestCaseError> {
    let volumes = [false, true].map(|several| load_in(engine, recipe, several));
    for mesher in [Mesher::Dual, Mesher::MarchingCubes] {
        let [want, got] = [0, 1].map(|i| peel(engine, &volumes[i], mesher, beta));
        for (got, want) in got.iter().zip(&want) {
            prop_assert!(got.regions == want.regions, "the same regions, byte for byte");
            let counted = |s: &Surface| {
                let s = &s.statistics;
                let whole = (s.triangles, s.vertices, s.full_triangles);
                (whole, s.leaves, s.lost_cubes, s.unpatched_vertices)
            };
            prop_assert_eq!(counted(got), counted(want));
        }
    }
    Ok(())
}

#[test]
fn expressions_have_the_same_values_in_slabs() {
    let Some(mut engine) = device() else { return };
    let recipe = |kind, seed| Recipe {
        kind,
        ..Recipe::plain([40, 35, 99], Pattern::Waves(9), seed)
    };
    let ops = vec![Op::Field(0), Op::Field(1), Op::Binary(Binary::Multiply, 0, 1)];
    let product = Expression::new(ops).expect("an expression");
    let [whole, parts] = [false, true].map(|several| {
        let fields = [(SampleType::I16, 1), (SampleType::F32, 2)]
            .map(|(kind, seed)| load_in(&mut engine, &recipe(kind, seed), several));
        let made = engine.evaluate(&product, &[&fields[0].volume, &fields[1].volume], &Never);
        let made = made.expect("evaluate");
        assert_eq!(slab_count(&made) > 1, several);
        engine.download(&made, 0..99).expect("download")
    });
    assert!(whole.get(99) != whole.get(40 * 35 * 98));
    assert_eq!(whole.as_bytes(), parts.as_bytes());
}

#[test]
fn slabs_make_the_same_surface() {
    let Some(mut engine) = device() else { return };
    let strategy = (recipes(surfaces()), 0.0f32..0.1);
    let mut runner = proptest::test_runner::TestRunner::new(config(3));
    let engine = std::cell::RefCell::new(&mut engine);
    let result = runner.run(&strategy, |(recipe, beta)| {
        let tall = Recipe {
            dims: [40, 35, 99],
            ..recipe
        };
        compare(&mut engine.borrow_mut(), &tall, beta)
    });
    result.unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn fields_of_other_types_are_cut_alike() {
    let Some(mut engine) = device() else { return };
    for seed in 0..3 {
        let recipe = Recipe::plain([37, 30, 99], Pattern::Waves(15), seed);
        let other = Recipe {
            kind: [SampleType::U8, SampleType::I16, SampleType::F32][seed as usize],
            missing: true,
            seed: seed + 10,
            ..recipe.clone()
        };
        let loaded = load_in(&mut engine, &recipe, true);
        let feature = load_in(&mut engine, &other, true);
        let pyramid = build(&engine, &loaded, Feature::Field(&feature.volume));
        let host = HostPyramid::read(&engine, &pyramid);
        let twin_feature = construct::Feature::Field(&feature.field);
        let twin = construct::construct(&loaded.field, twin_feature, loaded.iso);
        for (&cube, want) in &twin.nodes[0] {
            let got = host.nodes[host.slots[&Leaf { level: 0, cube }]].f;
            let off = (got - want.f).abs();
            assert!(
                off <= 2e-5 * want.f.abs().max(1.0),
                "f of {cube:?} is {got}, expected {}",
                want.f
            );
        }
    }
}
