//! MGH and MGZ of FreeSurfer (<https://surfer.nmr.mgh.harvard.edu/fswiki/FsTutorial/MghFormat>): a header of 284 bytes, samples, then tags.
//!
//! Read: all types of numbers; frames as time steps; the affine to a patient's right, front and head. What follows the samples (repetition
//! time, history) is skipped. Big-endian; `.mgz` is compressed.

use super::super::stored::{Begin, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError};
use super::header::{self, Channels, FieldHead, GridFields};

/// Offset of the samples in bytes.
const HEADER_BYTES: usize = 284;

/// Deviation of a direction's length from 1 that is not worth a notice: rounding of a program that writes few digits.
const UNIT_TOLERANCE: f64 = 1e-3;

const FIELDS: GridFields = GridFields {
    dims: "width, height, depth",
    spacing: "spacing",
    origin: "c_ras",
    direction: "x_ras, y_ras, z_ras",
};

fn word(head: &[u8], at: usize) -> i32 {
    i32::from_be_bytes(std::array::from_fn(|i| head[at + i]))
}

fn floats<const N: usize>(head: &[u8], at: usize) -> [f64; N] {
    std::array::from_fn(|i| f64::from(f32::from_bits(word(head, at + 4 * i).cast_unsigned())))
}

/// Whether version, sizes and type are valid.
pub(super) fn is_content(head: &[u8]) -> bool {
    head.len() >= HEADER_BYTES
        && word(head, 0) == 1
        && (1..5).all(|i| (1..1 << 24).contains(&word(head, 4 * i)))
        && stored_type(word(head, 20)).is_some()
}

fn stored_type(code: i32) -> Option<(StoredType, &'static str)> {
    Some(match code {
        0 => (StoredType::U8, "UCHAR"),
        1 => (StoredType::I32, "INT"),
        3 => (StoredType::F32, "FLOAT"),
        4 => (StoredType::I16, "SHORT"),
        10 => (StoredType::U16, "USHRT"),
        _ => return None,
    })
}

/// Reads the header of a file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
    let head = location.open()?.head(HEADER_BYTES)?;
    if head.len() < HEADER_BYTES {
        return fail("header", format!("{} bytes, expected {HEADER_BYTES}", head.len()));
    }
    if word(&head, 0) != 1 {
        return fail("version", format!("{}, expected 1", word(&head, 0)));
    }
    let sizes = [1, 2, 3, 4].map(|i| u64::try_from(word(&head, 4 * i)).unwrap_or(0));
    let sizes = header::sizes(path, "width, height, depth, frames", &sizes)?;
    let (dims, steps) = ([sizes[0], sizes[1], sizes[2]], sizes[3]);
    let Some((stored, name)) = stored_type(word(&head, 20)) else {
        let why = format!(
            "{}, expected 0 (uchar), 1 (int), 3 (float), 4 (short) or 10 (ushort)",
            word(&head, 20)
        );
        return fail("type", why);
    };
    let mut notices = Notices::default();
    // Any other number than 0, as nibabel takes it.
    let has_axes = head[28..30] != [0; 2];
    let geometry = if has_axes {
        geometry(location, &head, dims, &mut notices)?
    } else {
        notices.add("the header has no axes: they are those of a coronal scan, as FreeSurfer takes them, 1 mm apart");
        coronal(location, dims)?
    };
    let mut samples = StoredSamples::new(
        location,
        Begin::At(HEADER_BYTES as u64),
        stored,
        &geometry,
        steps,
        FIELDS.dims,
    )?;
    samples.endian = Endian::Big;
    // Tags follow the samples. If the size overflows, `u64::MAX` is taken as the end, which the check refuses.
    let bytes = samples.total_samples().checked_mul(stored.bytes());
    samples.end = bytes
        .and_then(|bytes| bytes.checked_add(HEADER_BYTES as u64))
        .or(Some(u64::MAX));
    samples.check(FIELDS.dims)?;
    let like = FieldHead {
        name: location.stem(),
        stored_type: name.to_owned(),
        missing: None,
        unit: None,
    };
    Ok(OpenedFile {
        geometry,
        steps,
        uneven: None,
        axes: None,
        times: None,
        fields: Channels::numbered(&like.name, 1).fields(&samples, 0, &like),
        notices,
    })
}

/// Returns the grid around the position of its centre. `axes` are the vectors from sample to sample.
fn placed(
    location: &FileLocation,
    dims: [u32; 3],
    axes: [[f64; 3]; 3],
    centre: [f64; 3],
) -> Result<Geometry, ReadError> {
    let origin = std::array::from_fn(|row| {
        let to_centre = |axis: usize| axes[axis][row] * f64::from(dims[axis]) / 2.0;
        centre[row] - to_centre(0) - to_centre(1) - to_centre(2)
    });
    let (spacing, direction) = header::split_axes(axes);
    let geometry = header::geometry(location.path(), &FIELDS, dims, spacing, origin, direction)?;
    Ok(Geometry {
        frame: Frame::Ras,
        unit: Some(LengthUnit::Millimetre),
        ..geometry
    })
}

/// Returns the grid by the affine of nibabel and FreeSurfer: directions times distances. Directions that are no unit vectors change the
/// distances.
fn geometry(
    location: &FileLocation,
    head: &[u8],
    dims: [u32; 3],
    notices: &mut Notices,
) -> Result<Geometry, ReadError> {
    let stored: [[f64; 3]; 3] = [42, 54, 66].map(|at| floats(head, at));
    let (distances, axes) = header::signed_distances(floats(head, 30), stored, notices);
    let (lengths, _) = header::split_axes(axes);
    if lengths.iter().any(|length| (length - 1.0).abs() > UNIT_TOLERANCE) {
        notices.add(format!(
            "x_ras, y_ras, z_ras are {:?} long, expected unit vectors: they multiply the distances of samples, as in nibabel and FreeSurfer",
            lengths.map(|length| length as f32)
        ));
    }
    let axes = std::array::from_fn(|axis| axes[axis].map(|component| component * distances[axis]));
    placed(location, dims, axes, floats(head, 78))
}

fn coronal(location: &FileLocation, dims: [u32; 3]) -> Result<Geometry, ReadError> {
    let axes = [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
    placed(location, dims, axes, [0.0; 3])
}
