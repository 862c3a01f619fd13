//! What importance looks at beside smoothness, and how its values are distributed.

use crate::{Volume, constants};

/// The feature that the importance blends with smoothness (eq. 3).
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// None: `f` is zero everywhere.
    None,
    /// Another field on the same grid.
    Field(&'a Volume),
    /// A feature that is computed from the field itself.
    Derived(DerivedFeature),
}

impl Feature<'_> {
    /// Its number in `cl/`.
    pub(crate) fn kind(self) -> u32 {
        match self {
            Self::None => constants::FEATURE_NONE,
            Self::Field(_) => constants::FEATURE_FIELD,
            Self::Derived(derived) => derived.kind(),
        }
    }
}

/// Declares the derived features: variant, name for users, number in `cl/`.
macro_rules! derived_features {
    ($($(#[doc = $doc:literal])* $variant:ident, $name:literal, $kind:ident;)*) => {
        /// A feature that is computed from a field, on the device.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum DerivedFeature {
            $($(#[doc = $doc])* $variant),*
        }

        impl DerivedFeature {
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

// A new one is a line here, its number in `constants.rs`, a case of `derived_sample` in `cl/lib/feature.h`, and its twin in the
// reference crate's `field.rs`.
derived_features! {
    /// Magnitude of the field's gradient, in the field's units per world unit.
    GradientMagnitude, "gradient-magnitude", FEATURE_GRADIENT;
}

/// Range and distribution of a field or a derived feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Minimum and maximum finite value; `[0, 0]` when there is none.
    pub range: [f32; 2],
    /// Samples in 256 equal bins from `range[0]` to `range[1]`.
    pub bins: Vec<u64>,
}
