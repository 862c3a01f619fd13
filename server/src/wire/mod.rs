//! Text frames of the stream. `PROTOCOL.md` is normative. The crate `isopeel_codec` has the binary frames.
//!
//! - [`messages`]: the messages of client and server.
//! - [`group`]: types in the messages of groups.

pub mod group;
pub mod messages;
