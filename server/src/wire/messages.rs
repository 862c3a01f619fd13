//! Text frames and limits of the stream. `PROTOCOL.md` is normative.

mod close;

use isopeel_codec::chunk::{ChunkKind, MAX_SURFACES};
use isopeel_view::Edit;
use isopeel_view::quality::MesherName;
use serde::de::value::MapDeserializer;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;

pub use close::CloseCode;
use isopeel_extraction::{Curve, Distribution, ExtractionStatistics, MeasuredError, Probe};

use super::group::{Follower, LedSurface, Pose, Resume};
use crate::service::Preparation;

/// Subprotocol that a client must offer.
pub const SUBPROTOCOL: &str = "isopeel.v2";

/// Maximum bytes of a client's message. An edit with 64 control points takes about 4 KiB.
pub const MAX_MESSAGE_BYTES: usize = 64 * 1024;

/// Number of consecutive malformed messages after which the server closes the connection with [`CloseCode::Malformed`].
pub const MAX_MALFORMED: u32 = 16;

/// A text frame from a client.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(
    tag = "type",
    rename_all = "kebab-case",
    rename_all_fields = "camelCase",
    deny_unknown_fields
)]
pub enum ClientMessage {
    /// Open a volume.
    Open {
        /// Its id.
        volume: String,
        /// Time step.
        #[serde(default)]
        step: u32,
        /// Names of codings that the client can read beside that of every client; those that are unknown here count for nothing.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Go to another time step of the open volume.
    Step {
        /// Which one.
        step: u32,
    },
    /// Change the view of a surface and extract.
    Edit(Box<SurfaceEdit>),
    /// End the running generations.
    Cancel {},
    /// Remove a surface.
    Remove {
        /// Its number.
        surface: u32,
    },
    /// The first prefix of a generation is on screen.
    Drawn {
        /// Of which edit.
        generation: u32,
    },
    /// Ask what is at a position.
    Probe {
        /// Number of the surface.
        #[serde(default)]
        surface: u32,
        /// In the world.
        position: [f64; 3],
    },
    /// Ask how values are distributed over a surface.
    Distribution {
        /// Number of the surface.
        #[serde(default)]
        surface: u32,
        /// Bins from 0 to 1.
        #[serde(default = "default_bins")]
        bins: u32,
    },
    /// Ask how error and triangles of a surface depend on each other.
    Curve {
        /// Number of the surface.
        #[serde(default)]
        surface: u32,
    },
    /// Ask for a number of each vertex of a surface.
    Annotate {
        /// Number of the surface.
        #[serde(default)]
        surface: u32,
        /// Which one.
        annotation: Annotation,
    },
    /// Start a group, whose followers are shown what is shown here, or lead one again.
    Lead {
        /// The group that was led on another connection.
        #[serde(default)]
        resume: Option<Resume>,
        /// As those of `open`, for connections without one.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Follow a group.
    Join {
        /// Its id.
        group: String,
        /// What to be called in it.
        #[serde(default)]
        name: Option<String>,
        /// As those of `open`, for connections without one.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Ask for signs of life.
    Heartbeat {},
    /// Leave the group; who leads it ends it.
    Leave {},
    /// How the surfaces are looked at, for those who follow.
    Pose(Pose),
    /// Ask for control, or no longer.
    AskControl {
        /// Whether it is asked for.
        asks: bool,
    },
    /// Give control to a follower who has asked for it, or back to the leader.
    GiveControl {
        /// The follower's number; 0: the leader.
        to: u32,
    },
}

/// What a surface is annotated with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum Annotation {
    /// The distance of each vertex to the isosurface.
    Error,
    /// The largest distance to the isosurface of each vertex and of the triangles around it.
    ErrorAround,
}

/// Default number of bins.
fn default_bins() -> u32 {
    64
}

/// An edit and the number of the surface that it is for; 0 if it is left out.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(test, derive(ts_rs::TS), ts(type = "{ surface?: number } & Edit"))]
pub struct SurfaceEdit {
    /// Number of the surface.
    pub surface: u32,
    /// What changes.
    pub edit: Edit,
}

/// Written by hand, because serde cannot flatten and refuse unknown fields at the same time.
impl<'de> Deserialize<'de> for SurfaceEdit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error;

        struct Fields;

        impl<'de> serde::de::Visitor<'de> for Fields {
            type Value = Vec<(String, Value)>;

            fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str("an edit")
            }

            /// Collects the fields in a list instead of a map, because a map would hide duplicate fields.
            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(fields)
            }
        }

        let fields = deserializer.deserialize_map(Fields)?;
        let (surface, edit): (Vec<_>, Vec<_>) = fields.into_iter().partition(|(name, _)| name == "surface");
        let surface = match &surface[..] {
            [] => 0,
            [(_, number)] => u32::deserialize(number).map_err(|error| D::Error::custom(format!("surface: {error}")))?,
            _ => return Err(D::Error::duplicate_field("surface")),
        };
        let edit = MapDeserializer::<_, serde_json::Error>::new(edit.into_iter());
        Ok(Self {
            surface,
            edit: Edit::deserialize(edit).map_err(D::Error::custom)?,
        })
    }
}

impl ClientMessage {
    /// Parses a text frame.
    ///
    /// # Errors
    /// A message for clients that says what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }
}

/// What this server does beyond what every server of this version does.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Capabilities {
    /// Surfaces that a connection may have; their numbers are those below.
    pub surfaces: u32,
    /// Kinds of chunks that may come.
    pub chunk_kinds: Vec<ChunkKind>,
    /// Whether `measured` may follow `done`.
    pub measured_error: bool,
    /// Whether `step` is understood.
    pub steps: bool,
    /// Whether volumes and time steps may appear while the server runs.
    pub watches: bool,
    /// Whether `lead` and `join` are understood.
    pub groups: bool,
    /// Types of messages that ask about a surface.
    pub questions: &'static [&'static str],
}

impl Capabilities {
    /// Surfaces of a connection.
    pub const SURFACES: u32 = MAX_SURFACES as u32;
    /// What may be asked.
    const QUESTIONS: &'static [&'static str] = &["probe", "distribution", "curve", "annotate"];
}

impl Default for Capabilities {
    fn default() -> Self {
        Self {
            surfaces: Self::SURFACES,
            chunk_kinds: ChunkKind::ALL.to_vec(),
            measured_error: true,
            steps: true,
            watches: false,
            groups: true,
            questions: Self::QUESTIONS,
        }
    }
}

/// The measured error of a region, in world units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct RegionError {
    /// Region, in units of 32 cells.
    pub region: [u32; 3],
    /// Root mean square.
    pub rms: f32,
    /// Maximum.
    pub max: f32,
}

/// A text frame from the server.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "type", rename_all = "kebab-case", rename_all_fields = "camelCase")]
pub enum ServerMessage {
    /// The volume is being read, put on the device and counted.
    Opening {
        /// Bytes of files and samples that this has gone through so far.
        bytes: u64,
        /// Bytes that it has to go through.
        total_bytes: u64,
        /// The device is being prepared, and nothing was read yet.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[cfg_attr(test, ts(optional))]
        device: Option<Preparation>,
    },
    /// The volume is open.
    Opened {
        /// As `GET /api/v1/volumes/{id}`.
        #[cfg_attr(test, ts(as = "crate::service::VolumeInfo"))]
        volume: Box<RawValue>,
        /// Time step.
        step: u32,
        /// Every value in force.
        edit: Edit,
        /// Name of the device.
        device: String,
        /// What this server does.
        capabilities: Capabilities,
    },
    /// The volume is at another time step, of which surfaces follow.
    Stepped {
        /// Which one.
        step: u32,
        /// Its time as text for people, if the file has times.
        label: Option<String>,
    },
    /// What the values of the time step are like.
    Described {
        /// As `GET /api/v1/volumes/{id}` of that step.
        #[cfg_attr(test, ts(as = "crate::service::VolumeInfo"))]
        volume: Box<RawValue>,
        /// Time step.
        step: u32,
    },
    /// A prefix begins.
    Prefix {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// Level of the prefix.
        level: u8,
        /// What its chunks are.
        kind: ChunkKind,
        /// Which mesher made them.
        mesher: MesherName,
        /// Chunks that follow.
        regions: usize,
        /// Regions that the client keeps as they are.
        unchanged: usize,
        /// Triangles of the whole surface once this prefix is committed.
        triangles: u64,
        /// Whether this is the final surface of the edit.
        #[serde(rename = "final")]
        is_final: bool,
    },
    /// Every chunk of this prefix was sent.
    Committed {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// Level of the prefix.
        level: u8,
        /// Whether this is the final surface of the edit.
        #[serde(rename = "final")]
        is_final: bool,
    },
    /// The final surface is complete.
    Done {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// What the edit has in the server's log: 16 hexadecimal digits.
        trace: String,
        /// As `isopeel extract --stats` prints them.
        statistics: ExtractionStatistics,
    },
    /// The final surface was measured.
    Measured {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// Of the whole surface.
        error: MeasuredError,
        /// Of each region that has triangles.
        regions: Vec<RegionError>,
    },
    /// What is at a position.
    Probed {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface that was probed; 0 if no surface is shown.
        generation: u32,
        /// The answer.
        #[serde(flatten)]
        probe: Probe,
    },
    /// How values are distributed over a surface.
    Distribution {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// The answer.
        #[serde(flatten)]
        distribution: Distribution,
    },
    /// How error and triangles of a surface depend on each other.
    Curve {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// The answer.
        #[serde(flatten)]
        curve: Curve,
    },
    /// Chunks of an annotation follow.
    Annotated {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
        /// What they hold.
        annotation: Annotation,
        /// How many.
        regions: usize,
    },
    /// The generation ended early.
    Superseded {
        /// Number of the surface.
        surface: u8,
        /// Of which edit.
        generation: u32,
    },
    /// The answer to `remove`: the surface is gone.
    Removed {
        /// Number of the surface.
        surface: u8,
    },
    /// Who is in the group.
    Group {
        /// Its id, which a link to it has.
        group: String,
        /// The viewer's own number in it; 0: it leads.
        you: u32,
        /// Number of who has control.
        control: u32,
        /// How many follow.
        followers: u32,
        /// Whether the viewer asks for control.
        asks: bool,
        /// The leader's connection was lost; the group waits for it.
        leader_away: bool,
        /// For the leader alone: what it comes back with on another connection.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[cfg_attr(test, ts(optional))]
        key: Option<String>,
        /// For the leader: some of those who follow, first those who ask for control.
        people: Vec<Follower>,
    },
    /// What who has control shows, which is shown to this viewer now.
    Led {
        /// The volume.
        volume: String,
        /// Time step.
        step: u32,
        /// The surfaces that there are, with every value in force.
        surfaces: Vec<LedSurface>,
    },
    /// How who has control looks at it.
    Posed {
        /// Camera and look.
        #[serde(flatten)]
        pose: Pose,
    },
    /// A sign of life, at once and then again and again, for a client that asked for it.
    Heartbeat {
        /// Time until the next one.
        seconds: f64,
    },
    /// The viewer is in no group any more.
    Left {
        /// Why.
        reason: String,
    },
    /// A message or a job failed.
    Error {
        /// Stable code for programs.
        code: &'static str,
        /// What was wrong and what was expected.
        message: String,
        /// Whether the connection stays open.
        open: bool,
        /// Number of the surface whose generation failed.
        #[cfg_attr(test, ts(optional))]
        #[serde(skip_serializing_if = "Option::is_none")]
        surface: Option<u8>,
        /// With `too-large`, if the surface has too many triangles: a budget that is within the limit.
        #[cfg_attr(test, ts(optional))]
        #[serde(skip_serializing_if = "Option::is_none")]
        suggested_triangles: Option<u64>,
    },
}

impl ServerMessage {
    /// Whether another budget may avoid this error.
    pub fn suggests_budget(&self) -> bool {
        matches!(
            self,
            Self::Error {
                suggested_triangles: Some(_),
                ..
            }
        )
    }

    /// Returns the text frame.
    pub fn to_json(&self) -> String {
        // Cannot fail: serde_json fails only for maps whose keys are not strings, and messages have no such maps.
        serde_json::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests;
