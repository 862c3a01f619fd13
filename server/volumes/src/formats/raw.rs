//! Raw samples with a JSON sidecar that describes them.
//!
//! ```json
//! {"file": "head.raw", "type": "u16", "dims": [256, 256, 108], "spacing": [0.96, 0.96, 1.5], "missing": 65535, "unit": "HU"}
//! ```
//!
//! `FORMATS.md` has all names and their defaults. An unknown name is refused. A `.raw` file is opened through the sidecar of the
//! same stem beside it.

use serde::Deserialize;

use super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, OpenedFile, ReadError};
use super::header::{self, GridFields, MAX_HEADER_BYTES};

const FIELDS: GridFields = GridFields {
    dims: "dims",
    spacing: "spacing",
    origin: "origin",
    direction: "direction",
};

/// The sidecar.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sidecar {
    file: String,
    #[serde(rename = "type")]
    stored: String,
    dims: [u64; 3],
    #[serde(default)]
    endian: SidecarEndian,
    #[serde(default)]
    offset: u64,
    #[serde(default)]
    encoding: SidecarEncoding,
    #[serde(default = "one")]
    steps: u64,
    #[serde(default = "unit_spacing")]
    spacing: [f64; 3],
    #[serde(default)]
    origin: [f64; 3],
    #[serde(default = "identity")]
    direction: [[f64; 3]; 3],
    missing: Option<f64>,
    unit: Option<String>,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum SidecarEndian {
    #[default]
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum SidecarEncoding {
    #[default]
    Raw,
    Gzip,
}

fn one() -> u64 {
    1
}

fn unit_spacing() -> [f64; 3] {
    [1.0; 3]
}

fn identity() -> [[f64; 3]; 3] {
    Geometry::IDENTITY
}

/// Whether a JSON file is a sidecar: an object with `file` and `dims`. Folders may have other JSON files.
pub fn is_sidecar(location: &FileLocation) -> bool {
    let text = location.open().and_then(|blob| blob.head(MAX_HEADER_BYTES));
    let value: Option<serde_json::Value> = text.ok().and_then(|text| serde_json::from_slice(&text).ok());
    value.is_some_and(|v| v.get("file").is_some() && v.get("dims").is_some())
}

/// Reads the sidecar beside a file of samples.
///
/// # Errors
/// There is no sidecar, or it is invalid.
pub fn open_samples(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let name = format!("{}.json", location.stem());
    let sidecar = location.sibling(&name, "file").map_err(|_| {
        let why = format!("raw samples need a sidecar that says what they are, expected {name:?} beside them");
        ReadError::new(location.path(), "file", why)
    })?;
    open(&sidecar)
}

/// Reads a sidecar.
///
/// # Errors
/// What is wrong with it or with the file it names.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let blob = location.open()?;
    let text = blob.head(MAX_HEADER_BYTES)?;
    let sidecar: Sidecar = serde_json::from_slice(&text).map_err(|e| ReadError::new(path, "sidecar", e.to_string()))?;
    let stored = StoredType::ALL
        .into_iter()
        .find(|t| t.name() == sidecar.stored)
        .ok_or_else(|| {
            let names = StoredType::ALL.map(StoredType::name).join(", ");
            ReadError::new(path, "type", format!("{:?}, expected one of {names}", sidecar.stored))
        })?;
    let dims = header::sizes(path, "dims", &sidecar.dims)?;
    let steps = header::sizes(path, "steps", &[sidecar.steps])?[0];
    let (_, direction) = header::split_axes(sidecar.direction);
    let dims = [dims[0], dims[1], dims[2]];
    let geometry = header::geometry(path, &FIELDS, dims, sidecar.spacing, sidecar.origin, direction)?;
    let data = location.sibling(&sidecar.file, "file")?;
    let plain = matches!(sidecar.encoding, SidecarEncoding::Raw);
    let begin = Begin::At(if plain { sidecar.offset } else { 0 });
    let mut samples = StoredSamples::new(&data, begin, stored, &geometry, steps, "dims")?;
    if !plain {
        samples.encoding = Encoding::Deflate;
        samples.skip_decoded = sidecar.offset;
    }
    if let SidecarEndian::Big = sidecar.endian {
        samples.endian = Endian::Big;
    }
    samples.check_exactly("dims")?;
    let missing = sidecar.missing.map(|m| m as f32);
    header::opened(
        location,
        "dims",
        geometry,
        samples,
        sidecar.stored,
        missing,
        sidecar.unit,
    )
}
