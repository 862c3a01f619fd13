//! Metadata of arrays and groups, of both versions.

use half::f16;
use serde::Deserialize;
use serde_json::Value;

use super::super::store::{Store, join};
use super::codecs::{Pipeline, integers};
use crate::ReadError;
use crate::formats::npy::parse_descr;
use crate::stored::StoredType;

/// An array or a group.
pub(super) enum Node {
    Array(Box<Array>),
    /// A group, with its attributes.
    Group(Value),
}

/// Metadata of an array.
#[derive(Debug)]
pub(super) struct Array {
    pub(super) shape: Vec<u64>,
    /// Samples of a chunk along each axis.
    pub(super) chunks: Vec<u64>,
    pub(super) stored: StoredType,
    pub(super) type_name: String,
    /// Value of samples that are not stored.
    pub(super) fill: f64,
    pub(super) pipeline: Pipeline,
    /// Prefix of the name of a chunk, and the separator of its numbers.
    pub(super) key_prefix: &'static str,
    pub(super) key_separator: String,
    /// Whether the number along the last axis comes first in the name.
    pub(super) is_key_reversed: bool,
    pub(super) attributes: Value,
    /// Names of the axes; empty if the array has none.
    pub(super) names: Vec<String>,
    /// The fill value, if it is also the value of missing samples, as xarray takes it.
    pub(super) missing: Option<f64>,
}

impl Array {
    /// Whether at least one axis has a name, and `names` has an entry for every axis.
    pub(super) fn has_names(&self) -> bool {
        self.names.len() == self.shape.len() && self.names.iter().any(|name| !name.is_empty())
    }

    /// Returns the name of a chunk's file.
    pub(super) fn key(&self, chunk: &[u64]) -> String {
        let mut numbers: Vec<String> = chunk.iter().map(u64::to_string).collect();
        if self.is_key_reversed {
            numbers.reverse();
        }
        format!("{}{}", self.key_prefix, numbers.join(&self.key_separator))
    }
}

/// `zarr.json`.
#[derive(Deserialize)]
struct Third {
    zarr_format: u32,
    node_type: String,
    #[serde(default)]
    attributes: Value,
    #[serde(default)]
    shape: Vec<u64>,
    #[serde(default)]
    data_type: Value,
    chunk_grid: Option<Named>,
    chunk_key_encoding: Option<Named>,
    #[serde(default)]
    fill_value: Value,
    #[serde(default)]
    codecs: Vec<Value>,
    #[serde(default)]
    storage_transformers: Vec<Value>,
    dimension_names: Option<Vec<Option<String>>>,
}

/// A name with its configuration.
#[derive(Deserialize)]
pub(super) struct Named {
    pub(super) name: String,
    #[serde(default)]
    pub(super) configuration: Value,
}

/// `.zarray`.
#[derive(Deserialize)]
struct Second {
    zarr_format: u32,
    shape: Vec<u64>,
    chunks: Vec<u64>,
    dtype: Value,
    #[serde(default)]
    compressor: Value,
    #[serde(default)]
    fill_value: Value,
    order: String,
    #[serde(default)]
    filters: Value,
    dimension_separator: Option<String>,
}

/// Reads the node at a path; `None` if there is neither an array nor a group.
pub(super) fn node(store: &Store, path: &str) -> Result<Option<Node>, ReadError> {
    if let Some(third) = store.json::<Third>(&join(path, "zarr.json"))? {
        return third.node(store, path).map(Some);
    }
    let attributes = || -> Result<Option<Value>, ReadError> { store.json(&join(path, ".zattrs")) };
    if let Some(second) = store.json::<Second>(&join(path, ".zarray"))? {
        let attributes = attributes()?.unwrap_or_default();
        return second
            .array(store, path, attributes)
            .map(|array| Some(Node::Array(Box::new(array))));
    }
    let group: Option<Value> = store.json(&join(path, ".zgroup"))?;
    let attributes = attributes()?;
    let is_group = group.is_some() || attributes.is_some();
    Ok(is_group.then(|| Node::Group(attributes.unwrap_or_default())))
}

impl Third {
    fn node(self, store: &Store, path: &str) -> Result<Node, ReadError> {
        let fail = |why: String| Err(store.error(path, why));
        if self.zarr_format != 3 {
            return fail(format!("zarr_format {}, expected 3 in zarr.json", self.zarr_format));
        }
        match self.node_type.as_str() {
            "group" => return Ok(Node::Group(self.attributes)),
            "array" => {}
            other => return fail(format!("node_type {other:?}, expected array or group")),
        }
        if !self.storage_transformers.is_empty() {
            return fail("storage_transformers, expected none".to_owned());
        }
        let name = match &self.data_type {
            Value::String(name) => name.clone(),
            other => other.get("name").and_then(Value::as_str).unwrap_or("none").to_owned(),
        };
        let Some(stored) = third_type(&name) else {
            return fail(format!(
                "data_type {name:?}, expected bool, an integer of 8 to 64 bits, float32 or float64"
            ));
        };
        let chunks = match &self.chunk_grid {
            Some(grid) if grid.name == "regular" => integers(grid.configuration.get("chunk_shape")),
            _ => None,
        };
        let Some(chunks) = chunks else {
            return fail("chunk_grid, expected a regular one with its chunk_shape".to_owned());
        };
        let (key_prefix, key_separator) = self.keys().map_err(|why| store.error(path, why))?;
        let pipeline = Pipeline::third(&self.codecs, chunks.len()).map_err(|why| store.error(path, why))?;
        let array = Array {
            fill: fill(&self.fill_value, stored),
            shape: self.shape,
            chunks,
            stored,
            type_name: name,
            pipeline,
            key_prefix,
            key_separator,
            is_key_reversed: false,
            attributes: self.attributes,
            missing: None,
            names: self
                .dimension_names
                .unwrap_or_default()
                .into_iter()
                .map(Option::unwrap_or_default)
                .collect(),
        };
        array.checked(store, path).map(|array| Node::Array(Box::new(array)))
    }
}

impl Third {
    /// Returns the prefix of the name of a chunk, and the separator of its numbers.
    fn keys(&self) -> Result<(&'static str, String), String> {
        let encoding = self.chunk_key_encoding.as_ref();
        let named = encoding
            .and_then(|e| e.configuration.get("separator"))
            .and_then(Value::as_str);
        let (prefix, separator) = match (encoding.map(|e| e.name.as_str()), named) {
            (None | Some("default"), None | Some("/")) => ("c/", "/"),
            (None | Some("default"), Some(".")) => ("c.", "."),
            (Some("v2"), None | Some(".")) => ("", "."),
            (Some("v2"), Some("/")) => ("", "/"),
            (Some("default" | "v2") | None, Some(other)) => {
                return Err(format!("separator {other:?}, expected / or ."));
            }
            (Some(other), _) => return Err(format!("chunk_key_encoding {other:?}, expected default or v2")),
        };
        Ok((prefix, separator.to_owned()))
    }
}

impl Second {
    fn array(self, store: &Store, path: &str, attributes: Value) -> Result<Array, ReadError> {
        let fail = |why: String| Err(store.error(path, why));
        if self.zarr_format != 2 {
            return fail(format!("zarr_format {}, expected 2 in .zarray", self.zarr_format));
        }
        let name = self.dtype.as_str().unwrap_or("a structure").to_owned();
        let Some((Some(endian), stored)) = parse_descr(&name) else {
            let what = "a bool, an integer, f4 or f8, with its byte order, as <f4";
            return fail(format!("dtype {name:?}, expected {what}"));
        };
        let filters = match &self.filters {
            Value::Null => &[],
            Value::Array(filters) => filters.as_slice(),
            other => return fail(format!("filters {other}, expected a list")),
        };
        let fortran = match self.order.as_str() {
            "C" => false,
            "F" => true,
            other => return fail(format!("order {other:?}, expected C or F")),
        };
        let separator = self.dimension_separator.unwrap_or_else(|| ".".to_owned());
        if !matches!(separator.as_str(), "/" | ".") {
            return fail(format!("dimension_separator {separator:?}, expected / or ."));
        }
        let pipeline = Pipeline::second(filters, &self.compressor, (stored, endian), fortran, self.chunks.len());
        let names = attributes.get("_ARRAY_DIMENSIONS").and_then(Value::as_array);
        let fill_value = fill(&self.fill_value, stored);
        let missing = names.filter(|_| !self.fill_value.is_null()).map(|_| fill_value);
        let names = names
            .into_iter()
            .flatten()
            .map(|name| name.as_str().unwrap_or_default().to_owned());
        let array = Array {
            fill: fill_value,
            missing,
            shape: self.shape,
            chunks: self.chunks,
            stored,
            type_name: name,
            pipeline: pipeline.map_err(|why| store.error(path, why))?,
            key_prefix: "",
            key_separator: separator,
            is_key_reversed: false,
            names: names.collect(),
            attributes,
        };
        array.checked(store, path)
    }
}

impl Array {
    /// Maximum bytes of a chunk, decoded.
    const MAX_CHUNK_BYTES: u64 = 1 << 30;

    pub(super) fn checked(self, store: &Store, path: &str) -> Result<Self, ReadError> {
        let fail = |why: String| Err(store.error(path, why));
        if self.shape.len() != self.chunks.len() || !(1..=32).contains(&self.shape.len()) {
            return fail(format!(
                "shape {:?} in chunks {:?}, expected 1 to 32 axes in both",
                self.shape, self.chunks
            ));
        }
        if self.chunks.contains(&0) {
            return fail(format!("chunks {:?}, expected numbers above 0", self.chunks));
        }
        // The unit that is decoded at once.
        let piece = self.pipeline.shard.as_ref().map_or(&self.chunks, |shard| &shard.chunks);
        let bytes = piece
            .iter()
            .try_fold(self.stored.bytes(), |n, &size| n.checked_mul(size));
        if bytes.is_none_or(|bytes| bytes > Self::MAX_CHUNK_BYTES) {
            return fail(format!(
                "chunks {piece:?} of {}, expected 1 GiB at most",
                self.stored.name()
            ));
        }
        if let Some(shard) = &self.pipeline.shard {
            let even = shard.chunks.len() == self.chunks.len()
                && shard
                    .chunks
                    .iter()
                    .zip(&self.chunks)
                    .all(|(&inner, &outer)| inner > 0 && outer % inner == 0);
            if !even {
                return fail(format!(
                    "chunks {:?} in shards {:?}, expected a whole number",
                    shard.chunks, self.chunks
                ));
            }
        }
        Ok(self)
    }
}

pub(super) fn third_type(name: &str) -> Option<StoredType> {
    Some(match name {
        "bool" | "uint8" => StoredType::U8,
        "int8" => StoredType::I8,
        "uint16" => StoredType::U16,
        "int16" => StoredType::I16,
        "uint32" => StoredType::U32,
        "int32" => StoredType::I32,
        "uint64" => StoredType::U64,
        "int64" => StoredType::I64,
        "float16" => StoredType::F16,
        "float32" => StoredType::F32,
        "float64" => StoredType::F64,
        _ => return None,
    })
}

/// Parses a fill value: a number, its name, or its bits; 0 if there is none.
fn fill(value: &Value, stored: StoredType) -> f64 {
    match value {
        Value::Bool(value) => f64::from(u8::from(*value)),
        Value::String(text) => match text.strip_prefix("0x").map(|hex| u64::from_str_radix(hex, 16)) {
            Some(Ok(bits)) if stored == StoredType::F16 => f16::from_bits(bits as u16).to_f64(),
            Some(Ok(bits)) if stored == StoredType::F32 => f64::from(f32::from_bits(bits as u32)),
            Some(Ok(bits)) => f64::from_bits(bits),
            _ => text.parse().unwrap_or(0.0),
        },
        value => value.as_f64().unwrap_or(0.0),
    }
}
