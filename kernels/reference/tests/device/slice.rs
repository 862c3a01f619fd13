//! Planes of samples, along every axis and from several slabs.

use super::recipes::{Pattern, any_recipe};
use super::*;
use isopeel_kernels::{SampleType, Samples};
use isopeel_reference::slice::slice;

/// Bytes of a plane as values.
fn values(volume: &Volume, bytes: &[u8], missing: Option<f32>) -> Vec<f32> {
    let pairs = || bytes.chunks_exact(2).map(|b| [b[0], b[1]]);
    let samples = match volume.sample_type() {
        SampleType::U8 => Samples::U8(bytes.to_vec()),
        SampleType::I8 => Samples::I8(bytes.iter().map(|b| b.cast_signed()).collect()),
        SampleType::U16 => Samples::U16(pairs().map(u16::from_le_bytes).collect()),
        SampleType::I16 => Samples::I16(pairs().map(i16::from_le_bytes).collect()),
        SampleType::F32 => {
            let words = bytes.chunks_exact(4).map(|b| [b[0], b[1], b[2], b[3]]);
            Samples::F32(words.map(f32::from_le_bytes).collect())
        }
    };
    let value = |i| Some(samples.get(i)).filter(|&v| Some(v) != missing).unwrap_or(f32::NAN);
    (0..samples.len()).map(value).collect()
}

fn check(engine: &Engine, recipe: &Recipe, seed: u64) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let (.., missing, _) = recipe.make();
    for axis in 0..3 {
        let planes = recipe.dims[axis];
        for index in [0, (seed % u64::from(planes)) as u32, planes - 1] {
            let bytes = engine.slice(&loaded.volume, axis, index).expect("a plane");
            let got = values(&loaded.volume, &bytes, missing);
            let want = slice(&loaded.field, axis, index);
            let same = |a: f32, b: f32| a == b || (a.is_nan() && b.is_nan());
            prop_assert!(
                got.len() == want.len() && got.iter().zip(&want).all(|(&a, &b)| same(a, b)),
                "plane {} across axis {}",
                index,
                axis
            );
        }
    }
    Ok(())
}

#[test]
fn planes_have_the_twins_samples() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in any_recipe(), seed in any::<u64>())| check(&engine, &recipe, seed)?);
}

#[test]
fn planes_of_several_slabs_are_whole() {
    let Some(mut engine) = device() else { return };
    let before = testing::limit_allocations(&mut engine, 40 * 40 * 70 * 4);
    let recipe = Recipe::plain([40, 40, 140], Pattern::Waves(5), 3);
    assert!(testing::slab_count(&load(&engine, &recipe).volume) > 1);
    check(&engine, &recipe, 33).expect("the twin's samples");
    check(&engine, &recipe, 64).expect("the twin's samples");
    testing::limit_allocations(&mut engine, before);
}

#[test]
fn planes_that_are_not_there_are_refused() {
    let Some(engine) = device() else { return };
    let loaded = load(&engine, &Recipe::plain([5, 6, 7], Pattern::Noise, 1));
    for (axis, index) in [(0, 5), (1, 6), (2, 7), (3, 0), (2, u32::MAX)] {
        assert!(
            engine.slice(&loaded.volume, axis, index).is_err(),
            "{index} across {axis}"
        );
    }
}
