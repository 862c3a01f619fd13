//! Filters of numcodecs: they change the bytes of samples so that these are compressed better, and keep their number.

use serde_json::Value;

use crate::formats::blosc::unshuffled_bytes;
use crate::formats::npy::parse_descr;
use crate::scalar::Scalar;
use crate::stored::{Endian, StoredType};

/// Maximum bytes of a sample that are shuffled.
const MAX_WIDTH: u64 = 64;

/// A filter that has to be undone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    /// The first bytes of all samples, then the second ones, and so on, of samples with this many bytes.
    Shuffle(usize),
    /// The first sample, then differences of neighbours.
    Delta(StoredType, Endian),
}

impl Filter {
    /// Parses the configuration of a filter; `None` for one that loses digits as it writes and has nothing to undo. `own`: the type of the
    /// array, which the filter must not change.
    pub(super) fn parse(
        id: &str,
        configuration: &Value,
        own: Option<(StoredType, Endian)>,
    ) -> Result<Option<Self>, String> {
        let own = own.filter(|own| {
            let keeps = |name: &str| match configuration.get(name) {
                None | Some(Value::Null) => true,
                Some(value) => value
                    .as_str()
                    .and_then(parse_descr)
                    .is_some_and(|(order, stored)| stored == own.0 && (stored.bytes() == 1 || order == Some(own.1))),
            };
            keeps("dtype") && keeps("astype")
        });
        match (id.strip_prefix("numcodecs.").unwrap_or(id), own) {
            ("shuffle", _) => match configuration.get("elementsize").map_or(Some(4), Value::as_u64) {
                Some(width @ 1..=MAX_WIDTH) => Ok(Some(Self::Shuffle(width as usize))),
                _ => Err(format!(
                    "shuffle {configuration}, expected an elementsize of 1 to {MAX_WIDTH}"
                )),
            },
            ("bitround", _) | ("quantize", Some(_)) => Ok(None),
            ("delta", Some((stored, endian))) if stored != StoredType::F16 => Ok(Some(Self::Delta(stored, endian))),
            ("delta" | "quantize", _) => Err(format!(
                "filter {id:?} {configuration}, expected one that keeps the array's type"
            )),
            _ => Err(format!("filter {id:?}, expected bitround, quantize, shuffle or delta")),
        }
    }

    /// Undoes the filter.
    pub(super) fn undo(self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let width = match self {
            Self::Shuffle(width) => width,
            Self::Delta(stored, _) => stored.bytes() as usize,
        };
        if !bytes.len().is_multiple_of(width) {
            return Err(format!("{} bytes, expected samples of {width}", bytes.len()));
        }
        Ok(match self {
            Self::Shuffle(width) => unshuffled_bytes(bytes, width),
            Self::Delta(stored, endian) => match stored {
                StoredType::U8 | StoredType::I8 => sums(bytes, endian, u8::wrapping_add),
                StoredType::U16 | StoredType::I16 | StoredType::F16 => sums(bytes, endian, u16::wrapping_add),
                StoredType::U32 | StoredType::I32 => sums(bytes, endian, u32::wrapping_add),
                StoredType::U64 | StoredType::I64 => sums(bytes, endian, u64::wrapping_add),
                StoredType::F32 => sums(bytes, endian, |a: f32, b| a + b),
                StoredType::F64 => sums(bytes, endian, |a: f64, b| a + b),
            },
        })
    }
}

/// Returns the samples whose differences are stored.
fn sums<T: Scalar>(bytes: &[u8], endian: Endian, add: impl Fn(T, T) -> T) -> Vec<u8> {
    let native = |sample: T| if endian.is_native() { sample } else { sample.swapped() };
    let mut plain = Vec::with_capacity(bytes.len());
    let mut sum: Option<T> = None;
    for difference in bytes.chunks_exact(size_of::<T>()) {
        let difference = native(bytemuck::pod_read_unaligned(difference));
        let sample = sum.map_or(difference, |sum| add(sum, difference));
        plain.extend_from_slice(bytemuck::bytes_of(&native(sample)));
        sum = Some(sample);
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filter(id: &str, configuration: &str) -> Result<Option<Filter>, String> {
        let own = Some((StoredType::I16, Endian::Big));
        Filter::parse(id, &serde_json::from_str(configuration).expect("JSON"), own)
    }

    #[test]
    fn differences_are_summed_and_wrap() {
        let delta = filter("delta", r#"{"dtype": ">i2", "astype": ">i2"}"#)
            .unwrap()
            .unwrap();
        let stored = [7, -10, 32767, 4].map(i16::to_be_bytes).concat();
        let plain = [7, -3, 32764, -32768].map(i16::to_be_bytes).concat();
        assert_eq!(delta.undo(&stored), Ok(plain));
        assert!(delta.undo(&stored[1..]).is_err());
    }

    #[test]
    fn bytes_are_put_side_by_side_again() {
        let shuffle = filter("numcodecs.shuffle", r#"{"elementsize": 2}"#).unwrap().unwrap();
        assert_eq!(shuffle.undo(&[1, 2, 3, 4, 5, 6]), Ok(vec![1, 4, 2, 5, 3, 6]));
        assert_eq!(shuffle.undo(&[]), Ok(Vec::new()));
        assert!(shuffle.undo(&[1]).is_err());
    }

    #[test]
    fn filters_that_change_the_type_are_refused() {
        assert_eq!(filter("bitround", r#"{"keepbits": 3}"#), Ok(None));
        assert_eq!(filter("quantize", r#"{"digits": 1, "dtype": ">i2"}"#), Ok(None));
        for (id, configuration) in [
            ("quantize", r#"{"dtype": ">i2", "astype": "<i2"}"#),
            ("delta", r#"{"dtype": ">i4", "astype": ">i2"}"#),
            ("delta", r#"{"dtype": 7}"#),
            ("fixedscaleoffset", "{}"),
            ("shuffle", r#"{"elementsize": 0}"#),
            ("shuffle", r#"{"elementsize": -1}"#),
        ] {
            assert!(filter(id, configuration).is_err(), "{id} {configuration}");
        }
    }
}
