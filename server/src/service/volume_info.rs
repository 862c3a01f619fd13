//! The description of a volume, as JSON: an answer of REST, and part of the stream's `opened`.

use std::collections::BTreeMap;
use std::sync::Arc;

use isopeel_extraction::dataset_views::opening_edit;
use isopeel_extraction::fields;
use isopeel_extraction::{ALWAYS_DESCRIBED, WorkError};
use isopeel_geometry::UnevenAxes;
use isopeel_kernels::{DerivedFeature, Histogram, SampleType, VectorFeature};
use isopeel_view::{Edit, FeatureName, FieldExpression, OpeningIso, VectorName};
use isopeel_volumes::vectors::vectors;
use isopeel_volumes::{AxisScale, Dataset, Field, Label, LengthUnit, TimeAxis, VolumeStep};
use serde::Serialize;
use utoipa::ToSchema;

use super::DeviceWorker;

/// A volume: the description of one time step for the editor.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct VolumeInfo {
    /// Stable id in URLs and messages.
    pub id: String,
    /// Title for users.
    pub title: String,
    /// Positions of the samples.
    pub geometry: GeometryInfo,
    /// Time steps, at least 1.
    pub steps: u32,
    /// The time step that ranges and histograms describe.
    pub step: u32,
    /// Meaning of the positions along the axes x, y and z; null for an axis that the file does not describe; absent if it describes none.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<[Option<AxisInfo>; 3]>,
    /// Times of the steps, if the file states them and there are several steps.
    pub times: Option<TimesInfo>,
    /// Fields, the main one first.
    pub fields: Vec<FieldInfo>,
    /// Features, besides `none`, whose values are known: those derived from a field (here from the main one), then every field.
    pub features: Vec<FieldInfo>,
    /// Vector fields, known by the names of their components, with the features that are computed from them.
    pub vectors: Vec<VectorInfo>,
    /// Notices to be shown with the data, one a line: copyright and source; what the file's reader repaired, assumed or interpolated; and
    /// values that the device's type cannot hold, once they were read.
    pub notice: Option<String>,
    /// Edit that the viewer opens with, if the volume comes with one.
    pub opening: Option<Edit>,
}

/// Positions of samples: `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`. Along an axis with `positions`, the entry of
/// `positions[axis]` at the index takes the place of `spacing[axis] · index[axis]`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS), ts(rename = "Geometry"))]
pub struct GeometryInfo {
    /// Samples along x (fastest), y, z.
    #[schema(min_items = 3, max_items = 3)]
    pub dims: [u32; 3],
    /// World units between samples; along an uneven axis their mean.
    #[schema(min_items = 3, max_items = 3)]
    pub spacing: [f64; 3],
    /// Position of each sample along the uneven axes among x, y, z, ascending, world units from the first one; null for an even axis.
    /// Absent if all axes are even. If present, distances, areas and errors of surfaces are upper bounds: those in a grid whose cells are
    /// all as large as the largest along each axis.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 3, max_items = 3)]
    pub positions: Option<[Option<Vec<f64>>; 3]>,
    /// World position of sample (0, 0, 0).
    #[schema(min_items = 3, max_items = 3)]
    pub origin: [f64; 3],
    /// Unit vectors of the axes x, y, z in the world.
    #[schema(min_items = 3, max_items = 3)]
    pub direction: [[f64; 3]; 3],
    /// Directions of the world's axes: `LPS` (of a patient: left, back, head), `RAS` (right, front, head), `world` if the file does not
    /// say, `index` if positions count samples.
    pub frame: &'static str,
    /// Unit of lengths in the world, such as `mm`, if the file states it.
    pub unit: Option<&'static str>,
}

/// Meaning of the positions along an axis.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct AxisInfo {
    /// Name in the file.
    pub name: String,
    /// Unit of the positions, as the file says it.
    pub unit: Option<String>,
    /// Kind of the positions: `longitude`, `latitude`, `depth`, `height`, `pressure` or `other`.
    pub kind: &'static str,
    /// Position of each sample, if the world's coordinates count samples; null: the world's coordinate along the axis is the position.
    pub positions: Option<Vec<f64>>,
    /// Whether positions grow downwards: if `positions` is null, they are then the world's coordinates times −1.
    pub points_down: bool,
}

impl AxisInfo {
    fn of(axis: &AxisScale) -> Self {
        Self {
            name: axis.name.clone(),
            unit: axis.unit.clone(),
            kind: axis.kind.name(),
            positions: axis.positions.clone(),
            points_down: axis.points_down,
        }
    }

    /// Returns the meaning of the positions along all axes of a volume; `None` if the file describes none.
    pub fn all(dataset: &Dataset) -> Option<[Option<Self>; 3]> {
        let axes = dataset.axes.as_deref()?;
        Some([0, 1, 2].map(|axis| axes[axis].as_ref().map(Self::of)))
    }
}

/// Times of the steps.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS), ts(rename = "Times"))]
#[serde(rename_all = "camelCase")]
pub struct TimesInfo {
    /// The described step, for people: `1850-01-16`, `12.5 s`, `step 007`.
    pub label: String,
    /// Labels of all steps, if there are at most 1024.
    pub labels: Option<Vec<String>>,
    /// What times count: a unit (`s`), or a unit and a reference date (`days since 1850-01-01`); null if the file does not say.
    pub unit: Option<String>,
    /// Calendar of the dates, by its name in CF; null if times are not dates.
    pub calendar: Option<&'static str>,
    /// Time of step 0; null if it is not a finite number.
    pub start: Option<f64>,
    /// Time between steps, if it is constant.
    pub spacing: Option<f64>,
    /// Time of every step, if steps are uneven and there are at most 1024; an entry is null if the time is not a number.
    pub values: Option<Vec<f64>>,
}

impl TimesInfo {
    /// Describes one step and, if there are not too many, all steps.
    pub fn new(times: &TimeAxis, step: u32) -> Self {
        Self {
            label: times.label(step),
            labels: times.labels(),
            unit: times.unit(),
            calendar: times.calendar(),
            start: times.value(0).filter(|start| start.is_finite()),
            spacing: times.spacing(),
            values: times.uneven_values().map(<[f64]>::to_vec),
        }
    }
}

/// A field, or a feature made from one.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct FieldInfo {
    /// Name, as edits use it.
    pub name: String,
    /// Type of the samples on the device: `u8`, `i8`, `u16`, `i16` or `f32`.
    #[serde(rename = "type")]
    pub sample_type: &'static str,
    /// Type of the samples in the file, as its format names it; absent for computed values.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stored_type: Option<String>,
    /// Unit of the values, if the file declares one.
    pub unit: Option<String>,
    /// Meaning of the values, in ascending order, if this is a field of labels and the file describes them.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub labels: Option<Vec<LabelInfo>>,
    /// Minimum and maximum.
    #[schema(min_items = 2, max_items = 2)]
    pub range: [f32; 2],
    /// Distribution of the values.
    pub histogram: HistogramInfo,
    /// Isovalue that this field opens with, unless the volume comes with one; absent if this is a feature.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub opening_iso: Option<OpeningIso>,
    /// Features that are computed from this field when its isosurface is made, by their names in edits; empty if this is a feature itself.
    pub derived_features: BTreeMap<String, DerivedInfo>,
}

/// A label: a value of a field, and what it means.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS), ts(rename = "Label"))]
#[serde(rename_all = "camelCase")]
pub struct LabelInfo {
    /// Value of the samples, as edits use it.
    pub value: f32,
    /// Number in the file, if it differs from `value`: 32-bit floats do not hold all numbers above 16777216.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stored: Option<String>,
    /// Name for users.
    pub name: Option<String>,
    /// Colour, `#rrggbb`.
    pub color: Option<String>,
}

/// Three fields that are the components of a vector.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct VectorInfo {
    /// Names of the fields: along the axes x, y, z of the grid.
    pub components: [String; 3],
    /// The features that are computed from them, by their names in edits.
    pub features: BTreeMap<String, DerivedInfo>,
}

/// A feature computed from one field or from three. Its values are described only if they have been computed before; those of
/// `gradient-magnitude` always are.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct DerivedInfo {
    /// Unit of the values; null if it depends on units of fields that are not declared, or that differ.
    pub unit: Option<String>,
    /// Minimum and maximum, if they are known.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 2, max_items = 2)]
    pub range: Option<[f32; 2]>,
    /// Distribution of the values, if it is known.
    #[cfg_attr(test, ts(optional))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub histogram: Option<HistogramInfo>,
}

/// How often values occur, in equal bins.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS), ts(rename = "Histogram"))]
pub struct HistogramInfo {
    /// Lower bound of the first bin.
    pub min: f32,
    /// Upper bound of the last bin.
    pub max: f32,
    /// Samples in each of the 256 bins; for a volume of more than 2^27 samples, only samples of a share of its planes.
    pub counts: Vec<u64>,
}

impl From<Histogram> for HistogramInfo {
    fn from(histogram: Histogram) -> Self {
        let [min, max] = histogram.range;
        Self {
            min,
            max,
            counts: histogram.bins,
        }
    }
}

impl GeometryInfo {
    fn of(dataset: &Dataset) -> Self {
        let geometry = dataset.geometry;
        let positions = |uneven: &Arc<UnevenAxes>| {
            let along = |axis: usize| {
                let in_spacings = uneven.of_axis(axis)?.iter();
                Some(in_spacings.map(|position| position * geometry.spacing[axis]).collect())
            };
            [along(0), along(1), along(2)]
        };
        Self {
            positions: dataset.uneven.as_ref().map(positions),
            dims: geometry.dims,
            spacing: geometry.spacing,
            origin: geometry.origin,
            direction: geometry.direction,
            frame: geometry.frame.name(),
            unit: geometry.unit.map(LengthUnit::symbol),
        }
    }
}

impl LabelInfo {
    /// Returns the labels of a field, if there are any: those that its file names, and those that are represented by ranks.
    pub fn of(field: &Field) -> Option<Vec<Self>> {
        let labels: Vec<_> = field.all_labels().into_iter().map(Self::new).collect();
        (!labels.is_empty()).then_some(labels)
    }

    fn new((value, label): (f32, Label)) -> Self {
        let color = |[r, g, b]: [u8; 3]| format!("#{r:02x}{g:02x}{b:02x}");
        let differs = value as i128 != label.value || value.fract() != 0.0;
        Self {
            value,
            stored: differs.then(|| label.value.to_string()),
            name: label.name,
            color: label.color.map(color),
        }
    }
}

impl DerivedInfo {
    fn new(unit: Option<String>, histogram: Option<Histogram>) -> Self {
        Self {
            unit,
            range: histogram.as_ref().map(|histogram| histogram.range),
            histogram: histogram.map(Into::into),
        }
    }
}

/// Returns the unit of a field's derived feature. `unit`: that of the field; `length`: that of lengths.
fn derived_unit(feature: DerivedFeature, unit: Option<&str>, length: &str) -> Option<String> {
    match feature {
        DerivedFeature::GradientMagnitude => unit.map(|unit| format!("{unit} per {length}")),
        DerivedFeature::MeanCurvature => Some(format!("per {length}")),
        DerivedFeature::GaussianCurvature => Some(format!("per {length}²")),
        DerivedFeature::LocalVariance => unit.map(|unit| format!("({unit})²")),
    }
}

/// Returns the unit of a feature of a vector whose components have `unit`. `length`: the unit of lengths.
fn vector_unit(feature: VectorFeature, unit: &str, length: &str) -> String {
    match feature {
        VectorFeature::Magnitude => unit.to_owned(),
        VectorFeature::Divergence | VectorFeature::VorticityMagnitude => format!("{unit} per {length}"),
        VectorFeature::QCriterion | VectorFeature::Lambda2 => format!("({unit} per {length})²"),
        VectorFeature::Helicity => format!("({unit})² per {length}"),
    }
}

/// Returns the unit of lengths in a volume.
fn length_unit(volume: &VolumeStep) -> &'static str {
    volume.dataset().geometry.unit.map_or("world unit", LengthUnit::symbol)
}

/// Describes a feature that is derived from a field.
async fn derived_info(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    field: &Field,
    feature: DerivedFeature,
) -> Result<DerivedInfo, WorkError> {
    let name = FeatureName::Derived(feature);
    let histogram = if ALWAYS_DESCRIBED.contains(&feature) {
        Some(worker.histogram(volume, &field.name, &name).await?)
    } else {
        worker.peek_histogram(volume, &field.name, &name)
    };
    let unit = derived_unit(feature, field.unit.as_deref(), length_unit(volume));
    Ok(DerivedInfo::new(unit, histogram))
}

/// Describes the vector fields of a volume.
fn vector_infos(worker: &DeviceWorker, volume: &VolumeStep) -> Vec<VectorInfo> {
    let dataset = volume.dataset();
    let info_of = |components: [&str; 3]| {
        let components = components.map(str::to_owned);
        let units = components.each_ref().map(|name| dataset.field(name)?.unit.as_deref());
        let unit = units[0].filter(|_| units.iter().all(|unit| *unit == units[0]));
        let names = VectorFeature::ALL.iter().map(|&feature| {
            let name = FeatureName::Vector(Box::new(VectorName::new(feature, components.clone())));
            (feature, name)
        });
        let features = names.map(|(feature, name)| {
            let histogram = worker.peek_histogram(volume, &components[0], &name);
            let unit = unit.map(|unit| vector_unit(feature, unit, length_unit(volume)));
            (name.as_str().to_owned(), DerivedInfo::new(unit, histogram))
        });
        VectorInfo {
            features: features.collect(),
            components,
        }
    };
    vectors(&dataset.field_names()).into_iter().map(info_of).collect()
}

/// Describes the field that an expression over a volume's fields gives. The description is that of a field of the volume, but without
/// derived features.
///
/// # Errors
/// [`WorkError::Edit`] if the expression is invalid, or another [`WorkError`].
pub async fn describe_expression(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    text: &str,
) -> Result<FieldInfo, WorkError> {
    let dataset = volume.dataset();
    // The name of a field is not necessarily a valid expression.
    let unit = match dataset.field(text) {
        Some(field) => field.unit.clone(),
        None => {
            FieldExpression::parse(text, &dataset.field_names(), "expression").map_err(WorkError::Edit)?;
            fields::computed_field(dataset, text).and_then(|field| field.unit)
        }
    };
    let histogram = worker.histogram(volume, text, &FeatureName::None).await?;
    Ok(FieldInfo {
        name: text.to_owned(),
        sample_type: SampleType::F32.name(),
        stored_type: None,
        labels: None,
        range: histogram.range,
        opening_iso: Some(OpeningIso::of(&histogram, unit.as_deref(), false)),
        unit,
        histogram: histogram.into(),
        derived_features: BTreeMap::new(),
    })
}

/// Describes one time step of a volume. The worker makes the histograms that are not cached.
///
/// # Errors
/// [`WorkError`].
pub async fn describe(worker: &DeviceWorker, volume: &VolumeStep) -> Result<VolumeInfo, WorkError> {
    let dataset = volume.dataset();
    let mut fields = Vec::new();
    for field in &dataset.fields {
        let histogram = worker.histogram(volume, &field.name, &FeatureName::None).await?;
        let mut derived_features = BTreeMap::new();
        for &feature in DerivedFeature::ALL {
            let info = derived_info(worker, volume, field, feature).await?;
            derived_features.insert(feature.name().to_owned(), info);
        }
        fields.push(FieldInfo {
            name: field.name.clone(),
            sample_type: field.sample_type.name(),
            stored_type: Some(field.stored_type.clone()),
            unit: field.unit.clone(),
            labels: LabelInfo::of(field),
            range: histogram.range,
            opening_iso: Some(OpeningIso::of(&histogram, field.unit.as_deref(), field.has_labels())),
            histogram: histogram.into(),
            derived_features,
        });
    }
    let mut features = Vec::new();
    if let Some(main) = fields.first() {
        for (name, info) in main.derived_features.clone() {
            let DerivedInfo {
                unit,
                range: Some(range),
                histogram: Some(histogram),
            } = info
            else {
                continue;
            };
            features.push(FieldInfo {
                name,
                sample_type: SampleType::F32.name(),
                stored_type: None,
                unit,
                labels: None,
                range,
                histogram,
                opening_iso: None,
                derived_features: BTreeMap::new(),
            });
        }
    }
    features.extend(fields.iter().cloned().map(|field| FieldInfo {
        opening_iso: None,
        derived_features: BTreeMap::new(),
        ..field
    }));
    Ok(VolumeInfo {
        id: dataset.id.clone(),
        title: dataset.title.clone(),
        geometry: GeometryInfo::of(dataset),
        axes: AxisInfo::all(dataset),
        steps: dataset.steps,
        step: volume.step(),
        times: dataset.times.as_ref().map(|times| TimesInfo::new(times, volume.step())),
        fields,
        features,
        vectors: vector_infos(worker, volume),
        notice: dataset.notice(),
        opening: opening_edit(dataset).map_err(WorkError::Edit)?,
    })
}

#[cfg(test)]
mod tests {
    use super::{Label, LabelInfo};

    #[test]
    fn labels_have_their_numbers_if_samples_stand_for_them_by_other_values() {
        let label = |number: i128| Label::new(number, "Putamen", Some([0x34, 0x65, 0xa4]));
        let plain = LabelInfo::new((12.0, label(12)));
        assert_eq!((plain.value, plain.stored), (12.0, None));
        assert_eq!(
            (plain.name.as_deref(), plain.color.as_deref()),
            (Some("Putamen"), Some("#3465a4"))
        );
        let ranked = LabelInfo::new((3.0, label(1_000_000_007)));
        assert_eq!((ranked.value, ranked.stored.as_deref()), (3.0, Some("1000000007")));
    }
}
