//! Text frames and limits of the stream. Normative: `PROTOCOL.md`.

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::extraction::ExtractionStatistics;
use crate::view::Edit;

/// Subprotocol that a client must offer.
pub const SUBPROTOCOL: &str = "isopeel.v1";

/// Longest message of a client, bytes. 64 control points take about 4 KiB.
pub const MAX_MESSAGE_BYTES: usize = 64 * 1024;

/// Malformed messages in a row after which a client is closed with [`CloseCode::Malformed`].
pub const MAX_MALFORMED: u32 = 16;

/// A text frame from a client.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ClientMessage {
    /// Open a volume.
    Open {
        /// Its id.
        volume: String,
        /// Time step.
        #[serde(default)]
        step: u32,
    },
    /// Change the view and extract.
    Edit(Edit),
    /// End the running generation.
    Cancel {},
    /// The first prefix of a generation is on screen.
    Drawn {
        /// Of which edit.
        generation: u32,
    },
}

impl ClientMessage {
    /// Reads a text frame.
    ///
    /// # Errors
    /// What is wrong with it, in a sentence.
    pub fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }
}

/// A text frame from the server.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ServerMessage {
    /// The volume is open.
    Opened {
        /// As `GET /api/v1/volumes/{id}`.
        #[cfg_attr(test, ts(as = "crate::extraction::VolumeInfo"))]
        volume: Box<RawValue>,
        /// Time step.
        step: u32,
        /// Every value in force.
        edit: Edit,
        /// Name of the device.
        device: String,
    },
    /// A prefix begins.
    Prefix {
        /// Of which edit.
        generation: u32,
        /// Level of the prefix, 0 is the final surface.
        level: u8,
        /// Chunks that follow.
        regions: usize,
        /// Regions that the client keeps as they are.
        standing: usize,
    },
    /// Every chunk of this prefix was sent.
    Committed {
        /// Of which edit.
        generation: u32,
        /// Level of the prefix.
        level: u8,
    },
    /// The final surface is complete.
    Done {
        /// Of which edit.
        generation: u32,
        /// As `isopeel extract --stats` prints them.
        statistics: ExtractionStatistics,
    },
    /// The generation ended early.
    Superseded {
        /// Of which edit.
        generation: u32,
    },
    /// A message or a job failed.
    Error {
        /// Stable code for programs.
        code: &'static str,
        /// What was wrong and what was expected.
        message: String,
        /// Whether the connection stays open.
        open: bool,
        /// With `too-large`, where the surface has too many triangles: a budget that is within the limit.
        #[cfg_attr(test, ts(optional))]
        #[serde(rename = "suggestedTriangles", skip_serializing_if = "Option::is_none")]
        suggested_triangles: Option<u64>,
    },
}

impl ServerMessage {
    /// The text frame.
    pub fn to_json(&self) -> String {
        // serde_json fails on maps with other keys than strings alone, and there are none.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// Why the server closes a connection; the codes are those of the table in `PROTOCOL.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseCode {
    /// The server shuts down.
    Shutdown = 1001,
    /// A binary frame from the client.
    Binary = 1003,
    /// A message over [`MAX_MESSAGE_BYTES`].
    TooLong = 1009,
    /// Too many malformed messages in a row.
    Malformed = 4000,
    /// A frame was not taken within the deadline.
    SlowReader = 4001,
    /// The server has its maximum of viewers.
    TooManyViewers = 4002,
    /// No frame for too long, not even a pong.
    Silent = 4003,
}

impl CloseCode {
    /// The reason in the close frame.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Shutdown => "the server shuts down",
            Self::Binary => "binary frame, expected text",
            Self::TooLong => "message too long, expected at most 64 KiB",
            Self::Malformed => "too many malformed messages",
            Self::SlowReader => "a frame could not be handed over in time",
            Self::TooManyViewers => "too many viewers, try again later",
            Self::Silent => "nothing heard for too long",
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{ClientMessage, ServerMessage};
    use crate::view::Edit;

    #[test]
    fn messages_parse_as_in_the_protocol_page() {
        let parse = |text: &str| ClientMessage::parse(text).expect(text);
        assert_eq!(
            parse(r#"{"type":"open","volume":"mni152"}"#),
            ClientMessage::Open {
                volume: "mni152".into(),
                step: 0
            }
        );
        assert_eq!(parse(r#"{"type":"cancel"}"#), ClientMessage::Cancel {});
        assert_eq!(
            parse(r#"{"type":"drawn","generation":3}"#),
            ClientMessage::Drawn { generation: 3 }
        );
        assert_eq!(parse(r#"{"type":"edit"}"#), ClientMessage::Edit(Edit::default()));
        let ClientMessage::Edit(edit) = parse(
            r##"{"type":"edit","iso":517,"field":"ct-head","feature":"gradient-magnitude","featureRange":[0,400],
 "alpha":0.3,"beta":0.02,"maxLevel":5,
 "transferFunction":{"points":[{"x":0,"importance":0,"color":"#3465a4"},{"x":1,"importance":1,"color":"#f57900"}]}}"##,
        ) else {
            panic!("not an edit");
        };
        assert_eq!(
            (edit.iso, edit.feature_range, edit.max_level),
            (Some(517.0), Some([0.0, 400.0]), Some(5))
        );
    }

    #[test]
    fn unknown_or_malformed_messages_are_refused() {
        for text in [
            "",
            "x",
            "[]",
            "null",
            "{}",
            r#"{"type":"close"}"#,
            r#"{"type":"open"}"#,
            r#"{"type":"open","volume":"a","step":-1}"#,
            r#"{"type":"open","volume":"a","extra":1}"#,
            r#"{"type":"cancel","extra":1}"#,
            r#"{"type":"drawn"}"#,
            r#"{"type":"edit","isovalue":1}"#,
            r#"{"type":"edit","iso":"1"}"#,
            r#"{"type":"edit","featureRange":[1]}"#,
            r#"{"type":"edit","transferFunction":{"points":[],"extra":1}}"#,
            r#"{"type":"edit"} {"type":"edit"}"#,
        ] {
            assert!(ClientMessage::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn server_messages_have_the_names_of_the_protocol_page() {
        let prefix = ServerMessage::Prefix {
            generation: 3,
            level: 2,
            regions: 7,
            standing: 9,
        };
        assert_eq!(
            prefix.to_json(),
            r#"{"type":"prefix","generation":3,"level":2,"regions":7,"standing":9}"#
        );
        let error = ServerMessage::Error {
            code: "bad-edit",
            message: "alpha: 2, expected 0 to 1".into(),
            open: true,
            suggested_triangles: None,
        };
        assert_eq!(
            error.to_json(),
            r#"{"type":"error","code":"bad-edit","message":"alpha: 2, expected 0 to 1","open":true}"#
        );
    }

    proptest! {
        #[test]
        fn noise_never_panics(text in ".{0,200}") {
            let _ = ClientMessage::parse(&text);
        }
    }
}
