//! Features that importance blends with smoothness, and histograms of their values.

use crate::{Error, Result, Volume, constants};

/// The feature that the importance blends with smoothness (eq. 3).
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// None: `f` is zero everywhere.
    None,
    /// Another field on the same grid.
    Field(&'a Volume),
    /// A feature that is computed from the field itself.
    Derived(DerivedFeature),
    /// A feature that is computed from three fields on the same grid: the components of a vector along its axes x, y, z.
    Vector(VectorFeature, [&'a Volume; 3]),
}

impl<'a> Feature<'a> {
    /// Its number in `cl/`.
    pub(crate) fn kind(self) -> u32 {
        match self {
            Self::None => constants::FEATURE_NONE,
            Self::Field(_) => constants::FEATURE_FIELD,
            Self::Derived(derived) => derived.kind(),
            Self::Vector(feature, _) => feature.kind(),
        }
    }

    /// Returns the fields that it needs in addition to the one whose surface is extracted.
    fn fields(self) -> Vec<&'a Volume> {
        match self {
            Self::None | Self::Derived(_) => Vec::new(),
            Self::Field(field) => vec![field],
            Self::Vector(_, components) => components.to_vec(),
        }
    }

    /// Checks that its fields have as many samples along each axis as `volume`.
    pub(crate) fn check_grid(self, volume: &Volume) -> Result<()> {
        let expected = volume.grid.dims;
        match self.fields().iter().find(|field| field.grid.dims != expected) {
            None => Ok(()),
            Some(field) => Err(Error::Invalid {
                what: "feature",
                why: format!("its grid has {:?} samples, expected {expected:?}", field.grid.dims),
            }),
        }
    }

    /// Bytes of the samples of its fields, without `volume`.
    pub(crate) fn sample_bytes_beside(self, volume: &Volume) -> u64 {
        let others = self.fields().into_iter().filter(|field| !std::ptr::eq(*field, volume));
        others.map(Volume::sample_bytes).sum()
    }

    /// Its number in `cl/construct.cl` and `cl/histogram.cl`, for which `derive` has computed its features before. `volume`: the field
    /// whose surface is extracted.
    pub(crate) fn kind_after_derive(self, volume: &Volume) -> u32 {
        match self.kind() {
            constants::FEATURE_MEAN_CURVATURE.. => constants::FEATURE_STORED,
            // `construct` computes the gradient only for even axes.
            constants::FEATURE_GRADIENT if volume.inverse_lengths.is_some() => constants::FEATURE_STORED,
            kind => kind,
        }
    }
}

/// Declares features that are computed: variant, name for users, number in `cl/`.
macro_rules! computed_features {
    ($(#[doc = $of:literal])* $features:ident { $($(#[doc = $doc:literal])* $variant:ident, $name:literal, $kind:ident;)* }) => {
        $(#[doc = $of])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub enum $features {
            $($(#[doc = $doc])* $variant),*
        }

        impl $features {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// Its name in REST, stream and command line.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name),*
                }
            }

            const fn kind(self) -> u32 {
                match self {
                    $(Self::$variant => constants::$kind),*
                }
            }
        }
    };
}

// A new one is a line here, its number in `constants.rs`, a case in `cl/lib/neighbourhood.h`, and its twin in the reference crate's
// `derive.rs`.
computed_features! {
    /// A feature that is computed from a field, on the device.
    DerivedFeature {
        /// Magnitude of the field's gradient, in the field's units per world unit.
        GradientMagnitude, "gradient-magnitude", FEATURE_GRADIENT;
        /// Mean curvature of the isosurface, per world unit; positive at points where the inside is convex.
        MeanCurvature, "mean-curvature", FEATURE_MEAN_CURVATURE;
        /// Gaussian curvature of the isosurface, per square of a world unit.
        GaussianCurvature, "gaussian-curvature", FEATURE_GAUSSIAN_CURVATURE;
        /// Variance of the 27 samples around, in squares of the field's unit: texture.
        LocalVariance, "local-variance", FEATURE_LOCAL_VARIANCE;
    }
}

computed_features! {
    /// A feature that is computed from a vector field's three components, on the device.
    VectorFeature {
        /// Length of the vector, in the fields' unit.
        Magnitude, "vector-magnitude", FEATURE_VECTOR_MAGNITUDE;
        /// Divergence, in the fields' unit per world unit.
        Divergence, "divergence", FEATURE_DIVERGENCE;
        /// Length of the curl, in the fields' unit per world unit.
        VorticityMagnitude, "vorticity-magnitude", FEATURE_VORTICITY;
        /// Q-criterion, in squares of the fields' unit per world unit; positive if rotation exceeds strain.
        QCriterion, "q-criterion", FEATURE_Q_CRITERION;
        /// λ₂, in squares of the fields' unit per world unit: negative in the cores of vortices.
        Lambda2, "lambda2", FEATURE_LAMBDA_2;
        /// Helicity density, in squares of the fields' unit, per world unit; positive if the vector turns right-handed about itself.
        Helicity, "helicity", FEATURE_HELICITY;
    }
}

/// Range and distribution of a field or a derived feature.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Histogram {
    /// Minimum and maximum finite value; `[0, 0]` when there is none.
    pub range: [f32; 2],
    /// Samples in 256 equal bins from `range[0]` to `range[1]`.
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    pub bins: Vec<u64>,
}
