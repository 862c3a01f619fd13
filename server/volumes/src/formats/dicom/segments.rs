//! Description of the segments of a segmentation (part 3, C.8.20.2): numbers, names, colours.

use super::super::super::{Label, MAX_LABELS};
use super::data_set::{DataSet, Fault, tag};
use super::frames::dot;

/// Segments of a file.
#[derive(Clone, Debug)]
pub struct Segmentation {
    pub labels: Vec<Label>,
    /// Smallest stored value of samples that belong to the segment of their frame; `None` if stored values are the numbers of segments.
    pub threshold: Option<u32>,
}

impl Segmentation {
    /// Reads the segments. `None` for a file without segments.
    pub fn of(set: &DataSet) -> Result<Option<Self>, Fault> {
        let segments = set.items(tag::SEGMENTS);
        if segments.is_empty() {
            return Ok(None);
        }
        let threshold = match set.text(tag::SEGMENTATION_TYPE).as_deref() {
            Some("LABELMAP") => None,
            Some("FRACTIONAL") => {
                let maximum = set.short(tag::MAX_FRACTION)?.unwrap_or(255);
                Some(u32::from(maximum).div_ceil(2).max(1))
            }
            _ => Some(1),
        };
        let mut labels = Vec::new();
        for segment in segments.iter().take(MAX_LABELS) {
            let Some(number) = segment.short(tag::SEGMENT_NUMBER)? else {
                return Err(Fault::of(
                    tag::SEGMENT_NUMBER,
                    "missing, expected the number of each segment",
                ));
            };
            let name = segment.text(tag::SEGMENT_LABEL).unwrap_or_default();
            labels.push(Label::new(number, &name, color(segment)));
        }
        labels.sort_by_key(|label| label.value);
        Ok(Some(Self { labels, threshold }))
    }

    /// Returns the notice of the threshold, if samples are fractions.
    pub fn notice(&self) -> Option<String> {
        let threshold = self.threshold.filter(|&threshold| threshold > 1)?;
        Some(format!(
            "the segmentation has fractions: samples of at least half, {threshold}, belong to their segment, others to none"
        ))
    }
}

/// Returns the colour that the file recommends, converted from CIE L*a*b* (D50) to sRGB.
fn color(segment: &DataSet) -> Option<[u8; 3]> {
    let stored: [f64; 3] = segment.shorts(tag::SEGMENT_COLOR)?.try_into().ok()?;
    let [l, a, b] = [stored[0] * 100.0, stored[1] * 255.0, stored[2] * 255.0].map(|v| v / 65535.0);
    let y = (l + 16.0) / 116.0;
    let linear = |f: f64| {
        if f > 6.0 / 29.0 {
            f.powi(3)
        } else {
            (f - 4.0 / 29.0) * 3.0 * (6.0f64 / 29.0).powi(2)
        }
    };
    let xyz = [
        0.964_22 * linear(y + (a - 128.0) / 500.0),
        linear(y),
        0.825_21 * linear(y - (b - 128.0) / 200.0),
    ];
    let rows = [
        [3.133_856_1, -1.616_866_7, -0.490_614_6],
        [-0.978_768_4, 1.916_141_5, 0.033_454_0],
        [0.071_945_3, -0.228_991_4, 1.405_242_7],
    ];
    Some(rows.map(|row| {
        let light = dot(row, xyz).clamp(0.0, 1.0);
        let value = if light <= 0.003_130_8 {
            12.92 * light
        } else {
            1.055 * light.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * value).round() as u8
    }))
}
