//! Range and distribution of samples and of gradients.

use super::recipes::{DIMS, Pattern, any_recipe};
use super::*;
use isopeel_kernels::{HistogramWork, SampleType};
use isopeel_reference::histogram;

/// Bins may differ by what lies within rounding of their ends.
fn check(engine: &Engine, loaded: &Loaded, gradient: bool) -> Result<(), TestCaseError> {
    let derived;
    let (feature, field) = if gradient {
        derived = loaded.field.gradient_magnitude();
        (Feature::Derived(DerivedFeature::GradientMagnitude), &derived)
    } else {
        (Feature::None, &loaded.field)
    };
    let got = engine.histogram(&loaded.volume, feature).expect("histogram");
    let want = histogram::histogram(&field.values);
    let width = (want.range[1] - want.range[0]) / 256.0;
    let exact = !gradient;
    for (g, w) in got.range.iter().zip(want.range) {
        prop_assert!(
            if exact { *g == w } else { near(*g, w, 1e-6) },
            "{:?}, expected {:?}",
            got.range,
            want.range
        );
    }
    prop_assert_eq!(got.bins.iter().sum::<u64>(), want.bins.iter().sum::<u64>());
    if exact {
        prop_assert_eq!(got.bins, want.bins);
    } else if width > 0.0 && width.is_finite() {
        let slack = want.range[1].abs() * 4e-6;
        let finite: Vec<f32> = field.values.iter().copied().filter(|v| v.is_finite()).collect();
        let mut below = 0;
        for (i, n) in got.bins.iter().enumerate().take(255) {
            below += n;
            let end = want.range[0] + width * (i as f32 + 1.0);
            let minimum = finite.iter().filter(|v| **v < end - slack).count() as u64;
            let maximum = finite.iter().filter(|v| **v < end + slack).count() as u64;
            prop_assert!(
                (minimum..=maximum).contains(&below),
                "{below} values below {end}, expected {minimum} to {maximum}"
            );
        }
    }
    Ok(())
}

#[test]
fn samples_have_the_twins_histogram() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in any_recipe())| check(&engine, &load(&engine, &recipe), false)?);
}

#[test]
fn gradients_have_the_twins_histogram() {
    let Some(engine) = device() else { return };
    for i in 0..DIMS.len() {
        let recipe = Recipe::waves_on(i);
        check(&engine, &load(&engine, &recipe), true).expect("the same histogram");
    }
}

/// Of several launches, which are sized by the time of those before them.
#[test]
fn a_volume_of_many_launches_has_the_twins_histogram() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([211, 170, 97], Pattern::Waves(20), 3);
    let loaded = load(&engine, &recipe);
    let mut work = HistogramWork::default();
    let mut parts = 0;
    while work.complete().is_none() {
        let feature = Feature::Derived(DerivedFeature::GradientMagnitude);
        engine
            .continue_histogram(&loaded.volume, feature, &mut work)
            .expect("a part");
        parts += 1;
    }
    assert!(parts > 1, "{parts} part");
    for gradient in [false, true] {
        check(&engine, &loaded, gradient).expect("the same histogram");
    }
}

/// Large volumes are counted in part, here small ones. A field's range is that of all of its samples.
#[test]
fn a_share_of_a_large_volume_has_the_twins_histogram() {
    let Some(engine) = device() else { return };
    for (dims, limit) in [([40, 33, 97], 20_000), ([17, 40, 150], 9_000), ([64, 20, 30], 1_000)] {
        let loaded = load(&engine, &Recipe::plain(dims, Pattern::Waves(7), 3));
        let plane = (dims[0] * dims[1]) as usize;
        let counted = |values: &[f32]| -> Vec<f32> {
            let planes = histogram::counted_planes(dims, 1, limit);
            let of_plane = |&z: &u32| values[z as usize * plane..][..plane].iter().copied();
            planes.iter().flat_map(of_plane).collect()
        };
        let share = |feature| {
            let mut work = HistogramWork::of_share(limit);
            while work.complete().is_none() {
                engine
                    .continue_histogram(&loaded.volume, feature, &mut work)
                    .expect("a part");
            }
            work.complete().expect("complete")
        };
        let (got, values) = (share(Feature::None), counted(&loaded.field.values));
        assert_eq!(got.range, histogram::histogram(&loaded.field.values).range, "{dims:?}");
        assert!(
            values.len() < loaded.field.values.len() / 2,
            "{dims:?}: {} are counted",
            values.len()
        );
        let [lo, hi] = got.range;
        let mut bins = vec![0u64; histogram::BINS];
        for value in values {
            let bin = (0.5 * value - 0.5 * lo) / (0.5 * hi - 0.5 * lo) * 256.0;
            bins[(bin as usize).min(255)] += 1;
        }
        assert_eq!(got.bins, bins, "{dims:?}");
        let gradients = counted(&loaded.field.gradient_magnitude().values);
        let (got, want) = (
            share(Feature::Derived(DerivedFeature::GradientMagnitude)),
            histogram::histogram(&gradients),
        );
        assert_eq!(got.bins.iter().sum::<u64>(), want.bins.iter().sum::<u64>());
        assert!(near(got.range[0], want.range[0], 1e-6) && near(got.range[1], want.range[1], 1e-6));
    }
}

/// The largest and smallest finite ones count, whichever other samples their bricks have.
#[test]
fn infinite_samples_are_left_out() {
    let Some(engine) = device() else { return };
    for kind in [SampleType::F32, SampleType::I16] {
        let recipe = Recipe {
            kind,
            missing: true,
            ..Recipe::plain([40, 33, 35], Pattern::Extremes, 3)
        };
        check(&engine, &load(&engine, &recipe), false).expect("the same histogram");
    }
}
