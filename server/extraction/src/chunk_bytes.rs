//! Estimates of the bytes that meshes take in chunks.

use isopeel_kernels::SPARSE_TRIANGLES;

/// Bytes of a chunk without its triangles: headers of chunk and codecs.
const CHUNK_BYTES: u64 = 160;

/// Bytes of a hundred triangles in a chunk.
pub(crate) const BYTES_OF_100_TRIANGLES: u64 = 450;
/// As [`BYTES_OF_100_TRIANGLES`], for coarse meshes. They take more bytes, because their vertices differ by more.
pub(crate) const BYTES_OF_100_COARSE_TRIANGLES: u64 = 800;

/// Number of sparse regions that one chunk has, about.
const JOINED_REGIONS: u64 = 4;

/// Returns the bytes of `triangles` triangles in `regions` regions, with headers.
pub(crate) fn of_triangles(triangles: u64, regions: u64, bytes_of_100_triangles: u64) -> u64 {
    let chunks = match triangles < regions.saturating_mul(SPARSE_TRIANGLES.into()) {
        true => regions.div_ceil(JOINED_REGIONS),
        false => regions,
    };
    triangles.min(chunks) * CHUNK_BYTES + triangles.saturating_mul(bytes_of_100_triangles) / 100
}

/// Returns the number of triangles in `regions` regions that take this many bytes, with headers.
pub(crate) fn triangles_of(bytes: u64, regions: u64, bytes_of_100_triangles: u64) -> u64 {
    let beside = |chunks: u64| bytes.saturating_sub(chunks * CHUNK_BYTES) * 100 / bytes_of_100_triangles;
    let (sparse, limit) = (
        beside(regions.div_ceil(JOINED_REGIONS)),
        regions.saturating_mul(SPARSE_TRIANGLES.into()),
    );
    beside(regions).max(sparse.min(limit))
}

#[cfg(test)]
mod tests {
    use super::{of_triangles, triangles_of};

    #[test]
    fn bytes_and_triangles_fit_each_other() {
        for (regions, triangles) in [
            (1, 1000),
            (250, 1000),
            (250, 50_000),
            (20_000, 50_000),
            (20_000, 4_000_000),
        ] {
            let found = triangles_of(of_triangles(triangles, regions, 800), regions, 800);
            let is_near = found.abs_diff(triangles) * 100 <= triangles;
            assert!(is_near, "{found} of {triangles} in {regions} regions");
        }
    }
}
