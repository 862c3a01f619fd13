//! Messages of the server: section 3 of the protocol.

use serde::{Deserialize, Deserializer, de};
use serde_json::Value;

use crate::chunk::RegionKey;
use crate::error::{Error, ensure};

/// Root mean square and maximum of the distance of each region of 32³ cells.
pub type Distances = Vec<([u32; 3], [f64; 2])>;

/// A decoded frame from the server.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    tag = "type",
    rename_all = "kebab-case",
    rename_all_fields = "camelCase",
    deny_unknown_fields
)]
#[expect(missing_docs, reason = "the protocol defines the fields")]
pub enum Frame {
    Opening {
        bytes: u64,
        total_bytes: u64,
        device: Option<Value>,
    },
    Opened {
        volume: Value,
        step: u64,
        edit: Value,
        device: Value,
        capabilities: Value,
    },
    Prefix(Prefix),
    /// A chunk of kind `cut`, which [`Viewer`](crate::Viewer) holds.
    #[serde(skip)]
    Chunk {
        surface: u8,
        generation: u32,
        level: u8,
        region: RegionKey,
        bytes: usize,
        triangles: usize,
    },
    Committed {
        surface: u8,
        generation: u32,
        level: u8,
        #[serde(rename = "final")]
        is_final: bool,
    },
    Done {
        surface: u8,
        generation: u32,
        trace: String,
        statistics: Value,
    },
    Measured {
        surface: u8,
        generation: u32,
        /// Root mean square and maximum.
        #[serde(deserialize_with = "distance")]
        error: [f64; 2],
        #[serde(deserialize_with = "distances")]
        regions: Distances,
    },
    Superseded {
        surface: u8,
        generation: u32,
    },
    Removed {
        surface: u8,
    },
    Stepped {
        step: u64,
        label: Value,
    },
    Described {
        volume: Value,
        step: u64,
    },
    /// The members of the group.
    Group(Value),
    /// View of the member in control.
    Led(Value),
    /// Camera pose of the member in control.
    Posed(Value),
    Left {
        reason: String,
    },
    Heartbeat {
        seconds: f64,
    },
    /// A chunk of kind `error`: distances of a region's vertices.
    #[serde(skip)]
    Errors {
        surface: u8,
        generation: u32,
        region: RegionKey,
        distances: Vec<f32>,
    },
    /// An answer to a question; `kind` is its type.
    #[serde(skip)]
    Answer {
        kind: String,
        generation: u32,
        answer: Value,
    },
    Error {
        code: String,
        message: String,
        open: bool,
        /// The surface of the generation, if a generation failed.
        surface: Option<u8>,
        suggested_triangles: Option<u64>,
    },
    /// The end of the connection, with the code of the close frame.
    #[serde(skip)]
    Closed {
        code: Option<u16>,
    },
}

/// Contents of `prefix`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the protocol defines the fields")]
pub struct Prefix {
    pub surface: u8,
    pub generation: u32,
    pub level: u8,
    pub kind: Kind,
    pub mesher: Mesher,
    pub regions: usize,
    pub unchanged: usize,
    pub triangles: usize,
    #[serde(rename = "colorField")]
    pub color_field: Option<String>,
    #[serde(rename = "final")]
    pub is_final: bool,
}

/// Kind of the chunks of a prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Meshes of a cut.
    Cut,
}

/// Mesher of a prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mesher {
    /// Dual contouring.
    Dual,
    /// Marching cubes.
    MarchingCubes,
}

/// Messages whose fields stay JSON: type, fields, and fields that may be missing.
const UNTYPED: [(&str, &str, &str); 7] = [
    ("probed", "surface generation position inside values nearest", ""),
    ("distribution", "surface generation kind bins coarse coarseShare", ""),
    ("annotated", "surface generation annotation regions", ""),
    ("curve", "surface generation kind byError points", ""),
    ("group", "group you control followers asks", "people key leaderAway"),
    ("led", "volume step surfaces", ""),
    ("posed", "", "camera page"),
];

impl Frame {
    /// Returns the generation of the frame, if it has one.
    pub fn generation(&self) -> Option<u32> {
        match *self {
            Self::Prefix(Prefix { generation, .. })
            | Self::Chunk { generation, .. }
            | Self::Committed { generation, .. }
            | Self::Done { generation, .. }
            | Self::Measured { generation, .. }
            | Self::Superseded { generation, .. }
            | Self::Errors { generation, .. }
            | Self::Answer { generation, .. } => Some(generation),
            _ => None,
        }
    }

    /// Returns the surface of the frame, if it has one.
    fn surface(&self) -> Option<u8> {
        match *self {
            Self::Prefix(Prefix { surface, .. })
            | Self::Chunk { surface, .. }
            | Self::Committed { surface, .. }
            | Self::Done { surface, .. }
            | Self::Measured { surface, .. }
            | Self::Superseded { surface, .. }
            | Self::Removed { surface }
            | Self::Errors { surface, .. } => Some(surface),
            _ => None,
        }
    }

    /// Reads a text frame.
    pub(crate) fn read(text: &str) -> Result<Self, Error> {
        let message: Value = serde_json::from_str(text)?;
        let kind = message["type"].as_str().unwrap_or_default();
        if let Some((_, fields, optional)) = UNTYPED.iter().find(|(name, ..)| *name == kind) {
            check_fields(&message, fields, optional)?;
            if let Some(generation) = message.get("generation") {
                return Ok(Self::Answer {
                    kind: kind.to_owned(),
                    generation: u32::deserialize(generation)?,
                    answer: message,
                });
            }
        }
        let frame = Self::deserialize(message)?;
        ensure(frame.surface() <= Some(3), || format!("surfaces are 0 to 3: {frame:?}"))?;
        match &frame {
            Self::Prefix(prefix) => ensure(prefix.level <= 5, || format!("levels are 0 to 5: {prefix:?}"))?,
            Self::Done { statistics, .. } => check_statistics(statistics)?,
            _ => {}
        }
        Ok(frame)
    }
}

/// Checks that a message has exactly the documented fields.
fn check_fields(message: &Value, fields: &str, optional: &str) -> Result<(), Error> {
    let names = message.as_object().into_iter().flatten().map(|(name, _)| name.as_str());
    let mut found: Vec<_> = names
        .filter(|name| *name != "type" && optional.split(' ').all(|other| other != *name))
        .collect();
    let mut expected: Vec<_> = fields.split_whitespace().collect();
    found.sort_unstable();
    expected.sort_unstable();
    ensure(found == expected, || format!("fields {found:?}, expected {expected:?}"))
}

/// Distances from the isosurface.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Distance {
    rms: f64,
    max: f64,
}

impl Distance {
    fn check<E: de::Error>(&self) -> Result<[f64; 2], E> {
        if 0.0 <= self.rms && self.rms <= self.max {
            Ok([self.rms, self.max])
        } else {
            Err(E::custom(format!("rms {}, max {}", self.rms, self.max)))
        }
    }
}

fn distance<'de, D: Deserializer<'de>>(value: D) -> Result<[f64; 2], D::Error> {
    Distance::deserialize(value)?.check()
}

/// Distances of a region.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionDistance {
    region: [u32; 3],
    rms: f64,
    max: f64,
}

fn distances<'de, D: Deserializer<'de>>(value: D) -> Result<Distances, D::Error> {
    let distances = Vec::<RegionDistance>::deserialize(value)?.into_iter();
    distances
        .map(|RegionDistance { region, rms, max }| Ok((region, Distance { rms, max }.check()?)))
        .collect()
}

/// Names of `statistics`, of which others may be added.
const STATISTICS: &str = "mesher beta tolerance maxError topology featureRange gaveWay isTreeCut estimatedError error fullTriangles mesherTriangles removedParts \
    removedTriangles unmatchedPositions activeCells leaves triangles vertices lostCubes unpatchedVertices stagesMs wallMs deviceBytes volumeBytes device";

fn check_statistics(statistics: &Value) -> Result<(), Error> {
    let violation = |rule: &str| format!("{rule}: {statistics}");
    for name in STATISTICS.split_whitespace() {
        ensure(statistics.get(name).is_some(), || violation(name))?;
    }
    if let Some(all) = statistics["mesherTriangles"].as_u64() {
        let is_below = statistics["triangles"].as_u64() <= Some(all);
        ensure(is_below, || violation("triangles are at most mesherTriangles"))?;
    }
    let mut names = statistics.as_object().into_iter().flatten();
    let is_camel_case = names.all(|(name, _)| !name.contains('_'));
    ensure(is_camel_case, || violation("names are in camelCase"))?;
    let has_one = statistics["beta"].is_null() != statistics["tolerance"].is_null();
    ensure(has_one, || violation("either β or a tolerance"))?;
    ensure(statistics["topology"] != "auto", || violation("topology is never auto"))?;
    if !statistics["error"].is_null() {
        distance(&statistics["error"])?;
    }
    Ok(())
}
