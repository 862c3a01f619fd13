//! `isopeel info`: describes a dataset. Needs no device.

use std::io::Write;
use std::path::Path;

use isopeel_geometry::DVec3;
use isopeel_kernels::{DerivedFeature, Histogram, VectorFeature};
use isopeel_view::{FeatureName, OpeningIso, VectorName};
use isopeel_volumes::statistics::FieldStatistics;
use isopeel_volumes::vectors::vectors;
use isopeel_volumes::{AxisKind, Dataset, Field, Geometry, LengthUnit, ReadError, open_dataset};
use serde::Serialize;

use crate::service::{AxisInfo, LabelInfo, TimesInfo};

/// Maximum number of labels of a field in the text output.
const SHOWN_LABELS: usize = 32;

/// Why a dataset cannot be described.
#[derive(Debug, thiserror::Error)]
pub enum InfoError {
    /// The dataset cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The output cannot be written.
    #[error("the output cannot be written")]
    Write(#[from] std::io::Error),
}

/// Prints a description of a dataset for users.
///
/// # Errors
/// The dataset cannot be read, or `out` cannot be written.
pub fn run(path: &Path, out: &mut dyn Write) -> Result<(), InfoError> {
    let dataset = open_dataset(path)?;
    let report = Report::of(&dataset)?;
    report.print(&dataset, out)?;
    Ok(())
}

/// Prints a description of a dataset as one JSON object, with complete histograms.
///
/// # Errors
/// As [`run`].
pub fn run_json(path: &Path, out: &mut dyn Write) -> Result<(), InfoError> {
    let report = Report::of(&open_dataset(path)?)?;
    serde_json::to_writer(&mut *out, &report).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}

/// The description of a dataset.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Report {
    title: String,
    layout: &'static str,
    /// Samples along x, y, z.
    dims: [u32; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    direction: [[f64; 3]; 3],
    frame: &'static str,
    unit: Option<&'static str>,
    steps: u32,
    /// Copyright, and notices about repairs, assumptions and missing information of the grid, separated by line breaks.
    notice: Option<String>,
    times: Option<TimesInfo>,
    /// The axes that the file describes; absent if it describes none.
    #[serde(skip_serializing_if = "Option::is_none")]
    axes: Option<[Option<AxisInfo>; 3]>,
    fields: Vec<FieldReport>,
    /// Names of the features that the device can compute: first those that are derived from the surface's own field, then those of vector
    /// fields.
    features: Vec<String>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct FieldReport {
    name: String,
    stored_type: String,
    sample_type: &'static str,
    /// Bytes of one time step on the device.
    bytes: u64,
    unit: Option<String>,
    /// Names and colours of values, if this is a field of labels.
    labels: Option<Vec<LabelInfo>>,
    missing: Option<f32>,
    /// Range of values in step 0. All values below are of step 0, too.
    range: Option<[f32; 2]>,
    histogram: Vec<u64>,
    /// Isovalue with which a viewer opens the field.
    opening_iso: OpeningIso,
    missing_samples: u64,
    not_finite_samples: u64,
}

impl Report {
    fn of(dataset: &Dataset) -> Result<Self, ReadError> {
        let Geometry {
            dims,
            spacing,
            origin,
            direction,
            frame,
            unit,
        } = dataset.geometry;
        Ok(Self {
            title: dataset.title.clone(),
            layout: dataset.layout,
            dims,
            spacing,
            origin,
            direction,
            frame: frame.name(),
            unit: unit.map(LengthUnit::symbol),
            steps: dataset.steps,
            times: dataset.times.as_ref().map(|times| TimesInfo::new(times, 0)),
            axes: AxisInfo::all(dataset),
            fields: dataset.fields.iter().map(FieldReport::of).collect::<Result<_, _>>()?,
            // Comes after `FieldReport::of`, which reads the samples and may add notices.
            notice: dataset.notice(),
            features: features_of(dataset),
        })
    }

    fn print(&self, dataset: &Dataset, out: &mut dyn Write) -> std::io::Result<()> {
        let [x, y, z] = self.dims;
        writeln!(out, "{}", self.title)?;
        writeln!(out, "  read as     {}", self.layout)?;
        writeln!(
            out,
            "  dimensions  {x} x {y} x {z} = {} samples",
            dataset.geometry.sample_count()
        )?;
        let unit = self.unit.map(|unit| format!(" {unit}")).unwrap_or_default();
        writeln!(out, "  spacing     {}{unit}", triple(self.spacing))?;
        writeln!(out, "  frame       {}", self.frame)?;
        if self.origin != [0.0; 3] {
            writeln!(out, "  origin      {}", triple(self.origin))?;
        }
        if !dataset.geometry.is_axis_aligned() {
            for (axis, vector) in ["x", "y", "z"].iter().zip(self.direction) {
                writeln!(out, "  axis {axis}      {}", triple(vector))?;
            }
        }
        if self.steps > 1 {
            writeln!(
                out,
                "  steps       {} (ranges and histograms are those of step 0)",
                self.steps
            )?;
        }
        for line in self.notice.iter().flat_map(|notice| notice.lines()) {
            writeln!(out, "  notice      {line}")?;
        }
        if let Some(times) = &dataset.times {
            let (first, last) = (times.label(0), times.label(self.steps - 1));
            let calendar = times
                .calendar()
                .map(|name| format!(" ({name} calendar)"))
                .unwrap_or_default();
            writeln!(out, "  times       {first} to {last}{calendar}")?;
        }
        for line in axis_lines(dataset) {
            writeln!(out, "{line}")?;
        }
        for field in &self.fields {
            field.print(out)?;
        }
        writeln!(out, "features")?;
        for feature in &self.features {
            writeln!(out, "  {feature}")?;
        }
        Ok(())
    }
}

/// Returns a line for each axis that the file describes: name, kind, first and last position, and unit.
fn axis_lines(dataset: &Dataset) -> Vec<String> {
    let ends = [[0; 3], dataset.geometry.dims.map(|n| n.saturating_sub(1))];
    let line = |axis: usize| {
        let scale = dataset.axes.as_deref()?.get(axis)?.as_ref()?;
        let position = |sample: [u32; 3]| match &scale.positions {
            Some(positions) => positions.get(sample[axis] as usize).copied(),
            None => {
                let world = dataset.sample_space().world(DVec3::from_array(sample.map(f64::from)));
                Some(if scale.points_down { -world[axis] } else { world[axis] })
            }
        };
        let [first, last] = ends.map(position);
        let unit = scale.unit.as_deref().map(|unit| format!(" {unit}")).unwrap_or_default();
        let kind = match scale.kind {
            AxisKind::Other => String::new(),
            kind => format!(" ({})", kind.name()),
        };
        let (name, letter) = (&scale.name, ["x", "y", "z"][axis]);
        Some(format!(
            "  along {letter}     {name}{kind}: {} to {}{unit}",
            number(rounded(first?)),
            number(rounded(last?))
        ))
    };
    (0..3).filter_map(line).collect()
}

/// Returns the names of the features that the device can compute.
fn features_of(dataset: &Dataset) -> Vec<String> {
    let derived = DerivedFeature::ALL.iter().map(|feature| feature.name().to_owned());
    let of_vectors = vectors(&dataset.field_names()).into_iter().flat_map(|components| {
        let components = components.map(str::to_owned);
        let name = move |&feature| VectorName::new(feature, components.clone());
        VectorFeature::ALL.iter().map(name).collect::<Vec<_>>()
    });
    let of_vectors = of_vectors.map(|vector| FeatureName::Vector(Box::new(vector)).as_str().to_owned());
    derived.chain(of_vectors).collect()
}

impl FieldReport {
    fn of(field: &Field) -> Result<Self, ReadError> {
        let samples = field.source.load(0)?;
        let statistics = FieldStatistics::of(&samples, field.missing);
        let histogram = Histogram {
            range: statistics.range.unwrap_or_default(),
            bins: statistics.bins,
        };
        Ok(Self {
            name: field.name.clone(),
            stored_type: field.stored_type.clone(),
            sample_type: field.sample_type.name(),
            bytes: (samples.len() * field.sample_type.bytes()) as u64,
            unit: field.unit.clone(),
            labels: LabelInfo::of(field),
            missing: field.missing,
            range: statistics.range,
            opening_iso: OpeningIso::of(&histogram, field.unit.as_deref(), field.has_labels()),
            histogram: histogram.bins,
            missing_samples: statistics.missing,
            not_finite_samples: statistics.not_finite,
        })
    }

    fn print(&self, out: &mut dyn Write) -> std::io::Result<()> {
        let unit = self.unit.as_ref().map(|u| format!(" {u}")).unwrap_or_default();
        writeln!(out, "field {}", self.name)?;
        writeln!(
            out,
            "  type        {} in the file, {} on the device ({})",
            self.stored_type,
            self.sample_type,
            size(self.bytes)
        )?;
        match self.range {
            Some([low, high]) => {
                writeln!(out, "  range       {} to {}{unit}", number(low), number(high))?;
                writeln!(
                    out,
                    "  histogram   {}  (64 bins, logarithmic)",
                    sparkline(&self.histogram)
                )?;
                let OpeningIso { iso, explanation, .. } = &self.opening_iso;
                writeln!(out, "  isovalue    {}{unit} by default: {explanation}", number(*iso))?;
            }
            None => writeln!(out, "  range       none: no sample has a value")?,
        }
        if let Some(missing) = self.missing {
            writeln!(
                out,
                "  missing     {} samples, marked by the value {}",
                self.missing_samples,
                number(missing)
            )?;
        }
        let labels = self.labels.as_deref().unwrap_or_default();
        for label in labels.iter().take(SHOWN_LABELS) {
            let stored = label.stored.as_ref().map(|stored| format!(" ({stored} in the file)"));
            let color = label.color.as_ref().map(|color| format!(", {color}"));
            writeln!(
                out,
                "  label       {}{}: {}{}",
                number(label.value),
                stored.unwrap_or_default(),
                label.name.as_deref().unwrap_or("no name"),
                color.unwrap_or_default()
            )?;
        }
        if let Some(omitted) = labels.len().checked_sub(SHOWN_LABELS).filter(|omitted| *omitted > 0) {
            writeln!(out, "  labels      {omitted} more, in --json")?;
        }
        if self.not_finite_samples > 0 {
            writeln!(out, "  not finite  {} samples", self.not_finite_samples)?;
        }
        Ok(())
    }
}

/// Formats three numbers with eight digits.
fn triple(values: [f64; 3]) -> String {
    values.map(|v| number(rounded(v))).join(" ")
}

/// Rounds a number to eight significant digits, because further digits of values from single precision are noise. Converts -0 to 0.
fn rounded(value: f64) -> f64 {
    // Cannot fail: the text is a formatted number.
    format!("{value:.7e}").parse().unwrap_or(value) + 0.0
}

/// Formats a number: with a power of ten if it would have many zeros, and otherwise in full.
fn number<T: Copy + Into<f64> + std::fmt::Display + std::fmt::LowerExp>(value: T) -> String {
    let size = value.into().abs();
    if size == 0.0 || (1e-5..1e9).contains(&size) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Formats a number of bytes in MiB, or in KiB below a tenth of a MiB.
fn size(bytes: u64) -> String {
    const MIB: f64 = 1_048_576.0;
    let bytes = bytes as f64;
    if bytes < MIB / 10.0 {
        format!("{:.1} KiB", bytes / 1024.0)
    } else {
        format!("{:.1} MiB", bytes / MIB)
    }
}

/// Formats 256 bins as 64 characters. The scale is logarithmic, because the background dominates most volumes.
fn sparkline(bins: &[u64]) -> String {
    const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let sums: Vec<f64> = bins
        .chunks(bins.len().div_ceil(64))
        .map(|c| (c.iter().sum::<u64>() as f64).ln_1p())
        .collect();
    let top = sums.iter().copied().fold(0.0, f64::max);
    // Rounds up, so that a bin with a single sample has a visible bar.
    sums.iter()
        .map(|s| BARS[if top > 0.0 { (s / top * 8.0).ceil() as usize } else { 0 }])
        .collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_volumes::{AxisScale, testing};

    use super::*;

    fn write_volume(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("ramp.nrrd");
        let mut file = b"NRRD0004\ntype: short\ndimension: 3\nsizes: 4 4 4\nspacings: 1 1 2.5\nendian: little\n\
            encoding: raw\nsample units: \"HU\"\n_FillValue:=-1\n\n"
            .to_vec();
        (-1i16..63).for_each(|v| file.extend(v.to_le_bytes()));
        std::fs::write(&path, file).unwrap();
        path
    }

    #[test]
    fn text_says_what_the_volume_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut out = Vec::new();
        run(&write_volume(folder.path()), &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        for line in [
            "dimensions  4 x 4 x 4 = 64 samples",
            "spacing     1 1 2.5",
            "field ramp",
            "short in the file, i16 on the device",
            "range       0 to 62 HU",
            "isovalue    30.515625 HU by default: between two classes of values",
            "missing     1 samples, marked by the value -1",
            "features\n  gradient-magnitude\n  mean-curvature\n",
        ] {
            assert!(text.contains(line), "{line:?} in\n{text}");
        }
        assert!(
            !text.contains("origin") && !text.contains("axis"),
            "trivial, so not shown:\n{text}"
        );
    }

    #[test]
    fn interpolation_onto_an_even_grid_is_noticed() {
        let uneven = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes/xarray-uneven.zarr");
        let mut out = Vec::new();
        run(&uneven, &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(
            text.contains("notice      samples are interpolated onto an even grid")
                && text.contains("\"level\" is not even"),
            "{text}"
        );
    }

    #[test]
    fn positions_have_neither_noise_nor_a_negative_zero() {
        let axis = |positions: Option<Vec<f64>>| AxisScale {
            name: "depth".to_owned(),
            unit: Some("m".to_owned()),
            kind: AxisKind::Depth,
            points_down: positions.is_none(),
            positions,
        };
        let noisy = axis(Some(vec![f64::from(0.1f32), f64::from(0.5f32), 1.0]));
        let mut dataset = testing::dataset("sea", [3, 3, 3], &["salt"]);
        dataset.axes = Some(Arc::new([Some(noisy), None, Some(axis(None))]));
        let lines = axis_lines(&dataset);
        assert_eq!(lines[0], "  along x     depth (depth): 0.1 to 1 m");
        assert_eq!(lines[1], "  along z     depth (depth): 0 to -2 m");
    }

    #[test]
    fn json_has_the_whole_histogram() {
        let folder = tempfile::tempdir().unwrap();
        let mut out = Vec::new();
        run_json(&write_volume(folder.path()), &mut out).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&out).unwrap();
        let field = &json["fields"][0];
        assert_eq!(field["histogram"].as_array().unwrap().len(), 256);
        assert_eq!(field["range"], serde_json::json!([0.0, 62.0]));
        assert_eq!(field["openingIso"]["reason"], "whole-histogram");
        assert_eq!(
            (&json["dims"], &field["missingSamples"]),
            (&serde_json::json!([4, 4, 4]), &1.into())
        );
    }

    #[test]
    fn numbers_are_read_without_counting_zeros() {
        assert_eq!(
            [3.014_296_6e-10_f32, 9.969_21e36, 0.0, -300.5, 1e-4, 65_535.0].map(number),
            ["3.0142966e-10", "9.96921e36", "0", "-300.5", "0.0001", "65535"]
        );
        assert_eq!(triple([1.060_000_016_954_21, 0.1, 1e-9]), "1.06 0.1 1e-9");
        assert_eq!([500, 32_000, 2_916_000].map(size), ["0.5 KiB", "31.2 KiB", "2.8 MiB"]);
    }

    #[test]
    fn sparklines() {
        let mut bins = vec![0; 256];
        bins[0] = 1_000_000;
        bins[255] = 1;
        let line: Vec<char> = sparkline(&bins).chars().collect();
        assert_eq!((line.len(), line[0], line[1], line[63]), (64, '█', ' ', '▁'));
    }
}
