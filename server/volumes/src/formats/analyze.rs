//! Analyze 7.5: a header of 348 bytes, `.hdr`, beside samples in an `.img` file, as SPM wrote them before NIfTI.
//!
//! Read: bytes, integers and floating-point numbers, those of SPM's extension too; colours as luminance; the fourth axis as time steps;
//! scale and origin of SPM; both byte orders. The format does not say on which side of a patient the first column lies, so positions are
//! along the file's own axes, with a notice.

use super::super::stored::{Begin, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, LengthUnit, Notices, OpenedFile, ReadError};
use super::header::{self, Channels, FieldHead, GridFields, not_3d};
use super::pair::{Bytes, image_of_pair};

const FIELDS: GridFields = GridFields {
    dims: "dim",
    spacing: "pixdim",
    origin: "originator",
    direction: "orient",
};

/// Reads a header whose size and byte order are known.
///
/// # Errors
/// What is wrong with it, by field.
pub(super) fn open(location: &FileLocation, bytes: &Bytes<'_>) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
    let mut notices = Notices::default();
    notices.add(
        "an Analyze 7.5 header: it does not say where a patient's left and right are, positions are along the file's own axes",
    );
    let dim: [i32; 8] = std::array::from_fn(|i| bytes.i16(40 + 2 * i));
    let axes = match usize::try_from(dim[0]) {
        Ok(count @ 3..=7) => &dim[1..=count],
        _ => return Err(not_3d(path, "dim", format!("dim[0] is {}", dim[0]))),
    };
    if let Some((i, n)) = axes.iter().enumerate().find(|(i, n)| **n < 1 || *i > 3 && **n > 1) {
        return fail(
            "dim",
            format!("dim[{}] is {n}, expected sizes of x, y, z and time", i + 1),
        );
    }
    let size = |axis: usize| axes.get(axis).map_or(1, |&n| n as u32);
    let (dims, steps) = ([0, 1, 2].map(size), size(3));
    let (stored, colors, name) = stored_type(bytes, &mut notices).ok_or_else(|| {
        ReadError::new(
            path,
            "datatype",
            format!("code {}, expected 2, 4, 8, 16, 64, 128, 130, 132 or 136", bytes.i16(70)),
        )
    })?;
    let spacing = distances(bytes, &mut notices);
    let origin = origin(bytes, dims, spacing);
    let geometry = Geometry {
        unit: Some(LengthUnit::Millimetre),
        ..header::geometry(path, &FIELDS, dims, spacing, origin, Geometry::IDENTITY)?
    };
    let offset = bytes.f32s::<1>(108)[0];
    if !(0.0..=16_777_216.0).contains(&offset) || offset.fract() != 0.0 {
        return fail(
            "vox_offset",
            format!("{offset}, expected a whole number of bytes from 0 to 16777216"),
        );
    }
    let data = image_of_pair(location)?;
    let mut samples = StoredSamples::new(&data, Begin::At(offset as u64), stored, &geometry, steps, "dim")?;
    samples.endian = bytes.endian;
    let channels = if colors > 1 {
        samples = samples.interleaved(colors, "dim")?;
        Channels::Luminance
    } else {
        samples.scale = scale(bytes, &mut notices);
        Channels::numbered(&location.stem(), 1)
    };
    samples.check("dim")?;
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
        fields: channels.fields(&samples, 1, &like),
        notices,
    })
}

fn stored_type(bytes: &Bytes<'_>, notices: &mut Notices) -> Option<(StoredType, u32, &'static str)> {
    // Maximum and minimum, if the writer stored them.
    let (maximum, minimum) = (bytes.i32(140), bytes.i32(144));
    Some(match bytes.i16(70) {
        2 => (StoredType::U8, 1, "unsigned char"),
        4 if maximum > 32767 && (0..maximum).contains(&minimum) => {
            notices.add(format!(
                "samples are read as 16-bit numbers without sign, as glmin and glmax are {minimum} and {maximum}; datatype says a type with sign"
            ));
            (StoredType::U16, 1, "signed short, read as unsigned")
        }
        4 => (StoredType::I16, 1, "signed short"),
        8 => (StoredType::I32, 1, "signed int"),
        16 => (StoredType::F32, 1, "float"),
        64 => (StoredType::F64, 1, "double"),
        128 => (StoredType::U8, 3, "RGB"),
        130 => (StoredType::I8, 1, "signed char"),
        132 => (StoredType::U16, 1, "unsigned short"),
        136 => (StoredType::U32, 1, "unsigned int"),
        _ => return None,
    })
}

/// Returns the distances of samples, without the signs that some writers leave in them.
fn distances(bytes: &Bytes<'_>, notices: &mut Notices) -> [f64; 3] {
    let pixdim: [f64; 3] = bytes.f32s(80);
    std::array::from_fn(|axis| match pixdim[axis].abs() {
        size if size.is_finite() && size > 0.0 => size,
        _ => {
            let number = axis + 1;
            notices.add(format!(
                "pixdim[{number}] is {}: samples are taken to be 1 apart",
                pixdim[axis]
            ));
            1.0
        }
    })
}

/// Returns the position of the first sample. SPM stores the sample at the origin, counted from 1.
fn origin(bytes: &Bytes<'_>, dims: [u32; 3], spacing: [f64; 3]) -> [f64; 3] {
    let sample: [i32; 3] = std::array::from_fn(|axis| bytes.i16(253 + 2 * axis));
    let is_inside = sample.iter().zip(dims).all(|(&at, n)| at >= 1 && at as u32 <= n);
    if !is_inside {
        return [0.0; 3];
    }
    std::array::from_fn(|axis| 0.0 - f64::from(sample[axis] - 1) * spacing[axis])
}

/// Returns SPM's factor, or the scale by which calibrated values lie between the minimum and the maximum.
fn scale(bytes: &Bytes<'_>, notices: &mut Notices) -> Option<[f64; 2]> {
    let [factor, intercept] = bytes.f32s::<2>(112);
    let [cal_max, cal_min] = bytes.f32s::<2>(124);
    let (maximum, minimum) = (f64::from(bytes.i32(140)), f64::from(bytes.i32(144)));
    let scale = if factor.is_finite() && factor != 0.0 {
        [factor, if intercept.is_finite() { intercept } else { 0.0 }]
    } else if cal_max > cal_min && maximum > minimum {
        let slope = (cal_max - cal_min) / (maximum - minimum);
        [slope, cal_min - slope * minimum]
    } else {
        return None;
    };
    if scale == [1.0, 0.0] {
        return None;
    }
    notices.add(format!(
        "values are {} times the stored ones plus {}, as SPM writes them",
        scale[0], scale[1]
    ));
    Some(scale)
}
