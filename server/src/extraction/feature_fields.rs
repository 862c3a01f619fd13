//! A feature with its fields, which are held while others use the device.

use std::rc::Rc;

use isopeel_kernels::{DerivedFeature, Feature, VectorFeature, Volume};

use super::WorkError;
use crate::view::{EditError, FeatureName};
use crate::volumes::Dataset;

/// A view's feature and the fields that it is made of.
pub(super) enum FeatureFields {
    None,
    Derived(DerivedFeature),
    Field(Rc<Volume>),
    Vector(VectorFeature, [Rc<Volume>; 3]),
}

/// Whether a feature of a dataset can be computed: derivatives are those of even distances between samples.
pub(super) fn can_be_computed(dataset: &Dataset, feature: &FeatureName) -> bool {
    let needs_distances = match feature {
        FeatureName::None | FeatureName::Field(_) => false,
        FeatureName::Derived(derived) => *derived != DerivedFeature::LocalVariance,
        FeatureName::Vector(vector) => vector.feature != VectorFeature::Magnitude,
    };
    !needs_distances || dataset.uneven.is_none()
}

impl FeatureFields {
    /// The feature of this name. `resident`: a field by its name.
    pub fn new(
        dataset: &Dataset,
        feature: &FeatureName,
        resident: impl Fn(&str) -> Result<Rc<Volume>, WorkError>,
    ) -> Result<Self, WorkError> {
        if !can_be_computed(dataset, feature) {
            return Err(WorkError::Edit(EditError {
                field: "feature",
                why: format!(
                    "{:?} has derivatives, and the volume's samples are at uneven positions, expected a field, an expression, {:?} or the \
                     magnitude of a vector",
                    feature.as_str(),
                    DerivedFeature::LocalVariance.name()
                ),
            }));
        }
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

    /// What the kernels take.
    pub fn get(&self) -> Feature<'_> {
        match self {
            Self::None => Feature::None,
            Self::Derived(derived) => Feature::Derived(*derived),
            Self::Field(field) => Feature::Field(field),
            Self::Vector(feature, [x, y, z]) => Feature::Vector(*feature, [x, y, z]),
        }
    }
}
