//! Distances to samples that are inside: the device and the twin have the same.

use super::recipes::{DIMS, Random};
use super::tree::Others;
use super::*;
use isopeel_kernels::expression::{Comparison, Expression, Op};
use isopeel_kernels::testing::{LAYER_PLANES, limit_allocations, slab_count, with_gpu_kernels};
use isopeel_kernels::{Error, RectilinearGrid, Samples};
use isopeel_reference::distance_field::squares;
use std::cell::Cell;

/// An expression of one field that is true if the field is 3.
fn where_three() -> Expression {
    let ops = vec![
        Op::Field(0),
        Op::Number(3.0),
        Op::Compare(Comparison::Is, 0, 1),
        Op::Number(1.0),
        Op::Number(0.0),
        Op::Select(2, 3, 4),
    ];
    Expression::new(ops).expect("an expression")
}

/// Labels on a grid.
#[derive(Debug)]
struct Labels {
    dims: [u32; 3],
    spacing: [f32; 3],
    lengths: Option<[Vec<f32>; 3]>,
    values: Vec<u8>,
}

impl Labels {
    /// About one sample in `rarity` is 3, alone or in blocks; one in ten is missing, 255.
    fn random(dims: [u32; 3], spacing: [f32; 3], is_uneven: bool, rarity: u64, seed: u64) -> Self {
        let mut random = Random(seed);
        let count = dims.iter().map(|&n| n as usize).product();
        let is_missing = |random: &mut Random| random.next().is_multiple_of(10);
        let mut values: Vec<u8> = (0..count)
            .map(|_| {
                if is_missing(&mut random) {
                    255
                } else {
                    (random.next() % 3) as u8
                }
            })
            .collect();
        for value in &mut values {
            if random.next().is_multiple_of(rarity) {
                *value = 3;
            }
        }
        let mut along = |axis: usize| {
            let length = |_| spacing[axis] * (0.2 + random.unit());
            (1..dims[axis]).map(length).collect::<Vec<_>>()
        };
        let lengths = is_uneven.then(|| [along(0), along(1), along(2)]);
        Self {
            dims,
            spacing,
            lengths,
            values,
        }
    }

    /// Of floats, if there is no missing label.
    fn samples(&self) -> Samples {
        match self.values.contains(&255) {
            true => Samples::U8(self.values.clone()),
            false => Samples::F32(self.values.iter().map(|&value| value.into()).collect()),
        }
    }

    fn load(&self, engine: &Engine) -> Volume {
        let grid = Grid::new(self.dims, self.spacing).expect("a grid");
        let rectilinear = match &self.lengths {
            None => grid.into(),
            Some(lengths) => RectilinearGrid::uneven(grid, lengths.clone()).expect("lengths"),
        };
        let samples = self.samples();
        engine.upload(rectilinear, &samples, Some(255.0)).expect("upload")
    }

    /// The twin's distances, and the length of the volume's diagonal.
    fn distances(&self) -> (Vec<f64>, f64) {
        let positions = [0, 1, 2].map(|axis| {
            let length = |i: usize| match &self.lengths {
                None => f64::from(self.spacing[axis]),
                Some(lengths) => f64::from(lengths[axis][i]),
            };
            let mut at = 0.0;
            let after = (0..self.dims[axis] as usize - 1).map(|i| {
                at += length(i);
                at
            });
            [0.0].into_iter().chain(after).collect::<Vec<f64>>()
        });
        let inside: Vec<bool> = self.values.iter().map(|&value| value == 3).collect();
        let diagonal = positions
            .iter()
            .map(|along| along[along.len() - 1].powi(2))
            .sum::<f64>();
        let distances = squares(&positions, &inside).into_iter().map(f64::sqrt);
        (distances.collect(), diagonal.sqrt())
    }

    fn check(&self, volume: &Volume, engine: &Engine) -> Result<(), TestCaseError> {
        let found = engine
            .distance_field(&where_three(), &[volume], 1.0, &Never)
            .expect("distances");
        let (want, diagonal) = self.distances();
        let Some(found) = found else {
            prop_assert!(want[0].is_infinite(), "there are samples inside");
            return Ok(());
        };
        prop_assert_eq!(slab_count(&found), slab_count(volume));
        let got = engine.download(&found, 0..self.dims[2]).expect("download");
        prop_assert_eq!(got.len(), want.len());
        // Even axes: what a few operations round. Uneven ones: positions are rounded, too.
        let absolute = if self.lengths.is_some() { 1e-6 * diagonal } else { 0.0 };
        for (i, &want) in want.iter().enumerate() {
            let got = f64::from(got.get(i));
            let is_exact = want == 0.0 && got == 0.0;
            prop_assert!(
                is_exact || (want > 0.0 && (got - want).abs() <= 1e-6 * want + absolute),
                "{} at {}, expected {}",
                got,
                i,
                want
            );
        }
        Ok(())
    }
}

#[test]
fn distances_are_the_twins() {
    let Some(engine) = device() else { return };
    let dims = prop_oneof![
        proptest::sample::select(DIMS.to_vec()),
        [2..40u32, 2..40u32, 2..40u32],
        Just([2, 40, 2])
    ];
    let spacing = prop_oneof![
        Just([1.0f32; 3]),
        Just([1.0, 0.3, 7.0]),
        Just([2e-9, 1e-9, 1e-9]),
        Just([1e25; 3])
    ];
    let rarity = prop_oneof![Just(1u64), Just(2), Just(50), Just(2000), Just(u64::MAX)];
    proptest!(config(24), |(dims in dims, spacing in spacing, is_uneven in any::<bool>(), rarity in rarity, seed in any::<u64>())| {
        let labels = Labels::random(dims, spacing, is_uneven, rarity, seed);
        labels.check(&labels.load(&engine), &engine)?;
    });
}

/// One sample alone, in each corner and in the middle; and all of them.
#[test]
fn distances_to_one_sample_and_to_all() {
    let Some(engine) = device() else { return };
    let dims = [35, 6, 33];
    let count = 35 * 6 * 33;
    for is_uneven in [false, true] {
        let mut labels = Labels::random(dims, [0.5, 2.0, 1.0], is_uneven, u64::MAX, 7);
        for at in [0, 34, count - 35, count - 1, count / 2] {
            labels.values = vec![0; count];
            labels.values[at] = 3;
            labels
                .check(&labels.load(&engine), &engine)
                .expect("the twin's distances");
        }
        labels.values = vec![3; count];
        labels.check(&labels.load(&engine), &engine).expect("zeros");
        labels.values = vec![255; count];
        let missing = labels.load(&engine);
        let found = engine
            .distance_field(&where_three(), &[&missing], 1.0, &Never)
            .expect("no fault");
        assert!(found.is_none(), "missing samples are not inside");
    }
}

#[test]
fn distances_go_through_slabs() {
    let Some(mut engine) = device() else { return };
    for (seed, is_uneven, rarity) in [(1, false, 30_000), (2, true, 30_000), (3, false, 40), (4, true, 3)] {
        let labels = Labels::random([40, 35, 131], [1.0, 0.5, 0.25], is_uneven, rarity, seed);
        let before = limit_allocations(&mut engine, 40 * 35 * 4 * u64::from(LAYER_PLANES));
        let volume = labels.load(&engine);
        assert!(slab_count(&volume) > 3);
        labels.check(&volume, &engine).expect("the twin's distances");
        limit_allocations(&mut engine, before);
    }
}

/// These kernels have one work-item per column; those of a CPU process sixteen columns per work-item.
#[test]
fn kernels_of_a_gpu_have_the_twins_distances() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    for (seed, is_uneven, rarity) in [(1, false, 300), (2, true, 20)] {
        let mut labels = Labels::random([41, 35, 30], [1.0, 0.5, 0.25], is_uneven, rarity, seed);
        labels.values.iter_mut().for_each(|value| *value = (*value).min(4));
        labels
            .check(&labels.load(&of_gpu), &of_gpu)
            .expect("the twin's distances");
    }
}

#[test]
fn others_have_turns_and_what_is_given_up_leaves_no_memory() {
    let Some(engine) = device() else { return };
    let labels = Labels::random([40, 30, 20], [1.0; 3], false, 50, 7);
    let volume = labels.load(&engine);
    let in_use = || engine.memory().expect("the device's memory").in_use;
    let before = in_use();
    // The expression, the samples before and after along z, the lines along y and x.
    for given_up_at in 1..=5 {
        let others = Others {
            polls: Cell::new(0),
            given_up_at,
            work: &|| labels.check(&volume, &engine).expect("the twin's distances"),
        };
        let found = engine.distance_field(&where_three(), &[&volume], 1.0, &others);
        assert!(
            matches!(found, Err(Error::Cancelled)),
            "goes on after poll {given_up_at}"
        );
        assert_eq!(in_use(), before, "given up at poll {given_up_at}");
    }
}
