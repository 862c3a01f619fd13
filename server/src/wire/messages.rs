//! Text frames and limits of the stream. `PROTOCOL.md` is normative.

mod close;

use isopeel_codec::chunk::{ChunkKind, MAX_SURFACES};
use isopeel_view::quality::MesherName;
use isopeel_view::{CameraJson, Edit};
use serde::de::value::MapDeserializer;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;

pub use close::CloseCode;
use isopeel_extraction::{Curve, Distribution, ExtractionStatistics, MeasuredError, Probe};

use super::group::{Follower, LedSurface, Pose, Resume};
use crate::service::Preparation;

/// Subprotocol that a client must offer.
pub const SUBPROTOCOL: &str = "isopeel.v3";

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
        /// Id of the volume.
        volume: String,
        /// Time step.
        #[serde(default)]
        step: u32,
        /// Names of codings that the client can decode in addition to the one that every client can. The server ignores names that it does
        /// not know.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Go to another time step of the open volume.
    Step {
        /// Number of the time step.
        step: u32,
    },
    /// Change the view of a surface and extract.
    Edit(Box<SurfaceEdit>),
    /// End the running generations.
    Cancel {},
    /// Remove a surface.
    Remove {
        /// Number of the surface.
        surface: u32,
    },
    /// The first prefix of a generation is on screen.
    Drawn {
        /// Generation whose prefix is on screen.
        generation: u32,
    },
    /// Ask what is at a position.
    Probe {
        /// Number of the surface.
        #[serde(default)]
        surface: u32,
        /// Position in world coordinates.
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
        /// The requested annotation.
        annotation: Annotation,
    },
    /// Start a group, whose followers are shown what is shown here, or lead one again.
    Lead {
        /// The group that was led on another connection.
        #[serde(default)]
        resume: Option<Resume>,
        /// As `codings` of `open`, for a connection that has opened no volume.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Follow a group.
    Join {
        /// Id of the group.
        group: String,
        /// Name that the leader sees.
        #[serde(default)]
        name: Option<String>,
        /// As `codings` of `open`, for a connection that has opened no volume.
        #[serde(default)]
        codings: Vec<String>,
    },
    /// Ask for signs of life.
    Heartbeat {},
    /// Leave the group; who leads it ends it.
    Leave {},
    /// How the viewer looks at the surfaces: what it sees from near is made finer.
    Camera {
        /// The camera; null: none of its own.
        camera: Option<CameraJson>,
    },
    /// How the surfaces are looked at, for those who follow.
    Pose(Pose),
    /// Ask for control, or no longer.
    AskControl {
        /// True to ask for control, false to withdraw the request.
        asks: bool,
    },
    /// Give control to a follower who has asked for it, or back to the leader.
    GiveControl {
        /// Number of the follower; 0: the leader.
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

/// Optional functions that this server supports.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Capabilities {
    /// Maximum number of surfaces of a connection. The numbers of surfaces are lower than this.
    pub surfaces: u32,
    /// Kinds of chunks that the server may send.
    pub chunk_kinds: Vec<ChunkKind>,
    /// Whether the server may send `measured` after `done`.
    pub measured_error: bool,
    /// Whether the server supports `step`.
    pub steps: bool,
    /// Whether volumes and time steps may appear while the server runs.
    pub watches: bool,
    /// Whether the server supports `lead` and `join`.
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
    /// Position of the region, in units of 32 cells.
    pub region: [u32; 3],
    /// Root mean square of the distance.
    pub rms: f32,
    /// Maximum of the distance.
    pub max: f32,
}

/// A text frame from the server.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "type", rename_all = "kebab-case", rename_all_fields = "camelCase")]
pub enum ServerMessage {
    /// The volume is being read, put on the device and counted.
    Opening {
        /// Bytes of files and samples that the server has processed so far.
        bytes: u64,
        /// Bytes that the server has to process in total.
        total_bytes: u64,
        /// Progress of the device's preparation, before the server reads the volume.
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
        /// The values of all parameters.
        edit: Edit,
        /// Name of the device.
        device: String,
        /// Optional functions that this server supports.
        capabilities: Capabilities,
    },
    /// The volume is at another time step, of which surfaces follow.
    Stepped {
        /// Number of the time step.
        step: u32,
        /// Time of the step as text for users, if the file has times.
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
        /// Generation of the surface.
        generation: u32,
        /// Level of the prefix.
        level: u8,
        /// Kind of the chunks.
        kind: ChunkKind,
        /// Mesher that made the chunks.
        mesher: MesherName,
        /// Number of chunks that follow.
        regions: usize,
        /// Number of regions that the client keeps unchanged.
        unchanged: usize,
        /// Triangles of the whole surface once this prefix is committed.
        triangles: u64,
        /// Field whose values chunks with values have.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[cfg_attr(test, ts(optional))]
        color_field: Option<String>,
        /// Whether this is the final surface of the edit.
        #[serde(rename = "final")]
        is_final: bool,
    },
    /// Every chunk of this prefix was sent.
    Committed {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface.
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
        /// Generation of the surface.
        generation: u32,
        /// Id of the edit in the server's log: 16 hexadecimal digits.
        trace: String,
        /// As `isopeel extract --stats` prints them.
        statistics: ExtractionStatistics,
    },
    /// The final surface was measured.
    Measured {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface.
        generation: u32,
        /// Error of the whole surface.
        error: MeasuredError,
        /// Error of each region that has triangles.
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
        /// Generation of the surface.
        generation: u32,
        /// The answer.
        #[serde(flatten)]
        distribution: Distribution,
    },
    /// How error and triangles of a surface depend on each other.
    Curve {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface.
        generation: u32,
        /// The answer.
        #[serde(flatten)]
        curve: Curve,
    },
    /// Chunks of an annotation follow.
    Annotated {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface.
        generation: u32,
        /// Annotation that the chunks hold.
        annotation: Annotation,
        /// Number of chunks that follow.
        regions: usize,
    },
    /// The generation ended early.
    Superseded {
        /// Number of the surface.
        surface: u8,
        /// Generation of the surface.
        generation: u32,
    },
    /// The answer to `remove`: the surface is gone.
    Removed {
        /// Number of the surface.
        surface: u8,
    },
    /// Who is in the group.
    Group {
        /// Id of the group, which a link to it contains.
        group: String,
        /// The viewer's own number in the group; 0: the viewer leads.
        you: u32,
        /// Number of the member in control.
        control: u32,
        /// Number of followers.
        followers: u32,
        /// Whether the viewer asks for control.
        asks: bool,
        /// Whether the leader's connection is lost, so that the group waits for the leader.
        leader_away: bool,
        /// Only for the leader: the key with which it resumes the group on another connection.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[cfg_attr(test, ts(optional))]
        key: Option<String>,
        /// Only for the leader: some of the followers, first those who ask for control.
        people: Vec<Follower>,
    },
    /// What who has control shows, which is shown to this viewer now.
    Led {
        /// Id of the volume.
        volume: String,
        /// Time step.
        step: u32,
        /// The surfaces, with the values of all parameters.
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
        /// Seconds until the next heartbeat.
        seconds: f64,
    },
    /// The viewer is in no group any more.
    Left {
        /// Why the viewer is no longer in the group.
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
