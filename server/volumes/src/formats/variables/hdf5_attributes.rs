//! Attributes of HDF5's datasets.

use std::cell::LazyCell;

use hdf5_reader::Datatype;

use super::super::super::scalar::numbers;
use super::super::super::stored::StoredType;
use super::file::{ATTRIBUTES, Attribute, Attributes};
use super::hdf5_types::stored_type;
use super::long_float::LongFloat;

/// Returns the attributes that are read, by [`ATTRIBUTES`]. `raw`: all attributes as they are in the file.
pub fn known_attributes(
    all: Vec<hdf5_reader::Attribute>,
    raw: impl FnOnce() -> hdf5_reader::error::Result<Vec<hdf5_reader::RawAttribute>>,
) -> Attributes {
    let known = all.into_iter().filter(|a| ATTRIBUTES.contains(&a.name.as_str()));
    // Attributes that cannot be read are skipped, whatever the reason.
    let raw = LazyCell::new(|| raw().unwrap_or_default());
    let encoded = |name: &str| {
        let named = raw.iter().find(|attribute| attribute.name() == name);
        let missing = || hdf5_reader::error::Error::AttributeNotFound(name.to_owned());
        named
            .map(|attribute| attribute.raw_datatype().to_vec())
            .ok_or_else(missing)
    };
    let read = known.filter_map(|a| Some((a.name.clone(), value(&a, || encoded(&a.name))?)));
    Attributes(read.collect())
}

/// Returns the value of an attribute; `encoded`: its type as in the file.
pub fn value(
    attribute: &hdf5_reader::Attribute,
    encoded: impl FnOnce() -> hdf5_reader::error::Result<Vec<u8>>,
) -> Option<Attribute> {
    if let Datatype::FloatingPoint {
        size: 10..=16,
        byte_order,
    } = &attribute.datatype
    {
        let kind = LongFloat::parse(&encoded().ok()?, *byte_order)?;
        let numbers = attribute
            .raw_data
            .chunks_exact(kind.bytes)
            .map(|bytes| kind.value(bytes));
        return Some(Attribute::Numbers(numbers.collect(), Some(StoredType::F64)));
    }
    if let Ok((stored, endian)) = stored_type(&attribute.datatype, encoded) {
        let numbers = numbers(&attribute.raw_data, stored, endian);
        return Some(Attribute::Numbers(numbers, Some(stored)));
    }
    match attribute.read_string() {
        Ok(text) if attribute.num_elements().is_ok_and(|count| count == 1) => Some(Attribute::Text(text)),
        _ => attribute.read_strings().ok().map(Attribute::Texts),
    }
}
