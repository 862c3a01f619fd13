//! Segmentations (part 3, C.8.20): the frames of segments, which are mostly sparse, become one field of labels with names and colours.

use std::sync::Arc;

use isopeel_kernels::{SampleType, Samples};

use super::super::super::parallel::try_map;
use super::super::super::{
    Field, FileLocation, Findings, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError, ReadProgress, Source,
};
use super::super::header;
use super::data_set::Fault;
use super::frames::{Plane, cross, dot};
use super::grid::{FIELDS, OFF_GRID, POSITION};
use super::label::FileLabel;
use super::samples::Target;
use super::segments::Segmentation;
use super::source::StoredImage;

/// Maximum slices of a volume: a frame far away could claim any amount of memory.
const MAX_SLICES: f64 = 65_536.0;

/// Frames by their slices, with the segment of each.
struct SegmentSource {
    label: FileLabel,
    slices: Vec<Vec<StoredImage>>,
    threshold: Option<u32>,
    sample_type: SampleType,
    findings: Findings,
}

impl std::fmt::Debug for SegmentSource {
    /// Omits the identifiers of series and images.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SegmentSource({} slices)", self.slices.len())
    }
}

/// Opens the volume of all frames of a segmentation.
pub(super) fn open(
    label: &FileLabel,
    images: Vec<StoredImage>,
    segmentation: &Segmentation,
) -> Result<OpenedFile, ReadError> {
    let fail = |fault: Fault| label.error(fault.field, fault.why);
    let file = Arc::clone(&images[0].file);
    let plane = images[0].image.plane;
    let mut notices = Notices::default();
    segmentation.notice().into_iter().for_each(|notice| notices.add(notice));
    let (slices, first, distance) = slices(images).map_err(fail)?;
    let normal = cross(plane.axes[0], plane.axes[1]);
    let [x, y] = plane.axes.map(|axis| axis.map(|v| v + 0.0));
    let depth = u32::try_from(slices.len()).map_err(|_| label.error("images", "too many"))?;
    let geometry = header::geometry(
        &label.asked,
        &FIELDS,
        [file.format.columns, file.format.rows, depth],
        [plane.spacing[0], plane.spacing[1], distance],
        first,
        [x, y, normal.map(|v| v + 0.0)],
    )?;
    let largest = segmentation.labels.last().map_or(0, |label| label.value);
    let sample_type = if largest < 256 && (segmentation.threshold.is_some() || file.format.bytes == 1) {
        SampleType::U8
    } else {
        SampleType::U16
    };
    let field = Field {
        name: "segments".to_owned(),
        stored_type: file.format.type_name(),
        sample_type,
        missing: None,
        unit: None,
        labels: segmentation.labels.clone(),
        declares_labels: true,
        source: Arc::new(SegmentSource {
            label: label.clone(),
            slices,
            threshold: segmentation.threshold,
            sample_type,
            findings: Findings::default(),
        }),
    };
    Ok(OpenedFile {
        geometry: Geometry {
            frame: if plane.is_patient { Frame::Lps } else { Frame::World },
            unit: Some(LengthUnit::Millimetre),
            ..geometry
        },
        steps: 1,
        uneven: None,
        axes: None,
        times: None,
        fields: vec![field],
        notices,
    })
}

/// Frames by slice, the first slice's position, and the distance of slices.
type Slices = (Vec<Vec<StoredImage>>, [f64; 3], f64);

/// Sorts frames into slices. Slices without a segment have no frame.
fn slices(images: Vec<StoredImage>) -> Result<Slices, Fault> {
    let plane = images[0].image.plane;
    let normal = cross(plane.axes[0], plane.axes[1]);
    let height = |plane: &Plane| dot(plane.position, normal);
    let mut heights: Vec<f64> = images.iter().map(|image| height(&image.image.plane)).collect();
    heights.sort_by(f64::total_cmp);
    let near = 1e-3 * plane.spacing[0].min(plane.spacing[1]);
    let gaps = heights
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|&gap| gap > near);
    let stated = images[0].image.distance.filter(|&distance| distance > near);
    let smallest = gaps.fold(f64::INFINITY, f64::min);
    let distance = match stated {
        Some(stated) => stated,
        None if smallest.is_finite() => smallest,
        None => {
            return Err(Fault::new(
                POSITION,
                "all frames lie at one position, expected 2 or more positions",
            ));
        }
    };
    let (low, high) = (heights[0], heights[heights.len() - 1]);
    let count = ((high - low) / distance).round() + 1.0;
    if !(2.0..=MAX_SLICES).contains(&count) {
        let why =
            format!("{count} slices of {distance} mm from the first frame to the last, expected 2 to {MAX_SLICES}");
        return Err(Fault::new(POSITION, why));
    }
    let mut slices = vec![Vec::new(); count as usize];
    let mut first = images[0].image.plane.position;
    for image in images {
        let at = (height(&image.image.plane) - low) / distance;
        let beside: [f64; 3] = std::array::from_fn(|i| {
            image.image.plane.position[i] - first[i] - (height(&image.image.plane) - dot(first, normal)) * normal[i]
        });
        let off = dot(beside, beside).sqrt();
        if (at - at.round()).abs() > OFF_GRID || off > OFF_GRID * plane.spacing[0].min(plane.spacing[1]) {
            let why = format!(
                "a frame lies between slices of {distance} mm, or {off:.4} mm beside the others, expected all of them on a grid"
            );
            return Err(Fault::new(POSITION, why));
        }
        if at.round() == 0.0 {
            first = image.image.plane.position;
        }
        slices[at.round() as usize].push(image);
    }
    Ok((slices, first, distance))
}

impl Source for SegmentSource {
    fn stored_bytes(&self) -> u64 {
        self.slices.iter().flatten().map(StoredImage::bytes).sum()
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        let first = self.slices.iter().flatten().next();
        first.map(|image| image.file.location.clone()).into_iter().collect()
    }

    fn notices(&self) -> Notices {
        self.findings.notices()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        if step > 0 {
            return Err(self.label.error("step", format!("{step}, expected 0")));
        }
        let slices = try_map(self.slices.len(), |i| {
            progress.go_on(&self.label.asked)?;
            self.slice(&self.slices[i], progress)
        })?;
        let overlaps: u64 = slices.iter().map(|(_, overlaps)| overlaps).sum();
        if overlaps > 0 {
            let notice =
                format!("segments overlap in {overlaps} samples: each has the number of the last of its segments");
            self.findings.report(&self.label.asked, notice);
        }
        let values = slices.into_iter().flat_map(|(values, _)| values);
        Ok(match self.sample_type {
            SampleType::U8 => Samples::U8(values.map(|value| value as u8).collect()),
            _ => Samples::U16(values.collect()),
        })
    }
}

impl SegmentSource {
    /// Returns the labels of a slice, and the number of samples that are in several segments.
    fn slice(&self, frames: &[StoredImage], progress: &ReadProgress) -> Result<(Vec<u16>, u64), ReadError> {
        let Some(first) = self.slices.iter().flatten().next() else {
            return Ok((Vec::new(), 0));
        };
        let mut values = vec![0u16; first.file.format.samples() as usize];
        let mut overlaps = 0;
        let target = Target {
            sample_type: SampleType::U16,
            missing: None,
        };
        for frame in frames {
            let Samples::U16(stored) = frame.read(target, progress)? else {
                return Err(self.label.error("data", "no whole numbers, expected those of segments"));
            };
            for (value, stored) in values.iter_mut().zip(stored) {
                let own = match self.threshold {
                    None => stored,
                    Some(threshold) if u32::from(stored) >= threshold => frame.image.segment.unwrap_or(1),
                    Some(_) => 0,
                };
                if own > 0 {
                    overlaps += u64::from(*value > 0 && *value != own);
                    *value = own;
                }
            }
        }
        Ok((values, overlaps))
    }
}
