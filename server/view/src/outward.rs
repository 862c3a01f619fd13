//! Which side of a surface is its outside.

use serde::{Deserialize, Serialize};

/// Which side of a surface is its outside: the one that its triangles and normals show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "lowercase")]
pub enum Outward {
    /// Of a closed surface the side away from the volume that it encloses, else the side of low values
    #[default]
    Auto,
    /// The side of high values, for distance fields, pores and airways
    High,
    /// The side of low values
    Low,
}

impl Outward {
    /// Whether the surface itself decides.
    pub fn is_auto(&self) -> bool {
        *self == Self::Auto
    }
}
