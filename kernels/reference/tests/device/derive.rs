//! Features that are computed before `construct`: at cells, and their histograms.

use super::recipes::{DIMS, Pattern, any_recipe};
use super::*;
use isopeel_kernels::expression::{Expression, Op};
use isopeel_kernels::testing::{LAYER_PLANES, limit_allocations, slab_count, with_gpu_kernels};
use isopeel_kernels::{Histogram, RectilinearGrid, SampleType, Samples, VectorFeature};
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

/// Each cell has the twin's feature, and the histogram is that of the twin's values. `rounding`: the error of
/// values that are small differences of large ones.
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
    let squares = fields.map(|field| derive::derived(field, DerivedFeature::GradientMagnitude).values);
    let sum = |i: usize| squares.iter().map(|values| values[i] * values[i]).sum::<f32>();
    (0..squares[0].len())
        .map(sum)
        .filter(|v| v.is_finite())
        .fold(0.0, f32::max)
}

/// Lengths of the cells of a recipe's grid: up to ten times as long as others.
fn lengths_of(recipe: &Recipe) -> [Vec<f32>; 3] {
    let mut random = Random(recipe.seed ^ 0x5eed);
    let mut along = |axis: usize| {
        let cells = 0..recipe.dims[axis] - 1;
        cells
            .map(|_| recipe.spacing[axis] * (0.1 + 0.9 * random.unit()))
            .collect()
    };
    [along(0), along(1), along(2)]
}

fn upload_uneven(
    engine: &Engine,
    grid: Grid,
    lengths: [Vec<f32>; 3],
    samples: &Samples,
    missing: Option<f32>,
) -> Volume {
    let uneven = RectilinearGrid::uneven(grid, lengths).expect("lengths of cells");
    engine.upload(uneven, samples, missing).expect("upload")
}

/// As [`load`], with cells of these lengths.
fn load_uneven(engine: &Engine, recipe: &Recipe, lengths: &[Vec<f32>; 3]) -> Loaded {
    let (grid, samples, missing, iso) = recipe.make();
    Loaded {
        volume: upload_uneven(engine, grid, lengths.clone(), &samples, missing),
        field: Field::from_samples(grid, &samples, missing).with_lengths(lengths.clone()),
        iso,
    }
}

fn check_all(engine: &Engine, recipe: &Recipe) -> Result<(), TestCaseError> {
    check_with(engine, recipe, &SCALAR, |recipe| load(engine, recipe))
}

/// As [`check_all`], on uneven axes. Those of the components are those of the volume.
fn check_uneven(engine: &Engine, recipe: &Recipe) -> Result<(), TestCaseError> {
    let lengths = lengths_of(recipe);
    check_with(engine, recipe, DerivedFeature::ALL, |recipe| {
        load_uneven(engine, recipe, &lengths)
    })
}

fn check_with(
    engine: &Engine,
    recipe: &Recipe,
    scalar: &[DerivedFeature],
    load: impl Fn(&Recipe) -> Loaded,
) -> Result<(), TestCaseError> {
    let of = load(recipe);
    for &feature in scalar {
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
    let parts = components(recipe).map(|component| load(&component));
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
    for i in 0..DIMS.len() {
        let recipe = Recipe::waves_on(i);
        check_all(&engine, &recipe).expect("the same features");
    }
}

#[test]
fn uneven_axes_have_the_twins_features() {
    let Some(engine) = device() else { return };
    proptest!(config(4), |(recipe in any_recipe())| check_uneven(&engine, &recipe)?);
}

/// Some of the cases run the kernels of a GPU on a CPU.
#[test]
fn uneven_axes_of_every_extent_have_the_twins_features() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    for i in 0..DIMS.len() {
        let recipe = Recipe::waves_on(i);
        check_uneven(if i % 3 == 2 { &of_gpu } else { &engine }, &recipe).expect("the same features");
    }
}

/// The gradient's magnitude at cells, and its histogram.
fn gradient_magnitude(engine: &Engine, of: &Loaded) -> (Vec<f32>, Histogram) {
    let feature = Feature::Derived(DerivedFeature::GradientMagnitude);
    let host = HostPyramid::read(engine, &build(engine, of, feature));
    let histogram = engine.histogram(&of.volume, feature).expect("histogram");
    (host.nodes.iter().map(|node| node.f).collect(), histogram)
}

/// `derive` and `construct` have it by formulas of their own.
#[test]
fn cells_of_one_length_have_the_gradient_of_even_axes() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        missing: true,
        spacing: [1.0, 0.5, 3.0],
        ..Recipe::plain([35, 20, 18], Pattern::Waves(10), 5)
    };
    let lengths = [0, 1, 2].map(|axis| vec![recipe.spacing[axis]; recipe.dims[axis] as usize - 1]);
    let even = gradient_magnitude(&engine, &load(&engine, &recipe));
    let uneven = gradient_magnitude(&engine, &load_uneven(&engine, &recipe, &lengths));
    assert!(even.0.len() > 1000 && even.0.len() == uneven.0.len());
    for (a, b) in even
        .0
        .iter()
        .zip(&uneven.0)
        .chain(even.1.range.iter().zip(&uneven.1.range))
    {
        assert!(near(*a, *b, 1e-5), "{a}, {b}");
    }
}

#[test]
fn uneven_axes_have_the_same_features_in_slabs() {
    let Some(mut engine) = device() else { return };
    let recipe = Recipe::plain([20, 12, 110], Pattern::Waves(10), 6);
    let lengths = lengths_of(&recipe);
    let whole = load_uneven(&engine, &recipe, &lengths);
    let [x, y, _] = recipe.dims.map(u64::from);
    let before = limit_allocations(&mut engine, x * y * 4 * u64::from(LAYER_PLANES));
    let in_slabs = load_uneven(&engine, &recipe, &lengths);
    limit_allocations(&mut engine, before);
    assert_eq!([&whole, &in_slabs].map(|of| slab_count(&of.volume) > 1), [false, true]);
    assert_eq!(
        gradient_magnitude(&engine, &whole),
        gradient_magnitude(&engine, &in_slabs)
    );
}

/// A field that is computed from others is on their grid.
#[test]
fn what_is_computed_from_uneven_fields_is_uneven() {
    let Some(engine) = device() else { return };
    let recipe = Recipe::plain([20, 12, 18], Pattern::Waves(10), 7);
    let of = load_uneven(&engine, &recipe, &lengths_of(&recipe));
    let same = Expression::new(vec![Op::Field(0)]).expect("an expression");
    let computed = Loaded {
        volume: engine.evaluate(&same, &[&of.volume], &Never).expect("evaluate"),
        field: of.field.clone(),
        iso: of.iso,
    };
    assert_eq!(gradient_magnitude(&engine, &computed), gradient_magnitude(&engine, &of));
}
