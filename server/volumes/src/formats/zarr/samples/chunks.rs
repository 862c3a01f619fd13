//! Reads and decodes stored chunks, also those in shards.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::super::super::ahead::Work;
use super::super::super::store::join;
use super::ZarrSamples;
use crate::parallel::try_sum;
use crate::remote::Part;
use crate::{ReadError, ReadProgress};

/// Stored bytes of a chunk, or of an inner chunk of a shard.
pub(super) struct Stored {
    /// Name of its object.
    key: String,
    bytes: Vec<u8>,
}

/// Index of the chunks in a shard.
#[derive(Debug)]
struct Index {
    /// Offset and length of each chunk; `None` for a chunk that is not stored.
    chunks: Vec<Option<[u64; 2]>>,
    /// Bytes of the shard.
    size: u64,
}

/// The index of a shard after it was read; the inner `None` means that the shard is not stored.
type Known = Mutex<Option<Option<Arc<Index>>>>;

/// State that the chunks of one time step share.
pub(super) struct Reading<'a> {
    pub(super) work: Work<'a>,
    /// Indices by the names of shards.
    indices: Mutex<HashMap<String, Arc<Known>>>,
}

impl<'a> Reading<'a> {
    pub(super) fn new(progress: &'a ReadProgress) -> Self {
        Self {
            work: Work::new(progress),
            indices: Mutex::default(),
        }
    }
}

impl ZarrSamples {
    /// Returns the bytes of a decoded chunk, or of a decoded inner chunk of a shard.
    pub(super) fn block_bytes(&self) -> u64 {
        self.block.iter().product::<u64>() * self.array.stored.bytes()
    }

    /// Returns the total bytes of the files with the chunks of a time step.
    pub(super) fn chunk_bytes(&self, step: u32) -> Result<u64, ReadError> {
        let files = &self.array.chunks;
        let bytes = |index: u64| -> Result<u64, ReadError> {
            let key = self.array.key(&self.piece(step, files, index));
            Ok(self.store.disk_bytes(&join(&self.path, &key))?.unwrap_or(0))
        };
        let count = self.counts(files).iter().product();
        try_sum(count, bytes)
    }

    /// Returns the stored bytes of a chunk; `None` if it is not stored.
    pub(super) fn stored(&self, block: &[u64], reading: &Reading<'_>) -> Result<Option<Stored>, ReadError> {
        if self.array.pipeline.shard.is_some() {
            return self.in_shard(block, reading);
        }
        let key = self.array.key(block);
        let path = join(&self.path, &key);
        let object = self
            .store
            .read(&path, Part::Whole, self.max_stored(), &|| reading.work.is_over())?;
        Ok(object.map(|object| Stored {
            key,
            bytes: object.bytes,
        }))
    }

    /// Returns the maximum bytes of a stored chunk. Far more than its samples is invalid.
    fn max_stored(&self) -> u64 {
        self.block_bytes().saturating_mul(2).saturating_add(1 << 16)
    }

    /// Decodes the samples of a chunk.
    pub(super) fn decode(&self, stored: Stored) -> Result<Vec<u8>, ReadError> {
        let shard = self.array.pipeline.shard.as_ref();
        let pipeline = shard.map_or(&self.array.pipeline, |shard| &shard.pipeline);
        let decoded = pipeline.decode(stored.bytes, self.block_bytes() as usize);
        decoded.map_err(|why| self.error(format!("chunk {}: {why}", stored.key)))
    }

    /// Returns the stored bytes of a chunk in a shard.
    fn in_shard(&self, block: &[u64], reading: &Reading<'_>) -> Result<Option<Stored>, ReadError> {
        let sizes = self.array.chunks.iter().zip(self.block.iter());
        let per_shard: Vec<u64> = sizes.map(|(shard, chunk)| shard / chunk).collect();
        let (outer, inner): (Vec<u64>, Vec<u64>) = block.iter().zip(&per_shard).map(|(b, n)| (b / n, b % n)).unzip();
        let number = inner.iter().zip(&per_shard).fold(0, |at, (i, n)| at * n + i);
        let key = self.array.key(&outer);
        let Some(index) = self.index(&key, per_shard.iter().product(), reading)? else {
            return Ok(None);
        };
        let Some([offset, length]) = index.chunks[number as usize] else {
            return Ok(None);
        };
        let end = offset.checked_add(length).filter(|&end| end <= index.size);
        let (Some(end), true) = (end, length <= self.max_stored()) else {
            let why = format!("a chunk of {length} bytes at {offset}, the file has {}", index.size);
            return Err(self.error(format!("shard {key}: {why}")));
        };
        if length == 0 {
            return Ok(Some(Stored { key, bytes: Vec::new() }));
        }
        let (path, part) = (join(&self.path, &key), Part::At(offset..end));
        let object = self.store.read(&path, part, length, &|| reading.work.is_over())?;
        // The shard existed when its index was read.
        let object = object.ok_or_else(|| self.error(format!("shard {key} is there no more")))?;
        Ok(Some(Stored {
            key,
            bytes: object.bytes,
        }))
    }

    /// Returns the index of a shard. It is read once.
    fn index(&self, key: &str, count: u64, reading: &Reading<'_>) -> Result<Option<Arc<Index>>, ReadError> {
        let known = {
            let mut indices = reading.indices.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(indices.entry(key.to_owned()).or_default())
        };
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(index) = &*known {
            return Ok(index.clone());
        }
        let index = self.read_index(key, count, reading)?.map(Arc::new);
        *known = Some(index.clone());
        Ok(index)
    }

    fn read_index(&self, key: &str, count: u64, reading: &Reading<'_>) -> Result<Option<Index>, ReadError> {
        let Some(shard) = &self.array.pipeline.shard else {
            return Ok(None);
        };
        let fail = |why: String| self.error(format!("shard {key}: {why}"));
        let length = shard.index_bytes(count);
        let part = if shard.at_end {
            Part::End(length)
        } else {
            Part::At(0..length)
        };
        let object = self
            .store
            .read(&join(&self.path, key), part, length, &|| reading.work.is_over())?;
        let Some(object) = object else {
            return Ok(None);
        };
        if (object.bytes.len() as u64) < length {
            let found = object.bytes.len();
            return Err(fail(format!("{found} bytes, expected an index of {length} at least")));
        }
        let chunks = shard.index(&object.bytes).map_err(fail)?;
        let size = object.size;
        Ok(Some(Index { chunks, size }))
    }
}

impl Stored {
    pub(super) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }
}
