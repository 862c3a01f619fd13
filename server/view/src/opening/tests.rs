//! Histograms of each kind.

use isopeel_kernels::Histogram;
use proptest::prelude::*;

use super::{IsoReason, OpeningIso};

/// Samples in the bin of each of 256 values from `range[0]` to `range[1]`.
fn histogram(range: [f32; 2], count: impl Fn(f64) -> f64) -> Histogram {
    let [low, high] = range.map(f64::from);
    let centre = |bin: u32| low + (f64::from(bin) + 0.5) * (high - low) / 256.0;
    let mut bins: Vec<u64> = (0..256).map(|bin| count(centre(bin)) as u64).collect();
    // What makes the range.
    bins[0] = bins[0].max(1);
    bins[255] = bins[255].max(1);
    Histogram { range, bins }
}

/// A peak of about `samples` samples, in bins of `width`.
fn peak(value: f64, at: f64, deviation: f64, samples: f64, width: f64) -> f64 {
    let t = (value - at) / deviation;
    samples * width / deviation / std::f64::consts::TAU.sqrt() * (-t * t / 2.0).exp()
}

/// A head in a scanner: air, a head rest of foam, soft tissue, bone. `value` is the value of a number of Hounsfield units.
fn ct_head(low: f64, value: impl Fn(f64) -> f64) -> Histogram {
    let width = (3000.0 - low) / 256.0;
    let range = [value(low) as f32, value(3000.0) as f32];
    let slope = (value(1000.0) - value(0.0)) / 1000.0;
    histogram(range, |v| {
        let hu = (v - value(0.0)) / slope;
        let others = match hu {
            -900.0..-550.0 => 30_000.0,
            -550.0..150.0 => 4000.0,
            150.0..1700.0 => 8000.0 * (1.0 - hu / 1700.0),
            _ => 0.0,
        };
        peak(hu, -1000.0, 15.0, 4e6, width) + peak(hu, 30.0, 25.0, 2e6, width) + others
    })
}

fn chosen(histogram: &Histogram, unit: Option<&str>) -> (f32, IsoReason) {
    let OpeningIso {
        iso,
        reason,
        explanation,
    } = OpeningIso::of(histogram, unit, false);
    assert!(!explanation.is_empty());
    (iso, reason)
}

#[test]
fn computed_tomography_opens_with_bone() {
    for low in [-1024.0, -1000.0, -2000.0, -3024.0] {
        let mut head = ct_head(low, |hu| hu);
        assert_eq!(chosen(&head, None), (300.0, IsoReason::Bone), "from {low}");
        assert_eq!(chosen(&head, Some("HU")), (300.0, IsoReason::Bone), "from {low}");
        if low < -1024.0 {
            head.bins[0] += 2_000_000;
            assert_eq!(chosen(&head, None), (300.0, IsoReason::Bone), "padded with {low}");
        }
    }
}

#[test]
fn a_declared_unit_decides_what_are_hounsfield_units() {
    let head = ct_head(-1024.0, |hu| hu);
    assert_ne!(chosen(&head, Some("K")).1, IsoReason::Bone);
    // A part of a body without air.
    let body = |low, high| histogram([low, high], |v| peak(v, 40.0, 30.0, 1e6, 4.0) + 500.0);
    assert_ne!(chosen(&body(-200.0, 900.0), None).1, IsoReason::Bone);
    for unit in ["HU", " hu ", "Hounsfield units"] {
        assert_eq!(
            chosen(&body(-200.0, 900.0), Some(unit)),
            (300.0, IsoReason::Bone),
            "{unit:?}"
        );
        // Without bone there is none to show.
        assert_ne!(chosen(&body(-200.0, 250.0), Some(unit)).1, IsoReason::Bone, "{unit:?}");
    }
}

#[test]
fn other_values_from_minus_thousand_on_are_not_taken_for_computed_tomography() {
    let wave = histogram([-1024.0, 3000.0], |_| 1000.0);
    let depth = histogram([-4000.0, 2000.0], |v| 1000.0 + peak(v, 0.0, 100.0, 1e6, 24.0));
    let two = histogram([-1024.0, 3000.0], |v| {
        peak(v, -1000.0, 20.0, 1e6, 16.0) + peak(v, 2000.0, 100.0, 1e6, 16.0)
    });
    for other in [wave, depth, two] {
        assert_ne!(chosen(&other, None).1, IsoReason::Bone);
    }
}

#[test]
fn a_head_in_eight_bits_opens_with_bone_too() {
    // What lies between air and soft tissue, foam and partly filled cells, is no class of its own.
    let scale = |hu: f64| (hu + 1024.0) / 4024.0 * 255.0;
    let (iso, reason) = chosen(&ct_head(-1024.0, scale), None);
    assert_eq!(reason, IsoReason::BackgroundLeftOut);
    let bone = scale(150.0)..scale(700.0);
    assert!(bone.contains(&f64::from(iso)), "{iso}, expected {bone:?}");
}

#[test]
fn a_brain_on_a_grid_of_zeros_opens_between_its_tissues() {
    let brain = |zeros: f64| {
        histogram([0.0, 255.0], |v| {
            let tissue = peak(v, 165.0, 20.0, 1e6, 1.0) + peak(v, 225.0, 8.0, 5e5, 1.0);
            tissue + if v < 1.0 { zeros } else { 0.0 }
        })
    };
    let (iso, reason) = chosen(&brain(6e6), None);
    assert_eq!(reason, IsoReason::BackgroundLeftOut);
    assert!((180.0..215.0).contains(&iso), "{iso}");
    // A few zeros are no background.
    let (iso, reason) = chosen(&brain(1e4), None);
    assert_eq!(reason, IsoReason::WholeHistogram);
    assert!((180.0..215.0).contains(&iso), "{iso}");
}

#[test]
fn a_probability_that_is_mostly_zero_opens_at_half() {
    let probability = histogram([0.0, 1.0], |p| {
        let u = 1000.0 + 3000.0 * (2.0 * p - 1.0).powi(4);
        if p < 0.004 { 1e6 } else { u }
    });
    let (iso, reason) = chosen(&probability, None);
    assert_eq!(reason, IsoReason::BackgroundLeftOut);
    assert!((0.4..0.6).contains(&iso), "{iso}");
}

#[test]
fn without_a_background_the_whole_histogram_decides() {
    // Temperatures of an ocean, with a low and wide peak at the coldest ones.
    let ocean = histogram([-3.0, 30.0], |t| {
        100.0 + peak(t, -1.5, 0.5, 400.0, 0.13) + 500.0 * (-t / 8.0).exp()
    });
    // The distance to the nearer one of two spheres, and a wave.
    let spheres = histogram([-40.0, 20.0], |d| 10.0 * (d + 40.0));
    let wave = histogram([-1.0, 1.0], |w| 1000.0 / (1.02 - w * w).sqrt());
    // Falls too slowly for a peak.
    let decay = histogram([0.0, 256.0], |v| 1e6 * (-v / 20.0).exp());
    for field in [ocean, spheres, wave, decay] {
        let (iso, reason) = chosen(&field, None);
        assert_eq!(reason, IsoReason::WholeHistogram);
        let [low, high] = field.range;
        let inner = (low + 0.1 * (high - low))..(high - 0.1 * (high - low));
        assert!(inner.contains(&iso), "{iso}, expected {inner:?}");
    }
}

#[test]
fn masks_and_labels_open_between_two_values() {
    let labels = |values: &[(usize, u64)]| {
        let mut bins = vec![0; 256];
        values.iter().for_each(|&(bin, n)| bins[bin] = n);
        bins
    };
    let of = |high: f32, values: &[(usize, u64)]| {
        let range = [0.0, high];
        chosen(
            &Histogram {
                range,
                bins: labels(values),
            },
            None,
        )
    };
    assert_eq!(of(1.0, &[(0, 9_000_000), (255, 10)]), (0.5, IsoReason::WholeHistogram));
    assert_eq!(of(1.0, &[(0, 10), (255, 9_000_000)]), (0.5, IsoReason::WholeHistogram));
    assert_eq!(of(255.0, &[(0, 800), (255, 200)]), (127.5, IsoReason::WholeHistogram));
    // Around all of them: any other isovalue cuts off those whose numbers happen to be low.
    let three = [(0, 9_000_000), (85, 3000), (170, 3000), (255, 3000)];
    assert_eq!(of(3.0, &three), (0.5, IsoReason::Labels));
    // Several labels in a bin, and one whose number is far from the others.
    let brain = [(0, 700), (1, 100), (4, 50), (10, 50), (13, 60), (255, 40)];
    assert_eq!(of(1024.0, &brain), (0.5, IsoReason::Labels));
    // Values between whole numbers, a background of a few samples, a peak of measured values, and a few samples that are too bright.
    let measured = [
        of(3.0, &[(0, 9_000_000), (40, 3000), (120, 3000), (255, 3000)]),
        of(3.0, &[(0, 10), (85, 3000), (170, 3000), (255, 3000)]),
        of(
            65_535.0,
            &[
                (0, 700),
                (160, 40),
                (161, 90),
                (162, 160),
                (163, 90),
                (164, 40),
                (255, 1),
            ],
        ),
        of(65_535.0, &[(0, 99_000), (1, 2000), (2, 100), (200, 1), (255, 2)]),
    ];
    assert!(
        measured.iter().all(|&(_, reason)| reason != IsoReason::Labels),
        "{measured:?}"
    );
}

#[test]
fn where_no_isovalue_has_a_surface_that_is_said() {
    for (value, samples) in [(0.0, 0), (0.0, 8), (-3.5, 8), (1e30, 8), (f32::MAX, 8)] {
        let mut bins = vec![0; 256];
        bins[0] = samples;
        let constant = Histogram {
            range: [value; 2],
            bins,
        };
        assert_eq!(chosen(&constant, None), (value, IsoReason::NoSurface));
        assert_eq!(chosen(&constant, Some("HU")), (value, IsoReason::NoSurface));
    }
}

proptest! {
    /// Whatever the histogram: inside its range, with samples on both sides.
    #[test]
    fn there_are_samples_on_both_sides(
        ends in (any::<f32>(), any::<f32>()),
        background in 0_u64..1_000_000,
        counts in prop::collection::vec(prop_oneof![3 => Just(0_u64), 1 => 1_u64..1000], 256),
        is_hounsfield in any::<bool>(),
    ) {
        let (low, high) = (ends.0.min(ends.1), ends.0.max(ends.1));
        prop_assume!(low.is_finite() && high.is_finite() && low < high);
        let mut bins = counts;
        bins[0] += 1 + background;
        bins[255] += 1;
        let field = Histogram { range: [low, high], bins };
        let (iso, reason) = chosen(&field, is_hounsfield.then_some("HU"));
        prop_assert!(low < iso && iso <= high, "{iso} of {low} to {high}");
        prop_assert_ne!(reason, IsoReason::NoSurface);
    }
}

#[test]
fn labels_that_the_file_declares_open_around_all_of_them() {
    // Brain parcellation: two groups of values far apart, which would be two classes.
    let mut parcellation = Histogram {
        range: [0.0, 2035.0],
        bins: vec![0; 256],
    };
    parcellation.bins[0] = 6_000_000;
    for bin in 126..130 {
        parcellation.bins[bin] = 400_000;
        parcellation.bins[bin + 125] = 400_000;
    }
    parcellation.bins[255] = 9000;
    let opening = OpeningIso::of(&parcellation, None, true);
    assert_eq!((opening.iso, opening.reason), (0.5, IsoReason::Labels));
    // Hounsfield units are nothing that labels have.
    assert_eq!(
        OpeningIso::of(&ct_head(-1024.0, |hu| hu), None, true).reason,
        IsoReason::Labels
    );
    let one = Histogram {
        range: [3.0, 3.0],
        bins: vec![9; 1],
    };
    assert_eq!(OpeningIso::of(&one, None, true).reason, IsoReason::NoSurface);
}

#[test]
fn many_labels_are_known_by_gaps_and_uneven_counts() {
    // FreeSurfer's aseg: most numbers up to 255, with gaps, large and small structures side by side.
    let mut aseg = Histogram {
        range: [0.0, 255.0],
        bins: vec![0; 256],
    };
    aseg.bins[0] = 10_000_000;
    let structures = [
        2, 3, 4, 5, 7, 8, 10, 11, 12, 13, 14, 15, 16, 17, 18, 24, 26, 28, 31, 41, 42, 43, 44, 46, 47, 49, 50, 77, 85,
        251, 255,
    ];
    for (i, &label) in structures.iter().enumerate() {
        aseg.bins[label] = [250_000, 900, 40_000, 7000][i % 4];
    }
    assert_eq!(chosen(&aseg, None), (0.5, IsoReason::Labels));
    // Measured values stretched to more grey values than they had: gaps, but counts are alike.
    let mut stretched = histogram([0.0, 255.0], |v| {
        peak(v, 0.0, 3.0, 5e6, 1.0) + peak(v, 120.0, 25.0, 3e6, 1.0)
    });
    for bin in (0..256).filter(|bin| bin % 5 == 4) {
        stretched.bins[bin] = 0;
    }
    stretched.bins[0] = 5_000_000;
    stretched.bins[255] = 1;
    assert_ne!(chosen(&stretched, None).1, IsoReason::Labels);
}
