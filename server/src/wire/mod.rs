//! Text frames of the stream. Normative: `PROTOCOL.md`. Binary frames are those of `isopeel_codec`.
//!
//! - [`messages`]: text frames; [`group`]: parts of those of groups.

pub mod group;
pub mod messages;
