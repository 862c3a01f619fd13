//! Common model of HDF5 and NetCDF files: named arrays with named axes and attributes.

use std::ops::Range;

use super::super::super::scalar::numbers;
use super::super::super::stored::{Endian, StoredType};
use super::super::named_axes::Role;

/// A named array of a file.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Path from the root group, as `/group/name`.
    pub path: String,
    /// Axes, the slowest first, as stored.
    pub axes: Vec<Axis>,
    /// Type of its samples, or why they cannot be read.
    pub stored: Result<StoredType, String>,
    pub endian: Endian,
    /// The attributes that [`ATTRIBUTES`] lists.
    pub attributes: Attributes,
    /// Size of a chunk along the axes, if the variable is chunked: the samples of a chunk are decoded at once.
    pub chunk: Option<Vec<u64>>,
    /// Offset in the file and byte order of its samples, if they are contiguous there and need no decoding.
    pub plain: Option<(u64, Endian)>,
    /// Whether it holds the positions along an axis of other variables.
    pub is_scale: bool,
    /// Whether the file follows NetCDF, in which samples that were never written have a value of their own.
    pub is_netcdf: bool,
}

/// One axis of a variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Path of its dimension, if it has one: the same in every variable that shares it.
    pub dimension: Option<String>,
    /// Path of the variable with the positions along it.
    pub scale: Option<String>,
    /// What the file states about the axis beside its dimension.
    pub label: AxisLabel,
    pub size: u64,
    /// Whether the file may grow along it.
    pub is_unlimited: bool,
}

/// Description of an axis: HDF5's label of a dimension, `axistags`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxisLabel {
    pub name: Option<String>,
    /// Role of the axis, if the file states it in a way that overrides all else.
    pub role: Option<Role>,
    /// Distance of neighbours; not 0.
    pub resolution: Option<f64>,
}

/// Value of an attribute.
#[derive(Clone, Debug)]
pub enum Attribute {
    Text(String),
    Texts(Vec<String>),
    /// Numbers, with the type in which they are stored, if they have one.
    Numbers(Vec<f64>, Option<StoredType>),
}

/// Attributes of a variable or a group, by name.
#[derive(Clone, Debug, Default)]
pub struct Attributes(pub Vec<(String, Attribute)>);

/// The attributes of variables that are read; others may have any type.
pub const ATTRIBUTES: [&str; 24] = [
    "DIMENSION_LABELS",
    "_CoordinateAxisType",
    "_FillValue",
    "_Unsigned",
    "add_offset",
    "axis",
    "axistags",
    "calendar",
    "element_size",
    "element_size_um",
    "missing_value",
    "pixel_size",
    "pixelsize",
    "positive",
    "resolution",
    "scale_factor",
    "spacing",
    "standard_name",
    "units",
    "valid_max",
    "valid_min",
    "valid_range",
    "voxel_size",
    "voxelsize",
];

/// Attributes with the bounds of valid values.
const VALID_BOUNDS: [&str; 3] = ["valid_range", "valid_min", "valid_max"];

impl Attributes {
    /// Returns a text, trimmed; `None` if it is empty, or no text.
    pub fn text(&self, name: &str) -> Option<&str> {
        match self.get(name)? {
            Attribute::Text(text) => Some(text.trim().trim_end_matches('\0')).filter(|text| !text.is_empty()),
            Attribute::Texts(_) | Attribute::Numbers(..) => None,
        }
    }

    /// Returns a list of texts; a single text is a list of one.
    pub fn texts(&self, name: &str) -> &[String] {
        match self.get(name) {
            Some(Attribute::Texts(texts)) => texts,
            Some(Attribute::Text(text)) => std::slice::from_ref(text),
            _ => &[],
        }
    }

    /// Returns numbers, also those that are written as text; none if there is no such attribute.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        match self.get(name) {
            Some(Attribute::Numbers(numbers, _)) => numbers.clone(),
            Some(Attribute::Text(text)) => numbers_of_text(text).unwrap_or_default(),
            Some(Attribute::Texts(_)) | None => Vec::new(),
        }
    }

    /// Returns exactly `N` numbers.
    pub fn array<const N: usize>(&self, name: &str) -> Option<[f64; N]> {
        self.numbers(name).try_into().ok()
    }

    /// Returns the type in which numbers are stored; `None` if they have none, or are none.
    pub fn stored_type(&self, name: &str) -> Option<StoredType> {
        match self.get(name)? {
            Attribute::Numbers(_, stored) => *stored,
            Attribute::Text(_) | Attribute::Texts(_) => None,
        }
    }

    /// Returns the value of an attribute.
    pub fn get(&self, name: &str) -> Option<&Attribute> {
        self.0.iter().find(|(own, _)| own == name).map(|(_, value)| value)
    }

    /// Sets an attribute that has no value yet.
    pub fn set(&mut self, name: &str, value: Attribute) {
        if self.get(name).is_none() {
            self.0.push((name.to_owned(), value));
        }
    }
}

impl Variable {
    /// Returns a text attribute, trimmed; `None` if it is empty, or no text.
    pub fn text(&self, name: &str) -> Option<&str> {
        self.attributes.text(name)
    }

    /// Returns the scale: value = `[0]` · stored + `[1]`.
    pub fn packing(&self) -> [f64; 2] {
        let first = |name: &str, default: f64| self.numbers(name).first().copied().unwrap_or(default);
        [first("scale_factor", 1.0), first("add_offset", 0.0)]
    }

    /// Returns the numbers of an attribute, also those that are written as text; none if it is absent.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        self.attributes.numbers(name)
    }

    /// Returns the names of the bounds of valid values that are unpacked values, by the convention of NetCDF: their type is the wider one
    /// of scale and offset, and wider than that of the samples. Other bounds are stored numbers.
    pub fn unpacked_bounds(&self) -> Vec<&'static str> {
        // Of a wider type first by kind, then by size.
        let rank = |stored: StoredType| (!stored.is_whole(), stored.bytes());
        let type_of = |name: &str| self.attributes.stored_type(name).map(rank);
        let (of_scale, own) = (
            type_of("scale_factor").max(type_of("add_offset")),
            self.stored.as_ref().ok().map(|&stored| rank(stored)),
        );
        let is_unpacked = |name: &&str| of_scale > own && type_of(name) == of_scale;
        VALID_BOUNDS.into_iter().filter(is_unpacked).collect()
    }

    /// Returns notices of attributes that are read in a way that the file does not prescribe, and of those that should be numbers and are not.
    pub fn notices(&self) -> Vec<String> {
        let unpacked = self.unpacked_bounds();
        let unpacked = (!unpacked.is_empty()).then(|| {
            format!(
                "{} taken for unpacked values, as the type is that of scale_factor or add_offset",
                unpacked.join(", ")
            )
        });
        unpacked.into_iter().chain(self.unread_numbers()).collect()
    }

    fn unread_numbers(&self) -> Vec<String> {
        let names = [
            "_FillValue",
            "add_offset",
            "missing_value",
            "scale_factor",
            "valid_max",
            "valid_min",
            "valid_range",
        ];
        let unread = |name: &str| match self.attributes.get(name) {
            Some(Attribute::Text(text)) => numbers_of_text(text).is_none(),
            Some(Attribute::Texts(_)) => true,
            Some(Attribute::Numbers(..)) | None => false,
        };
        let shown = |name: &str| {
            format!(
                "{name} is {:?}, expected a number: not used",
                self.text(name).unwrap_or("")
            )
        };
        names.into_iter().filter(|name| unread(name)).map(shown).collect()
    }

    /// Returns the samples along each axis, the slowest first.
    pub fn sizes(&self) -> Vec<u64> {
        self.axes.iter().map(|axis| axis.size).collect()
    }

    /// Returns the size for display, as `6 x 5 x 7`, slowest first.
    pub fn shape(&self) -> String {
        let sizes: Vec<String> = self.axes.iter().map(|axis| axis.size.to_string()).collect();
        sizes.join(" x ")
    }

    /// Returns the bytes of a chunk; 0 if it has none.
    pub fn chunk_bytes(&self) -> u64 {
        let width = self.stored.as_ref().map_or(1, |stored| stored.bytes());
        let chunk = self.chunk.iter().flatten();
        chunk
            .fold(None, |n, &size| Some(n.unwrap_or(width).saturating_mul(size)))
            .unwrap_or(0)
    }

    /// Returns the bytes of its samples; `None` above 64 bits.
    pub fn bytes(&self) -> Option<u64> {
        let width = self.stored.as_ref().map_or(1, |stored| stored.bytes());
        self.axes.iter().try_fold(width, |n, axis| n.checked_mul(axis.size))
    }
}

/// Parses numbers with white space or commas between them; `None` if the text has anything else.
fn numbers_of_text(text: &str) -> Option<Vec<f64>> {
    let words = text
        .split([',', ' ', '[', ']', '\t', '\n', '\0'])
        .filter(|word| !word.is_empty());
    // Suffixes of constants in Fortran and C, as in `-999.f` or `1d20`.
    let number = |word: &str| {
        let word = word.to_lowercase();
        let plain = word
            .strip_suffix(['f', 's', 'b', 'l'])
            .filter(|rest| !rest.ends_with("in"))
            .unwrap_or(&word);
        plain.parse().or_else(|_| plain.replacen('d', "e", 1).parse()).ok()
    };
    let numbers: Vec<f64> = words.map(number).collect::<Option<_>>()?;
    (!numbers.is_empty()).then_some(numbers)
}

/// A file of variables.
pub trait VariableFile: Send + Sync {
    /// Returns all variables, including those that cannot be read.
    fn variables(&self) -> Vec<Variable>;

    /// Returns the variable with this path.
    fn variable(&self, path: &str) -> Result<Variable, String>;

    /// Reads the samples of a box, in the order and type in which they are stored. `selection` has a range for every axis.
    fn read(&self, variable: &Variable, selection: &[Range<u64>]) -> Result<Vec<u8>, String>;

    /// Returns all attributes of a group or a variable; none if there is neither, or the format has no groups.
    fn attributes_of(&self, _path: &str) -> Attributes {
        Attributes::default()
    }

    /// Returns the names of the groups and of the variables in a group, sorted; none if there is no such group.
    fn members(&self, _path: &str) -> [Vec<String>; 2] {
        [Vec::new(), Vec::new()]
    }

    /// Reads all values of a variable with one axis, at most `limit`.
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
