//! Decodes chunks of meshes as a client does.

use super::chunk::{ChunkError, ChunkHeader, ChunkKind, Coding, DecodedChunk, HEADER_BYTES, decode_meshopt};
use super::predictive;

/// Decodes a chunk of a mesh, whatever its coding. Safe on any bytes.
///
/// # Errors
/// The fault of the frame.
pub fn decode(frame: &[u8]) -> Result<DecodedChunk, ChunkError> {
    let header = ChunkHeader::parse(frame)?;
    match (header.prefix.kind, header.coding) {
        (ChunkKind::Cut, Coding::Predictive) if header.vertex_count > 0 => {
            let payload = &frame[HEADER_BYTES..][..header.vertex_bytes as usize];
            let (vertices, indices) = predictive::decode(&header, payload)?;
            Ok(DecodedChunk {
                values: header.vertex_values(frame)?,
                header,
                vertices,
                indices,
            })
        }
        (ChunkKind::Cut | ChunkKind::Error, Coding::Meshopt | Coding::Predictive) => decode_meshopt(frame),
    }
}
