//! TIFF: stacks of pages, ImageJ's hyperstacks, OME-TIFF, and folders of numbered slices.
//!
//! - [`directory`]: the directories of a file; [`page`]: the image of a directory; the crate `tiff` decodes it if it is compressed.
//! - [`stack`]: assigns pages to slices, channels and time steps; [`imagej`]: by ImageJ's description; [`ome`]: by OME's XML.
//! - [`source`] reads the pages; [`folder`]: one file for each slice.

mod directory;
pub mod folder;
mod imagej;
mod ome;
mod page;
mod source;
mod stack;

use std::sync::Arc;

use directory::{Chain, tag};
use page::{Image, Page};
use source::{PageSource, Pages, Pick};
use stack::{Calibration, Resolution, Stack};

use super::super::stored::StoredType;
use super::super::{Field, FileLocation, Findings, Geometry, OpenedFile, ReadError, TimeAxis};
use super::header::{self, GridFields};
use super::named_axes::doubt_of_order;

const FIELDS: GridFields = GridFields {
    dims: "dimensions",
    spacing: "resolution",
    origin: "xorigin, yorigin, zorigin",
    direction: "resolution",
};

/// Pages of a file, with the properties that the first page states.
struct Opened {
    pages: Pages,
    description: Option<String>,
    resolution: Resolution,
    /// Orientation as the specification numbers it: 1 is the first row at the top, the first column on the left.
    orientation: u64,
    /// The stored value of pixels without a measurement.
    missing: Option<f64>,
}

/// Reads the directories of a file.
///
/// # Errors
/// What is wrong with the directories; the list of volumes if the file holds several.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let Opened {
        mut pages,
        description,
        resolution,
        orientation,
        missing,
    } = read_pages(location)?;
    let fail = |why: String| ReadError::new(location.path(), "ImageDescription", why);
    let description = description.unwrap_or_default();
    if ome::is_ome(&description) {
        let (stacks, files) = ome_stacks(location, &description, pages)?;
        return volume(location, &chosen(location, stacks)?, files);
    }
    let is_imagej = description.starts_with("ImageJ=");
    if is_imagej {
        extend_imagej(&mut pages, &description).map_err(fail)?;
    }
    let count = pages.pages.len();
    let mut stack = if is_imagej {
        Stack::of_imagej(&description, count, resolution).map_err(fail)?
    } else {
        let mut stack = Stack::of_tifffile(&description, count).unwrap_or_else(|| Stack::of_pages(count));
        stack.keep_ratio(resolution);
        stack
    };
    stack.missing = missing;
    stack.tell_of_orientation(orientation);
    let file = volume(location, &chosen(location, vec![stack])?, vec![pages])?;
    let [x, y, z] = file.geometry.dims.map(u64::from);
    let doubt = doubt_of_order(&[file.steps.into(), z, y, x]).filter(|_| !is_imagej);
    Ok(header::with_notices(file, doubt))
}

/// Reads the directories of one file.
fn read_pages(location: &FileLocation) -> Result<Opened, ReadError> {
    let blob = location.open()?;
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let chain = Chain::open(&blob).map_err(|why| fail("header", why))?;
    let mut opened = Opened {
        pages: Pages {
            location: location.clone(),
            file_bytes: blob.len(),
            pages: Vec::new(),
        },
        description: None,
        resolution: Resolution::default(),
        orientation: 1,
        missing: None,
    };
    let mut number = 0;
    let read = chain.for_each(|directory| {
        number += 1;
        if number == 1 {
            opened.description = directory.text(tag::IMAGE_DESCRIPTION)?;
            opened.orientation = directory.number(tag::ORIENTATION, 1)?;
            let missing = directory.text(tag::NO_DATA)?;
            opened.missing = missing.and_then(|text| text.trim().parse().ok());
            opened.resolution = Resolution {
                pixels: [
                    directory.rational(tag::X_RESOLUTION)?,
                    directory.rational(tag::Y_RESOLUTION)?,
                ],
                // The default unit is the inch.
                is_of_file: directory.number(tag::RESOLUTION_UNIT, 2)? == 1,
            };
        }
        let page = Page::read(&directory, chain.header, blob.len())?;
        opened.pages.pages.extend(page);
        Ok(())
    });
    read.map_err(|why| fail(&format!("page {number}"), why))?;
    Ok(opened)
}

/// Adds the pages of a file of more than 4 GB by ImageJ, which has one directory: the samples of all slices follow those of the first.
fn extend_imagej(pages: &mut Pages, description: &str) -> Result<(), String> {
    let images = description
        .lines()
        .find_map(|line| line.strip_prefix("images="))
        .map(|text| text.trim().parse::<u64>());
    let (
        Some(Ok(images)),
        [
            Page {
                plain: Some(begin),
                image,
                ..
            },
        ],
    ) = (images, pages.pages.as_slice())
    else {
        return Ok(());
    };
    if images < 2 {
        return Ok(());
    }
    let (begin, page) = (*begin, pages.pages[0]);
    let slice = image.bytes().unwrap_or(u64::MAX);
    let end = images.checked_mul(slice).and_then(|bytes| bytes.checked_add(begin));
    if end.is_none_or(|end| end > pages.file_bytes) {
        let have = pages.file_bytes;
        return Err(format!(
            "{images} images of {slice} bytes from {begin} on, in a file of {have}, expected all of them in it"
        ));
    }
    let slice = |i: u64| Page {
        plain: Some(begin + i * slice),
        ..page
    };
    pages.pages = (0..images).map(slice).collect();
    Ok(())
}

/// Reads the volumes of an OME-TIFF, and opens the files that contain their planes.
fn ome_stacks(location: &FileLocation, xml: &str, own: Pages) -> Result<(Vec<Stack>, Vec<Pages>), ReadError> {
    let mut files = vec![own];
    let mut failed = None;
    let mut find = |name: Option<&str>| {
        let own = location.path().file_name().unwrap_or_default().to_string_lossy();
        let Some(name) = name.filter(|name| *name != own) else {
            return Ok((0, files[0].pages.len()));
        };
        let path = location.path().with_file_name(name);
        if let Some(known) = files.iter().position(|file| file.location.path() == path) {
            return Ok((known, files[known].pages.len()));
        }
        let opened = location
            .sibling(name, "TiffData")
            .and_then(|sibling| read_pages(&sibling));
        // Keep the error: it has more fields than its text.
        let opened = opened.map_err(|e| {
            let text = e.why.clone();
            failed = Some(e);
            text
        })?;
        files.push(opened.pages);
        Ok((files.len() - 1, files[files.len() - 1].pages.len()))
    };
    match ome::read(xml, &mut find) {
        Ok(stacks) => Ok((stacks, files)),
        Err(why) => Err(failed.unwrap_or_else(|| ReadError::new(location.path(), "ImageDescription", why))),
    }
}

/// Returns the only volume, or the one that is named by its name or by its number from 1.
fn chosen(location: &FileLocation, mut stacks: Vec<Stack>) -> Result<Stack, ReadError> {
    let found = match location.part() {
        Some(part) => {
            let number = part
                .parse::<usize>()
                .ok()
                .and_then(|n| n.checked_sub(1))
                .filter(|&n| n < stacks.len());
            stacks
                .iter()
                .position(|stack| stack.name.as_deref() == Some(part))
                .or(number)
        }
        None => (stacks.len() == 1).then_some(0),
    };
    if let Some(found) = found {
        return Ok(stacks.swap_remove(found));
    }
    let describe = |(i, stack): (usize, &Stack)| {
        let name = stack.name.as_deref().unwrap_or_default();
        format!("{} {name:?} ({} slices)", i + 1, stack.slices)
    };
    let names: Vec<String> = stacks.iter().enumerate().map(describe).take(20).collect();
    let why = format!(
        "{} volumes, expected the name or number of one, behind a colon: {}",
        stacks.len(),
        names.join(", ")
    );
    Err(ReadError::new(location.path(), "file", why))
}

/// Returns the common size and type of all slices, or an error if they differ.
fn image_of(location: &FileLocation, stack: &Stack, files: &[Pages]) -> Result<Image, ReadError> {
    let fail = |why: String| Err(ReadError::new(location.path(), "pages", why));
    let page = |&(file, page): &(usize, usize)| files[file].pages[page].image;
    let Some(image) = stack.planes.first().map(page) else {
        return fail("none, expected a slice in each".into());
    };
    let (first, slices) = (image.describe(), stack.planes.len() as u64);
    if let Some(other) = stack.planes.iter().find(|plane| page(plane) != image) {
        let (file, number, has) = (
            files[other.0].location.path().display(),
            other.1 + 1,
            page(other).describe(),
        );
        return fail(format!(
            "page {number} of {file} has {has}, the first one {first}, expected one size and type"
        ));
    }
    if image.bytes().and_then(|bytes| bytes.checked_mul(slices)).is_none() {
        return fail(format!("{slices} slices of {first} pass 64 bits"));
    }
    Ok(image)
}

/// Makes the fields of a volume.
fn volume(location: &FileLocation, stack: &Stack, files: Vec<Pages>) -> Result<OpenedFile, ReadError> {
    let image = image_of(location, stack, &files)?;
    let dims = [image.width, image.height, stack.slices];
    let geometry = Geometry {
        unit: stack.unit,
        ..header::geometry(
            location.path(),
            &FIELDS,
            dims,
            stack.spacing,
            stack.origin,
            Geometry::IDENTITY,
        )?
    };
    let interval = stack.interval.as_ref().filter(|_| stack.frames > 1);
    let times = interval.and_then(|(interval, unit)| TimeAxis::even(0.0, *interval, stack.frames, unit));
    let files = Arc::new(files);
    let mut notices = stack.notices.clone();
    if image.is_rgb {
        notices.add("colours become their luminance: 0.2126 red + 0.7152 green + 0.0722 blue");
    }
    let is_calibrated = !image.is_rgb && image.samples == 1;
    let calibration = match (stack.calibration, image.stored) {
        (calibration, StoredType::U16) if is_calibrated => calibration,
        (calibration, StoredType::U8) if is_calibrated => calibration.map(Calibration::as_line),
        _ => None,
    };
    let missing = stack.missing.filter(|value| {
        calibration.is_none()
            && !image.is_rgb
            && value.is_finite()
            && (!image.stored.is_whole() || value.fract() == 0.0)
    });
    let fields = fields(location, stack, image).into_iter().map(|(name, channel, pick)| {
        let steps = (0..stack.frames).map(|frame| stack.step(channel, frame).to_vec());
        let source = PageSource {
            files: files.clone(),
            image,
            pick,
            calibration,
            steps: steps.collect(),
            findings: Findings::default(),
        };
        Field {
            name,
            stored_type: image.stored.name().to_owned(),
            sample_type: source.sample_type(),
            missing: missing.map(|value| value as f32),
            unit: stack.value_unit.clone(),
            labels: Vec::new(),
            declares_labels: false,
            source: Arc::new(source),
        }
    });
    Ok(OpenedFile {
        geometry,
        steps: stack.frames,
        uneven: None,
        axes: None,
        times,
        fields: fields.collect(),
        notices,
    })
}

/// Returns the names of the fields, each with its channel and the component of a pixel that is read.
fn fields(location: &FileLocation, stack: &Stack, image: Image) -> Vec<(String, usize, Pick)> {
    let picks: Vec<Pick> = if image.is_rgb {
        vec![Pick::Luminance]
    } else {
        (0..image.samples).map(Pick::Sample).collect()
    };
    let channels = 0..stack.channels.len();
    let fields: Vec<(usize, Pick)> = channels
        .flat_map(|c| picks.iter().map(move |pick| (c, *pick)))
        .collect();
    if let [(channel, pick)] = fields.as_slice() {
        let stem = location.stem();
        let name = stem.strip_suffix(".ome").unwrap_or(&stem).to_owned();
        return vec![(name, *channel, *pick)];
    }
    let mut names: Vec<String> = Vec::new();
    for (i, (channel, _)) in fields.iter().enumerate() {
        let stated = stack.channels[*channel]
            .clone()
            .filter(|name| picks.len() == 1 && !names.contains(name));
        names.push(stated.unwrap_or_else(|| format!("channel {}", i + 1)));
    }
    names
        .into_iter()
        .zip(fields)
        .map(|(name, (channel, pick))| (name, channel, pick))
        .collect()
}
