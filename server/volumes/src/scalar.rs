//! Types of stored samples, and those of the device's samples among them.

use half::f16;
use isopeel_kernels::Samples;

use super::stored::{Endian, StoredType};

/// Converts stored numbers of any type to doubles. Bytes behind the last whole number are left out.
pub(super) fn numbers(bytes: &[u8], stored: StoredType, endian: Endian) -> Vec<f64> {
    fn all<S: Scalar>(bytes: &[u8], endian: Endian) -> Vec<f64> {
        let stored = bytes
            .chunks_exact(size_of::<S>())
            .map(bytemuck::pod_read_unaligned::<S>);
        let value = |stored: S| if endian.is_native() { stored } else { stored.swapped() };
        stored.map(|stored| value(stored).to_f64()).collect()
    }
    match stored {
        StoredType::U8 => all::<u8>(bytes, endian),
        StoredType::I8 => all::<i8>(bytes, endian),
        StoredType::U16 => all::<u16>(bytes, endian),
        StoredType::I16 => all::<i16>(bytes, endian),
        StoredType::U32 => all::<u32>(bytes, endian),
        StoredType::I32 => all::<i32>(bytes, endian),
        StoredType::U64 => all::<u64>(bytes, endian),
        StoredType::I64 => all::<i64>(bytes, endian),
        StoredType::F16 => all::<f16>(bytes, endian),
        StoredType::F32 => all::<f32>(bytes, endian),
        StoredType::F64 => all::<f64>(bytes, endian),
    }
}

/// A type of stored samples.
pub(super) trait Scalar: bytemuck::Pod + Send + Sync {
    fn swapped(self) -> Self;
    fn to_f32(self) -> f32;
    fn to_f64(self) -> f64;
    fn parse(text: &str) -> Option<Self>;
    /// Whether a 32-bit float does not hold all numbers of this type.
    const IS_WIDE: bool;
    const IS_FLOAT: bool;
    /// Returns the number if it is a whole one.
    fn integer(self) -> Option<i128>;

    /// Whether the number is at least 2²⁴ or at most −2²⁴, beyond which 32-bit floats do not hold all whole numbers.
    fn is_large(self) -> bool {
        self.to_f64().abs() >= 16_777_216.0
    }
}

/// A type of samples on the device.
pub(super) trait DeviceScalar: Scalar {
    fn samples(values: Vec<Self>) -> Samples;
}

macro_rules! device_scalar {
    ($($t:ty: $variant:ident),*) => {$(
        impl DeviceScalar for $t {
            fn samples(values: Vec<Self>) -> Samples {
                Samples::$variant(values)
            }
        }
    )*};
}
device_scalar!(u8: U8, i8: I8, u16: U16, i16: I16, f32: F32);

macro_rules! scalar {
    ($($t:ty: $wide:literal $float:literal $integer:expr, $swap:expr);*) => {$(
        impl Scalar for $t {
            const IS_WIDE: bool = $wide;
            const IS_FLOAT: bool = $float;

            fn integer(self) -> Option<i128> {
                let integer: fn(Self) -> Option<i128> = $integer;
                integer(self)
            }
            fn swapped(self) -> Self {
                $swap(self)
            }
            fn to_f32(self) -> f32 {
                self as f32
            }
            fn to_f64(self) -> f64 {
                self as f64
            }
            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        }
    )*};
}
scalar!(
    u8: false false |v| Some(v.into()), u8::swap_bytes;
    i8: false false |v| Some(v.into()), i8::swap_bytes;
    u16: false false |v| Some(v.into()), u16::swap_bytes;
    i16: false false |v| Some(v.into()), i16::swap_bytes;
    u32: true false |v| Some(v.into()), u32::swap_bytes;
    i32: true false |v| Some(v.into()), i32::swap_bytes;
    u64: true false |v| Some(v.into()), u64::swap_bytes;
    i64: true false |v| Some(v.into()), i64::swap_bytes;
    f32: false true |v| whole(v.into()), |v: f32| f32::from_bits(v.to_bits().swap_bytes());
    f64: true true whole, |v: f64| f64::from_bits(v.to_bits().swap_bytes())
);

/// Converts a double that is a whole number, if doubles hold all whole numbers of that size.
fn whole(value: f64) -> Option<i128> {
    (value.fract() == 0.0 && value.abs() < 9.0e15).then_some(value as i128)
}

impl Scalar for f16 {
    const IS_WIDE: bool = false;
    const IS_FLOAT: bool = true;

    fn integer(self) -> Option<i128> {
        whole(self.to_f64())
    }

    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().swap_bytes())
    }
    fn to_f32(self) -> f32 {
        self.to_f32()
    }
    fn to_f64(self) -> f64 {
        self.to_f64()
    }
    fn parse(text: &str) -> Option<Self> {
        text.parse().ok()
    }
}
