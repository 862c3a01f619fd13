//! Volumes at a low resolution, of several slabs too.

use super::recipes::{Pattern, any_recipe};
use super::*;
use isopeel_kernels::{Overview, OverviewMode, OverviewWork, Samples};
use isopeel_reference::overview::{Mode, overview};

/// The overview and the number of its launches.
fn made(engine: &Engine, volume: &Volume, mode: OverviewMode, side: u32) -> (Overview, usize) {
    let mut work = OverviewWork::new(volume.grid().dims, mode, side);
    let mut launches = 0;
    while let Some(part) = work.next() {
        assert!(work.complete().is_none(), "a part is missing");
        work.add(engine.overview_values(volume, part).expect("a part"));
        launches += 1;
    }
    (work.complete().expect("complete"), launches)
}

fn check(engine: &Engine, loaded: &Loaded, side: u32) -> Result<(), TestCaseError> {
    // Sums are of 32-bit floats, whose errors are shares of the differences of samples.
    let finite = loaded.field.values.iter().filter(|v| v.is_finite());
    let largest = finite.fold(0.0, |largest: f64, v| largest.max(f64::from(v.abs())));
    for (mode, twin) in [(OverviewMode::Mean, Mode::Mean), (OverviewMode::Maximum, Mode::Maximum)] {
        let (got, _) = made(engine, &loaded.volume, mode, side);
        let want = overview(&loaded.field, twin, side);
        prop_assert!(got.dims.iter().all(|n| *n <= side), "{:?}", got.dims);
        prop_assert_eq!(got.codes.len(), want.len());
        let values = || want.iter().flatten().copied();
        let [lo, hi] = [
            values().reduce(f64::min).unwrap_or_default(),
            values().reduce(f64::max).unwrap_or_default(),
        ];
        for (found, expected) in got.range.iter().zip([lo, hi]) {
            let is_near = (f64::from(*found) - expected).abs() <= 1e-5 * largest;
            prop_assert!(is_near, "{:?}, expected {:?}", got.range, [lo, hi]);
        }
        // Rounding moves a value within its range, by more of it if that is small.
        let slack = 0.51 + 254.0 * 1e-5 * largest / (hi - lo).max(f64::MIN_POSITIVE);
        for (code, value) in got.codes.iter().zip(&want) {
            let share = value.map(|value| if hi > lo { (value - lo) / (hi - lo) } else { 0.0 });
            let expected = share.map_or(0.0, |share| 1.0 + 254.0 * share);
            let is_near = value.is_some() == (*code > 0) && (f64::from(*code) - expected).abs() <= slack;
            prop_assert!(is_near, "{:?}: code {}, expected {}", mode, code, expected);
        }
    }
    Ok(())
}

#[test]
fn overviews_have_the_twins_values() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in any_recipe(), side in 1..60u32)| check(&engine, &load(&engine, &recipe), side)?);
}

#[test]
fn blocks_in_two_slabs_have_the_samples_of_both() {
    let Some(mut engine) = device() else { return };
    let before = testing::limit_allocations(&mut engine, 40 * 40 * 70 * 4);
    let loaded = load(&engine, &Recipe::plain([40, 40, 140], Pattern::Waves(5), 3));
    assert!(testing::slab_count(&loaded.volume) > 1);
    // Blocks of 1, 3, 5, 12 and 140 planes: slabs end within some of them.
    for side in [140, 50, 28, 12, 1] {
        check(&engine, &loaded, side).expect("the twin's values");
    }
    testing::limit_allocations(&mut engine, before);
}

/// Of several launches, which are sized by the time of those before them: the result does not depend on that.
#[test]
fn an_overview_of_many_launches_is_always_the_same() {
    let Some(engine) = device() else { return };
    let loaded = load(&engine, &Recipe::plain([211, 190, 97], Pattern::Waves(20), 3));
    check(&engine, &loaded, 60).expect("the twin's values");
    let (first, launches) = made(&engine, &loaded.volume, OverviewMode::Mean, 60);
    assert!(launches > 1, "{launches} launch");
    assert_eq!(first.factors, [4, 4, 2]);
    for _ in 0..3 {
        assert_eq!(made(&engine, &loaded.volume, OverviewMode::Mean, 60).0, first);
    }
}

#[test]
fn infinite_and_missing_samples_do_not_count() {
    let Some(engine) = device() else { return };
    for missing in [false, true] {
        let recipe = Recipe {
            missing,
            ..Recipe::plain([40, 33, 35], Pattern::Extremes, 3)
        };
        for side in [40, 9, 2] {
            check(&engine, &load(&engine, &recipe), side).expect("the twin's values");
        }
    }
}

#[test]
fn large_blocks_of_one_value_have_that_value() {
    let Some(engine) = device() else { return };
    let count = 1_500_000;
    for (samples, value) in [
        (Samples::U16(vec![60_001; count as usize]), 60_001.0),
        (Samples::F32(vec![0.1; count as usize]), 0.1),
        (Samples::F32(vec![-1e30; count as usize]), -1e30),
    ] {
        for (dims, side) in [([count / 4, 2, 2], 128), ([100, 125, 120], 7), ([100, 125, 120], 1)] {
            let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
            let loaded = load_samples(&engine, grid, &samples, None, 0.0);
            for mode in [OverviewMode::Mean, OverviewMode::Maximum] {
                let (found, _) = made(&engine, &loaded.volume, mode, side);
                assert_eq!(found.range, [value; 2], "{mode:?} of {dims:?}");
                assert!(found.codes.iter().all(|code| *code == 1), "{mode:?} of {dims:?}");
            }
        }
    }
}

#[test]
fn values_that_rounding_alone_tells_apart_are_equal() {
    let Some(engine) = device() else { return };
    let noise = |i: u32| f32::from_bits(0.1f32.to_bits() + i % 3);
    let grid = Grid::new([90, 2, 2], [1.0; 3]).expect("a grid");
    let samples = Samples::F32((0..360).map(noise).collect());
    let loaded = load_samples(&engine, grid, &samples, None, 0.0);
    for mode in [OverviewMode::Mean, OverviewMode::Maximum] {
        let (found, _) = made(&engine, &loaded.volume, mode, 90);
        assert_eq!(found.range, [0.1; 2]);
        assert!(found.codes.iter().all(|code| *code == 1));
    }
}

#[test]
fn a_volume_of_another_size_is_refused() {
    let Some(engine) = device() else { return };
    let loaded = load(&engine, &Recipe::plain([5, 6, 7], Pattern::Noise, 1));
    let work = OverviewWork::new([5, 6, 8], OverviewMode::Mean, 9);
    let part = work.next().expect("a first part");
    let error = engine.overview_values(&loaded.volume, part).expect_err("another size");
    assert!(error.to_string().contains("[5, 6, 7]"), "{error}");
}
