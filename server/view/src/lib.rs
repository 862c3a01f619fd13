//! Requests of users. A [`View`] is everything that decides a surface; an [`Edit`] is any part of a view, as JSON.

mod binary;
mod camera;
mod chosen_parts;
mod edit;
mod error;
mod expression;
mod feature;
mod interest;
mod mask;
mod opening;
mod outward;
mod parts;
pub mod quality;
mod request;
#[cfg(feature = "openapi")]
mod schemas;
mod transfer_function;

use isopeel_geometry::IndexSpace;
use isopeel_kernels::{CutParams, DerivedFeature, Histogram, Isovalue, Level, MAX_LEVEL, Topology};

use serde::{Deserialize, Serialize};

pub use camera::{CameraJson, Detail, Projection};
pub use chosen_parts::{ChosenPartsJson, parse_position};
pub use edit::Edit;
pub use error::EditError;
pub use expression::{FieldExpression, SIGMAS};
pub use feature::{FeatureName, VectorName, arguments};
pub use interest::InterestJson;
pub use mask::Mask;
pub use opening::{IsoReason, OpeningIso};
pub use outward::Outward;
pub use transfer_function::{PointJson, TransferFunctionJson};

use error::quoted;
use quality::{
    Budget, Distance, ErrorLimit, Fitted, GuardName, MaxError, MesherName, ShareBudget, TopologyName, TriangleBudget,
};

/// Everything that decides a surface of one dataset. Every value is in its range; `None` stands for a value that depends on the data
/// and that [`View::resolve`] fills in.
///
/// Serialized for binary formats: its JSON is an [`Edit`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Isovalue in the field's units; `None`: chosen from the field's histogram.
    pub iso: Option<Isovalue>,
    /// Field whose isosurface is shown.
    pub field: String,
    /// Restriction of the surface to certain samples; `None`: no restriction.
    pub mask: Option<Box<Mask>>,
    /// Feature on which importance depends in addition to smoothness.
    pub feature: FeatureName,
    /// Feature values that become 0 and 1; `None`: the feature's own range.
    pub feature_range: Option<[f32; 2]>,
    /// Field, or expression over fields, whose values at the vertices accompany the surface, for colours. It decides no triangle.
    pub color_field: Option<String>,
    /// Weight of the feature against smoothness, 0 to 1.
    pub alpha: f32,
    /// Importance up to which a cube is decimated. Used only if there is neither an error nor a budget.
    pub beta: f32,
    /// Instead of `beta`: a part is merged up to this error divided by the part's weight.
    #[serde(with = "binary")]
    pub error: Option<ErrorLimit>,
    /// Maximum size of the surface, instead of `beta`. If there is an error too, the greater tolerance of both decides.
    #[serde(with = "binary")]
    pub budget: Option<Budget>,
    /// Minimum area of a part of the surface, in world units. Smaller parts are removed before the surface is cut. 0: no part is removed.
    /// Above 0 only if an error or a budget decides.
    pub min_part: f64,
    /// Chosen parts, which are removed, or which alone stay; `None`: all parts are shown. Set only if an error or a budget decides.
    pub parts: Option<ChosenPartsJson>,
    /// The threshold that keeps the budget. It is computed when the surface is made, and dropped at the next edit.
    pub fitted: Option<Fitted>,
    /// Guard on the error.
    #[serde(with = "binary")]
    pub max_error: MaxError,
    /// Guard on the topology.
    pub topology: TopologyName,
    /// Mesher that turns the cut into triangles.
    pub mesher: MesherName,
    /// Whether the surface is closed on the volume's faces.
    pub cap: bool,
    /// Coarsest level a leaf may have.
    pub max_level: Level,
    /// Control points as in the edit, colours included.
    pub transfer_function: TransferFunctionJson,
    /// Regions of interest, in which importance is raised.
    #[serde(with = "binary")]
    pub interest: Vec<InterestJson>,
    /// Whether the surface follows the camera.
    pub detail: Detail,
    /// Camera for which the surface is made.
    #[serde(with = "binary")]
    pub camera: Option<Box<CameraJson>>,
}

/// Checks that `field`, a value of `name` in an edit, is a field of the volume, or an expression over its fields.
fn check_field(name: &'static str, field: &str, fields: &[&str]) -> Result<(), EditError> {
    if fields.contains(&field) {
        return Ok(());
    }
    if FieldExpression::may_be(field) {
        return FieldExpression::parse(field, fields, name).map(drop);
    }
    Err(EditError {
        field: name,
        why: format!("{field:?}, expected one of {}", quoted(fields)),
    })
}

impl View {
    /// Weight of the gradient magnitude with which a volume opens. On most of a surface, the gradient is much smaller than the steepest one
    /// in the volume. With less weight, only smoothness would be visible: the teeth of a skull, or the crowns of a brain's folds, would
    /// look like the rest of the surface.
    pub const OPENING_ALPHA: f32 = 0.5;

    /// Error with which a volume opens: too small to see.
    pub const OPENING_ERROR: ErrorLimit = ErrorLimit::Pixels(1.0);

    /// Budget with which a volume opens. On a GPU the bundled viewer draws that many triangles at once.
    pub const OPENING_BUDGET: ShareBudget = ShareBudget {
        share: 0.25,
        max: Some(1_000_000),
    };

    /// Returns the defaults: the first of the volume's fields, no feature, guards on.
    pub fn plain(fields: &[&str]) -> Self {
        Self {
            iso: None,
            field: fields.first().copied().unwrap_or_default().to_owned(),
            mask: None,
            feature: FeatureName::None,
            feature_range: None,
            color_field: None,
            alpha: 0.0,
            beta: 0.02,
            error: None,
            budget: None,
            min_part: 0.0,
            parts: None,
            fitted: None,
            max_error: MaxError::default(),
            topology: TopologyName::default(),
            mesher: MesherName::default(),
            cap: false,
            max_level: MAX_LEVEL,
            transfer_function: TransferFunctionJson::default(),
            interest: Vec::new(),
            detail: Detail::default(),
            camera: None,
        }
    }

    /// Returns the view with which a volume with these fields opens: the defaults, to which the volume's opening edit is applied, if it has
    /// one.
    ///
    /// # Errors
    /// The opening edit has an invalid value, or a field that the volume does not have.
    pub fn opening(fields: &[&str], edit: Option<&Edit>) -> Result<Self, EditError> {
        let defaults = Self {
            feature: FeatureName::Derived(DerivedFeature::GradientMagnitude),
            alpha: Self::OPENING_ALPHA,
            error: Some(Self::OPENING_ERROR),
            budget: Some(Budget::Triangles(TriangleBudget::Share(Self::OPENING_BUDGET))),
            ..Self::plain(fields)
        };
        match edit {
            Some(edit) => defaults.apply(edit, fields),
            None => Ok(defaults),
        }
    }

    /// Returns the view after an edit; `fields` are the names of the volume's fields. If the feature changes and the edit has no range, the
    /// range becomes the feature's own.
    ///
    /// # Errors
    /// The first value that is out of its range.
    pub fn apply(&self, edit: &Edit, fields: &[&str]) -> Result<Self, EditError> {
        let mut view = self.clone();
        if let Some(iso) = edit.iso {
            view.iso = Some(Isovalue::new(iso).map_err(|_| EditError {
                field: "iso",
                why: format!("{iso}, expected a finite number"),
            })?);
        }
        if let Some(field) = &edit.field {
            check_field("field", field, fields)?;
            view.field.clone_from(field);
        }
        if let Some(mask) = &edit.mask {
            let parse = |text: &String| Mask::parse(text, fields).map(Box::new);
            view.mask = mask.as_ref().map(parse).transpose()?;
        }
        if let Some(feature) = &edit.feature {
            view.feature = FeatureName::find(feature, fields)?;
        }
        // A derived feature of another field is a different feature, although its name is the same.
        let is_derived = matches!(view.feature, FeatureName::Derived(_));
        if view.feature != self.feature || (is_derived && view.field != self.field) {
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
        if let Some(color_field) = &edit.color_field {
            if let Some(field) = color_field {
                check_field("colorField", field, fields)?;
            }
            view.color_field.clone_from(color_field);
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
        if let Some(interest) = &edit.interest {
            interest::check(interest)?;
            view.interest.clone_from(interest);
        }
        view.detail = edit.detail.unwrap_or(view.detail);
        if let Some(camera) = &edit.camera {
            camera.check()?;
            if !view.is_by_error() {
                return Err(EditError {
                    field: "camera",
                    why: view.has_no_tree_cut("given"),
                });
            }
            view.camera = Some(Box::new(camera.clone()));
        }
        Ok(view)
    }

    /// Applies the criterion, the mesher, the guards, and the parts that are left out.
    fn apply_quality(&mut self, edit: &Edit) -> Result<(), EditError> {
        self.fitted = None;
        let refuse = |field, why| Err(EditError { field, why });
        self.apply_criterion(edit)?;
        if let Some(max_error) = edit.max_error {
            if matches!(max_error, MaxError::At(distance) if !distance.is_valid()) {
                return refuse("maxError", format!("{max_error}, {}", MaxError::EXPECTED));
            }
            self.max_error = max_error;
        }
        self.topology = edit.topology.unwrap_or(self.topology);
        self.mesher = edit.mesher.unwrap_or(self.mesher);
        self.cap = edit.cap.unwrap_or(self.cap);
        if self.mesher == MesherName::MarchingCubes {
            if self.cap {
                return refuse("cap", "true with marching-cubes, expected the dual mesher".into());
            }
            if edit.error.is_some() {
                return refuse("error", "given with marching-cubes, expected the dual mesher".into());
            }
            self.error = None;
        }
        self.apply_min_part(edit)?;
        self.apply_parts(edit)
    }

    /// Applies the minimum area of parts. Only a cut of the vertex tree can leave parts out, so the minimum is 0 in a view without such a
    /// cut.
    fn apply_min_part(&mut self, edit: &Edit) -> Result<(), EditError> {
        let refuse = |why| Err(EditError { field: "minPart", why });
        if let Some(min_part) = edit.min_part {
            if !(min_part.is_finite() && min_part >= 0.0) {
                return refuse(format!("{min_part}, expected an area in world units, 0 or more"));
            }
            self.min_part = min_part.abs();
        }
        if self.is_by_error() {
            return Ok(());
        }
        self.min_part = 0.0;
        match edit.min_part {
            None | Some(0.0) => Ok(()),
            Some(min_part) => refuse(self.has_no_tree_cut(&min_part.to_string())),
        }
    }

    /// Applies the chosen parts, under the same condition as the minimum area of parts.
    fn apply_parts(&mut self, edit: &Edit) -> Result<(), EditError> {
        if let Some(parts) = &edit.parts {
            parts.as_ref().map_or(Ok(()), ChosenPartsJson::check)?;
            self.parts.clone_from(parts);
        }
        if self.is_by_error() {
            return Ok(());
        }
        self.parts = None;
        match edit.parts {
            None | Some(None) => Ok(()),
            Some(Some(_)) => Err(EditError {
                field: "parts",
                why: self.has_no_tree_cut("given"),
            }),
        }
    }

    /// Returns the reason why this view has no cut of the vertex tree, which can leave out parts and follow a camera.
    fn has_no_tree_cut(&self, given: &str) -> String {
        match self.mesher {
            MesherName::MarchingCubes => format!("{given} with marching-cubes, expected the dual mesher"),
            MesherName::Dual => format!("{given} with beta alone, expected error, triangles or bytes too"),
        }
    }

    /// Whether parts of the surface are removed.
    pub fn removes_parts(&self) -> bool {
        self.min_part > 0.0 || self.parts.is_some()
    }

    /// Applies the criterion: β, or an error and a budget.
    fn apply_criterion(&mut self, edit: &Edit) -> Result<(), EditError> {
        let refuse = |field, why: String| Err(EditError { field, why });
        let Edit {
            beta,
            error,
            triangles,
            bytes,
            ..
        } = *edit;
        if let Some(beta) = beta {
            let others = [
                ("error", error.is_some()),
                ("triangles", triangles.is_some()),
                ("bytes", bytes.is_some()),
            ];
            if let Some((field, _)) = others.into_iter().find(|(_, is_given)| *is_given) {
                return refuse(field, "beside beta, expected only one of both in an edit".into());
            }
            if !beta.is_finite() {
                return refuse("beta", format!("{beta}, expected a finite number"));
            }
            (self.beta, self.error, self.budget) = (beta, None, None);
            return Ok(());
        }
        if error.is_none() && triangles.is_none() && bytes.is_none() {
            return Ok(());
        }
        if let Some(error) = error
            && !error.is_valid()
        {
            return refuse("error", format!("{error}, {}", ErrorLimit::EXPECTED));
        }
        let budget = match (triangles, bytes) {
            (Some(_), Some(_)) => {
                return refuse("triangles", "beside bytes, expected only one of both in an edit".into());
            }
            (Some(triangles), None) => {
                triangles.check().or_else(|why| refuse("triangles", why))?;
                Some(Budget::Triangles(triangles))
            }
            (None, Some(0)) => return refuse("bytes", "0, expected 1 or more".into()),
            (None, Some(bytes)) => Some(Budget::Bytes(bytes)),
            (None, None) => None,
        };
        (self.error, self.budget) = (error, budget);
        Ok(())
    }

    /// Fills in the values that depend on the data: the opening isovalue of the shown field, and the range of the feature's histogram. Each
    /// of the two functions is called only if its result is needed.
    ///
    /// # Errors
    /// Those of the two functions.
    pub fn resolve<E>(
        &mut self,
        opening_iso: impl FnOnce() -> Result<OpeningIso, E>,
        feature_histogram: impl FnOnce() -> Result<Histogram, E>,
    ) -> Result<(), E> {
        if self.iso.is_none() {
            self.iso = Isovalue::new(opening_iso()?.iso).ok();
        }
        if self.feature_range.is_none() {
            self.feature_range = Some(match self.feature {
                FeatureName::None => [0.0, 1.0],
                _ => proper_range(self.feature.own_range(feature_histogram()?.range)),
            });
        }
        Ok(())
    }

    /// Returns the parameters of a cut of cubes; `None` before [`View::resolve`]. `smallest`: the volume's smallest spacing, in world
    /// units; lengths in the parameters are multiples of it. `index_space` includes the samples of a cap's padding. Until a budget is
    /// fitted, the threshold is the view's own.
    pub fn cut_params(&self, smallest: f64, index_space: &IndexSpace) -> Option<CutParams> {
        let tolerance = self.tolerance_in_force(smallest);
        let interest = self.interest.iter().map(|interest| interest.to_kernel(index_space));
        Some(CutParams {
            alpha: self.alpha,
            tolerance: tolerance.filter(|&tolerance| tolerance >= 0.0),
            feature_range: self.feature.range_on_device(self.feature_range?, smallest),
            max_level: self.max_level,
            transfer: self.transfer_function.to_kernel().ok()?,
            interest: interest.collect::<Option<_>>()?,
            max_error: self.max_error_in_force().map(|distance| distance.in_spacings(smallest)),
            topology: self.topology_in_force(),
            mesher: self.mesher.into(),
            cap: self.cap,
            ..CutParams::paper(self.beta_in_force().unwrap_or(-1.0))
        })
    }

    /// Returns the guard on the error, if there is one. `auto` is no guard if an error or a budget decides.
    pub fn max_error_in_force(&self) -> Option<Distance> {
        match self.max_error {
            MaxError::Auto if self.is_by_error() || self.budget.is_some() => None,
            MaxError::Auto => Some(MaxError::AUTO),
            MaxError::None => None,
            MaxError::At(distance) => Some(distance),
        }
    }

    /// Returns the guard on the topology. `auto` may give way to a budget.
    pub fn topology_in_force(&self) -> Topology {
        self.fitted.map_or(self.topology.into(), |fitted| fitted.topology)
    }

    /// Returns the guards that are `auto` and gave way to the budget: first the error guard, if the fitted tolerance is above both the
    /// view's error and [`MaxError::AUTO`]; then the topology guard.
    pub fn gave_way(&self, smallest: f64) -> Vec<GuardName> {
        let Some(fitted) = self.fitted else { return Vec::new() };
        let error_gave_way = self.max_error == MaxError::Auto
            && self.is_by_error()
            && fitted.pixels.is_none()
            && fitted.threshold > MaxError::AUTO.in_spacings(smallest)
            && self
                .error
                .is_none_or(|error| fitted.threshold > error.in_spacings(smallest));
        let topology_gave_way = self.topology == TopologyName::Auto && fitted.topology == Topology::Free;
        let guards = [
            (GuardName::MaxError, error_gave_way),
            (GuardName::Topology, topology_gave_way),
        ];
        guards
            .into_iter()
            .filter(|(_, gave_way)| *gave_way)
            .map(|(guard, _)| guard)
            .collect()
    }

    /// Returns the maximum triangles, if the full surface has `full` triangles. For a budget of bytes the maximum is known only once the
    /// budget is fitted.
    pub fn max_triangles(&self, full: u64) -> Option<u64> {
        match self.budget? {
            Budget::Triangles(budget) => Some(budget.of(full)),
            Budget::Bytes(_) => self.fitted.map(|fitted| fitted.triangles),
        }
    }

    /// Whether an error or a budget decides, so that the vertex tree is cut. False if β decides, or with the paper's mesher.
    pub fn is_by_error(&self) -> bool {
        self.mesher == MesherName::Dual && (self.error.is_some() || self.budget.is_some())
    }

    /// Whether the surface follows the camera, if there is one: not if β decides, or if every part is to be fine alike.
    pub fn follows_camera(&self) -> bool {
        self.detail == Detail::View && self.is_by_error()
    }

    /// Returns the camera that the surface follows.
    pub fn camera_in_force(&self) -> Option<&CameraJson> {
        self.camera.as_deref().filter(|_| self.follows_camera())
    }

    /// Returns β, if β decides: the one that was fitted to the budget, or else the view's own.
    pub fn beta_in_force(&self) -> Option<f32> {
        let beta = self.fitted.map_or(self.beta, |fitted| fitted.threshold);
        (!self.is_by_error()).then_some(beta)
    }

    /// Returns the tolerance in smallest spacings, if an error or a budget decides. If there are both, returns the greater tolerance. If it
    /// is below 0, nothing is decimated. If the surface was made for a camera, it is the tolerance at the distance of the camera's target.
    pub fn tolerance_in_force(&self, smallest: f64) -> Option<f32> {
        let guard = self
            .max_error_in_force()
            .map_or(f32::INFINITY, |guard| guard.in_spacings(smallest));
        let error = self.error.map(|error| error.in_spacings(smallest).min(guard));
        let fitted = self.fitted.map(|fitted| fitted.threshold);
        // What pixels are in space is known once the tree is cut for the camera.
        if self.fitted.is_some_and(|fitted| fitted.pixels.is_some()) {
            return fitted;
        }
        let greater = match (error, fitted) {
            (Some(error), Some(fitted)) => error.max(fitted),
            (error, fitted) => fitted.or(error).unwrap_or(0.0),
        };
        self.is_by_error().then_some(greater)
    }

    /// Returns an edit with every value of the view. Of β, the error and the budgets, the edit has only those in force.
    pub fn to_edit(&self) -> Edit {
        let (triangles, bytes) = match self.budget {
            None => (None, None),
            Some(Budget::Triangles(triangles)) => (Some(triangles), None),
            Some(Budget::Bytes(bytes)) => (None, Some(bytes)),
        };
        let beta_decides = self.error.is_none() && self.budget.is_none();
        Edit {
            iso: self.iso.map(Isovalue::get),
            field: Some(self.field.clone()),
            mask: Some(self.mask.as_ref().map(|mask| mask.as_str().to_owned())),
            feature: Some(self.feature.as_str().to_owned()),
            feature_range: self.feature_range,
            color_field: Some(self.color_field.clone()),
            alpha: Some(self.alpha),
            beta: beta_decides.then_some(self.beta),
            error: self.error,
            triangles,
            bytes,
            min_part: Some(self.min_part),
            parts: Some(self.parts.clone()),
            max_error: Some(self.max_error),
            topology: Some(self.topology),
            mesher: Some(self.mesher),
            cap: Some(self.cap),
            max_level: Some(self.max_level.get()),
            transfer_function: Some(self.transfer_function.clone()),
            interest: Some(self.interest.clone()),
            detail: Some(self.detail),
            camera: self.camera.as_deref().cloned(),
        }
    }
}

/// Returns the range. If the range is empty, returns one that begins at the same minimum and is not empty.
fn proper_range([lo, hi]: [f32; 2]) -> [f32; 2] {
    if lo < hi {
        return [lo, hi];
    }
    // The feature is constant, so f̂ is 0 everywhere. The width grows with the value, because adding a small one would not change a large
    // value.
    [lo, lo + lo.abs().max(1.0)]
}

#[cfg(test)]
mod tests;
