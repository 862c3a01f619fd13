//! Masked fields: the device's samples, their type and what is missing are the host's, bit for bit.

use super::recipes::{Pattern, Random, any_recipe};
use super::slabs::load_in;
use super::*;
use isopeel_kernels::testing::{read_minmax, slab_count};
use isopeel_kernels::{SampleType, ValueSet};

/// The recipe of labels on the same grid, of a type of their own.
fn labels_of(recipe: &Recipe, random: &mut Random) -> Recipe {
    let kinds = [
        SampleType::U8,
        SampleType::I8,
        SampleType::U16,
        SampleType::I16,
        SampleType::F32,
    ];
    Recipe {
        kind: kinds[(random.next() % 5) as usize],
        missing: random.next().is_multiple_of(2),
        seed: random.next(),
        ..recipe.clone()
    }
}

/// Ranges with ends among the labels: some lie on a label, some are empty of them, some overlap.
fn values_inside(labels: &Field, random: &mut Random) -> ValueSet {
    let mut label = || {
        let at = random.next() as usize % labels.values.len();
        Some(labels.values[at]).filter(|value| !value.is_nan()).unwrap_or(0.0)
    };
    let ranges = (0..3).map(|_| {
        let (a, b) = (label(), label());
        [a.min(b), a.max(b)]
    });
    let ranges: Vec<[f32; 2]> = ranges.collect();
    let open = [
        [ranges[0][0]; 2],
        [f32::NEG_INFINITY, ranges[1][0]],
        [ranges[2][1], f32::INFINITY],
    ];
    ValueSet {
        ranges: [ranges, open.to_vec()][(random.next() % 2) as usize][..1 + (random.next() % 3) as usize].to_vec(),
        is_complement: random.next().is_multiple_of(2),
    }
}

/// Compares a masked field with one that the host masked; returns how many of its samples are inside.
fn check(engine: &Engine, recipe: &Recipe, labels: &Loaded, field: &Volume, inside: &ValueSet) -> [usize; 2] {
    let (grid, samples, missing, _) = recipe.make();
    let is_inside = |i: usize| inside.holds(labels.field.values[i]);
    let count = (0..samples.len()).filter(|&i| is_inside(i)).count();
    let all = samples.len();
    let (expected, missing) = samples.masked(missing, is_inside);
    let masked = engine.mask(field, &labels.volume, inside, &Never).expect("mask");
    assert_eq!(masked.sample_type(), expected.sample_type(), "{recipe:?}");
    let found = engine.download(&masked, 0..grid.dims[2]).expect("download");
    assert!(found.as_bytes() == expected.as_bytes(), "{recipe:?} inside {inside:?}");
    let uploaded = engine.upload(grid, &expected, missing).expect("upload");
    let [found, expected] = [&masked, &uploaded].map(|volume| read_minmax(engine, volume).expect("a table"));
    assert!(found.ranges == expected.ranges && found.missing_masks == expected.missing_masks);
    [count, all]
}

#[test]
fn masked_fields_are_the_hosts() {
    let Some(engine) = device() else { return };
    let total = std::cell::Cell::new([0, 0]);
    proptest!(config(24), |(recipe in any_recipe(), seed in any::<u64>())| {
        let mut random = Random(seed);
        let labels = load(&engine, &labels_of(&recipe, &mut random));
        let inside = values_inside(&labels.field, &mut random);
        let field = load(&engine, &recipe);
        let [count, all] = check(&engine, &recipe, &labels, &field.volume, &inside);
        total.set([total.get()[0] + count, total.get()[1] + all]);
    });
    let [count, all] = total.get();
    assert!(
        (all / 10..all - all / 10).contains(&count),
        "{count} of {all} samples are inside"
    );
}

#[test]
fn masked_fields_are_the_same_in_slabs() {
    let Some(mut engine) = device() else { return };
    let recipe = Recipe {
        kind: SampleType::U8,
        ..Recipe::plain([40, 35, 99], Pattern::Waves(9), 1)
    };
    let of_labels = Recipe {
        kind: SampleType::F32,
        missing: true,
        ..recipe.clone()
    };
    let [field, labels] = [&recipe, &of_labels].map(|recipe| load_in(&mut engine, recipe, true));
    let inside = values_inside(&labels.field, &mut Random(3));
    let masked = engine
        .mask(&field.volume, &labels.volume, &inside, &Never)
        .expect("mask");
    assert!(slab_count(&masked) > 1);
    let [count, all] = check(&engine, &recipe, &labels, &field.volume, &inside);
    assert!(0 < count && count < all);
}

#[test]
fn labels_on_another_grid_are_refused() {
    let Some(engine) = device() else { return };
    let [field, labels] = [[5, 6, 7], [5, 6, 8]].map(|dims| load(&engine, &Recipe::plain(dims, Pattern::Waves(7), 5)));
    let all = ValueSet {
        ranges: Vec::new(),
        is_complement: true,
    };
    let error = engine.mask(&field.volume, &labels.volume, &all, &Never);
    assert!(error.is_err_and(|error| error.to_string().contains("expected one grid")));
}
