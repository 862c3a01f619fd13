//! What a user asks for: [`Edit`] is any subset of it as JSON, in REST and WebSocket alike (field names are normative
//! in `PROTOCOL.md`); [`View`] is the complete state that edits are applied to.

use isopeel_kernels::{ControlPoint, CutParams, Histogram, Isovalue, Level, MAX_LEVEL, TransferFunction};
use serde::{Deserialize, Serialize};

use crate::quality::{self, Budget, Fitted, MaxError, MesherName, TopologyName};
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
    /// Importance up to which a cube is decimated; below 0 gives the full surface. An export with it is exactly that cut:
    /// guards that it does not name are off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beta: Option<f32>,
    /// The most triangles there may be, instead of `beta`: the β that comes nearest below is found. An export with it has the
    /// guards `preserve` and `0.25vx` where it does not name them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub triangles: Option<u64>,
    /// The most bytes on the wire, instead of `beta`, as `triangles`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Guard: largest distance of a decimated cube's vertex to the surface it stands for, root mean square.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "quality::named"
    )]
    pub max_error: Option<MaxError>,
    /// Guard: whether decimation may change the topology.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topology: Option<TopologyName>,
    /// Which mesher.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesher: Option<MesherName>,
    /// Whether surfaces that leave the volume are closed on its faces. Exports only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cap: Option<bool>,
    /// Whether the final surface is simplified once more by quadric edge collapse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polish: Option<bool>,
    /// Coarsest level, 0 to 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_level: Option<u8>,
    /// Importance and colour over the blended feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_function: Option<TransferFunctionJson>,
}

impl Edit {
    /// The edit as a request that stands by itself, on the command line or for an export, where no one has set guards before.
    /// β then means the cut of eq. 4 exactly, a budget the best surface of that size: guards that are not named with one of
    /// them are off with the first and on with the second.
    #[must_use]
    pub fn alone(self) -> Self {
        let (max_error, topology) = if self.beta.is_some() {
            (MaxError::None, TopologyName::Free)
        } else if self.triangles.is_some() || self.bytes.is_some() {
            (MaxError::default(), TopologyName::default())
        } else {
            return self;
        };
        Self {
            max_error: self.max_error.or(Some(max_error)),
            topology: self.topology.or(Some(topology)),
            ..self
        }
    }
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
    /// Importance up to which a cube is decimated, where no budget is in force.
    pub beta: f32,
    /// Instead of `beta`.
    pub budget: Option<Budget>,
    /// What keeps the budget; found by [`crate::budget`], forgotten at the next edit.
    pub fitted: Option<Fitted>,
    /// Guard on the error.
    pub max_error: MaxError,
    /// Guard on the topology.
    pub topology: TopologyName,
    /// Which mesher.
    pub mesher: MesherName,
    /// Whether the surface is closed on the volume's faces.
    pub cap: bool,
    /// Whether the final surface is simplified once more.
    pub polish: bool,
    /// Coarsest level a leaf may have.
    pub max_level: Level,
    /// Control points as they travel, colours included, in the order they were given.
    pub transfer_function: TransferFunctionJson,
}

impl View {
    /// The main field without a feature, guards on.
    pub fn plain(dataset: &Dataset) -> Self {
        Self {
            iso: None,
            field: dataset.fields.first().map(|f| f.name.clone()).unwrap_or_default(),
            feature: FeatureName::None,
            feature_range: None,
            alpha: 0.0,
            beta: 0.02,
            budget: None,
            fitted: None,
            max_error: MaxError::default(),
            topology: TopologyName::default(),
            mesher: MesherName::default(),
            cap: false,
            polish: false,
            max_level: MAX_LEVEL,
            transfer_function: TransferFunctionJson::default(),
        }
    }

    /// What a dataset opens with: its own opening edit over the defaults.
    ///
    /// # Errors
    /// The opening edit does not fit its dataset.
    pub fn opening(dataset: &Dataset) -> Result<Self, EditError> {
        let defaults = Self {
            feature: FeatureName::GradientMagnitude,
            alpha: 0.3,
            ..Self::plain(dataset)
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
        view.apply_quality(edit)?;
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

    /// β or a budget, and the guards.
    fn apply_quality(&mut self, edit: &Edit) -> Result<(), EditError> {
        self.fitted = None;
        let refuse = |field, why| Err(EditError { field, why });
        match (edit.beta, edit.triangles, edit.bytes) {
            (None, None, None) => {}
            (Some(beta), None, None) => {
                if !beta.is_finite() {
                    return refuse("beta", format!("{beta}, expected a finite number"));
                }
                (self.beta, self.budget) = (beta, None);
            }
            (None, triangles, bytes) if triangles.is_none() || bytes.is_none() => {
                let (field, budget) = match (triangles, bytes) {
                    (Some(n), _) => ("triangles", Budget::Triangles(n)),
                    (_, n) => ("bytes", Budget::Bytes(n.unwrap_or_default())),
                };
                if matches!(budget, Budget::Triangles(0) | Budget::Bytes(0)) {
                    return refuse(field, "0, expected 1 or more".into());
                }
                self.budget = Some(budget);
            }
            _ => {
                let field = if edit.triangles.is_some() { "triangles" } else { "bytes" };
                return refuse(
                    field,
                    "expected only one of beta, triangles and bytes in an edit".into(),
                );
            }
        }
        if let Some(max_error) = edit.max_error {
            if !max_error.is_valid() {
                return refuse("maxError", format!("{max_error:?}, {}", MaxError::EXPECTED));
            }
            self.max_error = max_error;
        }
        self.topology = edit.topology.unwrap_or(self.topology);
        self.mesher = edit.mesher.unwrap_or(self.mesher);
        self.cap = edit.cap.unwrap_or(self.cap);
        self.polish = edit.polish.unwrap_or(self.polish);
        if self.cap && self.mesher == MesherName::MarchingCubes {
            return refuse("cap", "true with marching-cubes, expected the dual mesher".into());
        }
        Ok(())
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

    /// The parameters of a cut in a volume of this spacing; `None` before [`View::resolve`]. Under a budget that is not
    /// yet fitted, β is still that of the view.
    pub fn cut_params(&self, spacing: [f64; 3]) -> Option<CutParams> {
        Some(CutParams {
            alpha: self.alpha,
            feature_range: self.feature_range?,
            max_level: self.max_level,
            transfer: self.transfer_function.to_kernel().ok()?,
            max_error: self.max_error.world(spacing),
            topology: self.topology.into(),
            mesher: self.mesher.into(),
            cap: self.cap,
            ..CutParams::paper(self.beta_in_force())
        })
    }

    /// The β that was found for the budget, or else the view's own.
    pub fn beta_in_force(&self) -> f32 {
        self.fitted.map_or(self.beta, |fitted| fitted.beta)
    }

    /// Every value in force, as it travels: of β and budgets the one that decides.
    pub fn to_edit(&self) -> Edit {
        let (beta, triangles, bytes) = match self.budget {
            None => (Some(self.beta), None, None),
            Some(Budget::Triangles(n)) => (None, Some(n), None),
            Some(Budget::Bytes(n)) => (None, None, Some(n)),
        };
        Edit {
            iso: self.iso.map(Isovalue::get),
            field: Some(self.field.clone()),
            feature: Some(self.feature.as_str().to_owned()),
            feature_range: self.feature_range,
            alpha: Some(self.alpha),
            beta,
            triangles,
            bytes,
            max_error: Some(self.max_error),
            topology: Some(self.topology),
            mesher: Some(self.mesher),
            cap: Some(self.cap),
            polish: Some(self.polish),
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
