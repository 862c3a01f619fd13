//! What HDF5 and NetCDF files have in common: named arrays with named axes and attributes.

use std::ops::Range;

use super::super::super::scalar::numbers;
use super::super::super::stored::{Endian, StoredType};

/// A named array of a file.
#[derive(Clone, Debug)]
pub struct Variable {
    /// From the root group, as `/group/name`.
    pub path: String,
    /// Slowest first, as stored.
    pub axes: Vec<Axis>,
    /// Type of its samples; or why they cannot be read.
    pub stored: Result<StoredType, String>,
    pub endian: Endian,
    /// The attributes that [`ATTRIBUTES`] lists.
    pub attributes: Vec<(String, Attribute)>,
    /// Samples along the axes of the pieces that are decoded at once, where there are such.
    pub chunk: Option<Vec<u64>>,
    /// Where its samples are in the file and in which byte order, if they lie there in one piece as they are.
    pub plain: Option<(u64, Endian)>,
    /// Whether it holds the positions along an axis of others.
    pub is_scale: bool,
    /// Whether the file follows NetCDF, in which samples that nobody wrote have a value of their own.
    pub is_netcdf: bool,
}

/// One axis of a variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Path of its dimension, where it has one: the same in every variable that shares it.
    pub dimension: Option<String>,
    /// Path of the variable with the positions along it.
    pub scale: Option<String>,
    pub size: u64,
    /// Whether the file may grow along it.
    pub is_unlimited: bool,
}

/// Value of an attribute.
#[derive(Clone, Debug)]
pub enum Attribute {
    Text(String),
    Numbers(Vec<f64>),
}

/// The attributes that are read; others may have any type.
pub const ATTRIBUTES: [&str; 14] = [
    "_FillValue",
    "_Unsigned",
    "add_offset",
    "axis",
    "calendar",
    "element_size_um",
    "missing_value",
    "positive",
    "scale_factor",
    "standard_name",
    "units",
    "valid_max",
    "valid_min",
    "valid_range",
];

impl Variable {
    /// A text attribute, trimmed, unless it is empty.
    pub fn text(&self, name: &str) -> Option<&str> {
        match self.attribute(name)? {
            Attribute::Text(text) => Some(text.trim()).filter(|text| !text.is_empty()),
            Attribute::Numbers(_) => None,
        }
    }

    /// Value = `[0]` · stored + `[1]`.
    pub fn packing(&self) -> [f64; 2] {
        let first = |name: &str, default: f64| self.numbers(name).first().copied().unwrap_or(default);
        [first("scale_factor", 1.0), first("add_offset", 0.0)]
    }

    /// The numbers of an attribute; none where it is absent or a text.
    pub fn numbers(&self, name: &str) -> &[f64] {
        match self.attribute(name) {
            Some(Attribute::Numbers(numbers)) => numbers,
            _ => &[],
        }
    }

    fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.attributes.iter().find(|(n, _)| n == name).map(|(_, value)| value)
    }

    /// Its size, as `6 x 5 x 7`, slowest first.
    pub fn shape(&self) -> String {
        let sizes: Vec<String> = self.axes.iter().map(|axis| axis.size.to_string()).collect();
        sizes.join(" x ")
    }

    /// Bytes of its samples; `None` past 64 bits.
    pub fn bytes(&self) -> Option<u64> {
        let width = self.stored.as_ref().map_or(1, |stored| stored.bytes());
        self.axes.iter().try_fold(width, |n, axis| n.checked_mul(axis.size))
    }
}

/// A file of variables.
pub trait VariableFile: Send + Sync {
    /// All variables that were found, those that cannot be read too.
    fn variables(&self) -> Vec<Variable>;

    /// The variable of that path.
    fn variable(&self, path: &str) -> Result<Variable, String>;

    /// The samples of a box of it, in the order and type in which they are stored. `selection` has a range for every axis.
    fn read(&self, variable: &Variable, selection: &[Range<u64>]) -> Result<Vec<u8>, String>;

    /// All values of a variable with one axis, at most `limit`.
    fn read_line(&self, variable: &Variable, limit: u64) -> Result<Vec<f64>, String> {
        let stored = variable.stored.clone()?;
        match variable.axes.as_slice() {
            [axis] if axis.size <= limit => {
                let bytes = self.read(
                    variable,
                    &[Range {
                        start: 0,
                        end: axis.size,
                    }],
                )?;
                Ok(numbers(&bytes, stored, variable.endian))
            }
            _ => Err(format!(
                "{} values, expected one axis of at most {limit}",
                variable.shape()
            )),
        }
    }
}
