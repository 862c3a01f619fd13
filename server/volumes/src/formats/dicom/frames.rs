//! Position, time and scale of each image of a file: of a single image, of frames at even distances, or of frames that each state their
//! own (functional groups of enhanced images, part 3, C.7.6.16).

use super::data_set::{DataSet, Fault, Tag, tag};
use super::increments::Increments;

/// One image.
#[derive(Clone)]
pub struct Image {
    /// Number of the frame in its file.
    pub frame: u32,
    pub plane: Plane,
    /// Value = `scale[0]` · stored + `scale[1]`.
    pub scale: [f64; 2],
    /// Values that may distinguish times: temporal position, acquisition, trigger time.
    pub times: [Option<f64>; 3],
    /// Name of its stack. Never shown.
    pub stack: String,
    /// The segment of a frame of a segmentation.
    pub segment: Option<u16>,
    /// Distance between slices, if it is stated.
    pub distance: Option<f64>,
}

/// Position of an image in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Center of the first sample.
    pub position: [f64; 3],
    /// Directions of increasing column and row.
    pub axes: [[f64; 3]; 2],
    /// Distances between columns and between rows.
    pub spacing: [f64; 2],
    /// Whether positions are in a patient's frame.
    pub is_patient: bool,
}

/// Returns the images of a file; none if the file does not state their position in space, as films and photographs.
pub fn images(set: &DataSet, count: u32) -> Result<Vec<Image>, Fault> {
    let groups = set.items(tag::FRAME_GROUPS);
    if groups.is_empty() {
        return classic(set, count);
    }
    if groups.len() != count as usize {
        let why = format!("{} items, expected one for each of {count} frames", groups.len());
        return Err(Fault::of(tag::FRAME_GROUPS, why));
    }
    let shared = set.items(tag::SHARED_GROUPS).first();
    let images = (0..).zip(groups).map(|(frame, own)| enhanced(set, shared, own, frame));
    // If some frames have a position, it is an error if others have none.
    let images: Vec<Option<Image>> = images.collect::<Result<_, _>>()?;
    if images.iter().all(Option::is_none) {
        return Ok(Vec::new());
    }
    let placed: Option<Vec<Image>> = images.into_iter().collect();
    placed.ok_or_else(|| {
        let why = "some frames have no position, orientation or spacing, expected all of them to have one";
        Fault::of(tag::FRAME_GROUPS, why)
    })
}

/// Returns the images that the elements of the file itself describe.
fn classic(set: &DataSet, count: u32) -> Result<Vec<Image>, Fault> {
    let times = [
        set.number(tag::TEMPORAL_POSITION)?,
        set.number(tag::ACQUISITION_NUMBER)?,
        set.number(tag::TRIGGER_TIME)?,
    ];
    let mut scale = scale(set)?;
    if let Some(dose) = set.number(tag::DOSE_SCALING)? {
        scale = [dose, 0.0];
    }
    let image = |frame, plane| Image {
        frame,
        plane,
        scale,
        times,
        stack: String::new(),
        segment: None,
        distance: None,
    };
    if count == 1 {
        let plane = plane(set, set, set)?;
        return Ok(plane.map(|plane| image(0, plane)).into_iter().collect());
    }
    let increments = Increments::of(set, count)?;
    let (Some(first), Some(offsets)) = (first_plane(set)?, offsets(set, &increments, count)?) else {
        return Ok(Vec::new());
    };
    let normal = cross(first.axes[0], first.axes[1]);
    let plane = |offset: f64| Plane {
        position: std::array::from_fn(|i| first.position[i] + offset * normal[i]),
        ..first
    };
    let time = |frame: u32| increments.times.as_ref().map(|times| times[frame as usize]);
    let images = (0..).zip(offsets).map(|(frame, offset)| {
        let mut image = image(frame, plane(offset));
        image.times[0] = time(frame).or(image.times[0]);
        image
    });
    Ok(images.collect())
}

/// Returns the plane of the first of several frames. Without position and orientation, the axes are the file's own.
fn first_plane(set: &DataSet) -> Result<Option<Plane>, Fault> {
    if let Some(plane) = plane(set, set, set)? {
        return Ok(Some(plane));
    }
    // In nuclear medicine, the detector has the position.
    if let Some(detector) = set.items(tag::DETECTORS).first()
        && let Some(plane) = plane(detector, detector, set)?
    {
        return Ok(Some(plane));
    }
    let spacing = set.array::<2>(tag::PIXEL_SPACING)?;
    Ok(spacing.map(|[rows, columns]| Plane {
        position: [0.0; 3],
        axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        spacing: [columns, rows],
        is_patient: false,
    }))
}

/// Returns the distances of frames from the first one, along the normal.
fn offsets(set: &DataSet, increments: &Increments, count: u32) -> Result<Option<Vec<f64>>, Fault> {
    if let Some(offsets) = set.numbers(tag::FRAME_OFFSETS)? {
        if offsets.len() != count as usize {
            let why = format!("{} numbers, expected one for each of {count} frames", offsets.len());
            return Err(Fault::of(tag::FRAME_OFFSETS, why));
        }
        // Relative offsets begin at 0, absolute ones are positions: both become distances from the first.
        return Ok(Some(offsets.iter().map(|offset| offset - offsets[0]).collect()));
    }
    let spacing = set.number(tag::SPACING_BETWEEN_SLICES)?;
    let slice = |frame: u32| match &increments.slices {
        Some(slices) => slices[frame as usize] - slices[0],
        None if increments.times.is_some() => 0.0,
        None => f64::from(frame),
    };
    Ok(spacing.map(|spacing| (0..count).map(|frame| slice(frame) * spacing).collect()))
}

/// Returns a frame that functional groups describe: its own groups, else those that all frames share.
fn enhanced(set: &DataSet, shared: Option<&DataSet>, own: &DataSet, frame: u32) -> Result<Option<Image>, Fault> {
    let empty = DataSet::default();
    let group = |tag: Tag| {
        let own = own.items(tag).first();
        own.or_else(|| shared?.items(tag).first()).unwrap_or(&empty)
    };
    let plane = plane(
        group(tag::PLANE_POSITION),
        group(tag::PLANE_ORIENTATION),
        group(tag::PIXEL_MEASURES),
    )?;
    let content = group(tag::FRAME_CONTENT);
    let times = [
        content.long(tag::TEMPORAL_INDEX)?.map(f64::from),
        content.short(tag::FRAME_ACQUISITION)?.map(f64::from),
        group(tag::CARDIAC_SYNCHRONIZATION).double(tag::TRIGGER_DELAY)?,
    ];
    let transformed = group(tag::VALUE_TRANSFORMATION);
    let scale = if transformed.text(tag::SLOPE).is_some() {
        scale(transformed)?
    } else {
        scale(set)?
    };
    let segment = group(tag::SEGMENT_IDENTIFICATION).short(tag::REFERENCED_SEGMENT)?;
    let distance = group(tag::PIXEL_MEASURES).number(tag::SPACING_BETWEEN_SLICES)?;
    Ok(plane.map(|plane| Image {
        frame,
        plane,
        scale,
        times,
        stack: content.text(tag::STACK).unwrap_or_default(),
        segment,
        distance,
    }))
}

/// Returns position, orientation and spacing; `None` if one of them is missing.
fn plane(position: &DataSet, orientation: &DataSet, measures: &DataSet) -> Result<Option<Plane>, Fault> {
    let position = position.array::<3>(tag::POSITION)?;
    let orientation = orientation.array::<6>(tag::ORIENTATION)?;
    let spacing = measures.array::<2>(tag::PIXEL_SPACING)?;
    let (Some(position), Some(orientation), Some([rows, columns])) = (position, orientation, spacing) else {
        return Ok(None);
    };
    let [a, b, c, d, e, f] = orientation;
    Ok(Some(Plane {
        position,
        axes: axes([[a, b, c], [d, e, f]])?,
        // The file lists the distance of rows first.
        spacing: [columns, rows],
        is_patient: true,
    }))
}

/// Returns the axes as unit vectors, which they must be up to rounding.
fn axes(axes: [[f64; 3]; 2]) -> Result<[[f64; 3]; 2], Fault> {
    const ROUNDING: f64 = 1e-3;
    let lengths = axes.map(|axis| dot(axis, axis).sqrt());
    let is_unit = lengths.iter().all(|length| (length - 1.0).abs() < ROUNDING);
    let is_right = dot(axes[0], axes[1]).abs() < ROUNDING;
    // The conditions are also false for NaN.
    if !is_unit || !is_right {
        let why = format!("{axes:?}, expected two unit vectors at a right angle");
        return Err(Fault::of(tag::ORIENTATION, why));
    }
    let [x, y] = lengths;
    Ok([axes[0].map(|v| v / x), axes[1].map(|v| v / y)])
}

/// Returns slope and intercept of the values.
fn scale(set: &DataSet) -> Result<[f64; 2], Fault> {
    let slope = set.number(tag::SLOPE)?.unwrap_or(1.0);
    if slope == 0.0 {
        return Err(Fault::of(tag::SLOPE, "0, expected another number"));
    }
    Ok([slope, set.number(tag::INTERCEPT)?.unwrap_or(0.0)])
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
