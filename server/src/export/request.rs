//! The request for one file: the time step, the options of the file, and an edit, all in one JSON object.

use std::time::Duration;

use isopeel_extraction::fields;
use isopeel_extraction::{ExportWork, Measuring, Refining};
use isopeel_view::quality::Budget;
use isopeel_view::{Edit, EditError, Outward, SIGMAS, View};
use isopeel_volumes::{Dataset, LengthUnit};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::label::around_labels;
use super::schema::merged_schema;
use super::surface_options::SurfaceOptions;
use super::{Compress, Format};

/// Maximum number of fields whose values a file holds. The samples of each field stay in memory until the mesh is complete.
const MAX_FIELD_VALUES: usize = 16;

/// Maximum time limit for measuring the error, in seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;

fn is_zero(number: &f32) -> bool {
    *number == 0.0
}

/// How a surface is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct FileOptions {
    /// File format.
    pub format: Format,
    /// Whether a surface without triangles is written too. Without it such a surface is refused (`empty-surface`).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub allow_empty: bool,
    /// Side of the surface that is its outside.
    #[serde(default, skip_serializing_if = "Outward::is_auto")]
    pub outward: Outward,
    /// Unit of positions in a PLY, VTP, OBJ or USDZ, and what those of a volume are in that declares none: `mm`, `um`, `m` and so on. A GLB is always
    /// in metres, STL, 3MF and GIFTI are in millimetres, precomputed meshes in nanometres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Names of fields, and expressions over fields, whose values are attributes of the vertices, in their own units; in GLB, PLY, VTP and USDZ, at most
    /// 16.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 16)]
    pub field_values: Vec<String>,
    /// The surface around labels of a segmentation instead of one at an isovalue, by numbers or names: `7`, `3,Hippocampus`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Smooths the surface around labels: standard deviation, in samples, of a Gaussian over the samples that have one of them, up to 10. Details thinner than about
    /// two of it vanish. 0, which is the default: the surface is exactly between samples.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub label_smoothing: f32,
    /// How the file is compressed: `zlib` for a VTP or 3MF, `meshopt` for a GLB on a page.
    #[serde(default, skip_serializing_if = "Compress::is_none")]
    pub compress: Compress,
    /// Seconds that measuring the error of a surface may take, which takes about as long as all else; 0: it is not measured. Without it there is no bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measure: Option<f64>,
    /// Whether the file has no triangles that intersect: a cut of the vertex tree is refined at those that do, and then vertices of the rest
    /// are moved. A budget holds. `shape.cleaned` says what it cost.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub clean: bool,
    /// Several surfaces in one GLB, 3MF, OBJ, USDZ or precomputed, each with what differs from the request: `[{"iso":300,"color":"#d2b48c","opacity":0.4},
    /// {"iso":900}]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 64)]
    pub surfaces: Vec<SurfaceOptions>,
}

impl FileOptions {
    /// Names of the options in JSON.
    const NAMES: [&str; 11] = [
        "format",
        "allowEmpty",
        "outward",
        "unit",
        "fieldValues",
        "label",
        "labelSmoothing",
        "compress",
        "measure",
        "clean",
        "surfaces",
    ];

    /// Returns the options for a format, all others with their defaults.
    pub const fn new(format: Format) -> Self {
        Self {
            format,
            allow_empty: false,
            outward: Outward::Auto,
            unit: None,
            field_values: Vec::new(),
            label: None,
            label_smoothing: 0.0,
            compress: Compress::None,
            measure: None,
            clean: false,
            surfaces: Vec::new(),
        }
    }

    /// Checks the options for a volume.
    ///
    /// # Errors
    /// As [`FileOptions::check_alone`], and a field that the volume does not have.
    fn check(&self, dataset: &Dataset) -> Result<(), EditError> {
        self.check_alone()?;
        if let Some(name) = self
            .field_values
            .iter()
            .find(|name| fields::field_or_computed(dataset, name).is_none())
        {
            let names: Vec<String> = dataset.field_names().iter().map(|name| format!("{name:?}")).collect();
            return Err(EditError {
                field: "fieldValues",
                why: format!(
                    "{name:?}, expected some of {}, or expressions over them",
                    names.join(", ")
                ),
            });
        }
        Ok(())
    }

    /// Checks the options that do not depend on the volume.
    ///
    /// # Errors
    /// A unit that is not a length unit, too many fields, a repeated field, a number out of its range, or options that exclude each other.
    fn check_alone(&self) -> Result<(), EditError> {
        let refuse = |field, why| Err(EditError { field, why });
        self.check_field_values()?;
        if !self.compress.applies_to(self.format) {
            let (name, title, expected) = (self.compress.name(), self.format.title(), self.compress.expected());
            return refuse("compress", format!("{name} of a {title}, expected {expected}"));
        }
        if let Some(seconds) = self.measure.filter(|seconds| !(0.0..=MAX_SECONDS).contains(seconds)) {
            return refuse("measure", format!("{seconds}, expected seconds, 0 to {MAX_SECONDS}"));
        }
        self.check_label_smoothing()?;
        if let Some(text) = self.unit.as_ref().filter(|_| self.length_unit().is_none()) {
            let why = format!("{text:?}, expected one of m, mm, cm, um, nm, km or angstrom");
            return refuse("unit", why);
        }
        self.check_clean()
    }

    /// Checks the number of `field_values`, and that no field is repeated.
    fn check_field_values(&self) -> Result<(), EditError> {
        let refuse = |why| {
            Err(EditError {
                field: "fieldValues",
                why,
            })
        };
        let count = self.field_values.len();
        if count > MAX_FIELD_VALUES {
            return refuse(format!("{count} fields, expected at most {MAX_FIELD_VALUES}"));
        }
        let is_repeated = |(at, name): &(usize, &String)| self.field_values[..*at].contains(name);
        match self.field_values.iter().enumerate().find(is_repeated) {
            Some((_, name)) => refuse(format!("{name:?} twice, expected each field once")),
            None => Ok(()),
        }
    }

    /// Checks the range of `label_smoothing`, and that the request has a label.
    fn check_label_smoothing(&self) -> Result<(), EditError> {
        let refuse = |why| {
            Err(EditError {
                field: "labelSmoothing",
                why,
            })
        };
        let sigma = self.label_smoothing;
        if sigma == 0.0 {
            return Ok(());
        }
        if !SIGMAS.contains(&sigma) {
            let [low, high] = [SIGMAS.start(), SIGMAS.end()];
            return refuse(format!("{sigma}, expected 0, or {low} to {high} samples"));
        }
        let has_labels = self.label.is_some() || self.surfaces.iter().any(|surface| surface.look.label.is_some());
        match has_labels {
            true => Ok(()),
            false => refuse(format!("{sigma} without label, expected a label beside it")),
        }
    }

    /// Checks that `clean` is not combined with options that it excludes.
    fn check_clean(&self) -> Result<(), EditError> {
        let refuse = |field, why| Err(EditError { field, why });
        if self.clean && self.compress == Compress::Meshopt {
            return refuse(
                "clean",
                "beside compress meshopt, which rounds positions: expected one of them".into(),
            );
        }
        if self.clean && self.measure.is_some_and(|seconds| seconds > 0.0) {
            let why = "a bound beside clean, whose cut is measured while it is there: expected none, or 0".into();
            return refuse("measure", why);
        }
        Ok(())
    }

    /// Returns whether the error of a view's surface is measured, and which parts of the surface are refined.
    pub fn export_work(&self, view: &View) -> ExportWork {
        let refining = match self.clean {
            true => Refining::Everywhere,
            // A budget of bytes is fitted to an unrefined surface; refinement would exceed it.
            false if view.cap && !matches!(view.budget, Some(Budget::Bytes(_))) => Refining::AtCaps,
            false => Refining::Never,
        };
        ExportWork {
            measuring: self.measuring(),
            refining,
        }
    }

    /// Returns whether the error is measured, and its time limit.
    pub fn measuring(&self) -> Measuring {
        match self.measure {
            None => Measuring::Always,
            Some(seconds) if seconds > 0.0 => Measuring::Within(Duration::from_secs_f64(seconds.min(MAX_SECONDS))),
            Some(_) => Measuring::Never,
        }
    }

    /// Whether equal requests give equal bytes. They may not if measuring the error has a time limit: the file states an error only if it was
    /// measured in time.
    pub fn is_reproducible(&self) -> bool {
        !matches!(self.measuring(), Measuring::Within(_))
    }

    /// Returns the length unit that `unit` names; `None` if `unit` is missing or no length unit.
    pub(super) fn length_unit(&self) -> Option<LengthUnit> {
        let unit = LengthUnit::parse(self.unit.as_deref()?)?;
        unit.metres().is_some().then_some(unit)
    }
}

/// A request for one file. The command line, batch jobs and REST all use this type. Missing values have the defaults of
/// [`View::requested`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileRequest {
    /// Time step.
    pub step: u32,
    /// Options of the file.
    #[serde(flatten)]
    pub options: FileOptions,
    /// Edit of the default view.
    #[serde(flatten)]
    pub edit: Edit,
}

impl FileRequest {
    /// Checks the request, and returns its view of a volume.
    ///
    /// # Errors
    /// A value out of its range, or a field that the volume does not have.
    pub fn view(&self, dataset: &Dataset) -> Result<View, EditError> {
        self.options.check(dataset)?;
        self.check_clean_bytes()?;
        let fields = dataset.field_names();
        match &self.options.label {
            Some(labels) => View::requested(
                &around_labels(dataset, labels, self.options.label_smoothing, &self.edit)?,
                &fields,
            ),
            None => View::requested(&self.edit, &fields),
        }
    }

    /// Refuses a budget of bytes together with `clean`.
    fn check_clean_bytes(&self) -> Result<(), EditError> {
        if self.options.clean && self.edit.bytes.is_some() {
            let why = "beside bytes, which are those of a surface that is not refined: expected triangles".into();
            return Err(EditError { field: "clean", why });
        }
        Ok(())
    }

    /// Checks the values that do not depend on a volume, its fields and its labels.
    ///
    /// # Errors
    /// The first value that is wrong for any volume.
    pub fn check_alone(&self) -> Result<(), EditError> {
        self.options.check_alone()?;
        self.check_surfaces()?;
        self.check_clean_bytes()?;
        // Names of fields are left out, because they depend on the volume.
        let edit = Edit {
            field: None,
            mask: None,
            feature: None,
            feature_range: None,
            color_field: None,
            ..self.edit.clone()
        };
        View::requested(&edit, &["field"]).map(|_| ())
    }

    /// Whether the file has colours: only if the request has a transfer function.
    pub fn is_colored(&self) -> bool {
        self.edit.transfer_function.is_some()
    }

    /// Parses the request from a JSON object. Written by hand, because serde cannot both flatten and refuse unknown fields.
    ///
    /// # Errors
    /// The first name that is unknown or missing, or the first value of a wrong type.
    pub(crate) fn from_object<E: Error>(mut object: Map<String, Value>) -> Result<Self, E> {
        let step = object.remove("step").map(u32::deserialize).transpose();
        let (options, edit): (Map<_, _>, Map<_, _>) = object
            .into_iter()
            .partition(|(name, _)| FileOptions::NAMES.contains(&name.as_str()));
        Ok(Self {
            step: step.map_err(E::custom)?.unwrap_or_default(),
            options: FileOptions::deserialize(Value::Object(options)).map_err(E::custom)?,
            edit: Edit::deserialize(Value::Object(edit)).map_err(E::custom)?,
        })
    }
}

impl<'de> Deserialize<'de> for FileRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_object(Map::deserialize(deserializer)?)
    }
}

/// The names of a request that belong neither to the edit nor to the options.
#[derive(ToSchema)]
#[expect(dead_code, reason = "its schema alone is used")]
struct StepName {
    /// Time step; 0 if it is left out.
    step: Option<u32>,
}

impl PartialSchema for FileRequest {
    fn schema() -> RefOr<Schema> {
        merged_schema(
            [StepName::schema(), FileOptions::schema(), Edit::schema()],
            "Step, format and options, beside any of the edit's names.",
        )
    }
}

impl ToSchema for FileRequest {
    fn name() -> std::borrow::Cow<'static, str> {
        "FileRequest".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        FileOptions::schemas(schemas);
        Edit::schemas(schemas);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_reads_back_and_names_what_it_does_not_know() {
        let text = r#"{"step":2,"format":"stl","iso":-3.5,"beta":0.5}"#;
        let request: FileRequest = serde_json::from_str(text).unwrap();
        assert_eq!((request.step, request.options.format), (2, Format::Stl));
        assert_eq!(serde_json::to_string(&request).unwrap(), text);
        for (text, expected) in [
            (r#"{"iso":1}"#, "missing field `format`"),
            (r#"{"format":"ply","isovalue":1}"#, "unknown field `isovalue`"),
        ] {
            let error = serde_json::from_str::<FileRequest>(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn names_of_formats_are_those_of_their_list() {
        use clap::ValueEnum;
        for format in Format::value_variants() {
            let name = serde_json::to_value(format).unwrap();
            assert_eq!(name, format.name());
            assert_eq!(format.to_possible_value().unwrap().get_name(), format.name());
            assert!(Format::EXPECTED.contains(format.name()));
            let file = format!("a.{}", format.extension());
            assert_eq!(Format::from_path(std::path::Path::new(&file)).unwrap(), *format);
        }
    }

    #[test]
    fn fields_at_the_vertices_are_limited() {
        let dataset = isopeel_volumes::testing::dataset("head", [4; 3], &["t1"]);
        let options = |count| FileOptions {
            field_values: (0..count).map(|n| format!("{n}*t1")).collect(),
            ..FileOptions::new(Format::Ply)
        };
        assert!(options(MAX_FIELD_VALUES).check(&dataset).is_ok());
        let error = options(MAX_FIELD_VALUES + 1).check(&dataset).unwrap_err();
        assert_eq!(error.to_string(), "fieldValues: 17 fields, expected at most 16");
        let twice = FileOptions {
            field_values: ["t1", "2*t1", "t1"].map(str::to_owned).to_vec(),
            ..FileOptions::new(Format::Usdz)
        };
        let error = twice.check_alone().unwrap_err();
        assert_eq!(error.to_string(), "fieldValues: \"t1\" twice, expected each field once");
    }

    #[test]
    fn every_option_has_its_name_in_the_list() {
        let RefOr::T(Schema::Object(options)) = FileOptions::schema() else {
            panic!("options are an object");
        };
        let mut names = FileOptions::NAMES;
        names.sort_unstable();
        assert_eq!(options.properties.keys().collect::<Vec<_>>(), names);
    }
}
