//! A step that was made, shared by all viewers who are sent it: its regions are hashed and encoded once.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use axum::body::Bytes;
use isopeel_codec::chunk::{Coding, PrefixId, with_prefix};
use isopeel_codec::encode::{self, EncodeError, MAX_TASK_REGIONS, MeshHash};
use isopeel_codec::predictive;
use isopeel_extraction::{Refinement, Shown, Step, WorkError};
use isopeel_kernels::{Region, RegionKey};
use isopeel_volumes::{DatasetKey, VolumeStep};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use super::{ANY_LINE_BYTES, MAX_LINE_FACTOR, MIN_LINE_DIVISOR, Outcome};
use crate::metrics;
use crate::pool;

/// The regions that a client holds, by their places and sizes.
pub(in crate::stream) type HeldRegions = FxHashMap<RegionKey, HeldRegion>;

/// A region that a client holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::stream) struct HeldRegion {
    pub hash: MeshHash,
    /// Coding of the chunk in which the region was sent. It decides the order of the vertices.
    pub coding: Coding,
}

/// Estimated bytes of a chunk without its triangles.
const REGION_BYTES: u64 = 160;
/// Estimated bytes that each hundred triangles add to a chunk.
const BYTES_OF_100_TRIANGLES: u64 = 450;

/// A step for several viewers. The chunk of a region is encoded when the first viewer needs it.
#[derive(Debug)]
pub(in crate::stream) struct SharedStep {
    /// The result of the step, without its regions.
    pub refinement: Refinement,
    /// The regions that have triangles.
    pub regions: Vec<SharedRegion>,
    /// Key of the volume. It is part of the cache key of a chunk, because another volume may have a mesh with the same hash.
    volume_key: Arc<DatasetKey>,
}

/// A region of a [`SharedStep`].
#[derive(Debug)]
pub(in crate::stream) struct SharedRegion {
    pub key: RegionKey,
    pub hash: MeshHash,
    pub triangles: usize,
    /// The mesh; `None` once it is encoded.
    mesh: Mutex<Option<Region>>,
    chunk: OnceLock<Result<Bytes, EncodeError>>,
    /// The region's chunk in the coding for slow lines.
    predictive: OnceLock<Result<Bytes, EncodeError>>,
}

/// Metadata of a region, which is cached beside the region's chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct RegionMetadata {
    pub key: RegionKey,
    pub hash: MeshHash,
    pub triangles: usize,
}

/// Cache key of a chunk: the hash of its mesh, within its volume.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::stream) struct ChunkKey {
    pub volume_key: Arc<DatasetKey>,
    pub region: RegionKey,
    pub hash: u64,
}

/// A cache of chunks.
pub(in crate::stream) trait Chunks {
    fn find(&self, key: &ChunkKey) -> Option<Bytes>;
    fn insert(&self, key: ChunkKey, chunk: &Bytes);
}

impl SharedStep {
    /// Creates a step from the result of the device. A region without triangles counts as absent.
    pub(in crate::stream) async fn new(
        refinement: Refinement,
        volume: &VolumeStep,
        token: CancellationToken,
    ) -> Outcome<Arc<Self>> {
        let volume_key = Arc::new(volume.dataset().key());
        let hashing = pool::run(move || {
            let mut refinement = refinement;
            let regions = std::mem::take(&mut refinement.surface.regions);
            let hash_region = |mesh: Region| match token.is_cancelled() {
                true => Err(WorkError::Cancelled),
                false => Ok(SharedRegion::new(mesh)),
            };
            let regions = (regions.into_par_iter())
                .with_max_len(MAX_TASK_REGIONS)
                .filter(|region| !region.indices.is_empty())
                .map(hash_region)
                .collect::<Result<_, _>>()?;
            Ok(Self {
                refinement,
                regions,
                volume_key,
            })
        });
        let step = hashing.await.map_err(|_| WorkError::Stopped).and_then(|step| step);
        step.map(Arc::new).map_err(Arc::new)
    }

    /// Whether this step suits a viewer who has requested `step`: it is neither too large nor too small for the viewer's line.
    pub(super) fn suits(&self, step: Step) -> bool {
        let triangles = self.regions.iter().map(|region| region.triangles as u64).sum::<u64>();
        let bytes = self.regions.len() as u64 * REGION_BYTES + triangles * BYTES_OF_100_TRIANGLES / 100;
        if bytes > step.bytes.saturating_mul(MAX_LINE_FACTOR).max(ANY_LINE_BYTES) {
            return false;
        }
        let line_bytes = step
            .bytes
            .min(step.triangles.saturating_mul(BYTES_OF_100_TRIANGLES) / 100);
        self.refinement.is_final || step.shown == Shown::Another || bytes >= line_bytes / MIN_LINE_DIVISOR
    }

    /// Returns the chunk of one of the step's regions; encodes it if it is not cached.
    ///
    /// # Errors
    /// As [`encode::encode`].
    pub(in crate::stream) fn chunk(
        &self,
        region: usize,
        (prefix, coding): (PrefixId, Coding),
        cache: &impl Chunks,
    ) -> Result<Bytes, EncodeError> {
        let region = &self.regions[region];
        let chunk = match coding {
            Coding::Meshopt => self.meshopt_chunk(region, prefix, cache),
            Coding::Predictive => (region.predictive)
                .get_or_init(|| region.encode_predictive(&self.meshopt_chunk(region, prefix, cache)?))
                .clone(),
        };
        chunk.map(|chunk| with_prefix(&chunk, prefix))
    }

    /// Returns the chunk in the coding that every client reads. If the chunk was encoded for another prefix, its header names that prefix.
    fn meshopt_chunk(
        &self,
        region: &SharedRegion,
        prefix: PrefixId,
        cache: &impl Chunks,
    ) -> Result<Bytes, EncodeError> {
        let mut is_hit = true;
        let chunk = region.chunk.get_or_init(|| {
            let key = self.key_of(region);
            if let Some(chunk) = cache.find(&key) {
                return Ok(chunk);
            }
            is_hit = false;
            let chunk = region.encode(prefix)?;
            cache.insert(key, &chunk);
            Ok(chunk)
        });
        metrics::looked_up_chunk(is_hit);
        chunk.clone()
    }

    fn key_of(&self, region: &SharedRegion) -> ChunkKey {
        ChunkKey {
            volume_key: Arc::clone(&self.volume_key),
            region: region.key,
            hash: region.hash.ordered,
        }
    }

    /// Returns the part of the step that the cache stores beside the chunks.
    pub(super) fn metadata(&self) -> (Refinement, Arc<DatasetKey>, Vec<RegionMetadata>) {
        let metadata = self.regions.iter().map(|region| RegionMetadata {
            key: region.key,
            hash: region.hash,
            triangles: region.triangles,
        });
        (
            self.refinement.clone(),
            Arc::clone(&self.volume_key),
            metadata.collect(),
        )
    }

    /// Restores a step from its [`Self::metadata`], with the chunks of its regions in the same order.
    pub(super) fn from_cache(
        refinement: Refinement,
        volume_key: Arc<DatasetKey>,
        regions: Vec<(RegionMetadata, Bytes)>,
    ) -> Self {
        let cached = |(region, chunk): (RegionMetadata, Bytes)| SharedRegion {
            key: region.key,
            hash: region.hash,
            triangles: region.triangles,
            mesh: Mutex::new(None),
            chunk: OnceLock::from(Ok(chunk)),
            predictive: OnceLock::new(),
        };
        Self {
            refinement,
            regions: regions.into_iter().map(cached).collect(),
            volume_key,
        }
    }
}

impl SharedRegion {
    fn new(mesh: Region) -> Self {
        Self {
            key: mesh.key(),
            hash: MeshHash::of(&mesh),
            triangles: mesh.indices.len() / 3,
            mesh: Mutex::new(Some(mesh)),
            chunk: OnceLock::new(),
            predictive: OnceLock::new(),
        }
    }

    /// Whether the region's chunk in this coding is encoded.
    pub(in crate::stream) fn is_encoded(&self, coding: Coding) -> bool {
        let chunk = match coding {
            Coding::Meshopt => &self.chunk,
            Coding::Predictive => &self.predictive,
        };
        chunk.get().is_some()
    }

    /// Encodes the mesh, and frees the mesh.
    ///
    /// # Errors
    /// The mesh was encoded before, or cannot be encoded.
    fn encode(&self, prefix: PrefixId) -> Result<Bytes, EncodeError> {
        let mesh = self.mesh.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mesh = mesh.ok_or_else(|| EncodeError {
            region: self.key,
            why: "its mesh is gone".into(),
        })?;
        encode::encode(&mesh, prefix)
    }

    fn encode_predictive(&self, chunk: &Bytes) -> Result<Bytes, EncodeError> {
        predictive::encode(chunk).map_err(|error| EncodeError {
            region: self.key,
            why: error.to_string(),
        })
    }
}
