//! What travels on the stream: text frames, and binary frames with their codecs. Bytes in, bytes out. Normative:
//! `PROTOCOL.md`.
//!
//! - [`messages`], [`chunk`]: text and binary frames.
//! - [`encode`]: from the device's regions to chunk bytes, in an `order` that `index_codec` writes.

pub mod chunk;
pub mod encode;
mod index_codec;
pub mod messages;
mod order;
mod vertex_codec;
