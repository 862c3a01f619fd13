//! Volumes in several slabs: the same surface, byte for byte.

use super::volumes::{Pattern, recipes, surfaces};
use super::*;
use crate::volume::{slab_layers, slab_planes};
use crate::{Mesher, REGION_CELLS, SampleType, Surface};

/// Loads in one slab, or with a limit that one layer of regions and the planes around it just keep. Only the load is
/// limited: a pyramid of noise is larger than its volume.
fn load_in(engine: &mut Alone, recipe: &Recipe, several: bool) -> Loaded {
    let all = engine.engine.cx.limit_bytes;
    let [x, y, _] = recipe.dims.map(u64::from);
    if several {
        engine.engine.cx.limit_bytes = x * y * 4 * (u64::from(REGION_CELLS) + 3);
    }
    let loaded = load(engine, recipe);
    engine.engine.cx.limit_bytes = all;
    assert_eq!(loaded.volume.slabs.len() > 1, several);
    loaded
}

fn peel(engine: &Engine, loaded: &Loaded, mesher: Mesher, beta: f32) -> [Surface; 2] {
    let pyramid = build(engine, loaded, Feature::GradientMagnitude);
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

fn compare(engine: &mut Alone, recipe: &Recipe, beta: f32) -> Result<(), TestCaseError> {
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
        let host = Host::read(&engine, &pyramid);
        let twin_feature = crate::reference::Feature::Field(&feature.field);
        let twin = crate::reference::construct::construct(&loaded.field, twin_feature, loaded.iso);
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

#[test]
fn slabs_hold_what_their_layers_need() {
    // 8 Gi samples: every product here passes 2^32.
    let grid = Grid::new([2048, 2048, 2048], [1.0; 3]).expect("a grid");
    assert_eq!(grid.sample_count(), 1 << 33);
    assert_eq!(grid.regions(), [64; 3]);
    let plane = 2048 * 2048 * 4u64;
    for limit_bytes in [
        35 * plane,
        36 * plane,
        1 << 30,
        4 << 30,
        34_359_738_367,
        1 << 35,
        u64::MAX,
    ] {
        let slabs = slab_layers(&grid, limit_bytes).expect("slabs");
        assert_eq!(slabs[0].start, 0);
        assert_eq!(slabs.last().map(|s| s.end), Some(64));
        for (i, layers) in slabs.iter().enumerate() {
            assert!(i == 0 || slabs[i - 1].end == layers.start, "layers follow each other");
            let planes = slab_planes(&grid, layers);
            // A cell's corners, and the neighbours of these for gradients.
            assert!(planes.start <= (layers.start * 32).saturating_sub(1));
            assert!(planes.end >= (layers.end * 32 + 2).min(2048));
            assert!(u64::from(planes.end - planes.start) * plane <= limit_bytes);
        }
    }
    assert_eq!(slab_layers(&grid, u64::MAX).expect("one slab").len(), 1);
    let e = slab_layers(&grid, 35 * plane - 1).expect_err("one layer is too large");
    assert!(matches!(e, crate::Error::OutOfDeviceMemory { needed_bytes, .. } if needed_bytes == 35 * plane));
    // Taller than 32-bit planes could count once doubled.
    let tall = Grid::new([2, 2, u32::MAX], [1.0; 3]).expect("a grid");
    let layers = slab_layers(&tall, 1 << 30).expect("slabs");
    assert_eq!(layers.last().map(|s| s.end), Some(tall.regions()[2]));
    assert_eq!(slab_planes(&tall, layers.last().expect("one")).end, u32::MAX);
}
