//! Binary frames of the stream, from the device's regions to bytes and back. Normative: section 4 of `PROTOCOL.md`.
//!
//! - [`chunk`]: header, checks and vertices of a chunk.
//! - [`encode`]: the encoder; triangles are in an `order` that `index_codec` writes. [`predictive`]: chunks for slow lines.
//! - [`decode`]: chunks as a client reads them.

pub mod chunk;
pub mod decode;
pub mod encode;
mod index_codec;
mod order;
pub mod predictive;
mod range_coder;
mod vertex_codec;
