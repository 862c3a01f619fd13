//! A feature with its fields. References to the fields keep them alive while other jobs use the device.

use std::sync::Arc;

use isopeel_kernels::{DerivedFeature, Feature, VectorFeature, Volume};
use isopeel_view::FeatureName;

use super::WorkError;

/// A view's feature and the fields that it is made of.
pub(crate) enum FeatureFields {
    None,
    Derived(DerivedFeature),
    Field(Arc<Volume>),
    Vector(VectorFeature, [Arc<Volume>; 3]),
}

impl FeatureFields {
    /// Returns the feature of this name with its fields. `resident` returns a resident field by its name.
    pub fn new(
        feature: &FeatureName,
        resident: impl Fn(&str) -> Result<Arc<Volume>, WorkError>,
    ) -> Result<Self, WorkError> {
        Ok(match feature {
            FeatureName::None => Self::None,
            FeatureName::Derived(derived) => Self::Derived(*derived),
            FeatureName::Field(name) => Self::Field(resident(name)?),
            FeatureName::Vector(vector) => {
                let [x, y, z] = &vector.components;
                Self::Vector(vector.feature, [resident(x)?, resident(y)?, resident(z)?])
            }
        })
    }

    /// Returns the feature as an argument of the kernels.
    pub fn get(&self) -> Feature<'_> {
        match self {
            Self::None => Feature::None,
            Self::Derived(derived) => Feature::Derived(*derived),
            Self::Field(field) => Feature::Field(field),
            Self::Vector(feature, [x, y, z]) => Feature::Vector(*feature, [x, y, z]),
        }
    }
}
