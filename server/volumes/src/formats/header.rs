//! Shared by header parsers: limits, lists of numbers, and the checked [`Geometry`].

use std::fmt::Display;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use super::super::stored::StoredSamples;
use super::super::{Field, FileLocation, Frame, Geometry, Notices, OpenedFile, ReadError};

/// Maximum bytes of a text header, far above any real one.
pub const MAX_HEADER_BYTES: usize = 1 << 20;

/// Names of the header fields that describe the grid, for messages.
pub struct GridFields {
    pub dims: &'static str,
    pub spacing: &'static str,
    pub origin: &'static str,
    pub direction: &'static str,
}

/// Makes a geometry in the file's own axes. An error names the invalid field.
pub fn geometry(
    path: &Path,
    names: &GridFields,
    dims: [u32; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    direction: [[f64; 3]; 3],
) -> Result<Geometry, ReadError> {
    let [x, y, z] = dims;
    if dims.iter().any(|&n| n < 2) {
        let why = format!("{x} x {y} x {z} samples, expected a volume: at least 2 along each of 3 axes");
        return Err(ReadError::new(path, names.dims, why));
    }
    // The device computes in single precision, in which a spacing must neither vanish nor overflow.
    if spacing.iter().any(|&s| s <= 0.0 || !(s as f32).is_normal()) {
        let why = format!("{spacing:?}, expected three finite numbers above 0");
        return Err(ReadError::new(path, names.spacing, why));
    }
    if origin.iter().any(|&o| !(o as f32).is_finite()) {
        return Err(ReadError::new(
            path,
            names.origin,
            format!("{origin:?}, expected three finite numbers"),
        ));
    }
    let [a, b, c] = direction;
    let volume =
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
    // The axes are unit vectors: a smaller determinant is 0 up to the rounding of a header.
    if volume.is_nan() || volume.abs() < 1e-6 {
        let why = format!("{direction:?}, expected three axes that span space");
        return Err(ReadError::new(path, names.direction, why));
    }
    Ok(Geometry {
        spacing,
        // −0 becomes 0, for the output of `info`.
        origin: origin.map(|o| o + 0.0),
        direction,
        ..Geometry::of_index(dims)
    })
}

/// Splits axis vectors into lengths and unit vectors; a zero vector keeps length 0, which [`geometry`] refuses.
pub fn split_axes(axes: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    // Exact for axes with one component; the root of a square may round.
    let length = |v: [f64; 3]| match v.map(|x| x != 0.0) {
        [_, false, false] => v[0].abs(),
        [false, _, false] => v[1].abs(),
        [false, false, _] => v[2].abs(),
        _ => v.iter().fold(0.0f64, |h, x| h.hypot(*x)),
    };
    let spacing = axes.map(length);
    let mut direction = axes;
    for (axis, length) in direction.iter_mut().zip(spacing) {
        axis.iter_mut().for_each(|v| *v /= length);
        // −0 becomes 0, for the output of `info`.
        axis.iter_mut().for_each(|v| *v += 0.0);
    }
    (spacing, direction)
}

/// Returns the position of the first sample. NaN means unknown: such coordinates become 0, with a notice.
pub fn known_origin(origin: [f64; 3], notices: &mut Notices) -> [f64; 3] {
    if origin.iter().any(|at| at.is_nan()) {
        notices.add(format!(
            "the place of the first sample is missing in {origin:?}: it is taken to be 0"
        ));
    }
    origin.map(|at| if at.is_nan() { 0.0 } else { at })
}

/// Returns the distances of samples and the directions of their axes. An unknown distance is replaced by a known one of another axis; a
/// negative distance reverses its axis; both with a notice.
pub fn signed_distances(
    distances: [f64; 3],
    direction: [[f64; 3]; 3],
    notices: &mut Notices,
) -> ([f64; 3], [[f64; 3]; 3]) {
    let is_known = |distance: f64| distance.is_finite() && distance != 0.0;
    let known = distances.into_iter().find(|&distance| is_known(distance));
    let other = known.unwrap_or(1.0).abs();
    if distances.iter().any(|&distance| !is_known(distance)) {
        notices.add(format!(
            "a distance of samples is missing in {distances:?}: it is taken to be {other}, as along another axis"
        ));
    }
    if distances.iter().any(|&distance| distance < 0.0) {
        notices.add(format!(
            "a distance of samples is below 0 in {distances:?}: its axis points the other way"
        ));
    }
    let distances = distances.map(|distance| if is_known(distance) { distance } else { other });
    let mut turned = direction;
    for (axis, distance) in turned.iter_mut().zip(distances) {
        *axis = axis.map(|component| 0.0 + component * distance.signum());
    }
    (distances.map(f64::abs), turned)
}

/// Parses numbers separated by white space, exactly `count` if given.
pub fn numbers<T: FromStr>(path: &Path, field: &str, text: &str, count: Option<usize>) -> Result<Vec<T>, ReadError>
where
    T::Err: Display,
{
    let values = text
        .split_whitespace()
        .map(|w| {
            w.parse()
                .map_err(|e| ReadError::new(path, field, format!("{w:?}: {e}, expected a number")))
        })
        .collect::<Result<Vec<T>, _>>()?;
    match count {
        Some(n) if n != values.len() => Err(ReadError::new(
            path,
            field,
            format!("{} numbers, expected {n}", values.len()),
        )),
        _ => Ok(values),
    }
}

/// Converts exactly three numbers to an array.
pub fn three<T: Copy>(path: &Path, field: &str, values: &[T]) -> Result<[T; 3], ReadError> {
    values
        .try_into()
        .map_err(|_| ReadError::new(path, field, format!("{} numbers, expected 3", values.len())))
}

/// Converts the sizes of axes to 32-bit counts, none of which may be 0.
pub fn sizes(path: &Path, field: &str, values: &[u64]) -> Result<Vec<u32>, ReadError> {
    values
        .iter()
        .map(|&n| {
            u32::try_from(n).ok().filter(|&n| n > 0).ok_or_else(|| {
                ReadError::new(
                    path,
                    field,
                    format!("{n} samples along an axis, expected 1 to {}", u32::MAX),
                )
            })
        })
        .collect()
}

/// Returns the error for volumes that are not three-dimensional, the same for every format.
pub fn not_3d(path: &Path, field: &str, dimension: impl Display) -> ReadError {
    ReadError::new(
        path,
        field,
        format!("{dimension}, expected 3 (a volume), or 4 (a volume with time steps)"),
    )
}

/// Adds notices to a file.
pub fn with_notices(mut file: OpenedFile, notices: impl IntoIterator<Item = String>) -> OpenedFile {
    notices.into_iter().for_each(|notice| file.notices.add(notice));
    file
}

/// Makes a field of samples in a file.
pub fn field(
    name: String,
    samples: StoredSamples,
    stored_type: &str,
    missing: Option<f32>,
    unit: Option<String>,
) -> Field {
    samples.findings.set_missing(missing);
    Field {
        name,
        stored_type: stored_type.to_owned(),
        sample_type: samples.sample_type(),
        // NaN always counts as missing.
        missing: missing.filter(|m| !m.is_nan()),
        unit,
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(samples),
    }
}

/// Maximum channels of an array, each of which becomes a field.
pub const MAX_CHANNELS: u64 = 1024;

/// How the channels of an array become fields.
#[derive(Clone, Debug)]
pub enum Channels {
    /// Each channel becomes a field of this name.
    Fields(Vec<String>),
    /// The first three channels become one field, their luminance.
    Luminance,
}

impl Channels {
    /// One channel is the field itself; two or three channels are its components along x, y and z; more are numbered.
    pub fn vector(name: &str, count: u32) -> Self {
        match count {
            2..=3 => Self::named(name, &["x", "y", "z"][..count as usize]),
            _ => Self::numbered(name, count),
        }
    }

    /// One channel is the field itself; several are numbered.
    pub fn numbered(name: &str, count: u32) -> Self {
        match count {
            1 => Self::Fields(vec![name.to_owned()]),
            _ => Self::Fields((1..=count).map(|n| format!("{name} {n}")).collect()),
        }
    }

    /// Channels with their own names.
    pub fn named(name: &str, channels: &[impl Display]) -> Self {
        Self::Fields(channels.iter().map(|channel| format!("{name} {channel}")).collect())
    }

    /// Makes the fields of `array`, whose channels are `distance` samples apart. `like` has the fields' other properties; its name is used
    /// for a luminance.
    pub fn fields(self, array: &StoredSamples, distance: u64, like: &FieldHead) -> Vec<Field> {
        let make = |name: String, first: u64, luminance: Option<u64>| {
            let mut samples = array.clone();
            samples.findings = array.findings.of_another_field();
            (samples.first, samples.luminance) = (first, luminance);
            field(name, samples, &like.stored_type, like.missing, like.unit.clone())
        };
        match self {
            Self::Fields(names) => (0..)
                .zip(names)
                .map(|(i, name)| make(name, i * distance, None))
                .collect(),
            Self::Luminance => {
                let notice = "colours become their luminance: 0.2126 red + 0.7152 green + 0.0722 blue";
                array.findings.report(array.location.path(), notice);
                vec![make(like.name.clone(), 0, Some(distance))]
            }
        }
    }
}

/// Returns the frame of NRRD's `space`, and the signs that convert its vectors to [`Frame::Lps`] or [`Frame::Ras`].
pub fn frame_of_space(space: &str) -> (Frame, [f64; 3]) {
    let space = space.to_ascii_lowercase();
    match space
        .strip_suffix("-time")
        .or(space.strip_suffix('t'))
        .unwrap_or(&space)
    {
        "left-posterior-superior" | "lps" => (Frame::Lps, [1.0; 3]),
        "right-anterior-superior" | "ras" => (Frame::Ras, [1.0; 3]),
        "left-anterior-superior" | "las" => (Frame::Lps, [1.0, -1.0, 1.0]),
        _ => (Frame::World, [1.0; 3]),
    }
}

/// Properties of a field other than its samples.
#[derive(Clone, Debug)]
pub struct FieldHead {
    pub name: String,
    pub stored_type: String,
    pub missing: Option<f32>,
    pub unit: Option<String>,
}

/// Checks the samples against their file and makes the result of a parser.
pub fn opened(
    header: &FileLocation,
    size_field: &str,
    geometry: Geometry,
    samples: StoredSamples,
    stored_type: String,
    missing: Option<f32>,
    unit: Option<String>,
) -> Result<OpenedFile, ReadError> {
    samples.check(size_field)?;
    Ok(OpenedFile {
        geometry,
        steps: samples.steps,
        uneven: None,
        axes: None,
        times: None,
        fields: vec![field(header.stem(), samples, &stored_type, missing, unit)],
        notices: Notices::default(),
    })
}
