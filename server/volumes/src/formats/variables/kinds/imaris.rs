//! Imaris 5.5, `.ims`: levels of resolution, time points and channels are groups, positions are attributes of `DataSetInfo`.
//!
//! The finest level of at most 2^31 samples is opened; `file.ims:1` names another one. The extent of the image is that of the voxels' outer
//! faces. Datasets may be larger than the image, whose size is in `ImageSizeX` and so on.

use super::{Array, MAX_STEPS, World, numbered, of_index, roles_in_order, volume};
use crate::formats::header::{self, Channels, GridFields};
use crate::formats::variables::file::{Attributes, VariableFile};
use crate::numbered::join_steps;
use crate::{FileLocation, LengthUnit, OpenedFile, ReadError};

const FIELDS: GridFields = GridFields {
    dims: "ImageSizeX",
    spacing: "ExtMax0",
    origin: "ExtMin0",
    direction: "ExtMax0",
};

/// Maximum samples of a level that is opened without being named.
const MAX_LEVEL_SAMPLES: u64 = 1 << 31;

pub(super) fn open(location: &FileLocation, file: &dyn VariableFile) -> Result<OpenedFile, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let levels = numbered(file.members("/DataSet")[0].clone(), "ResolutionLevel ");
    let shown: Vec<String> = levels.iter().map(|(number, _)| number.to_string()).collect();
    let level = match location.part() {
        Some(part) => levels.iter().find(|(number, _)| Ok(*number) == part.trim().parse()),
        None => levels.iter().find(|(_, name)| is_fair(file, name)),
    };
    let Some((_, level)) = level else {
        return Err(fail(
            "DataSet",
            format!(
                "no such level of at most 2^31 samples, expected one of {}",
                shown.join(", ")
            ),
        ));
    };
    let points = numbered(file.members(&format!("/DataSet/{level}"))[0].clone(), "TimePoint ");
    if points.is_empty() || points.len() > MAX_STEPS {
        return Err(fail(
            level,
            format!("{} time points, expected 1 to {MAX_STEPS}", points.len()),
        ));
    }
    let info = file.attributes_of("/DataSetInfo/Image");
    let mut files = Vec::new();
    for (_, point) in &points {
        let opened = open_point(location, file, &format!("/DataSet/{level}/{point}"), &info)?;
        files.push((location.clone(), opened));
    }
    // The times are dates of an examination, which may identify a patient, so steps are counted.
    join_steps(files, None)
}

/// Whether the first array of a level is small enough to be opened without being named.
fn is_fair(file: &dyn VariableFile, level: &str) -> bool {
    let path = format!("/DataSet/{level}/TimePoint 0/Channel 0/Data");
    let size = |sizes: Vec<u64>| sizes.into_iter().fold(1u64, u64::saturating_mul);
    file.variable(&path)
        .is_ok_and(|variable| size(variable.sizes()) <= MAX_LEVEL_SAMPLES)
}

/// Opens the channels of a time point.
fn open_point(
    location: &FileLocation,
    file: &dyn VariableFile,
    path: &str,
    info: &Attributes,
) -> Result<OpenedFile, ReadError> {
    let channels = numbered(file.members(path)[0].clone(), "Channel ");
    if channels.len() as u64 > header::MAX_CHANNELS {
        let why = format!("{} channels, expected {} at most", channels.len(), header::MAX_CHANNELS);
        return Err(ReadError::new(location.path(), path, why));
    }
    let names = channel_names(file, &channels);
    let mut arrays: Vec<Array> = Vec::new();
    for ((_, channel), name) in channels.iter().zip(names) {
        let group = format!("{path}/{channel}");
        let whole = format!("{group}/Data");
        let fail = |why: String| ReadError::new(location.path(), &whole, why);
        let variable = file.variable(&whole).map_err(fail)?;
        if variable.axes.len() != 3 {
            return Err(fail(format!("{} samples, expected 3 axes", variable.shape())));
        }
        let mut array = Array::new(location, variable, &roles_in_order(false, false))?;
        array.channels = Channels::Fields(vec![name]);
        crop(&mut array, &file.attributes_of(&group)).map_err(fail)?;
        if arrays
            .first()
            .is_some_and(|first| first.layout.dims != array.layout.dims)
        {
            return Err(fail(format!(
                "{:?} samples, expected those of the first channel",
                array.layout.dims
            )));
        }
        arrays.push(array);
    }
    let dims = arrays.first().map_or([1; 3], |array| array.layout.dims);
    let placed = world(info, dims);
    let opened = volume(location, &arrays, placed.as_ref().unwrap_or(&of_index()), &FIELDS)?;
    let notice = placed
        .is_none()
        .then(|| "the file has no extent: samples are 1 apart along each axis".to_owned());
    let unit = placed.and_then(|_| LengthUnit::parse(&letters(info, "Unit").unwrap_or_default()));
    let mut opened = header::with_notices(opened, notice);
    opened.geometry.unit = unit;
    Ok(opened)
}

/// Limits the dimensions of an array to the image: datasets may be larger.
fn crop(array: &mut Array, attributes: &Attributes) -> Result<(), String> {
    for (axis, name) in ["ImageSizeX", "ImageSizeY", "ImageSizeZ"].into_iter().enumerate() {
        let Some(text) = letters(attributes, name) else {
            continue;
        };
        let have = array.layout.dims[axis];
        array.layout.dims[axis] = text
            .trim()
            .parse()
            .ok()
            .filter(|size| (1..=have).contains(size))
            .ok_or_else(|| format!("{name} is {text:?}, expected 1 to {have}"))?;
    }
    Ok(())
}

/// Returns the grid of an image with these dimensions in the world.
fn world(info: &Attributes, dims: [u32; 3]) -> Option<World> {
    let mut world = of_index();
    for (axis, size) in dims.into_iter().enumerate() {
        let number = |name: String| letters(info, &name)?.trim().parse::<f64>().ok();
        let (first, last) = (number(format!("ExtMin{axis}"))?, number(format!("ExtMax{axis}"))?);
        let step = (last - first) / f64::from(size);
        world.spacing[axis] = step.abs();
        world.direction[axis][axis] = if step < 0.0 { -1.0 } else { 1.0 };
        world.origin[axis] = first + 0.5 * step;
    }
    Some(world)
}

/// Returns the names of the channels, if they differ.
fn channel_names(file: &dyn VariableFile, channels: &[(u64, String)]) -> Vec<String> {
    let name = |channel: &str| letters(&file.attributes_of(&format!("/DataSetInfo/{channel}")), "Name");
    let names: Vec<String> = channels
        .iter()
        .map(|(_, channel)| name(channel).unwrap_or_default().trim().to_owned())
        .collect();
    let is_named = (0..names.len()).all(|i| !names[i].is_empty() && !names[..i].contains(&names[i]));
    if is_named {
        return names;
    }
    channels
        .iter()
        .map(|(number, _)| format!("channel {}", number + 1))
        .collect()
}

/// Returns a text, which Imaris writes as a list of letters.
fn letters(attributes: &Attributes, name: &str) -> Option<String> {
    let text: String = attributes.texts(name).concat();
    (!text.is_empty()).then_some(text)
}
