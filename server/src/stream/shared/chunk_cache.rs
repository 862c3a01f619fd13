//! Cache of steps, chunks and measured errors, for later equal requests. The cache has a budget of bytes and evicts the least recently used
//! entry.

use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use axum::body::Bytes;
use isopeel_extraction::{MeasuredError, Measurement, Refinement};
use isopeel_volumes::DatasetKey;
use lru::LruCache;

use super::RequestKey;
use super::step::{ChunkKey, Chunks, RegionMetadata, SharedStep};
use crate::metrics;

/// The budget divided by this number is the capacity for steps without their chunks. Measured errors get as much, and chunks get the rest.
const METADATA_DIVISOR: u64 = 16;

/// Estimated bytes that an entry takes beside its value: for its key, its links and its slot in the table.
const ENTRY_BYTES: u64 = 160;

/// The cache of chunks, of the steps that they belong to, and of measured errors.
pub(in crate::stream) struct ChunkCache(Mutex<Entries>);

struct Entries {
    chunks: Bounded<ChunkKey, Bytes>,
    steps: Bounded<RequestKey, CachedStep>,
    measured: Bounded<RequestKey, Arc<Measurement>>,
}

/// A cached step without its meshes and chunks.
struct CachedStep {
    refinement: Refinement,
    volume_key: Arc<DatasetKey>,
    regions: Vec<RegionMetadata>,
    /// The complete step, while a session still holds it.
    shared: Weak<SharedStep>,
}

impl ChunkCache {
    /// Creates a cache. `budget`: capacity in bytes; 0 caches nothing.
    pub(in crate::stream) fn new(budget: u64) -> Self {
        let metadata_bytes = budget / METADATA_DIVISOR;
        Self(Mutex::new(Entries {
            chunks: Bounded::new(budget - 2 * metadata_bytes),
            steps: Bounded::new(metadata_bytes),
            measured: Bounded::new(metadata_bytes),
        }))
    }

    /// Locks the entries. Ignores poisoning: a panic leaves nothing half updated.
    fn entries(&self) -> MutexGuard<'_, Entries> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a step if a session still holds it, or if all of its chunks are cached.
    pub(super) fn find_step(&self, key: &RequestKey) -> Option<Arc<SharedStep>> {
        let entries = &mut *self.entries();
        let entry = entries.steps.get(key)?;
        if let Some(shared) = entry.shared.upgrade() {
            return Some(shared);
        }
        let with_chunk = |region: &RegionMetadata| {
            let key = ChunkKey {
                volume_key: Arc::clone(&entry.volume_key),
                region: region.key,
                hash: region.hash.ordered,
            };
            Some((*region, entries.chunks.get(&key)?.clone()))
        };
        let regions = entry.regions.iter().map(with_chunk).collect::<Option<_>>()?;
        let step = Arc::new(SharedStep::from_cache(
            entry.refinement.clone(),
            Arc::clone(&entry.volume_key),
            regions,
        ));
        entry.shared = Arc::downgrade(&step);
        Some(step)
    }

    pub(super) fn insert_step(&self, key: RequestKey, step: &Arc<SharedStep>) {
        let (refinement, volume_key, regions) = step.metadata();
        let bytes = key.bytes() + size_of::<CachedStep>() + regions.len() * size_of::<RegionMetadata>();
        let cached = CachedStep {
            refinement,
            volume_key,
            regions,
            shared: Arc::downgrade(step),
        };
        self.change(|entries| entries.steps.insert(key, bytes as u64, cached));
    }

    pub(super) fn find_measured(&self, key: &RequestKey) -> Option<Arc<Measurement>> {
        self.entries().measured.get(key).cloned()
    }

    pub(super) fn insert_measured(&self, key: RequestKey, measured: &Arc<Measurement>) {
        let bytes = key.bytes() + measured.regions.len() * size_of::<([u32; 3], MeasuredError)>();
        let measured = Arc::clone(measured);
        self.change(|entries| entries.measured.insert(key, bytes as u64, measured));
    }

    /// Evicts all entries. Returns false if there were none.
    pub(super) fn clear(&self) -> bool {
        let mut had_any = false;
        self.change(|entries| {
            had_any = entries.bytes() > 0;
            entries.chunks.clear();
            entries.steps.clear();
            entries.measured.clear();
        });
        had_any
    }

    fn change(&self, change: impl FnOnce(&mut Entries)) {
        let mut entries = self.entries();
        change(&mut entries);
        metrics::set_memory("chunks", entries.bytes());
    }
}

impl Chunks for ChunkCache {
    fn find(&self, key: &ChunkKey) -> Option<Bytes> {
        self.entries().chunks.get(key).cloned()
    }

    fn insert(&self, key: ChunkKey, chunk: &Bytes) {
        self.change(|entries| entries.chunks.insert(key, chunk.len() as u64, chunk.clone()));
    }
}

impl Entries {
    fn bytes(&self) -> u64 {
        self.chunks.bytes + self.steps.bytes + self.measured.bytes
    }
}

/// An LRU cache with a budget of bytes. Each entry states its size.
struct Bounded<K: Hash + Eq, V> {
    entries: LruCache<K, (u64, V)>,
    bytes: u64,
    budget: u64,
}

impl<K: Hash + Eq, V> Bounded<K, V> {
    fn new(budget: u64) -> Self {
        Self {
            entries: LruCache::unbounded(),
            bytes: 0,
            budget,
        }
    }

    /// Returns a value, and marks it as most recently used.
    fn get(&mut self, key: &K) -> Option<&mut V> {
        self.entries.get_mut(key).map(|(_, value)| value)
    }

    /// Inserts or replaces an entry. Ignores values larger than the budget.
    fn insert(&mut self, key: K, bytes: u64, value: V) {
        let bytes = bytes + ENTRY_BYTES;
        if bytes > self.budget {
            return;
        }
        let before = self.entries.put(key, (bytes, value));
        self.bytes = self.bytes + bytes - before.map_or(0, |(bytes, _)| bytes);
        while self.bytes > self.budget
            && let Some((_, (bytes, _))) = self.entries.pop_lru()
        {
            self.bytes -= bytes;
        }
    }

    fn clear(&mut self) {
        self.entries.clear();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::{Bounded, ENTRY_BYTES};

    #[test]
    fn what_was_used_longest_ago_goes_first() {
        let mut cache = Bounded::new(2 * ENTRY_BYTES + 10);
        let get = |cache: &mut Bounded<char, i32>, key| cache.get(&key).copied();
        cache.insert('a', 4, 1);
        cache.insert('b', 6, 2);
        assert_eq!(get(&mut cache, 'a'), Some(1));
        cache.insert('c', 6, 3);
        assert_eq!((get(&mut cache, 'a'), get(&mut cache, 'b')), (Some(1), None));
        assert_eq!(cache.bytes, 2 * ENTRY_BYTES + 10);
        cache.insert('c', 1, 4);
        assert_eq!(cache.bytes, 2 * ENTRY_BYTES + 5, "the one before is replaced");
        cache.insert('d', ENTRY_BYTES + 11, 5);
        assert_eq!(
            (get(&mut cache, 'd'), get(&mut cache, 'c')),
            (None, Some(4)),
            "larger than all"
        );
        cache.clear();
        assert_eq!((cache.bytes, get(&mut cache, 'a')), (0, None));
    }
}
