//! Text frames of the stream. Normative: `PROTOCOL.md`. Binary frames are those of `isopeel_codec`.
//!
//! [`messages`], and in [`group`] parts of the messages of groups.

pub mod group;
pub mod messages;
