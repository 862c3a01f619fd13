//! Binary frames of the stream, from the device's regions to bytes and back. Normative: section 4 of `PROTOCOL.md`.
//!
//! - [`chunk`]: header, checks and vertices of a chunk.
//! - [`encode`]: the encoder. `order` orders the triangles; `index_codec` and `vertex_codec` write the payloads.
//! - [`predictive`]: chunks for slow lines, with `range_coder`.
//! - `values`: values of a field at the vertices, which follow the payloads.
//! - [`decode`]: chunks as a client reads them.

pub mod chunk;
pub mod decode;
pub mod encode;
mod index_codec;
mod order;
pub mod predictive;
mod range_coder;
mod values;
mod vertex_codec;
