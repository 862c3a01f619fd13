//! How fine a surface is: mesher, guards and budgets, as on the command line, in REST and in the stream.

use std::str::FromStr;

use isopeel_kernels::{Mesher, Topology};
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use utoipa::openapi::schema::{ObjectBuilder, OneOfBuilder, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// Which mesher turns the cut into triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum MesherName {
    /// Dual contouring, watertight for any cut
    #[default]
    Dual,
    /// The paper's: marching cubes on every leaf, cracks patched
    MarchingCubes,
}

impl From<MesherName> for Mesher {
    fn from(name: MesherName) -> Self {
        match name {
            MesherName::Dual => Self::Dual,
            MesherName::MarchingCubes => Self::MarchingCubes,
        }
    }
}

/// Whether decimation may change the surface's topology.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum TopologyName {
    /// Only what is safe to merge is merged: nothing vanishes, nothing closes
    #[default]
    Preserve,
    /// Small parts may vanish and openings close
    Free,
}

impl From<TopologyName> for Topology {
    fn from(name: TopologyName) -> Self {
        match name {
            TopologyName::Preserve => Self::Preserve,
            TopologyName::Free => Self::Free,
        }
    }
}

/// Maximum distance of a decimated cube's vertex to the surface it stands for, root mean square. In JSON a number of world units, a
/// string such as `0.25vx` (multiples of the volume's smallest spacing), or null or `none`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(test, derive(ts_rs::TS), ts(type = "number | string | null"))]
pub enum MaxError {
    /// No guard.
    None,
    /// World units.
    World(f32),
    /// Multiples of the smallest spacing.
    Spacings(f32),
}

impl Default for MaxError {
    fn default() -> Self {
        Self::Spacings(0.25)
    }
}

impl MaxError {
    /// The end of error messages.
    pub const EXPECTED: &str = "expected a number of world units, 0 or more, text like \"0.25vx\" (multiples of the smallest spacing), or \"none\"";

    /// In world units of a volume with this spacing; `None`: no guard.
    pub fn world(self, spacing: [f64; 3]) -> Option<f32> {
        match self {
            Self::None => None,
            Self::World(error) => Some(error),
            Self::Spacings(n) => Some((f64::from(n) * spacing.into_iter().fold(f64::INFINITY, f64::min)) as f32),
        }
    }

    /// Whether its number is finite and not below 0.
    pub fn is_valid(self) -> bool {
        match self {
            Self::None => true,
            Self::World(error) | Self::Spacings(error) => error.is_finite() && error >= 0.0,
        }
    }
}

impl FromStr for MaxError {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || format!("{text:?}, {}", Self::EXPECTED);
        if text == "none" {
            return Ok(Self::None);
        }
        let parsed = match text.strip_suffix("vx") {
            Some(number) => number.parse().map(Self::Spacings),
            None => text.parse().map(Self::World),
        };
        parsed.ok().filter(|e| e.is_valid()).ok_or_else(refuse)
    }
}

impl Serialize for MaxError {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::None => serializer.serialize_unit(),
            Self::World(error) => serializer.serialize_f32(*error),
            Self::Spacings(n) => serializer.collect_str(&format_args!("{n}vx")),
        }
    }
}

impl<'de> Deserialize<'de> for MaxError {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Words;

        impl Visitor<'_> for Words {
            type Value = MaxError;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a number of world units, text like \"0.25vx\", or null")
            }

            fn visit_unit<E>(self) -> Result<MaxError, E> {
                Ok(MaxError::None)
            }

            fn visit_none<E>(self) -> Result<MaxError, E> {
                Ok(MaxError::None)
            }

            fn visit_f64<E>(self, error: f64) -> Result<MaxError, E> {
                Ok(MaxError::World(error as f32))
            }

            fn visit_u64<E>(self, error: u64) -> Result<MaxError, E> {
                Ok(MaxError::World(error as f32))
            }

            fn visit_i64<E>(self, error: i64) -> Result<MaxError, E> {
                Ok(MaxError::World(error as f32))
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<MaxError, E> {
                text.parse().map_err(E::custom)
            }
        }

        deserializer.deserialize_any(Words)
    }
}

impl PartialSchema for MaxError {
    fn schema() -> RefOr<Schema> {
        OneOfBuilder::new()
            .item(ObjectBuilder::new().schema_type(Type::Number))
            .item(ObjectBuilder::new().schema_type(Type::String))
            .item(ObjectBuilder::new().schema_type(Type::Null))
            .description(Some(
                "World units, text like `0.25vx` (multiples of the smallest spacing), or null: no guard",
            ))
            .into()
    }
}

impl ToSchema for MaxError {}

/// Distinguishes null, which is a value, from a name that is left out.
pub fn some_max_error<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<MaxError>, D::Error> {
    MaxError::deserialize(deserializer).map(Some)
}

/// Maximum size of a surface; β is found for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Budget {
    /// Triangles.
    Triangles(u64),
    /// Bytes on the wire: chunks with their headers.
    Bytes(u64),
}

/// How a budget is met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// β in force.
    pub beta: f32,
    /// Maximum triangles of the finished surface.
    pub triangles: u64,
}

#[cfg(test)]
mod tests {
    use super::MaxError;

    #[test]
    fn errors_are_world_units_spacings_or_none() {
        for (text, json, expected) in [
            ("none", "null", MaxError::None),
            ("0.5", "0.5", MaxError::World(0.5)),
            ("2", "2.0", MaxError::World(2.0)),
            ("0.25vx", "\"0.25vx\"", MaxError::Spacings(0.25)),
        ] {
            assert_eq!(text.parse(), Ok(expected));
            assert_eq!(serde_json::from_str::<MaxError>(json).expect(json), expected);
            assert_eq!(serde_json::to_string(&expected).expect("JSON"), json);
        }
        assert_eq!(
            serde_json::from_str::<MaxError>("3").expect("JSON"),
            MaxError::World(3.0)
        );
        assert_eq!(
            serde_json::from_str::<MaxError>("\"none\"").expect("JSON"),
            MaxError::None
        );
        assert_eq!(MaxError::Spacings(0.5).world([2.0, 0.5, 4.0]), Some(0.25));
    }

    #[test]
    fn other_words_are_refused_with_what_was_expected() {
        for text in ["", "vx", "-1", "nan", "inf", "-0.1vx", "1 vx", "much"] {
            let error = text.parse::<MaxError>().expect_err(text);
            assert!(
                error.starts_with(&format!("{text:?}, expected a number of world units")),
                "{error}"
            );
        }
        for json in ["[]", "true", "\"x\""] {
            assert!(serde_json::from_str::<MaxError>(json).is_err(), "{json}");
        }
    }
}
