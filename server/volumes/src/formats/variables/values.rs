//! Meaning of the samples of a variable, by the conventions of NetCDF and CF: scale and offset, missing values, unsigned bytes.

use half::f16;
use isopeel_kernels::SampleType;

use super::super::super::scalar::numbers;
use super::super::super::stored::{Endian, StoredType};
use super::file::Variable;

/// Converts stored samples to values.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// Type of the stored samples. Differs from the variable's type if the attribute `_Unsigned` changes the sign of its integers.
    pub stored: StoredType,
    /// Value = `scale[0]` · stored + `scale[1]`.
    pub scale: Option<[f64; 2]>,
    /// Stored values that mean "no sample here".
    pub holes: Vec<f64>,
    /// Range of valid stored values: those outside mean "no sample here", too.
    pub valid: Option<[f64; 2]>,
}

impl Values {
    /// Evaluates the attributes. `stored` is the variable's type.
    pub fn of(variable: &Variable, stored: StoredType) -> Result<Self, String> {
        let says = |what: &str| {
            variable
                .text("_Unsigned")
                .is_some_and(|text| text.eq_ignore_ascii_case(what))
        };
        let (unsigned, signed) = (says("true"), says("false"));
        let stored = match stored {
            StoredType::U8 if signed => StoredType::I8,
            StoredType::U16 if signed => StoredType::I16,
            StoredType::U32 if signed => StoredType::I32,
            StoredType::I8 if unsigned => StoredType::U8,
            StoredType::I16 if unsigned => StoredType::U16,
            StoredType::I32 if unsigned => StoredType::U32,
            other => other,
        };
        // Attributes are written in the variable's own type.
        let modulus = 2f64.powi(8 * stored.bytes() as i32);
        let as_stored = |value: &f64| match () {
            () if unsigned && *value < 0.0 => value + modulus,
            () if signed && *value >= 0.5 * modulus => value - modulus,
            () if stored == StoredType::F16 => f16::from_f64(*value).to_f64(),
            () if stored == StoredType::F32 => f64::from(*value as f32),
            () => *value,
        };
        let read = |name: &str| variable.numbers(name).iter().map(as_stored).collect::<Vec<f64>>();
        let mut holes = [read("_FillValue"), read("missing_value")].concat();
        if holes.is_empty() && variable.is_netcdf {
            holes.extend(default_fill(stored));
        }
        holes.retain(|&value| can_be(value, stored));
        holes.sort_by(f64::total_cmp);
        holes.dedup();
        let scale = scale(variable)?;
        let unpacked = variable.unpacked_bounds();
        let mut valid = [f64::NEG_INFINITY, f64::INFINITY];
        for (end, name) in ["valid_min", "valid_max"].into_iter().enumerate() {
            for (name, number) in [("valid_range", end), (name, 0)] {
                if unpacked.contains(&name)
                    && let Some(&bound) = variable.numbers(name).get(number)
                {
                    let (end, bound) = packed_bound(bound, end, scale.unwrap_or([1.0, 0.0]), stored);
                    valid[end] = bound;
                } else if let Some(&bound) = read(name).get(number) {
                    valid[end] = bound;
                }
            }
        }
        Ok(Self {
            stored,
            scale,
            holes,
            valid: Some(valid).filter(|&[min, max]| excludes(min, max, stored)),
        })
    }

    /// Whether samples have to become floats, in which NaN marks the missing ones.
    pub fn needs_nan(&self) -> bool {
        self.holes.len() > 1 || self.valid.is_some()
    }

    /// Returns the value of a missing sample, if a single value means that.
    pub fn missing(&self) -> Option<f32> {
        let hole = self.holes.first().filter(|_| !self.needs_nan())?;
        Some(match self.scale {
            Some([slope, offset]) => (slope * hole + offset) as f32,
            None => *hole as f32,
        })
    }

    /// Type of the samples on the device.
    pub fn sample_type(&self) -> SampleType {
        if self.scale.is_some() || self.needs_nan() {
            return SampleType::F32;
        }
        self.stored.on_device()
    }

    /// Returns the value of a stored sample. If [`Values::needs_nan`], NaN for a missing one.
    pub fn value(&self, stored: f64) -> f32 {
        let outside = |[min, max]: [f64; 2]| stored < min || stored > max;
        if self.needs_nan() && (self.holes.contains(&stored) || self.valid.is_some_and(outside)) {
            return f32::NAN;
        }
        match self.scale {
            Some([slope, offset]) => (slope * stored + offset) as f32,
            None => stored as f32,
        }
    }

    /// Returns the values of stored samples, as [`Values::value`].
    pub fn decode(&self, bytes: &[u8], endian: Endian) -> Vec<f32> {
        let stored = numbers(bytes, self.stored, endian).into_iter();
        stored.map(|stored| self.value(stored)).collect()
    }
}

fn scale(variable: &Variable) -> Result<Option<[f64; 2]>, String> {
    let scale = variable.packing();
    if scale[0] == 0.0 || scale.iter().any(|v| !v.is_finite()) {
        let [slope, offset] = scale;
        return Err(format!(
            "scale_factor {slope} and add_offset {offset}, expected finite numbers and a factor other than 0"
        ));
    }
    Ok(Some(scale).filter(|scale| *scale != [1.0, 0.0]))
}

/// Converts an unpacked bound to a stored number. Returns the end of the stored range, 0 or 1, at which it is, and the number. A stored
/// number whose value is the bound up to rounding is valid.
fn packed_bound(bound: f64, end: usize, [slope, offset]: [f64; 2], stored: StoredType) -> (usize, f64) {
    let end = if slope < 0.0 { 1 - end } else { end };
    let rounding = f64::from(f32::EPSILON) * (bound.abs() + offset.abs()) / slope.abs();
    let outwards = rounding.min(0.25) * if end == 0 { -1.0 } else { 1.0 };
    let bound = (bound - offset) / slope + outwards;
    let bound = match end {
        _ if !stored.is_whole() => bound,
        0 => bound.ceil(),
        _ => bound.floor(),
    };
    (end, bound)
}

/// Lowest and highest value of an integer type.
fn limits(stored: StoredType) -> Option<[f64; 2]> {
    let bits = 8 * stored.bytes() as i32;
    match stored {
        StoredType::U8 | StoredType::U16 | StoredType::U32 | StoredType::U64 => Some([0.0, 2f64.powi(bits) - 1.0]),
        StoredType::I8 | StoredType::I16 | StoredType::I32 | StoredType::I64 => {
            let half = 2f64.powi(bits - 1);
            Some([-half, half - 1.0])
        }
        StoredType::F16 | StoredType::F32 | StoredType::F64 => None,
    }
}

/// Whether a stored sample may have that value. NaN is missing in any case.
fn can_be(value: f64, stored: StoredType) -> bool {
    let in_limits = |[min, max]: [f64; 2]| (min..=max).contains(&value) && value.fract() == 0.0;
    !value.is_nan() && limits(stored).is_none_or(in_limits)
}

/// Whether a range excludes any value of the type.
fn excludes(min: f64, max: f64, stored: StoredType) -> bool {
    let [lowest, highest] = limits(stored).unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    min > lowest || max < highest
}

/// Returns the value that NetCDF stores for samples that were never written. None for single bytes: all of their values may be data.
fn default_fill(stored: StoredType) -> Option<f64> {
    Some(match stored {
        StoredType::U8 | StoredType::I8 => return None,
        StoredType::I16 => -32767.0,
        StoredType::U16 => 65535.0,
        StoredType::I32 => -2_147_483_647.0,
        StoredType::U32 => 4_294_967_295.0,
        StoredType::I64 => -9_223_372_036_854_775_806.0,
        StoredType::U64 => 18_446_744_073_709_551_614.0,
        // The fill value is too large for a half float.
        StoredType::F16 => return None,
        StoredType::F32 | StoredType::F64 => f64::from(9.969_21e36_f32),
    })
}

#[cfg(test)]
mod tests {
    use super::super::file::{Attribute, Attributes};
    use super::*;

    fn variable(attributes: &[(&str, &[f64])]) -> Variable {
        let numbers =
            |(name, numbers): &(&str, &[f64])| ((*name).to_owned(), Attribute::Numbers(numbers.to_vec(), None));
        Variable {
            path: "/v".into(),
            axes: Vec::new(),
            stored: Ok(StoredType::I16),
            endian: Endian::Little,
            attributes: Attributes(attributes.iter().map(numbers).collect()),
            chunk: None,
            plain: None,
            is_scale: false,
            is_netcdf: true,
        }
    }

    #[test]
    fn one_missing_value_is_scaled_as_samples_are() {
        let packed = variable(&[
            ("_FillValue", &[-999.0]),
            ("missing_value", &[-999.0]),
            ("scale_factor", &[0.1]),
            ("add_offset", &[20.0]),
        ]);
        let values = Values::of(&packed, StoredType::I16).unwrap();
        assert!(!values.needs_nan());
        assert_eq!(values.missing(), Some((0.1f64 * -999.0 + 20.0) as f32));
    }

    #[test]
    fn several_missing_values_and_ranges_become_nan() {
        let holed = variable(&[
            ("_FillValue", &[7.0]),
            ("missing_value", &[8.0]),
            ("valid_max", &[50.0]),
        ]);
        let values = Values::of(&holed, StoredType::U8).unwrap();
        assert_eq!((values.needs_nan(), values.missing()), (true, None));
        let decoded = values.decode(&[6, 7, 8, 9, 50, 51], Endian::Little);
        let found: Vec<Option<f32>> = decoded.into_iter().map(|v| Some(v).filter(|v| !v.is_nan())).collect();
        assert_eq!(found, [Some(6.0), None, None, Some(9.0), Some(50.0), None]);
    }

    #[test]
    fn what_the_type_cannot_hold_is_no_missing_value() {
        let never = variable(&[
            ("_FillValue", &[-1e34, 0.5, f64::NAN]),
            ("valid_range", &[-32768.0, 32767.0]),
        ]);
        let values = Values::of(&never, StoredType::I16).unwrap();
        assert_eq!((values.holes.as_slice(), values.valid), (&[][..], None));
    }

    #[test]
    fn bytes_without_a_sign() {
        let mut unsigned = variable(&[("_FillValue", &[-1.0]), ("valid_range", &[0.0, -2.0])]);
        let text = Attribute::Text("true".into());
        unsigned.attributes.set("_Unsigned", text);
        let values = Values::of(&unsigned, StoredType::I8).unwrap();
        assert_eq!(
            (values.stored, values.holes, values.valid),
            (StoredType::U8, vec![255.0], Some([0.0, 254.0]))
        );
    }

    #[test]
    fn unwritten_samples_of_netcdf_are_missing() {
        let plain = variable(&[]);
        assert_eq!(Values::of(&plain, StoredType::I16).unwrap().missing(), Some(-32767.0));
        assert_eq!(Values::of(&plain, StoredType::U8).unwrap().missing(), None);
    }

    /// Stored numbers of 16 bits that are valid, by attributes with types.
    fn valid(attributes: &[(&str, &[f64], StoredType)]) -> (Option<[f64; 2]>, Vec<String>) {
        let mut packed = variable(&[]);
        for &(name, numbers, stored) in attributes {
            let value = Attribute::Numbers(numbers.to_vec(), Some(stored));
            packed.attributes.set(name, value);
        }
        let values = Values::of(&packed, StoredType::I16).unwrap();
        (values.valid, packed.notices())
    }

    #[test]
    fn bounds_in_the_type_of_the_scale_are_unpacked() {
        use StoredType::{F32, F64, I16, I32};
        let scale = |stored| ("scale_factor", &[0.1][..], stored);
        let offset = |stored| ("add_offset", &[20.0][..], stored);
        let range = |stored| ("valid_range", &[15.0, 50.0][..], stored);
        let (unpacked, notices) = valid(&[scale(F64), offset(F64), range(F64)]);
        assert_eq!(unpacked, Some([-50.0, 300.0]));
        assert_eq!(notices.len(), 1, "{notices:?}");
        // Of scale and offset the wider type counts.
        assert_eq!(valid(&[scale(F32), offset(F64), range(F64)]).0, Some([-50.0, 300.0]));
        let packed = (Some([15.0, 50.0]), Vec::new());
        for stored in [I16, F32] {
            assert_eq!(valid(&[scale(F64), offset(F64), range(stored)]), packed, "{stored:?}");
        }
        assert_eq!(valid(&[range(F64)]), packed);
        // Of whole numbers the wider ones, too.
        let (unpacked, _) = valid(&[("scale_factor", &[10.0], I32), ("valid_max", &[99.0], I32)]);
        assert_eq!(unpacked, Some([f64::NEG_INFINITY, 9.0]));
    }

    #[test]
    fn unpacked_bounds_change_their_ends_with_a_negative_scale() {
        let scale = ("scale_factor", &[-0.5][..], StoredType::F32);
        let only = |name| valid(&[scale, (name, &[10.0], StoredType::F32)]).0;
        assert_eq!(only("valid_min"), Some([f64::NEG_INFINITY, -20.0]));
        assert_eq!(only("valid_max"), Some([-20.0, f64::INFINITY]));
    }

    #[test]
    fn a_value_at_an_unpacked_bound_is_valid() {
        // In single precision 0.1 is a little more.
        let single = f64::from(0.1f32);
        for (scale, stored) in [(single, StoredType::F32), (0.1, StoredType::F64)] {
            let attributes = [
                ("scale_factor", &[scale][..], stored),
                ("valid_range", &[0.3, 50.0], stored),
            ];
            assert_eq!(valid(&attributes).0, Some([3.0, 500.0]));
        }
    }

    #[test]
    fn a_factor_of_zero_is_refused() {
        assert!(Values::of(&variable(&[("scale_factor", &[0.0])]), StoredType::I16).is_err());
    }
}
