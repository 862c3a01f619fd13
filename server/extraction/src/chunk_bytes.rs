//! Estimates of the bytes that meshes take in chunks.

/// Bytes of a chunk without its triangles: headers of chunk and codecs.
const CHUNK_BYTES: u64 = 160;

/// Bytes of a hundred triangles in a chunk.
pub(crate) const BYTES_OF_100_TRIANGLES: u64 = 450;
/// As [`BYTES_OF_100_TRIANGLES`], for coarse meshes. They take more bytes, because their vertices differ by more.
pub(crate) const BYTES_OF_100_COARSE_TRIANGLES: u64 = 800;

/// Returns the bytes of the headers of `chunks` chunks.
pub(crate) fn of_headers(chunks: u64) -> u64 {
    chunks * CHUNK_BYTES
}

/// Returns the bytes of `triangles` triangles in `regions` regions, with headers.
pub(crate) fn of_triangles(triangles: u64, regions: u64, bytes_of_100_triangles: u64) -> u64 {
    of_headers(triangles.min(regions)) + triangles.saturating_mul(bytes_of_100_triangles) / 100
}
