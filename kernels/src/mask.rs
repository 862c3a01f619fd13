//! Masks: a sample of a field is missing if the field of labels has another value than the selected ones there.

use crate::{SampleType, Samples};

/// A set of numbers: those in some ranges, or those in none of them.
#[derive(Clone, Debug, PartialEq)]
pub struct ValueSet {
    /// Minimum and maximum of each range, both included.
    pub ranges: Vec<[f32; 2]>,
    /// Whether the set holds the numbers outside of all ranges.
    pub is_complement: bool,
}

impl ValueSet {
    /// Whether a value is in the set. NaN is in none.
    pub fn holds(&self, value: f32) -> bool {
        let is_in = self.ranges.iter().any(|&[low, high]| low <= value && value <= high);
        !value.is_nan() && is_in != self.is_complement
    }
}

impl Samples {
    /// Returns the samples with those outside a mask missing, and the value of missing samples. That value is `missing` if given, otherwise
    /// NaN for floats, or for integers a value that no sample has; the type is widened if it has no such value. `is_inside` takes a
    /// sample's index.
    pub fn masked(self, missing: Option<f32>, is_inside: impl Fn(usize) -> bool) -> (Self, Option<f32>) {
        let (samples, missing) = match missing {
            Some(value) => (self, value),
            None => {
                let values = || (0..self.len()).map(|i| self.get(i));
                let extent = [
                    values().fold(f32::INFINITY, f32::min),
                    values().fold(f32::NEG_INFINITY, f32::max),
                ];
                let (sample_type, value) = self.sample_type().with_free_value(extent);
                (self.widened(sample_type), value)
            }
        };
        // Each cast is exact: the type holds the value.
        let masked = match samples {
            Self::U8(v) => Self::U8(masked(v, missing as u8, is_inside)),
            Self::I8(v) => Self::I8(masked(v, missing as i8, is_inside)),
            Self::U16(v) => Self::U16(masked(v, missing as u16, is_inside)),
            Self::I16(v) => Self::I16(masked(v, missing as i16, is_inside)),
            Self::F32(v) => Self::F32(masked(v, missing, is_inside)),
        };
        (masked, Some(missing).filter(|value| !value.is_nan()))
    }

    /// The samples in their own type or one that [`SampleType::with_free_value`] widened it to.
    fn widened(self, sample_type: SampleType) -> Self {
        match (self, sample_type) {
            (Self::U8(v), SampleType::I16) => Self::I16(v.into_iter().map(Into::into).collect()),
            (Self::I8(v), SampleType::I16) => Self::I16(v.into_iter().map(Into::into).collect()),
            (narrow @ (Self::U16(_) | Self::I16(_)), SampleType::F32) => {
                Self::F32((0..narrow.len()).map(|i| narrow.get(i)).collect())
            }
            (own, _) => own,
        }
    }
}

impl SampleType {
    /// Returns a type that can hold all samples of this type and one free value, and that value: NaN, or an integer next to the samples'
    /// range. `extent`: minimum and maximum of the samples.
    pub(crate) fn with_free_value(self, [low, high]: [f32; 2]) -> (Self, f32) {
        let ends = match self {
            Self::U8 => [0.0, f32::from(u8::MAX)],
            Self::I8 => [f32::from(i8::MIN), f32::from(i8::MAX)],
            Self::U16 => [0.0, f32::from(u16::MAX)],
            Self::I16 => [f32::from(i16::MIN), f32::from(i16::MAX)],
            Self::F32 => return (self, f32::NAN),
        };
        let free = [low - 1.0, high + 1.0].into_iter();
        if let Some(value) = free.into_iter().find(|value| (ends[0]..=ends[1]).contains(value)) {
            return (self, value);
        }
        match self {
            Self::U8 => (Self::I16, -1.0),
            Self::I8 => (Self::I16, -129.0),
            _ => (Self::F32, f32::NAN),
        }
    }
}

/// Replaces the samples outside by `value`.
fn masked<T: Copy>(mut samples: Vec<T>, value: T, is_inside: impl Fn(usize) -> bool) -> Vec<T> {
    for (i, sample) in samples.iter_mut().enumerate() {
        if !is_inside(i) {
            *sample = value;
        }
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::{SampleType, Samples, ValueSet};

    #[test]
    fn sets_have_their_ends_and_no_nan() {
        let inside = ValueSet {
            ranges: vec![[1.0, 1.0], [3.0, f32::INFINITY]],
            is_complement: false,
        };
        let outside = ValueSet {
            is_complement: true,
            ..inside.clone()
        };
        for (value, is_in) in [
            (1.0, true),
            (2.0, false),
            (3.0, true),
            (f32::INFINITY, true),
            (-0.0, false),
        ] {
            assert_eq!((inside.holds(value), outside.holds(value)), (is_in, !is_in), "{value}");
        }
        assert!(!inside.holds(f32::NAN) && !outside.holds(f32::NAN));
    }

    #[test]
    fn what_is_outside_a_mask_is_missing() {
        let mask = |samples: Samples, missing| {
            let (masked, missing) = samples.masked(missing, |i| i == 1);
            (masked.sample_type(), masked.get(0), masked.get(1), missing)
        };
        assert_eq!(
            mask(Samples::U8(vec![7, 9]), None),
            (SampleType::U8, 6.0, 9.0, Some(6.0))
        );
        assert_eq!(
            mask(Samples::U8(vec![0, 9]), None),
            (SampleType::U8, 10.0, 9.0, Some(10.0))
        );
        assert_eq!(
            mask(Samples::U8(vec![0, 255]), None),
            (SampleType::I16, -1.0, 255.0, Some(-1.0))
        );
        assert_eq!(
            mask(Samples::I8(vec![-128, 127]), None),
            (SampleType::I16, -129.0, 127.0, Some(-129.0))
        );
        assert_eq!(
            mask(Samples::I16(vec![3, 5]), Some(-9.0)),
            (SampleType::I16, -9.0, 5.0, Some(-9.0))
        );
        for wide in [
            Samples::U16(vec![0, 65535]),
            Samples::I16(vec![-32768, 32767]),
            Samples::F32(vec![2.0, 5.0]),
        ] {
            let kept = wide.get(1);
            let (masked, missing) = wide.masked(None, |i| i == 1);
            assert!(
                matches!(masked, Samples::F32(_))
                    && masked.get(0).is_nan()
                    && masked.get(1) == kept
                    && missing.is_none()
            );
        }
    }
}
