//! Features that are computed before `construct`: at cells, and their histograms.

use super::recipes::{DIMS, Pattern, any_recipe};
use super::*;
use isopeel_kernels::{SampleType, VectorFeature};
use isopeel_reference::{Feature as TwinFeature, construct, derive, histogram};

/// Features of a neighbourhood.
const SCALAR: [DerivedFeature; 3] = [
    DerivedFeature::MeanCurvature,
    DerivedFeature::GaussianCurvature,
    DerivedFeature::LocalVariance,
];

/// A vector field whose components have types of their own.
fn components(recipe: &Recipe) -> [Recipe; 3] {
    let kinds = [recipe.kind, SampleType::F32, SampleType::I16];
    [0, 1, 2].map(|i| Recipe {
        kind: kinds[i],
        seed: recipe.seed.wrapping_add(i as u64),
        ..recipe.clone()
    })
}

/// Each cell has the twin's feature, and the histogram is that of the twin's values. `rounding`: what is lost
/// where values are small differences of large ones.
fn check(
    engine: &Engine,
    of: &Loaded,
    feature: Feature<'_>,
    twin: TwinFeature<'_>,
    want: &Field,
    rounding: f32,
) -> Result<(), TestCaseError> {
    let finite = || want.values.iter().filter(|v| v.is_finite());
    let largest = finite().fold(0.0f32, |a, v| a.max(v.abs()));
    let slack = largest * 2e-4 + rounding;
    let host = HostPyramid::read(engine, &build(engine, of, feature));
    let twin = construct::construct(&of.field, twin, of.iso);
    for (slot, (node, leaf)) in host.nodes.iter().zip(&host.leaves).enumerate() {
        if host.is_extra(slot) || node.count == 0 {
            continue;
        }
        let f = twin.nodes[usize::from(leaf.level)][&leaf.cube].f;
        prop_assert!(
            (node.f - f).abs() <= slack,
            "f of {:?} is {}, expected {}",
            leaf,
            node.f,
            f
        );
    }
    let got = engine.histogram(&of.volume, feature).expect("histogram");
    let expected = histogram::histogram(&want.values);
    prop_assert_eq!(got.bins.iter().sum::<u64>(), expected.bins.iter().sum::<u64>());
    for (g, w) in got.range.iter().zip(expected.range) {
        prop_assert!((g - w).abs() <= slack, "{:?}, expected {:?}", got.range, expected.range);
    }
    Ok(())
}

/// The largest sum of the squares of a vector's derivatives, of which λ₂ is an eigenvalue.
fn largest_square(fields: [&Field; 3]) -> f32 {
    let squares = fields.map(|field| field.gradient_magnitude().values);
    let sum = |i: usize| squares.iter().map(|values| values[i] * values[i]).sum::<f32>();
    (0..squares[0].len())
        .map(sum)
        .filter(|v| v.is_finite())
        .fold(0.0, f32::max)
}

fn check_all(engine: &Engine, recipe: &Recipe) -> Result<(), TestCaseError> {
    let of = load(engine, recipe);
    for feature in SCALAR {
        let want = derive::derived(&of.field, feature);
        check(
            engine,
            &of,
            Feature::Derived(feature),
            TwinFeature::Derived(feature),
            &want,
            0.0,
        )?;
    }
    let parts = components(recipe).map(|component| load(engine, &component));
    let (volumes, fields) = (parts.each_ref().map(|p| &p.volume), parts.each_ref().map(|p| &p.field));
    for &feature in VectorFeature::ALL {
        let want = derive::of_vector(fields, feature);
        let twin = TwinFeature::Vector(feature, fields);
        let rounding = match feature {
            VectorFeature::Lambda2 => 1e-6 * largest_square(fields),
            _ => 0.0,
        };
        check(engine, &of, Feature::Vector(feature, volumes), twin, &want, rounding)?;
    }
    Ok(())
}

#[test]
fn cells_and_histograms_have_the_twins_features() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in any_recipe())| check_all(&engine, &recipe)?);
}

#[test]
fn every_extent_has_the_twins_features() {
    let Some(engine) = device() else { return };
    for (i, dims) in DIMS.into_iter().enumerate() {
        let recipe = Recipe {
            missing: i % 2 == 1,
            spacing: [1.0, 0.3, 7.0],
            ..Recipe::plain(dims, Pattern::Waves(20), i as u64)
        };
        check_all(&engine, &recipe).expect("the same features");
    }
}
