//! Wire format of the stream: text frames, and binary frames with their codecs. Bytes in, bytes out. Normative:
//! `PROTOCOL.md`.
//!
//! - [`messages`], [`chunk`]: text and binary frames; [`group`]: parts of the messages of groups.
//! - [`encode`]: from the device's regions to chunk bytes, in an `order` that `index_codec` writes; [`predictive`]: chunks for slow lines.
//! - [`decode`]: chunks as a client reads them.

pub mod chunk;
pub mod decode;
pub mod encode;
pub mod group;
mod index_codec;
pub mod messages;
mod order;
pub mod predictive;
mod range_coder;
mod vertex_codec;
