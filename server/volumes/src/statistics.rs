//! Range and histogram of a field, on the host.

use std::ops::Range;

use isopeel_kernels::Samples;
use rayon::prelude::*;

/// Bins of a histogram.
pub const BINS: usize = 256;
/// Samples of a task.
const CHUNK: usize = 1 << 20;

/// Statistics of the samples of one time step.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldStatistics {
    /// Minimum and maximum of the finite values that are not missing; `None` if there are none.
    pub range: Option<[f32; 2]>,
    /// Samples in 256 equal bins over the range, the last one closed; all 0 if there is no range.
    pub bins: Vec<u64>,
    /// Finite samples that are not missing: the sum of `bins`.
    pub counted: u64,
    /// Samples equal to the missing value.
    pub missing: u64,
    /// NaN and infinite samples.
    pub not_finite: u64,
}

impl FieldStatistics {
    /// Counts samples; those equal to `missing` are left out of range and histogram.
    pub fn of(samples: &Samples, missing: Option<f32>) -> Self {
        match samples {
            Samples::U8(v) => Self::of_integers(v, 0, missing),
            Samples::I8(v) => Self::of_integers(v, i32::from(i8::MIN), missing),
            Samples::U16(v) => Self::of_integers(v, 0, missing),
            Samples::I16(v) => Self::of_integers(v, i32::from(i16::MIN), missing),
            Samples::F32(v) => Self::of_floats(v, missing),
        }
    }

    /// One pass that counts each possible value, at most 65536 from `min` on.
    fn of_integers<T: Copy + Into<i32> + Sync>(samples: &[T], min: i32, missing: Option<f32>) -> Self {
        let values = 1usize << (8 * size_of::<T>());
        let counts = counted(samples.len(), values, &|range, counts| {
            samples[range]
                .iter()
                .for_each(|&v| counts[(v.into() - min) as usize] += 1);
        });
        let mut counted = counts
            .into_iter()
            .zip(min..)
            .map(|(n, value)| (value as f32, n))
            .collect::<Vec<_>>();
        let mut absent = 0;
        for (value, n) in &mut counted {
            if Some(*value) == missing {
                absent += std::mem::take(n);
            }
        }
        let mut present = counted.iter().filter(|(_, n)| *n > 0);
        let first = present.next();
        let range = first.map(|first| [first.0, present.next_back().unwrap_or(first).0]);
        let mut bins = vec![0; BINS];
        if let Some(range) = range {
            counted
                .iter()
                .filter(|(_, n)| *n > 0)
                .for_each(|(value, n)| bins[bin(*value, range)] += n);
        }
        Self::new(range, bins, absent, 0)
    }

    fn of_floats(samples: &[f32], missing: Option<f32>) -> Self {
        let counts = |v: f32| v.is_finite() && Some(v) != missing;
        let (low, high) = samples
            .par_chunks(CHUNK)
            .map(|chunk| {
                let values = chunk.iter().copied().filter(|&v| counts(v));
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| {
                    (low.min(v), high.max(v))
                })
            })
            .reduce(
                || (f32::INFINITY, f32::NEG_INFINITY),
                |a, b| (a.0.min(b.0), a.1.max(b.1)),
            );
        let range = (low <= high).then_some([low, high]);
        let (bins, absent, not_finite) = samples
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut bins = vec![0u64; BINS];
                let (mut absent, mut not_finite) = (0u64, 0u64);
                for &v in chunk {
                    match range {
                        _ if Some(v) == missing => absent += 1,
                        Some(range) if v.is_finite() => bins[bin(v, range)] += 1,
                        _ => not_finite += 1,
                    }
                }
                (bins, absent, not_finite)
            })
            .reduce(|| (vec![0; BINS], 0, 0), |a, b| (add(a.0, b.0), a.1 + b.1, a.2 + b.2));
        Self::new(range, bins, absent, not_finite)
    }

    fn new(range: Option<[f32; 2]>, bins: Vec<u64>, missing: u64, not_finite: u64) -> Self {
        Self {
            range,
            counted: bins.iter().sum(),
            bins,
            missing,
            not_finite,
        }
    }
}

/// Counts `samples` samples of integers with `values` possible values. `count` adds the samples of a range to the counts of the values.
fn counted(samples: usize, values: usize, count: &(dyn Fn(Range<usize>, &mut [u64]) + Sync)) -> Vec<u64> {
    let chunks = (0..samples.div_ceil(CHUNK)).into_par_iter().map(|chunk| {
        let mut counts = vec![0; values];
        count(chunk * CHUNK..samples.min((chunk + 1) * CHUNK), &mut counts);
        counts
    });
    chunks.reduce(|| vec![0; values], add)
}

fn add(mut a: Vec<u64>, b: Vec<u64>) -> Vec<u64> {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    a
}

/// Bin of a value in the range. In double precision, in which the width of every range of floats is finite.
fn bin(value: f32, [low, high]: [f32; 2]) -> usize {
    let width = f64::from(high) - f64::from(low);
    if width == 0.0 {
        return 0;
    }
    let position = (f64::from(value) - f64::from(low)) / width * BINS as f64;
    (position as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_and_floats_agree() {
        let values: Vec<i16> = (0..5000).map(|i: i32| (i * 7919 % 4001 - 1000) as i16).collect();
        let floats: Vec<f32> = values.iter().map(|&v| f32::from(v)).collect();
        for missing in [None, Some(-1000.0), Some(17.0), Some(0.5)] {
            let a = FieldStatistics::of(&Samples::I16(values.clone()), missing);
            let b = FieldStatistics::of(&Samples::F32(floats.clone()), missing);
            assert_eq!(a, b, "{missing:?}");
            assert_eq!(a.counted + a.missing, 5000);
        }
    }

    #[test]
    fn extremes_fill_the_first_and_last_bin() {
        let s = FieldStatistics::of(&Samples::I16(vec![i16::MIN, i16::MAX]), None);
        assert_eq!((s.range, s.bins[0], s.bins[255]), (Some([-32768.0, 32767.0]), 1, 1));
        let s = FieldStatistics::of(&Samples::F32(vec![f32::MIN, f32::MAX, 0.0]), None);
        assert_eq!((s.bins[0], s.bins[128], s.bins[255]), (1, 1, 1));
        let s = FieldStatistics::of(&Samples::U8(vec![7; 9]), None);
        assert_eq!((s.range, s.bins[0]), (Some([7.0, 7.0]), 9));
    }

    #[test]
    fn what_is_no_value_is_not_counted() {
        let s = FieldStatistics::of(&Samples::F32(vec![f32::NAN, f32::INFINITY, -9.0, 1.0, 3.0]), Some(-9.0));
        assert_eq!(
            (s.range, s.counted, s.missing, s.not_finite),
            (Some([1.0, 3.0]), 2, 1, 2)
        );
        let s = FieldStatistics::of(&Samples::F32(vec![f32::NAN; 4]), None);
        assert_eq!((s.range, s.counted, s.not_finite), (None, 0, 4));
        let s = FieldStatistics::of(&Samples::U16(vec![5; 4]), Some(5.0));
        assert_eq!((s.range, s.counted, s.missing), (None, 0, 4));
    }
}
