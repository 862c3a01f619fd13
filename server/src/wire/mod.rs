//! What travels on the stream: text frames, and binary frames with their codecs. Bytes in, bytes out. Normative:
//! `PROTOCOL.md`.
//!
//! - [`messages`], [`chunk`]: text and binary frames; [`group`]: what messages of groups have.
//! - [`encode`]: from the device's regions to chunk bytes, in an `order` that `index_codec` writes.

pub mod chunk;
pub mod encode;
pub mod group;
mod index_codec;
pub mod messages;
mod order;
mod vertex_codec;
