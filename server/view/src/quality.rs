//! How fine a surface is: mesher, guards and budgets, as on the command line, in REST and in the stream.

use std::str::FromStr;

use isopeel_kernels::{Mesher, Topology};
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};

/// Which mesher turns the cut into triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum TopologyName {
    /// As `preserve`, but it gives way to a budget
    #[default]
    Auto,
    /// Only what is safe to merge is merged: nothing vanishes, nothing closes
    Preserve,
    /// Small parts may vanish and openings close
    Free,
}

impl From<TopologyName> for Topology {
    fn from(name: TopologyName) -> Self {
        match name {
            TopologyName::Auto | TopologyName::Preserve => Self::Preserve,
            TopologyName::Free => Self::Free,
        }
    }
}

/// A distance, 0 or more. In JSON a number of world units, or text such as `0.25vx` (multiples of the volume's smallest spacing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distance {
    /// World units.
    World(f32),
    /// Multiples of the smallest spacing.
    Spacings(f32),
}

impl Distance {
    /// The expected form, for error messages.
    pub const EXPECTED: &str =
        "expected a number of world units, 0 or more, or text like \"0.25vx\" (multiples of the smallest spacing)";

    /// Converts to multiples of the smallest spacing `smallest`, in world units. The smallest spacing is the unit of lengths on the device.
    /// The result is at most the largest finite number.
    pub fn in_spacings(self, smallest: f64) -> f32 {
        match self {
            Self::World(distance) => ((f64::from(distance) / smallest) as f32).min(f32::MAX),
            Self::Spacings(n) => n,
        }
    }

    /// Converts to world units, in a volume with the smallest spacing `smallest`.
    pub fn world(self, smallest: f64) -> f32 {
        match self {
            Self::World(distance) => distance,
            Self::Spacings(n) => (f64::from(n) * smallest) as f32,
        }
    }

    /// Whether the distance is finite and not below 0.
    pub fn is_valid(self) -> bool {
        match self {
            Self::World(distance) | Self::Spacings(distance) => distance.is_finite() && distance >= 0.0,
        }
    }
}

impl std::fmt::Display for Distance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::World(distance) => write!(f, "{distance}"),
            Self::Spacings(n) => write!(f, "{n}vx"),
        }
    }
}

impl FromStr for Distance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = match text.strip_suffix("vx") {
            Some(number) => number.parse().map(Self::Spacings),
            None => text.parse().map(Self::World),
        };
        let valid = parsed.ok().filter(|distance| distance.is_valid());
        valid.ok_or_else(|| format!("{text:?}, {}", Self::EXPECTED))
    }
}

impl Serialize for Distance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::World(distance) => serializer.serialize_f32(*distance),
            Self::Spacings(_) => serializer.collect_str(self),
        }
    }
}

/// Limit on the error of a surface: a distance, or pixels of the picture that a camera makes of it. In JSON a number of world units, or text
/// such as `0.25vx` or `1px`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(type = "number | string"))]
pub enum ErrorLimit {
    /// A distance in space.
    Distance(Distance),
    /// Pixels, within which nearly all of what the camera sees is to lie.
    Pixels(f32),
}

impl ErrorLimit {
    /// The expected form, for error messages.
    pub const EXPECTED: &str = "expected a number of world units, 0 or more, or text like \"0.25vx\" (multiples of the smallest spacing) or \"1px\" (pixels of the picture, above 0)";

    /// Spacings that a pixel counts as if there is no camera: where a voxel covers a few pixels, an error of that size cannot be seen.
    pub const SPACINGS_OF_A_PIXEL: f32 = 0.1;

    /// Returns the limit in multiples of the smallest spacing `smallest` (world units) for a surface without a camera.
    pub fn in_spacings(self, smallest: f64) -> f32 {
        match self {
            Self::Distance(distance) => distance.in_spacings(smallest),
            Self::Pixels(pixels) => (pixels * Self::SPACINGS_OF_A_PIXEL).min(f32::MAX),
        }
    }

    /// Whether the limit is finite, and not below 0; pixels are above 0.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Distance(distance) => distance.is_valid(),
            Self::Pixels(pixels) => pixels.is_finite() && pixels > 0.0,
        }
    }
}

impl std::fmt::Display for ErrorLimit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Distance(distance) => distance.fmt(f),
            Self::Pixels(pixels) => write!(f, "{pixels}px"),
        }
    }
}

impl FromStr for ErrorLimit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = match text.strip_suffix("px") {
            Some(number) => number.parse().ok().map(Self::Pixels),
            None => text.parse().ok().map(Self::Distance),
        };
        let valid = parsed.filter(|limit| limit.is_valid());
        valid.ok_or_else(|| format!("{text:?}, {}", Self::EXPECTED))
    }
}

impl Serialize for ErrorLimit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Distance(distance) => distance.serialize(serializer),
            Self::Pixels(_) => serializer.collect_str(self),
        }
    }
}

impl<'de> Deserialize<'de> for ErrorLimit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(
            untagged,
            expecting = "expected a number of world units, or text like \"0.25vx\" or \"1px\""
        )]
        enum Form {
            Number(f32),
            Text(String),
        }

        match Form::deserialize(deserializer)? {
            Form::Number(distance) => Ok(Self::Distance(Distance::World(distance))),
            Form::Text(text) => text.parse().map_err(de::Error::custom),
        }
    }
}

/// Guard on the error: how far a decimated part may be from the surface it stands for. In JSON a distance, null or `none`, or `auto`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(type = "number | string | null"))]
pub enum MaxError {
    /// [`MaxError::AUTO`] if β decides; no guard if an error or a budget does.
    #[default]
    Auto,
    /// No guard.
    None,
    /// This far.
    At(Distance),
}

impl MaxError {
    /// The guard that `auto` means if β decides.
    pub const AUTO: Distance = Distance::Spacings(0.25);

    /// The expected form, for error messages.
    pub const EXPECTED: &str = "expected a number of world units, 0 or more, text like \"0.25vx\" (multiples of the smallest spacing), \"none\" or \"auto\"";
}

impl std::fmt::Display for MaxError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::None => f.write_str("none"),
            Self::At(distance) => distance.fmt(f),
        }
    }
}

impl FromStr for MaxError {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "none" => Ok(Self::None),
            _ => match text.parse() {
                Ok(distance) => Ok(Self::At(distance)),
                Err(_) => Err(format!("{text:?}, {}", Self::EXPECTED)),
            },
        }
    }
}

impl Serialize for MaxError {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::None => serializer.serialize_unit(),
            Self::At(distance) => distance.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for MaxError {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Words;

        impl Visitor<'_> for Words {
            type Value = MaxError;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a number of world units, text like \"0.25vx\" or \"auto\", or null")
            }

            fn visit_unit<E>(self) -> Result<MaxError, E> {
                Ok(MaxError::None)
            }

            fn visit_none<E>(self) -> Result<MaxError, E> {
                Ok(MaxError::None)
            }

            fn visit_f64<E>(self, error: f64) -> Result<MaxError, E> {
                Ok(MaxError::At(Distance::World(error as f32)))
            }

            fn visit_u64<E>(self, error: u64) -> Result<MaxError, E> {
                Ok(MaxError::At(Distance::World(error as f32)))
            }

            fn visit_i64<E>(self, error: i64) -> Result<MaxError, E> {
                Ok(MaxError::At(Distance::World(error as f32)))
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<MaxError, E> {
                text.parse().map_err(E::custom)
            }
        }

        deserializer.deserialize_any(Words)
    }
}

/// Deserializes a field that is present: null means 0, an absent field no change.
pub fn some_min_part<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    let min_part = Option::<f64>::deserialize(deserializer)?;
    Ok(Some(min_part.unwrap_or_default()))
}

/// Maximum triangles of a surface: a number, or a share of the full surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(untagged)]
pub enum TriangleBudget {
    /// A number of triangles.
    AtMost(u64),
    /// A share of the full surface.
    Share(ShareBudget),
}

/// A share of the full surface's triangles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(optional_fields))]
#[serde(deny_unknown_fields)]
pub struct ShareBudget {
    /// The share, above 0 and up to 1.
    pub share: f64,
    /// Maximum triangles, whatever the share is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<u64>,
}

impl TriangleBudget {
    /// Checks that a number or a maximum is at least 1, and that a share is above 0 and at most 1.
    ///
    /// # Errors
    /// The invalid value, and the expected range.
    pub fn check(self) -> Result<(), String> {
        match self {
            Self::AtMost(0) => Err("0, expected 1 or more".into()),
            Self::Share(ShareBudget { share, max }) if !(share > 0.0 && share <= 1.0) || max == Some(0) => Err(
                format!("a share of {share} and at most {max:?}, expected a share above 0 and up to 1, and 1 or more"),
            ),
            Self::AtMost(_) | Self::Share(_) => Ok(()),
        }
    }

    /// Returns the maximum triangles, for a full surface of `full` triangles.
    pub fn of(self, full: u64) -> u64 {
        match self {
            Self::AtMost(n) => n,
            Self::Share(ShareBudget { share, max }) => {
                let share_of_full = (share * full as f64) as u64;
                share_of_full.min(max.unwrap_or(u64::MAX)).max(1)
            }
        }
    }
}

/// Parses `100000`, or a share such as `25%`, of the command line.
impl FromStr for TriangleBudget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = match text.strip_suffix('%') {
            Some(percent) => percent.parse().ok().map(|percent: f64| {
                Self::Share(ShareBudget {
                    share: percent / 100.0,
                    max: None,
                })
            }),
            None => text.parse().ok().map(Self::AtMost),
        };
        let valid = parsed.filter(|budget| budget.check().is_ok());
        valid.ok_or_else(|| format!("{text:?}, expected a number of triangles, 1 or more, or a share such as 25%"))
    }
}

/// Maximum size of a surface. The tolerance is fitted to the budget; for marching cubes, β is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// Triangles.
    Triangles(TriangleBudget),
    /// Bytes on the wire: chunks with their headers.
    Bytes(u64),
}

/// The result of fitting a surface to a budget.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// Tolerance in force, in smallest spacings; for marching cubes β. Below 0 nothing is decimated.
    pub threshold: f32,
    /// Guard on the topology in force.
    pub topology: Topology,
    /// Maximum triangles of the finished surface.
    pub triangles: u64,
    /// Whether the surface is a cut of the vertex tree, and not of the octree.
    pub is_tree_cut: bool,
    /// Error in the camera's picture; `None` if the surface was made for no camera, or if it is not a cut of the vertex tree.
    pub pixels: Option<PixelError>,
}

/// What decides how fine a surface is in its camera's picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum PixelLimit {
    /// The error that was asked for.
    Error,
    /// The budget.
    Budget,
    /// The picture: more triangles would show nothing more.
    Pixels,
    /// The guard on the error.
    Guard,
    /// The data: this is the full surface.
    Data,
}

/// Error of a surface in its camera's picture, as expected from the tree's quadrics. It is no bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct PixelError {
    /// Pixels within which nearly all of what the camera sees lies: twice the root mean square.
    pub within: f32,
    /// What decides.
    pub limited_by: PixelLimit,
}

/// A guard, which limits what decimation may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum GuardName {
    /// On the error.
    MaxError,
    /// On the topology.
    Topology,
}

#[cfg(test)]
mod tests {
    use super::{Distance, ErrorLimit, MaxError, ShareBudget, TriangleBudget};

    #[test]
    fn errors_are_world_units_spacings_auto_or_none() {
        for (text, json, expected) in [
            ("auto", "\"auto\"", MaxError::Auto),
            ("none", "null", MaxError::None),
            ("0.5", "0.5", MaxError::At(Distance::World(0.5))),
            ("2", "2.0", MaxError::At(Distance::World(2.0))),
            ("0.25vx", "\"0.25vx\"", MaxError::At(Distance::Spacings(0.25))),
        ] {
            assert_eq!(text.parse(), Ok(expected));
            assert_eq!(expected.to_string(), text);
            assert_eq!(serde_json::from_str::<MaxError>(json).expect(json), expected);
            assert_eq!(serde_json::to_string(&expected).expect("JSON"), json);
        }
        assert_eq!(
            serde_json::from_str::<MaxError>("3").expect("JSON"),
            MaxError::At(Distance::World(3.0))
        );
        assert_eq!(
            serde_json::from_str::<MaxError>("\"none\"").expect("JSON"),
            MaxError::None
        );
        for (text, json, expected) in [
            ("2", "2.0", ErrorLimit::Distance(Distance::World(2.0))),
            ("0.25vx", "\"0.25vx\"", ErrorLimit::Distance(Distance::Spacings(0.25))),
            ("1.5px", "\"1.5px\"", ErrorLimit::Pixels(1.5)),
        ] {
            assert_eq!(text.parse(), Ok(expected));
            assert_eq!(expected.to_string(), text);
            assert_eq!(serde_json::from_str::<ErrorLimit>(json).expect(json), expected);
            assert_eq!(serde_json::to_string(&expected).expect("JSON"), json);
        }
        assert_eq!(ErrorLimit::Pixels(2.0).in_spacings(9.0), 0.2);
        assert_eq!(Distance::Spacings(0.5).in_spacings(1e-30), 0.5);
        assert_eq!(Distance::World(0.5).in_spacings(2.0), 0.25);
        assert_eq!(Distance::World(1.0).in_spacings(1e-50), f32::MAX);
    }

    #[test]
    fn other_words_are_refused_with_what_was_expected() {
        for text in ["0px", "-1px", "px"] {
            assert!(text.parse::<ErrorLimit>().is_err(), "{text}");
        }
        for text in ["", "vx", "-1", "nan", "inf", "-0.1vx", "1 vx", "much"] {
            let expected = format!("{text:?}, expected a number of world units");
            let error = text.parse::<MaxError>().expect_err(text);
            assert!(error.starts_with(&expected), "{error}");
            let error = text.parse::<Distance>().expect_err(text);
            assert!(error.starts_with(&expected), "{error}");
            let error = text.parse::<ErrorLimit>().expect_err(text);
            assert!(error.starts_with(&expected), "{error}");
        }
        for json in ["[]", "true", "\"x\""] {
            assert!(serde_json::from_str::<MaxError>(json).is_err(), "{json}");
        }
        for json in ["null", "\"none\"", "\"auto\"", "{}"] {
            assert!(serde_json::from_str::<ErrorLimit>(json).is_err(), "{json}");
        }
    }

    #[test]
    fn triangles_are_a_number_or_a_share() {
        let share = |share, max| TriangleBudget::Share(ShareBudget { share, max });
        for (json, expected) in [
            ("1000", TriangleBudget::AtMost(1000)),
            (r#"{"share":0.25}"#, share(0.25, None)),
            (r#"{"share":0.25,"max":1000000}"#, share(0.25, Some(1_000_000))),
        ] {
            assert_eq!(serde_json::from_str::<TriangleBudget>(json).expect(json), expected);
            assert_eq!(serde_json::to_string(&expected).expect("JSON"), json);
        }
        assert_eq!("25%".parse(), Ok(share(0.25, None)));
        assert_eq!("12".parse(), Ok(TriangleBudget::AtMost(12)));
        for text in ["0", "0%", "101%", "-1", "x", "", "%"] {
            assert!(text.parse::<TriangleBudget>().is_err(), "{text}");
        }
        for json in ["-1", "1.5", "\"25%\"", r#"{"max":5}"#, r#"{"share":1,"most":5}"#] {
            assert!(serde_json::from_str::<TriangleBudget>(json).is_err(), "{json}");
        }
        assert_eq!(
            (
                share(0.25, None).of(1000),
                share(0.25, Some(100)).of(1000),
                share(0.0001, None).of(10)
            ),
            (250, 100, 1)
        );
    }
}
