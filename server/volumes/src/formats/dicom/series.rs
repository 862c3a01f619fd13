//! Makes volumes of the images of a folder: series, stacks, steps and the grid.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use super::super::super::{Field, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use super::super::FolderVolume;
use super::super::header;
use super::data_set::Fault;
use super::frames::{Image, Plane, cross, dot};
use super::grid::{FIELDS, OFF_GRID, POSITION};
use super::image::{Found, ImageFile};
use super::label::FileLabel;
use super::samples::{Color, Target};
use super::segmentation;
use super::source::{DicomSamples, StoredImage};

/// Relative rounding of positions, spacings and directions.
const ROUNDING: f64 = 1e-3;
/// Maximum stacks of a series; real ones have a few.
const MAX_STACKS: usize = 100;

/// Index of the only one of an image's times that is in milliseconds; the others are numbers.
const TRIGGER_TIME: usize = 2;

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
    /// Why the series is refused, if it is.
    refused: Option<ReadError>,
}

/// Makes volumes of images, in the order of the numbers of their series. A series without a volume is skipped with a notice, if there are
/// others.
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
    if single > 0 {
        let notice = format!("{single} single images beside it are passed over: they are no volume");
        volumes.iter_mut().for_each(|(.., file)| file.notices.add(&notice));
    }
    for error in refused {
        let notice = format!("another series is passed over: {}: {}", error.field, error.why);
        volumes.iter_mut().for_each(|(.., file)| file.notices.add(&notice));
    }
    Ok(titled(volumes))
}

/// Names volumes by number and modality, which do not identify the patient.
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
    if let Some(segmentation) = &file.segmentation {
        return segmentation::open(label, stack.images, segmentation);
    }
    let mut notices = Notices::default();
    let repairs = stack.images.iter().flat_map(|image| &image.file.repairs);
    repairs.for_each(|repair| notices.add(*repair));
    let (images, steps, kind) = arrange(stack.images, &mut notices).map_err(fail)?;
    let slices = images.len() / steps;
    let axis = step_between(&images[..slices], &plane, &mut notices).map_err(fail)?;
    for step in images.chunks(slices).skip(1) {
        same_positions(&images[..slices], step, axis).map_err(fail)?;
    }
    let geometry = geometry(label, &images, slices, (&plane, axis), &mut notices)?;
    if file.format.color != Color::Grey {
        notices.add("colours become their luminance: 0.2126 red + 0.7152 green + 0.0722 blue");
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
        declares_labels: false,
        source: Arc::new(DicomSamples::new(label.clone(), images, slices, target)),
    };
    Ok(OpenedFile {
        geometry,
        steps,
        uneven: None,
        axes: None,
        times,
        fields: vec![field],
        notices,
    })
}

/// Returns the times of the steps: trigger times in milliseconds, or numbers. No tag with a date is read.
fn times(images: &[StoredImage], slices: usize, kind: usize) -> Option<TimeAxis> {
    let firsts = images.iter().step_by(slices);
    let values: Vec<f64> = firsts.map(|first| first.image.times[kind]).collect::<Option<_>>()?;
    if kind == TRIGGER_TIME {
        return TimeAxis::listed(values, "ms", None);
    }
    let numbers: Vec<u64> = values.iter().map(|value| value.max(0.0) as u64).collect();
    TimeAxis::numbers(&numbers, 1)
}

/// Orders images by step, and within a step along the normal. Returns them with the number of steps, and the kind of time that
/// distinguishes the steps.
fn arrange(
    mut images: Vec<StoredImage>,
    notices: &mut Notices,
) -> Result<(Vec<StoredImage>, usize, Option<usize>), Fault> {
    let plane = images[0].image.plane;
    let normal = cross(plane.axes[0], plane.axes[1]);
    let height = |image: &StoredImage| dot(image.image.plane.position, normal);
    images.sort_by(|a, b| height(a).total_cmp(&height(b)));
    let same = ROUNDING * plane.spacing[0].min(plane.spacing[1]);
    let before = images.len();
    // The position is a part of the identity: some writers give all their images the same identifier.
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
        notices.add(format!("{} copies of images are passed over", before - kept));
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

/// Sorts the images at each position by time, and returns the kind of time. Each time must have an image at every position.
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

/// Returns the vector from an image to the next one, by their positions, not by their thickness.
fn step_between(images: &[StoredImage], plane: &Plane, notices: &mut Notices) -> Result<[f64; 3], Fault> {
    let position = |i: usize| images[i].image.plane.position;
    let last = images.len() - 1;
    if last == 0 {
        let why = "all images lie at one position, expected 2 or more positions";
        return Err(Fault::new(POSITION, why));
    }
    let normal = cross(plane.axes[0], plane.axes[1]);
    check_gaps(&(0..=last).map(|i| dot(position(i), normal)).collect::<Vec<_>>())?;
    let (first, end) = (position(0), position(last));
    let step: [f64; 3] = std::array::from_fn(|i| (end[i] - first[i]) / last as f64);
    let length = dot(step, step).sqrt();
    let deviation = |i: usize| {
        let off: [f64; 3] = std::array::from_fn(|a| position(i)[a] - first[a] - i as f64 * step[a]);
        dot(off, off).sqrt()
    };
    let by_deviation = |&a: &usize, &b: &usize| deviation(a).total_cmp(&deviation(b));
    let worst = (0..=last).max_by(by_deviation).unwrap_or(0);
    let limit = OFF_GRID * length.min(plane.spacing[0]).min(plane.spacing[1]);
    if deviation(worst) > limit.max(rounding(length)) {
        let why = format!(
            "image {} lies {:.4} mm beside its place in a grid, the largest deviation, expected even distances of \
             {length:.4} mm on a line, up to {limit:.4} mm",
            worst + 1,
            deviation(worst)
        );
        return Err(Fault::new(POSITION, why));
    }
    if deviation(worst) > rounding(length) {
        notices.add(format!(
            "positions of images are uneven by up to {:.4} mm (image {}), as if rounded: they are taken to be {length:.4} mm apart on a line",
            deviation(worst),
            worst + 1
        ));
    }
    Ok(step)
}

/// Returns the allowed deviation of a position, between images at this distance: at least three decimals of a millimetre.
fn rounding(distance: f64) -> f64 {
    (ROUNDING * distance).max(1e-3)
}

/// Checks that no images are missing between others: a gap that is about a multiple of the usual distance is an error.
fn check_gaps(heights: &[f64]) -> Result<(), Fault> {
    let gaps: Vec<f64> = heights.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[sorted.len() / 2];
    let missing = |gap: f64| {
        let times = (gap / usual).round();
        let is_near = (gap - times * usual).abs() <= 2.0 * OFF_GRID * usual;
        if times >= 2.0 && is_near { times - 1.0 } else { 0.0 }
    };
    let worst = (0..gaps.len()).max_by(|a, b| missing(gaps[*a]).total_cmp(&missing(gaps[*b])));
    let Some((worst, count)) = worst
        .map(|at| (at, missing(gaps[at])))
        .filter(|(_, count)| *count > 0.0)
    else {
        return Ok(());
    };
    let why = format!(
        "{:.4} mm between images {} and {}, {usual:.4} mm between others: {count} seem to be missing there; expected even distances",
        gaps[worst],
        worst + 1,
        worst + 2
    );
    Err(Fault::new(POSITION, why))
}

/// Checks that the images of another step are at the positions of those of the first step.
fn same_positions(first: &[StoredImage], other: &[StoredImage], step: [f64; 3]) -> Result<(), Fault> {
    let length = dot(step, step).sqrt();
    let limit = (OFF_GRID * length).max(rounding(length));
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
    (plane, step): (&Plane, [f64; 3]),
    notices: &mut Notices,
) -> Result<Geometry, ReadError> {
    let format = &images[0].file.format;
    let depth = u32::try_from(slices).map_err(|_| label.error("images", "too many"))?;
    let ([_, _, distance], [_, _, direction]) = header::split_axes([[1.0; 3], [1.0; 3], step]);
    let normal = cross(plane.axes[0], plane.axes[1]);
    let angle = dot(direction, normal).clamp(-1.0, 1.0).acos().to_degrees();
    if angle > 0.05 {
        notices.add(format!(
            "images lie on a line {angle:.2}° off their normal (gantry tilt): the grid is sheared"
        ));
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
    fn a_gap_near_a_multiple_of_the_others_is_a_missing_image() {
        for heights in [
            &[0.0, 0.333, 0.667, 1.0][..],
            &[0.0, 1000.0, 2001.0],
            &[0.0, 0.62, 1.25, 1.87, 2.5],
            &[0.0, 0.6, 1.3, 1.9, 2.5, 3.1],
            &[0.0, 1.0],
        ] {
            assert!(check_gaps(heights).is_ok(), "{heights:?}");
        }
        let error = check_gaps(&[0.0, 0.3, 0.6, 1.2]).unwrap_err();
        assert!(
            error.why.starts_with("0.6000 mm between images 3 and 4") && error.why.contains("1 seem to be missing"),
            "{}",
            error.why
        );
        assert!(check_gaps(&[0.0, 0.62, 1.25, 2.49, 3.12]).is_err());
        assert!(check_gaps(&[0.0, 1.0, 2.0, 6.0]).is_err());
    }
}
