//! Types of HDF5's samples and attributes: numbers of the usual sizes and layouts.

use hdf5_reader::{ByteOrder, Datatype};

use super::super::super::stored::{Endian, StoredType};

/// Returns the type of a sample. `encoded`: the type's bytes in the file, which are more precise than the library's type.
pub fn stored_type(
    kind: &Datatype,
    encoded: impl FnOnce() -> hdf5_reader::error::Result<Vec<u8>>,
) -> Result<(StoredType, Endian), String> {
    // An enumeration is read as its numbers, without the names.
    let (kind, begin) = match kind {
        Datatype::Enum { base, .. } => (&**base, NUMBER_HEADER_BYTES),
        kind => (kind, 0),
    };
    let encoded = || -> Result<Vec<u8>, String> {
        let whole = encoded().map_err(|e| e.to_string())?;
        Ok(whole.get(begin..).unwrap_or_default().to_vec())
    };
    let (stored, order) = match kind {
        Datatype::FixedPoint {
            size,
            signed,
            byte_order,
        } => {
            let stored = match (size, signed) {
                (1, false) => StoredType::U8,
                (1, true) => StoredType::I8,
                (2, false) => StoredType::U16,
                (2, true) => StoredType::I16,
                (4, false) => StoredType::U32,
                (4, true) => StoredType::I32,
                (8, false) => StoredType::U64,
                (8, true) => StoredType::I64,
                _ => return Err(format!("integers of {size} bytes, expected 1, 2, 4 or 8")),
            };
            check_bits(&encoded()?, *size)?;
            (stored, byte_order)
        }
        Datatype::FloatingPoint { size, byte_order } => {
            let (stored, layout) = match size {
                2 => (StoredType::F16, &HALF),
                4 => (StoredType::F32, &SINGLE),
                8 => (StoredType::F64, &DOUBLE),
                _ => return Err(format!("floats of {size} bytes, expected 2, 4 or 8")),
            };
            check_float(&encoded()?, layout)?;
            (stored, byte_order)
        }
        other => {
            let name = match other {
                Datatype::Compound { .. } => "compound samples",
                Datatype::String { .. } | Datatype::VarLen { .. } => "text or lists",
                Datatype::Array { .. } => "arrays as samples",
                Datatype::Reference { .. } => "references",
                _ => "bits or opaque samples",
            };
            return Err(format!("{name}, expected one number a sample"));
        }
    };
    let endian = match order {
        ByteOrder::LittleEndian => Endian::Little,
        ByteOrder::BigEndian => Endian::Big,
    };
    Ok((stored, endian))
}

/// Header of a number's type in the file: class and version, 24 bits of flags, 4 bytes of size.
const NUMBER_HEADER_BYTES: usize = 8;

/// Second half of the type of an IEEE float: first bit and count of bits (2 bytes each), first bit and count of bits of the exponent (1
/// byte each), of the mantissa (1 byte each), and the exponent's bias (4 bytes).
type FloatLayout = [u8; 12];
const HALF: FloatLayout = [0, 0, 16, 0, 10, 5, 0, 10, 15, 0, 0, 0];
const SINGLE: FloatLayout = [0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0];
const DOUBLE: FloatLayout = [0, 0, 64, 0, 52, 11, 0, 52, 0xff, 3, 0, 0];

/// Checks that an integer uses all of its bits, or that it is unsigned and the bits above it are 0.
///
/// `encoded`: the type as in the file; its flags have byte order, padding below and above, sign, and the first bit and the count of bits follow.
fn check_bits(encoded: &[u8], bytes: u8) -> Result<(), String> {
    let [_, flags, _, _, _, _, _, _, a, b, c, d, ..] = *encoded else {
        return Err("a type that is cut off, expected integers".into());
    };
    let (first, count) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
    let is_whole = count == 8 * u16::from(bytes);
    let is_below_zeros = flags & 0b1100 == 0;
    if first == 0 && (is_whole || is_below_zeros) {
        return Ok(());
    }
    Err(format!(
        "integers of {count} bits from bit {first} of {bytes} bytes on, expected all bits, or those of an unsigned number from bit 0 on"
    ))
}

/// Checks that a float has the layout of IEEE 754. Others have the same width: bfloat16 has the exponent of a 32-bit float.
///
/// `encoded`: the type as in the file; its flags have byte order and how the mantissa is normalized, then the position of the sign bit.
fn check_float(encoded: &[u8], layout: &FloatLayout) -> Result<(), String> {
    let [_, flags, sign, _, _, _, _, _, properties @ ..] = encoded else {
        return Err("a type that is cut off, expected floats of IEEE 754".into());
    };
    let bits = layout[2];
    // The first bit of the mantissa is implied, as it is 1; the byte order is not that of a VAX.
    if flags & 0x70 == 0x20 && *sign == bits - 1 && properties.starts_with(layout) {
        return Ok(());
    }
    let [exponent, mantissa] = [5, 7].map(|at| properties.get(at).copied().unwrap_or(0));
    let [expected_exponent, expected_mantissa] = [layout[5], layout[7]];
    Err(format!(
        "floats in {bits} bits with an exponent of {exponent} bits and a mantissa of {mantissa}, expected those of IEEE 754 \
         ({expected_exponent} and {expected_mantissa}) with their bias and byte order"
    ))
}
