//! What a user asks for: [`Edit`] is any subset of it as JSON, in REST and WebSocket alike (field names are normative
//! in `PROTOCOL.md`); [`View`] is the complete state that edits are applied to.

use isopeel_kernels::{ControlPoint, CutParams, Histogram, Isovalue, Level, MAX_LEVEL, TransferFunction};
use serde::{Deserialize, Serialize};

use crate::volumes::Dataset;

/// Any subset of what can be edited; what is absent stays as it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Edit {
    /// Isovalue, in the field's units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<f32>,
    /// Field whose isosurface is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Feature that matters to the user: a field's name, `gradient-magnitude`, or `none`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature: Option<String>,
    /// Feature values that become 0 and 1, in the feature's units; the feature's own range when never given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature_range: Option<[f32; 2]>,
    /// Weight of the feature against smoothness, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f32>,
    /// Importance up to which a cube is decimated; below 0 gives the full surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beta: Option<f32>,
    /// Coarsest level, 0 to 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_level: Option<u8>,
    /// Importance and colour over the blended feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_function: Option<TransferFunctionJson>,
}

/// A transfer function as it travels; the kernels know importance alone, colour is the viewer's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct TransferFunctionJson {
    /// Control points, 1 to 64.
    pub points: Vec<PointJson>,
}

/// One control point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct PointJson {
    /// Where on the blended feature, 0 to 1.
    pub x: f32,
    /// Importance there, 0 to 1.
    pub importance: f32,
    /// Colour there, `#rrggbb`.
    pub color: String,
}

/// An edit that cannot be applied: which field of it, and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {why}")]
pub struct EditError {
    /// Name of the field, as it travels.
    pub field: &'static str,
    /// What was found and what was expected.
    pub why: String,
}

/// What the user's importance looks at beside smoothness, by name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum FeatureName {
    /// Nothing.
    None,
    /// Magnitude of the shown field's gradient.
    GradientMagnitude,
    /// A field of the same dataset.
    Field(String),
}

impl FeatureName {
    /// `none`.
    pub const NONE: &str = "none";
    /// `gradient-magnitude`.
    pub const GRADIENT_MAGNITUDE: &str = "gradient-magnitude";

    /// Looks a feature up by the name it travels with. A field of that name comes before a derived feature.
    ///
    /// # Errors
    /// Neither a field of the dataset nor a derived feature.
    pub fn find(name: &str, dataset: &Dataset) -> Result<Self, EditError> {
        if dataset.fields.iter().any(|f| f.name == name) {
            return Ok(Self::Field(name.to_owned()));
        }
        match name {
            Self::NONE => Ok(Self::None),
            Self::GRADIENT_MAGNITUDE => Ok(Self::GradientMagnitude),
            _ => Err(EditError {
                field: "feature",
                why: format!(
                    "{name:?}, expected {:?}, {:?} or a field: {}",
                    Self::NONE,
                    Self::GRADIENT_MAGNITUDE,
                    field_names(dataset)
                ),
            }),
        }
    }

    /// The name it travels with.
    pub fn as_str(&self) -> &str {
        match self {
            Self::None => Self::NONE,
            Self::GradientMagnitude => Self::GRADIENT_MAGNITUDE,
            Self::Field(name) => name,
        }
    }
}

/// Everything that decides a surface of one dataset. Every value is in its range; `None` stands for what only the
/// data can say and [`View::resolve`] fills in.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Isovalue in the field's units; `None`: chosen from the field's histogram.
    pub iso: Option<Isovalue>,
    /// Field whose isosurface is shown.
    pub field: String,
    /// What the user's importance looks at.
    pub feature: FeatureName,
    /// Feature values that become 0 and 1; `None`: the feature's own range.
    pub feature_range: Option<[f32; 2]>,
    /// Weight of the feature against smoothness, 0 to 1.
    pub alpha: f32,
    /// Importance up to which a cube is decimated.
    pub beta: f32,
    /// Coarsest level a leaf may have.
    pub max_level: Level,
    /// Control points as they travel, colours included, in the order they were given.
    pub transfer_function: TransferFunctionJson,
}

impl View {
    /// What a dataset opens with: its own opening edit over the defaults.
    ///
    /// # Errors
    /// The opening edit does not fit its dataset.
    pub fn opening(dataset: &Dataset) -> Result<Self, EditError> {
        let defaults = Self {
            iso: None,
            field: dataset.fields.first().map(|f| f.name.clone()).unwrap_or_default(),
            feature: FeatureName::GradientMagnitude,
            feature_range: None,
            alpha: 0.3,
            beta: 0.02,
            max_level: MAX_LEVEL,
            transfer_function: TransferFunctionJson::default(),
        };
        match &dataset.opening {
            Some(edit) => defaults.apply(edit, dataset),
            None => Ok(defaults),
        }
    }

    /// The state after an edit. When the feature changes and the edit has no range, the range becomes the feature's own.
    ///
    /// # Errors
    /// The first field whose value is not what it may be; the state stays as it was.
    pub fn apply(&self, edit: &Edit, dataset: &Dataset) -> Result<Self, EditError> {
        let mut view = self.clone();
        if let Some(iso) = edit.iso {
            view.iso = Some(Isovalue::new(iso).map_err(|_| EditError {
                field: "iso",
                why: format!("{iso}, expected a finite number"),
            })?);
        }
        if let Some(field) = &edit.field {
            if !dataset.fields.iter().any(|f| f.name == *field) {
                return Err(EditError {
                    field: "field",
                    why: format!("{field:?}, expected one of {}", field_names(dataset)),
                });
            }
            view.field.clone_from(field);
        }
        if let Some(feature) = &edit.feature {
            view.feature = FeatureName::find(feature, dataset)?;
        }
        // The gradient magnitude of another field is another feature, though its name is the same.
        let derived = view.feature == FeatureName::GradientMagnitude;
        if view.feature != self.feature || (derived && view.field != self.field) {
            view.feature_range = None;
        }
        if let Some([lo, hi]) = edit.feature_range {
            if !lo.is_finite() || !hi.is_finite() || lo >= hi {
                return Err(EditError {
                    field: "featureRange",
                    why: format!("[{lo}, {hi}], expected two finite numbers, the first below the second"),
                });
            }
            view.feature_range = Some([lo, hi]);
        }
        if let Some(alpha) = edit.alpha {
            if !(0.0..=1.0).contains(&alpha) {
                return Err(EditError {
                    field: "alpha",
                    why: format!("{alpha}, expected 0 to 1"),
                });
            }
            view.alpha = alpha;
        }
        if let Some(beta) = edit.beta {
            if !beta.is_finite() {
                return Err(EditError {
                    field: "beta",
                    why: format!("{beta}, expected a finite number"),
                });
            }
            view.beta = beta;
        }
        if let Some(level) = edit.max_level {
            view.max_level = Level::new(level).map_err(|_| EditError {
                field: "maxLevel",
                why: format!("{level}, expected 0 to {}", MAX_LEVEL.get()),
            })?;
        }
        if let Some(transfer_function) = &edit.transfer_function {
            transfer_function.check()?;
            view.transfer_function.clone_from(transfer_function);
        }
        Ok(view)
    }

    /// Fills in what only the data can say, from the histogram of the shown field and that of the feature; each is
    /// asked for only when needed.
    ///
    /// # Errors
    /// What the lookups return.
    pub fn resolve<E>(
        &mut self,
        field_histogram: impl FnOnce() -> Result<Histogram, E>,
        feature_histogram: impl FnOnce() -> Result<Histogram, E>,
    ) -> Result<(), E> {
        if self.iso.is_none() {
            self.iso = Isovalue::new(otsu(&field_histogram()?)).ok();
        }
        if self.feature_range.is_none() {
            self.feature_range = Some(match self.feature {
                FeatureName::None => [0.0, 1.0],
                _ => proper_range(feature_histogram()?.range),
            });
        }
        Ok(())
    }

    /// The parameters of a cut; `None` before [`View::resolve`].
    pub fn cut_params(&self) -> Option<CutParams> {
        Some(CutParams {
            alpha: self.alpha,
            feature_range: self.feature_range?,
            max_level: self.max_level,
            transfer: self.transfer_function.to_kernel().ok()?,
            // The paper's mesher without our guards: an edit has no names for others yet.
            ..CutParams::paper(self.beta)
        })
    }

    /// Every value in force, as it travels.
    pub fn to_edit(&self) -> Edit {
        Edit {
            iso: self.iso.map(Isovalue::get),
            field: Some(self.field.clone()),
            feature: Some(self.feature.as_str().to_owned()),
            feature_range: self.feature_range,
            alpha: Some(self.alpha),
            beta: Some(self.beta),
            max_level: Some(self.max_level.get()),
            transfer_function: Some(self.transfer_function.clone()),
        }
    }
}

impl Default for TransferFunctionJson {
    /// The identity, from a calm blue to a warm orange.
    fn default() -> Self {
        let point = |x: f32, color: &str| PointJson {
            x,
            importance: x,
            color: color.to_owned(),
        };
        Self {
            points: vec![point(0.0, "#3465a4"), point(1.0, "#f57900")],
        }
    }
}

impl TransferFunctionJson {
    /// What the kernels need of it.
    ///
    /// # Errors
    /// No point, too many, or a coordinate that is not in [0, 1].
    pub fn to_kernel(&self) -> Result<TransferFunction, EditError> {
        let points = self.points.iter().map(|p| ControlPoint {
            x: p.x,
            importance: p.importance,
        });
        TransferFunction::new(points.collect()).map_err(|e| EditError {
            field: "transferFunction",
            why: match e {
                isopeel_kernels::Error::Invalid { why, .. } => why,
                other => other.to_string(),
            },
        })
    }

    /// Checks coordinates and colours.
    fn check(&self) -> Result<(), EditError> {
        self.to_kernel()?;
        for (i, point) in self.points.iter().enumerate() {
            let digits = point.color.strip_prefix('#').unwrap_or_default();
            if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(EditError {
                    field: "transferFunction",
                    why: format!("point {i} has color {:?}, expected #rrggbb", point.color),
                });
            }
        }
        Ok(())
    }
}

fn field_names(dataset: &Dataset) -> String {
    let names: Vec<_> = dataset.fields.iter().map(|f| format!("{:?}", f.name)).collect();
    names.join(", ")
}

/// The range itself, or one that begins there and is not empty.
fn proper_range([lo, hi]: [f32; 2]) -> [f32; 2] {
    if lo < hi {
        return [lo, hi];
    }
    // A constant feature: f̂ is 0 everywhere. The width must survive rounding beside a large value.
    [lo, lo + lo.abs().max(1.0)]
}

/// N. Otsu's threshold (1979): parts the histogram in two classes so that the variance between them is greatest.
fn otsu(histogram: &Histogram) -> f32 {
    let [lo, hi] = histogram.range.map(f64::from);
    let width = (hi - lo) / histogram.bins.len().max(1) as f64;
    let centre = |bin: usize| lo + (bin as f64 + 0.5) * width;
    let weigh = |(bin, &n): (usize, &u64)| n as f64 * centre(bin);
    let total: f64 = histogram.bins.iter().map(|&n| n as f64).sum();
    let total_sum: f64 = histogram.bins.iter().enumerate().map(weigh).sum();
    let (mut below, mut below_sum) = (0.0, 0.0);
    let (mut best, mut threshold) = (0.0, (lo + hi) / 2.0);
    for (bin, &n) in histogram.bins.iter().enumerate() {
        below += n as f64;
        below_sum += n as f64 * centre(bin);
        let above = total - below;
        if below == 0.0 || above == 0.0 {
            continue;
        }
        let apart = below_sum / below - (total_sum - below_sum) / above;
        let between = below * above * apart * apart;
        if between > best {
            (best, threshold) = (between, lo + (bin + 1) as f64 * width);
        }
    }
    threshold as f32
}

#[cfg(test)]
mod tests;
