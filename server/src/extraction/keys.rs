//! Keys of resident volumes, pyramids and histograms.

use isopeel_kernels::{DerivedFeature, Isovalue};

use super::WorkError;
use crate::view::{EditError, FeatureName};
use crate::volumes::{Field, VolumeStep};

/// One time step of one field, padded by a sample on every side or not.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct VolumeKey {
    pub dataset: String,
    pub revision: u32,
    pub step: u32,
    pub field: String,
    /// Whether the samples are padded before they go to the device.
    pub padded: bool,
}

impl VolumeKey {
    pub(super) fn new(volume: &VolumeStep, field: &str, padded: bool) -> Self {
        Self {
            dataset: volume.dataset().id.clone(),
            revision: volume.dataset().revision,
            step: volume.step(),
            field: field.to_owned(),
            padded,
        }
    }

    /// The field's description.
    pub(super) fn field_of<'a>(&self, volume: &'a VolumeStep) -> Result<&'a Field, WorkError> {
        let found = volume.dataset().fields.iter().find(|f| f.name == self.field);
        found.ok_or_else(|| {
            WorkError::Edit(EditError {
                field: "field",
                why: format!("volume {:?} has no field {:?}", self.dataset, self.field),
            })
        })
    }
}

/// A histogram: of a field, or of a feature derived from it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct HistogramKey {
    pub volume: VolumeKey,
    pub derived: Option<DerivedFeature>,
}

impl HistogramKey {
    /// The histogram of a feature of `field`; a field as a feature has its own, whichever field is shown.
    pub(super) fn new(volume: &VolumeStep, field: &str, feature: &FeatureName) -> Self {
        let name = match feature {
            FeatureName::Field(name) => name,
            FeatureName::None | FeatureName::Derived(_) => field,
        };
        Self {
            volume: VolumeKey::new(volume, name, false),
            derived: match feature {
                FeatureName::Derived(derived) => Some(*derived),
                FeatureName::None | FeatureName::Field(_) => None,
            },
        }
    }
}

/// Everything that a pyramid depends on.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PyramidKey {
    volume: VolumeKey,
    feature: FeatureName,
    iso_bits: u32,
}

impl PyramidKey {
    pub(super) fn new(volume: VolumeKey, feature: FeatureName, iso: Isovalue) -> Self {
        Self {
            volume,
            feature,
            iso_bits: iso.get().to_bits(),
        }
    }
}
