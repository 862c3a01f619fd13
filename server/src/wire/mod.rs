//! Text frames of the stream. Normative: `PROTOCOL.md`. Binary frames are those of `isopeel_codec`.
//!
//! - [`messages`]: the messages of client and server.
//! - [`group`]: types in the messages of groups.

pub mod group;
pub mod messages;
