//! Keys of resident volumes and histograms.

use isopeel_kernels::{DerivedFeature, ValueSet};
use serde::{Deserialize, Serialize};

use crate::fields;

use isopeel_view::{EditError, FeatureName, FieldExpression, Mask, View};
use isopeel_volumes::{Field, StepKey, VolumeStep};

use super::WorkError;

/// Derived features whose values are part of every description of a volume. Others take longer, and are described only once a view has used
/// them.
pub const ALWAYS_DESCRIBED: &[DerivedFeature] = &[DerivedFeature::GradientMagnitude];

/// Key of a volume: a field at a time step, as it is on the device.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct VolumeKey {
    /// The time step and its revision.
    pub step: StepKey,
    /// Name of the field, or an expression.
    pub field: String,
    /// Whether one sample is added on every side before the samples go to the device.
    pub padded: bool,
    /// The mask, if there is one. Samples outside the mask count as missing.
    pub mask: Option<Mask>,
}

impl VolumeKey {
    /// Returns the key of a field that is not masked.
    pub fn new(volume: &VolumeStep, field: &str, padded: bool) -> Self {
        Self {
            step: volume.key(),
            field: field.to_owned(),
            padded,
            mask: None,
        }
    }

    /// Returns the key of the field that a view shows, masked as the view says.
    pub(crate) fn shown(volume: &VolumeStep, view: &View, padded: bool) -> Self {
        Self {
            mask: view.mask.as_deref().cloned(),
            ..Self::new(volume, &view.field, padded)
        }
    }

    /// Returns the mask with the description of its field, if this field is masked.
    pub(crate) fn mask_of(&self, volume: &VolumeStep) -> Result<Option<(Mask, Field)>, WorkError> {
        let Some(mask) = &self.mask else { return Ok(None) };
        let labels = Self::new(volume, &mask.field, false).field_of(volume)?;
        Ok(Some((mask.clone(), labels)))
    }

    /// Returns the maximum bytes of a sample on the device: a mask may need a wider type than the field.
    pub fn sample_bytes(&self, volume: &VolumeStep) -> Result<usize, WorkError> {
        let field = self.field_of(volume)?;
        let bytes = field.sample_type.bytes();
        let may_widen = self.mask.is_some() && field.missing.is_none();
        Ok(if may_widen { (2 * bytes).min(4) } else { bytes })
    }

    /// Returns the field's description. The field may be given by an expression.
    pub(crate) fn field_of(&self, volume: &VolumeStep) -> Result<Field, WorkError> {
        let dataset = volume.dataset();
        fields::field_or_computed(dataset, &self.field).ok_or_else(|| {
            WorkError::Edit(EditError {
                field: "field",
                why: format!("volume {:?} has no field {:?}", self.step.dataset.id, self.field),
            })
        })
    }
}

impl VolumeKey {
    /// Whether the device computes this field from others.
    pub fn is_computed(&self, volume: &VolumeStep) -> bool {
        self.recipe(volume).is_some()
    }

    /// Returns how the device computes this field from others, and the keys of its inputs. `None` if the host reads the
    /// field, or computes it because it is padded or smoothed.
    pub(crate) fn recipe(&self, volume: &VolumeStep) -> Option<(Recipe, Vec<Self>)> {
        if self.padded {
            return None;
        }
        if self.mask.is_some() {
            let (mask, labels) = self.mask_of(volume).ok()??;
            let keys = [&self.field, &mask.field].map(|name| Self::new(volume, name, false));
            return Some((Recipe::Mask(mask, labels), keys.to_vec()));
        }
        let parsed = fields::parse_expression(volume.dataset(), &self.field)?;
        if parsed.smoothing.is_some() {
            return None;
        }
        let keys = parsed
            .fields
            .iter()
            .map(|name| Self::new(volume, name, false))
            .collect();
        Some((Recipe::Expression(parsed), keys))
    }
}

impl VolumeKey {
    /// Returns the error that no sample is inside, so that there are no distances.
    pub(crate) fn no_sample_inside_error(&self) -> EditError {
        EditError {
            field: "feature",
            why: format!(
                "{:?} holds at no sample of step {}, expected at least one",
                self.field, self.step.step
            ),
        }
    }
}

/// How a field is made from others on the device.
pub(crate) enum Recipe {
    /// Evaluates an expression.
    Expression(FieldExpression),
    /// Masks a field: samples outside the mask become missing. The second value describes the mask's label field.
    Mask(Mask, Field),
}

/// Whether fields are masked on the device or on the host.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Masking {
    /// On the device, on which the field and the labels are resident too.
    OnDevice,
    /// On the host, which reads the field and the labels.
    OnHost,
}

/// Returns the label values that count as inside a mask, as they are on the device. `labels`: the mask's field, which was read.
pub(crate) fn values_inside(mask: &Mask, labels: &Field) -> ValueSet {
    let ranks = labels.source.ranks();
    mask.by_ranks(|number| Some(ranks.as_ref()?.position(number))).values()
}

/// Returns `keys` with the keys of all inputs from which the device makes these fields. Each key occurs once, and inputs come before the
/// fields that are made from them.
pub fn with_inputs(volume: &VolumeStep, keys: &[VolumeKey], masking: Masking) -> Vec<VolumeKey> {
    let mut ordered: Vec<VolumeKey> = Vec::new();
    for key in keys {
        let inputs = match key.recipe(volume) {
            Some((Recipe::Mask(..), _)) if masking == Masking::OnHost => Vec::new(),
            Some((_, inputs)) => with_inputs(volume, &inputs, masking),
            None => Vec::new(),
        };
        for key in inputs.into_iter().chain([key.clone()]) {
            if !ordered.contains(&key) {
                ordered.push(key);
            }
        }
    }
    ordered
}

/// Returns the keys of the fields of which a feature is made, each once.
pub(crate) fn feature_keys(volume: &VolumeStep, shown: &str, feature: &FeatureName, padded: bool) -> Vec<VolumeKey> {
    let mut keys: Vec<VolumeKey> = Vec::new();
    for name in feature.fields(shown) {
        let key = VolumeKey::new(volume, name, padded);
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    keys
}

/// Returns the key of the field whose values accompany a view's surface. Neither a mask nor a cap changes these values.
pub(crate) fn color_key(volume: &VolumeStep, view: &View) -> Option<VolumeKey> {
    let field = view.color_field.as_ref()?;
    Some(VolumeKey::new(volume, field, false))
}

/// Returns the keys of the fields of which a view's surface is made, and of the field whose values accompany it, each once. The shown field
/// comes first.
pub fn view_keys(volume: &VolumeStep, view: &View) -> Vec<VolumeKey> {
    let mut keys = vec![VolumeKey::shown(volume, view, view.cap)];
    // A feature derived from the shown field needs no other field, whether the shown field is masked or not.
    if !matches!(view.feature, FeatureName::Derived(_)) {
        let feature_keys = feature_keys(volume, &view.field, &view.feature, view.cap);
        let others = feature_keys
            .into_iter()
            .filter(|key| *key != keys[0])
            .collect::<Vec<_>>();
        keys.extend(others);
    }
    let color_key = color_key(volume, view).filter(|key| !keys.contains(key));
    keys.extend(color_key);
    keys
}

/// Key of a histogram: of a field, or of a feature that is computed from one field or from three.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HistogramKey {
    /// Key of the field; of a feature of three fields, the key of the first one.
    pub volume: VolumeKey,
    /// The feature, or `None` for the field's own samples. Never a field: the histogram of such a feature is that of the field itself.
    pub computed: FeatureName,
}

impl HistogramKey {
    /// Returns the key for a feature of `field`. If the feature is itself a field, returns the key for that field.
    pub fn new(volume: &VolumeStep, field: &str, feature: &FeatureName) -> Self {
        let computed = match feature {
            FeatureName::None | FeatureName::Field(_) => FeatureName::None,
            FeatureName::Derived(_) | FeatureName::Vector(_) => feature.clone(),
        };
        let name = feature.fields(field).first().copied().unwrap_or(field);
        Self {
            volume: VolumeKey::new(volume, name, false),
            computed,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_view::{Edit, View};
    use isopeel_volumes::{VolumeStep, testing};

    use super::{Masking, VolumeKey, view_keys, with_inputs};

    /// Returns the fields that are loaded for an edit, in order; `+` before a name marks a masked field.
    fn loaded(edit: &str, masking: Masking) -> Vec<String> {
        let dataset = testing::dataset("head", [9; 3], &["density", "heat", "labels"]);
        let volume = VolumeStep::new(Arc::new(dataset), 0).expect("a step");
        let edit: Edit = serde_json::from_str(edit).expect("an edit");
        let fields = ["density", "heat", "labels"];
        let view = View::plain(&fields).apply(&edit, &fields).expect("a good edit");
        let name = |key: &VolumeKey| format!("{}{}", if key.mask.is_some() { "+" } else { "" }, key.field);
        with_inputs(&volume, &view_keys(&volume, &view), masking)
            .iter()
            .map(name)
            .collect()
    }

    #[test]
    fn the_field_of_the_colours_is_loaded_once_and_not_masked() {
        let loaded = |edit| loaded(edit, Masking::OnHost);
        assert_eq!(loaded(r#"{"feature":"none","colorField":"heat"}"#), ["density", "heat"]);
        assert_eq!(loaded(r#"{"feature":"heat","colorField":"heat"}"#), ["density", "heat"]);
        assert_eq!(loaded(r#"{"feature":"none","colorField":"density"}"#), ["density"]);
        let masked = r#"{"feature":"none","mask":"labels==1","cap":true,"colorField":"density"}"#;
        assert_eq!(loaded(masked), ["+density", "density"]);
        let computed = r#"{"feature":"none","colorField":"heat*2"}"#;
        assert_eq!(loaded(computed), ["density", "heat", "heat*2"]);
    }

    #[test]
    fn what_a_masked_field_is_made_of_comes_first() {
        let masked = r#"{"mask":"labels==1","feature":"heat"}"#;
        assert_eq!(
            loaded(masked, Masking::OnDevice),
            ["density", "labels", "+density", "heat"]
        );
        assert_eq!(loaded(masked, Masking::OnHost), ["+density", "heat"]);
        let computed = r#"{"field":"density+heat","mask":"labels==1","feature":"none"}"#;
        assert_eq!(
            loaded(computed, Masking::OnDevice),
            ["density", "heat", "density+heat", "labels", "+density+heat"]
        );
        let capped = r#"{"mask":"labels==1","cap":true,"feature":"none"}"#;
        assert_eq!(loaded(capped, Masking::OnDevice), ["+density"]);
    }
}
