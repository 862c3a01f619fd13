//! Filters of HDF5's chunks: those of the library, and those that are decoded here.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use hdf5_reader::FilterRegistry;
use hdf5_reader::error::Error;
use hdf5_reader::messages::filter_pipeline::FilterPipelineMessage;

use super::super::blosc;
use super::{bitshuffle, lzf};
use crate::codec::decoded;
use crate::stored::Encoding;

/// Filters of the library, by their numbers: deflate, shuffle, Fletcher's checksum, szip, n-bit, scale-offset, LZ4.
const OF_LIBRARY: [u16; 7] = [1, 2, 3, 4, 5, 6, 32004];
/// Filters that are decoded here, by their numbers in HDF5's registry.
const BZIP2: u16 = 307;
const BLOSC: u16 = 32001;
const BITSHUFFLE: u16 = 32008;
const ZSTD: u16 = 32015;
const OWN: [u16; 5] = [BZIP2, lzf::FILTER, BLOSC, BITSHUFFLE, ZSTD];

/// Maximum bytes beside the samples between two filters: headers and checksums.
const OVERHEAD: usize = 1 << 12;

/// Maximum bytes that a filter may return: those of the largest chunk of the variables that are read.
#[derive(Clone, Debug, Default)]
pub(super) struct ChunkLimit(Arc<AtomicUsize>);

impl ChunkLimit {
    /// Permits chunks of this many bytes.
    pub(super) fn permit(&self, bytes: u64) {
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        let limit = bytes.saturating_add(bytes / 8).saturating_add(OVERHEAD);
        self.0.fetch_max(limit, Ordering::Relaxed);
    }

    fn bytes(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// Decodes a chunk by the properties of its filter to a limited number of bytes.
type Decode = fn(&[u8], &[u32], usize) -> Result<Vec<u8>, String>;

/// Returns the filters of the library, and those that are decoded here.
pub(super) fn registry(limit: &ChunkLimit) -> FilterRegistry {
    let mut filters = FilterRegistry::new();
    filters.register(lzf::FILTER, Box::new(|_, data, _| lzf::decode(data)));
    let mut register = |id: u16, name: &'static str, decode: Decode| {
        let limit = limit.clone();
        let decode = move |data: &[u8], properties: &[u32]| {
            decode(data, properties, limit.bytes()).map_err(|why| Error::DecompressionError(format!("{name}: {why}")))
        };
        filters.register(id, Box::new(move |filter, data, _| decode(data, &filter.client_data)));
    };
    register(BZIP2, "bzip2", |data, _, limit| decoded(Encoding::Bzip2, data, limit));
    register(BLOSC, "blosc", |data, _, limit| blosc::decode(data, limit));
    register(BITSHUFFLE, "bitshuffle", bitshuffle::decode);
    register(ZSTD, "zstd", |data, _, limit| decoded(Encoding::Zstd, data, limit));
    filters
}

/// Refuses filters that are not read.
pub(super) fn check(pipeline: &FilterPipelineMessage) -> Result<(), String> {
    let mut filters = pipeline.filters.iter();
    let is_read = |id: u16| OF_LIBRARY.contains(&id) || OWN.contains(&id);
    let Some(filter) = filters.find(|filter| !is_read(filter.id)) else {
        return Ok(());
    };
    let name = filter.name.as_deref().unwrap_or("without a name");
    let expected = "expected deflate, shuffle, fletcher32, szip, nbit, scaleoffset, lz4, lzf, bzip2, blosc, \
                    bitshuffle or zstd";
    Err(format!("filter {} ({name}), {expected}", filter.id))
}
