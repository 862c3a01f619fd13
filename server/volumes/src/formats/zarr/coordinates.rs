//! Arrays whose dimensions have names, as xarray writes them: an array in the same group with the name of a dimension has the positions
//! along it. The conventions are those of NetCDF, see `variables::axes` and `variables::values`.

use std::ops::Range;
use std::sync::Arc;

use serde_json::Value;

use super::super::store::{Store, join, never};
use super::metadata::{Array, Node, node};
use crate::formats::variables::file::{ATTRIBUTES, Attribute, Attributes, Axis, AxisLabel, Variable, VariableFile};
use crate::remote::Part;
use crate::stored::StoredType;

/// Maximum bytes of a decoded chunk of positions.
const MAX_CHUNK_BYTES: u64 = 64 << 20;

/// Provides the arrays of a group as variables.
pub(super) struct Variables {
    pub(super) store: Arc<Store>,
    /// Path of the group.
    pub(super) group: String,
}

impl Variables {
    /// Returns the variables of the group that contains an array.
    pub(super) fn beside(store: &Arc<Store>, path: &str) -> Self {
        Self {
            store: Arc::clone(store),
            group: path.rsplit_once('/').map_or("", |(group, _)| group).to_owned(),
        }
    }

    /// Describes an array as a variable.
    pub(super) fn describe(&self, path: &str, array: &Array) -> Variable {
        let name = path.rsplit('/').next().unwrap_or_default();
        let is_scale = array.shape.len() == 1 && array.names.first().is_some_and(|own| own == name);
        let axis = |(axis, &size): (usize, &u64)| {
            let named = array.names.get(axis).filter(|own| !own.is_empty());
            Axis {
                dimension: named.cloned(),
                scale: named.filter(|_| !is_scale).map(|own| join(&self.group, own)),
                label: AxisLabel::default(),
                size,
                is_unlimited: false,
            }
        };
        Variable {
            path: path.to_owned(),
            axes: array.shape.iter().enumerate().map(axis).collect(),
            stored: Ok(array.stored),
            endian: array.pipeline.endian,
            attributes: attributes(array),
            chunk: None,
            plain: None,
            is_scale,
            is_netcdf: false,
        }
    }

    fn array(&self, path: &str) -> Result<Array, String> {
        match node(&self.store, path) {
            Ok(Some(Node::Array(array))) => Ok(*array),
            Ok(_) => Err("no array there".to_owned()),
            Err(error) => Err(error.why),
        }
    }

    /// Reads all bytes of an array with one axis.
    fn line(&self, path: &str, array: &Array) -> Result<Vec<u8>, String> {
        let (size, chunk, width) = (array.shape[0], array.chunks[0], array.stored.bytes());
        if array.pipeline.shard.is_some() || chunk * width > MAX_CHUNK_BYTES {
            return Err(format!("in shards, or in chunks of {chunk}, expected smaller ones"));
        }
        let mut bytes = Vec::new();
        for first in (0..size).step_by(chunk as usize) {
            let key = join(path, &array.key(&[first / chunk]));
            let wanted = ((size - first).min(chunk) * width) as usize;
            // A chunk with more bytes than this is invalid.
            let limit = 2 * chunk * width + (1 << 16);
            let object = self.store.read(&key, Part::Whole, limit, &never);
            let Some(object) = object.map_err(|error| error.why)? else {
                return Err(format!("chunk {key} is not stored"));
            };
            let decoded = array.pipeline.decode(object.bytes, (chunk * width) as usize)?;
            bytes.extend_from_slice(decoded.get(..wanted).unwrap_or(&decoded));
        }
        Ok(bytes)
    }
}

impl VariableFile for Variables {
    fn variables(&self) -> Vec<Variable> {
        let names = self.store.folders(&self.group).unwrap_or_default();
        let paths = names.iter().map(|name| join(&self.group, name));
        paths.filter_map(|path| self.variable(&path).ok()).collect()
    }

    fn variable(&self, path: &str) -> Result<Variable, String> {
        Ok(self.describe(path, &self.array(path)?))
    }

    fn read(&self, variable: &Variable, _: &[Range<u64>]) -> Result<Vec<u8>, String> {
        let array = self.array(&variable.path)?;
        if array.shape.len() != 1 {
            return Err(format!("{} axes, expected one", array.shape.len()));
        }
        self.line(&variable.path, &array)
    }
}

/// Returns the attributes that give the meaning of samples.
fn attributes(array: &Array) -> Attributes {
    let value = |name: &str| {
        let found = array.attributes.get(name).unwrap_or(&Value::Null);
        match (name, found) {
            // In version 2 it is a property of the array, not an attribute.
            ("_FillValue", Value::Null) => array.missing.map(|value| Attribute::Numbers(vec![value], None)),
            ("_FillValue", Value::String(text)) => Some(match packed_number(text, array.stored) {
                Some(value) => Attribute::Numbers(vec![value], None),
                None => Attribute::Text(text.clone()),
            }),
            (_, Value::String(text)) => Some(Attribute::Text(text.clone())),
            (_, Value::Array(list)) => list_of(list),
            (_, value) => value
                .as_f64()
                .map(|number| Attribute::Numbers(vec![number], type_of(value))),
        }
    };
    let named = ATTRIBUTES.iter().map(|&name| (name.to_owned(), value(name)));
    Attributes(named.filter_map(|(name, value)| Some((name, value?))).collect())
}

/// Returns the type of a number that is written with a decimal point or an exponent; whole numbers may be of any type.
fn type_of(number: &Value) -> Option<StoredType> {
    number.is_f64().then_some(StoredType::F64)
}

/// Converts a list of numbers or of texts.
fn list_of(list: &[Value]) -> Option<Attribute> {
    let numbers: Option<Vec<f64>> = list.iter().map(Value::as_f64).collect();
    if let Some(numbers) = numbers {
        return Some(Attribute::Numbers(numbers, list.iter().find_map(type_of)));
    }
    let texts: Option<Vec<String>> = list.iter().map(|value| value.as_str().map(str::to_owned)).collect();
    texts.map(Attribute::Texts)
}

/// Parses a floating-point number in JSON as xarray writes it: the eight bytes of a double, little-endian, in base64; or its name.
fn packed_number(text: &str, stored: StoredType) -> Option<f64> {
    use base64::Engine;
    let is_float = !stored.is_whole();
    let bytes = base64::engine::general_purpose::STANDARD.decode(text).ok();
    match bytes.as_deref().and_then(|bytes| <[u8; 8]>::try_from(bytes).ok()) {
        Some(bytes) if is_float => Some(f64::from_le_bytes(bytes)),
        _ => text.parse().ok(),
    }
}
