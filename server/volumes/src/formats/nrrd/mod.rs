//! NRRD: `.nrrd`, and `.nhdr` with its samples in another file (<http://teem.sourceforge.net/nrrd/format.html>).
//!
//! Read: encodings raw, gzip, bzip2, hex and text; every integer type and both floating-point types; `spacings`, or
//! `space directions` with `space origin`; an axis of kind `time`, else one of kind `list`, as time steps, wherever it
//! stands; one axis of another kind as channels, of which colours become their luminance; line and byte skips; `space`
//! (a patient's are turned to LPS) and units. Values of fields are compared in any case. A missing value is taken from
//! a key/value pair `missing value`, `missing_value` or `_FillValue`. Refused with the reason: several axes of
//! channels, samples split over several files.
//!
//! - [`header`]: fields and key/value pairs; [`axes`]: roles of the axes; [`grid`]: positions and times; [`data`]: where the samples are.

mod axes;
mod data;
mod grid;
mod header;

use super::super::stored::StoredType;
use super::super::{FileLocation, Notices, OpenedFile, ReadError};
use super::header::{FieldHead, GridFields, MAX_HEADER_BYTES};
use axes::Axes;
use header::Header;

const FIELDS: GridFields = GridFields {
    dims: "sizes",
    spacing: "spacings",
    origin: "space origin",
    direction: "space directions",
};

/// Reads the header of a NRRD file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let blob = location.open()?;
    let head = blob.head(MAX_HEADER_BYTES)?;
    let header = Header::parse(location, &head)?;
    let stored_name = header.required("type")?;
    let stored = stored_type(stored_name).ok_or_else(|| {
        header.error(
            "type",
            format!("{stored_name:?}, expected an integer type, float or double"),
        )
    })?;
    let axes = Axes::parse(&header)?;
    let mut notices = Notices::default();
    let geometry = header.geometry(&axes, &mut notices)?;
    let samples = header.samples(&axes, &geometry, stored)?;
    let unit = header
        .get("sample units")
        .map(|u| u.trim_matches('"').to_owned())
        .filter(|u| !u.is_empty());
    let like = FieldHead {
        name: location.stem(),
        stored_type: stored_name.to_owned(),
        missing: header.missing()?,
        unit,
    };
    samples.check("sizes")?;
    let mut fields = axes.channels(&like.name).fields(&samples, axes.channel_distance, &like);
    for (layer, field) in fields.iter_mut().enumerate() {
        field.labels = header.segments(layer);
    }
    Ok(OpenedFile {
        geometry,
        steps: axes.steps,
        uneven: None,
        axes: None,
        times: header.times(&axes),
        fields,
        notices,
    })
}

fn stored_type(name: &str) -> Option<StoredType> {
    Some(match name.to_ascii_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => StoredType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => StoredType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => StoredType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => StoredType::U16,
        "int" | "signed int" | "int32" | "int32_t" => StoredType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => StoredType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => StoredType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => StoredType::U64,
        "float" => StoredType::F32,
        "double" => StoredType::F64,
        _ => return None,
    })
}
