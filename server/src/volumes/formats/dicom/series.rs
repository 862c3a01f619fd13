//! From the images of a folder to volumes: series, stacks, steps and the grid.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use super::super::super::{Field, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use super::super::FolderVolume;
use super::super::header::{self, GridFields};
use super::data_set::Fault;
use super::frames::{Image, Plane, cross, dot};
use super::image::{Found, ImageFile};
use super::label::FileLabel;
use super::samples::{Color, Target};
use super::source::{DicomSamples, StoredImage};

/// Relative rounding of positions, spacings and directions.
const ROUNDING: f64 = 1e-3;
/// Stacks of a series; real ones have a few.
const MAX_STACKS: usize = 100;

/// Which of an image's times is one, in milliseconds; the others are numbers.
const TRIGGER_TIME: usize = 2;

const POSITION: &str = "ImagePositionPatient";

const FIELDS: GridFields = GridFields {
    dims: "Rows, Columns",
    spacing: "PixelSpacing",
    origin: POSITION,
    direction: "ImageOrientationPatient",
};

/// Images that lie behind each other.
struct Stack {
    images: Vec<StoredImage>,
}

impl Stack {
    fn file(&self) -> &ImageFile {
        &self.images[0].file
    }

    fn plane(&self) -> &Plane {
        &self.images[0].image.plane
    }

    /// Whether an image of the same series has the same rows, columns, directions and kind of samples.
    fn fits(&self, file: &ImageFile, image: &Image) -> bool {
        let (format, other) = (&self.file().format, &file.format);
        let near = |a: f64, b: f64, scale: f64| (a - b).abs() <= 0.1 * ROUNDING * scale;
        let (plane, new) = (self.plane(), &image.plane);
        let axes = plane.axes.iter().flatten().zip(new.axes.iter().flatten());
        let mut spacing = plane.spacing.iter().zip(new.spacing);
        (format.rows, format.columns, format.color) == (other.rows, other.columns, other.color)
            && format.range().is_none() == other.range().is_none()
            && plane.is_patient == new.is_patient
            && self.images[0].image.stack == image.stack
            && axes.into_iter().all(|(a, b)| near(*a, *b, 1.0))
            && spacing.all(|(a, b)| near(*a, b, *a))
    }
}

/// The images of a series.
#[derive(Default)]
struct Series {
    stacks: Vec<Stack>,
    /// Why it is none.
    refused: Option<ReadError>,
}

/// The volumes that images make, in the order of their series' numbers. A series that makes none is passed over with a
/// warning, as long as there are others.
///
/// # Errors
/// There is no volume among them.
pub fn volumes(label: &FileLabel, files: Vec<Found>) -> Result<Vec<FolderVolume>, ReadError> {
    let mut volumes: Vec<(Option<i32>, &'static str, OpenedFile)> = Vec::new();
    let (mut single, mut refused) = (0, Vec::new());
    for series in all_series(label, files) {
        if let Some(error) = series.refused {
            refused.push(error);
            continue;
        }
        for stack in series.stacks {
            if stack.images.len() < 2 {
                single += 1;
                continue;
            }
            let (number, modality) = (stack.file().series_number, stack.file().modality);
            match open(label, stack) {
                Ok(file) => volumes.push((number, modality, file)),
                Err(error) => refused.push(error),
            }
        }
    }
    if single > 0 {
        tracing::info!(path = %label.asked.display(), images = single, "single images are no volume, passed over");
    }
    if volumes.is_empty() {
        let found = if single == 1 {
            "a single image".to_owned()
        } else {
            format!("{single} single images")
        };
        let why =
            format!("{found}, expected a series of 2 or more that lie behind each other, by the name of its folder");
        let none = || label.error("images", why);
        return Err(refused.into_iter().next().unwrap_or_else(none));
    }
    for error in refused {
        tracing::warn!("a series is passed over: {error}");
    }
    Ok(titled(volumes))
}

/// Names volumes by number and kind, which say nothing of the patient.
fn titled(mut volumes: Vec<(Option<i32>, &'static str, OpenedFile)>) -> Vec<FolderVolume> {
    volumes.sort_by_key(|(number, modality, _)| (number.is_none(), *number, *modality));
    let mut counts: HashMap<String, u32> = HashMap::new();
    let named = volumes.into_iter().map(|(number, modality, file)| {
        let mut title = match number {
            Some(number) => format!("Series {number} · {modality}"),
            None => format!("Series · {modality}"),
        };
        let count = counts.entry(title.clone()).or_default();
        *count += 1;
        if *count > 1 {
            title += &format!(" · {count}");
        }
        FolderVolume { title, file }
    });
    named.collect()
}

/// Sorts images into series and stacks.
fn all_series(label: &FileLabel, files: Vec<Found>) -> impl Iterator<Item = Series> {
    let mut all: BTreeMap<String, Series> = BTreeMap::new();
    for found in files {
        match found {
            Found::Nothing => {}
            Found::Refused { series, error } => {
                all.entry(series).or_default().refused.get_or_insert(error);
            }
            Found::Images(file, images) => {
                let series = all.entry(file.series.clone()).or_default();
                series.add(label, &file, images);
            }
        }
    }
    all.into_values()
}

impl Series {
    fn add(&mut self, label: &FileLabel, file: &Arc<ImageFile>, images: Vec<Image>) {
        for image in images {
            let stack = self.stacks.iter().position(|stack| stack.fits(file, &image));
            let stored = StoredImage {
                file: file.clone(),
                image,
            };
            match stack {
                Some(at) => self.stacks[at].images.push(stored),
                None if self.stacks.len() < MAX_STACKS => self.stacks.push(Stack { images: vec![stored] }),
                None => {
                    let why = format!("more than {MAX_STACKS} directions or sizes in a series, expected fewer");
                    self.refused = Some(label.error("images", why));
                }
            }
        }
    }
}

fn open(label: &FileLabel, stack: Stack) -> Result<OpenedFile, ReadError> {
    let fail = |fault: Fault| label.error(fault.field, fault.why);
    let file = stack.images[0].file.clone();
    let plane = *stack.plane();
    let (images, steps, kind) = arrange(label, stack.images).map_err(fail)?;
    let slices = images.len() / steps;
    let axis = step_between(&images[..slices], &plane).map_err(fail)?;
    for step in images.chunks(slices).skip(1) {
        same_positions(&images[..slices], step, axis).map_err(fail)?;
    }
    let geometry = geometry(label, &images, slices, &plane, axis)?;
    if file.format.color != Color::Grey {
        tracing::info!(path = %label.asked.display(), "colors become luminance (Rec. 709)");
    }
    let target = Target::of(images.iter().map(|i| (&i.file.format, i.image.scale)));
    let steps = u32::try_from(steps).map_err(|_| label.error("images", "too many times"))?;
    let times = kind.and_then(|kind| times(&images, slices, kind));
    let field = Field {
        name: file.modality.to_ascii_lowercase(),
        stored_type: file.format.type_name(),
        sample_type: target.sample_type,
        missing: target.missing.map(|missing| missing as f32),
        unit: file.unit.map(str::to_owned),
        labels: Vec::new(),
        source: Arc::new(DicomSamples::new(label.clone(), images, slices, target)),
    };
    Ok(OpenedFile {
        geometry,
        steps,
        uneven: None,
        times,
        fields: vec![field],
        notices: Notices::default(),
    })
}

/// When the steps are: trigger times in milliseconds, or numbers. No tag with a date is read.
fn times(images: &[StoredImage], slices: usize, kind: usize) -> Option<TimeAxis> {
    let firsts = images.iter().step_by(slices);
    let values: Vec<f64> = firsts.map(|first| first.image.times[kind]).collect::<Option<_>>()?;
    if kind == TRIGGER_TIME {
        return TimeAxis::listed(values, "ms", None);
    }
    let numbers: Vec<u64> = values.iter().map(|value| value.max(0.0) as u64).collect();
    TimeAxis::numbers(&numbers, 1)
}

/// Images in the order of steps, and in each along the normal; the number of steps, and which of their times tells them apart.
fn arrange(label: &FileLabel, mut images: Vec<StoredImage>) -> Result<(Vec<StoredImage>, usize, Option<usize>), Fault> {
    let plane = images[0].image.plane;
    let normal = cross(plane.axes[0], plane.axes[1]);
    let height = |image: &StoredImage| dot(image.image.plane.position, normal);
    images.sort_by(|a, b| height(a).total_cmp(&height(b)));
    let same = ROUNDING * plane.spacing[0].min(plane.spacing[1]);
    let before = images.len();
    // The position belongs to it: some writers give all their images one identifier.
    let mut seen = HashSet::new();
    images.retain(|StoredImage { file, image }| {
        let identity = (
            file.instance.clone(),
            image.frame,
            image.plane.position.map(f64::to_bits),
        );
        file.instance.is_empty() || seen.insert(identity)
    });
    let kept = images.len();
    if kept < before {
        tracing::info!(path = %label.asked.display(), "{} copies of images passed over", before - kept);
    }
    let mut heights: Vec<Vec<StoredImage>> = Vec::new();
    for image in images {
        match heights.last_mut() {
            Some(group) if height(&image) - height(&group[0]) <= same => group.push(image),
            _ => heights.push(vec![image]),
        }
    }
    let steps = heights[0].len();
    let is_sorted = steps > 1 || kept > heights.len();
    let kind = is_sorted.then(|| sort_times(&mut heights)).transpose()?;
    let mut ordered: Vec<StoredImage> = Vec::with_capacity(kept);
    for step in 0..steps {
        ordered.extend(heights.iter().map(|group| group[step].clone()));
    }
    Ok((ordered, steps, kind))
}

/// Sorts the images at each position by time, and says by which. Each time must have an image at every position.
fn sort_times(heights: &mut [Vec<StoredImage>]) -> Result<usize, Fault> {
    let times = |group: &[StoredImage], kind: usize| -> Option<Vec<f64>> {
        let mut times = group
            .iter()
            .map(|image| image.image.times[kind])
            .collect::<Option<Vec<f64>>>()?;
        times.sort_by(f64::total_cmp);
        times.windows(2).all(|pair| pair[0] < pair[1]).then_some(times)
    };
    let kind = (0..3).find(|&kind| {
        let first = times(&heights[0], kind);
        first.is_some() && heights.iter().all(|group| times(group, kind) == first)
    });
    let Some(kind) = kind else {
        let counts = heights.iter().map(Vec::len);
        let (min, max) = (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0));
        let why = format!(
            "{min} to {max} different images at one position, expected 1, or the same times at each (by \
             TemporalPositionIdentifier, AcquisitionNumber or TriggerTime)"
        );
        return Err(Fault::new(POSITION, why));
    };
    for group in heights {
        group.sort_by(|a, b| {
            a.image.times[kind]
                .partial_cmp(&b.image.times[kind])
                .unwrap_or(std::cmp::Ordering::Equal)
        });
    }
    Ok(kind)
}

/// The vector from an image to the next one. Positions, not thicknesses, tell it.
fn step_between(images: &[StoredImage], plane: &Plane) -> Result<[f64; 3], Fault> {
    let position = |i: usize| images[i].image.plane.position;
    let last = images.len() - 1;
    if last == 0 {
        let why = "all images lie at one position, expected 2 or more positions";
        return Err(Fault::new(POSITION, why));
    }
    let normal = cross(plane.axes[0], plane.axes[1]);
    even_gaps(&(0..=last).map(|i| dot(position(i), normal)).collect::<Vec<_>>())?;
    let (first, end) = (position(0), position(last));
    let step: [f64; 3] = std::array::from_fn(|i| (end[i] - first[i]) / last as f64);
    let length = dot(step, step).sqrt();
    let deviation = |i: usize| {
        let off: [f64; 3] = std::array::from_fn(|a| position(i)[a] - first[a] - i as f64 * step[a]);
        dot(off, off).sqrt()
    };
    let by_deviation = |&a: &usize, &b: &usize| deviation(a).total_cmp(&deviation(b));
    let worst = (0..=last).max_by(by_deviation).unwrap_or(0);
    if deviation(worst) > rounding(length) {
        let why = format!(
            "image {} lies {:.4} mm beside its place in a grid, the largest deviation, expected even distances of \
             {length:.4} mm on a line",
            worst + 1,
            deviation(worst)
        );
        return Err(Fault::new(POSITION, why));
    }
    Ok(step)
}

/// How far a position may be off, between images of that distance: by three decimals of a millimetre in any case.
fn rounding(distance: f64) -> f64 {
    (ROUNDING * distance).max(1e-3)
}

/// Whether the gaps between images are those of a grid, or one is missing.
fn even_gaps(heights: &[f64]) -> Result<(), Fault> {
    let gaps: Vec<f64> = heights.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[sorted.len() / 2];
    let off = |gap: f64| (gap - usual).abs();
    let by_deviation = |a: &usize, b: &usize| off(gaps[*a]).total_cmp(&off(gaps[*b]));
    let worst = (0..gaps.len()).max_by(by_deviation).unwrap_or(0);
    // Both ends are rounded.
    if off(gaps[worst]) > 2.0 * rounding(usual) {
        let why = format!(
            "{:.4} mm between images {} and {}, the largest deviation from {usual:.4} mm between others, expected \
             even distances: an image may be missing",
            gaps[worst],
            worst + 1,
            worst + 2
        );
        return Err(Fault::new(POSITION, why));
    }
    Ok(())
}

/// Whether another step's images lie where those of the first one do.
fn same_positions(first: &[StoredImage], other: &[StoredImage], step: [f64; 3]) -> Result<(), Fault> {
    let limit = rounding(dot(step, step).sqrt());
    for (a, b) in first.iter().zip(other) {
        let (a, b) = (a.image.plane.position, b.image.plane.position);
        if a.iter().zip(b).any(|(a, b)| (a - b).abs() > limit) {
            return Err(Fault::new(
                POSITION,
                "times differ in their positions, expected the same ones",
            ));
        }
    }
    Ok(())
}

fn geometry(
    label: &FileLabel,
    images: &[StoredImage],
    slices: usize,
    plane: &Plane,
    step: [f64; 3],
) -> Result<Geometry, ReadError> {
    let format = &images[0].file.format;
    let depth = u32::try_from(slices).map_err(|_| label.error("images", "too many"))?;
    let ([_, _, distance], [_, _, direction]) = header::split_axes([[1.0; 3], [1.0; 3], step]);
    let normal = cross(plane.axes[0], plane.axes[1]);
    let angle = dot(direction, normal).clamp(-1.0, 1.0).acos().to_degrees();
    if angle > 0.05 {
        let path = label.asked.display();
        tracing::info!(%path, "images lie on a line {angle:.2}° off their normal (gantry tilt): the grid is sheared");
    }
    let [x, y] = plane.axes.map(|axis| axis.map(|v| v + 0.0));
    let spacing = [plane.spacing[0], plane.spacing[1], distance];
    let origin = images[0].image.plane.position;
    let geometry = header::geometry(
        &label.asked,
        &FIELDS,
        [format.columns, format.rows, depth],
        spacing,
        origin,
        [x, y, direction],
    )?;
    Ok(Geometry {
        frame: if plane.is_patient { Frame::Lps } else { Frame::World },
        unit: Some(LengthUnit::Millimetre),
        ..geometry
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_positions_are_even_and_missing_ones_are_not() {
        assert!(even_gaps(&[0.0, 0.333, 0.667, 1.0]).is_ok());
        assert!(even_gaps(&[0.0, 1000.0, 2001.0]).is_ok());
        let error = even_gaps(&[0.0, 0.3, 0.6, 1.2]).unwrap_err();
        assert!(
            error.why.starts_with("0.6000 mm between images 3 and 4"),
            "{}",
            error.why
        );
        assert!(even_gaps(&[0.0, 1.0, 2.01]).is_err());
    }
}
