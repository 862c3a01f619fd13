//! A step that was made, shared by all viewers who are sent it: its regions are hashed and encoded once.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use axum::body::Bytes;
use isopeel_codec::chunk::{Coding, PrefixId, with_prefix};
use isopeel_codec::encode::{self, EncodeError, MAX_TASK_REGIONS, MeshHash};
use isopeel_codec::predictive;
use isopeel_extraction::{Refinement, Shown, Step, WorkError};
use isopeel_kernels::Region;
use isopeel_volumes::{DatasetKey, VolumeStep};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use super::{ANY_LINE_BYTES, MAX_LINE_FACTOR, MIN_LINE_PART, Outcome};
use crate::metrics;
use crate::pool;

/// The regions that a client holds, by their positions.
pub(in crate::stream) type HeldRegions = FxHashMap<[u32; 3], HeldRegion>;

/// A region that a client holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::stream) struct HeldRegion {
    pub hash: MeshHash,
    /// Coding of the chunk in which the region was sent. It decides the order of the vertices.
    pub coding: Coding,
}

/// Estimated bytes of chunks: a fixed number for each region, and a number for each hundred triangles.
const REGION_BYTES: u64 = 160;
const BYTES_OF_100_TRIANGLES: u64 = 450;

/// A step for several viewers. The chunk of a region is encoded when the first viewer needs it.
#[derive(Debug)]
pub(in crate::stream) struct SharedStep {
    /// The result of the step, without its regions.
    pub made: Refinement,
    /// The regions that have triangles.
    pub regions: Vec<SharedRegion>,
    /// Key of the volume, so that chunks of another volume are not mistaken for this one's.
    volume: Arc<DatasetKey>,
}

/// A region of a [`SharedStep`].
#[derive(Debug)]
pub(in crate::stream) struct SharedRegion {
    pub coords: [u32; 3],
    pub hash: MeshHash,
    pub triangles: usize,
    /// The mesh; `None` once it is encoded.
    mesh: Mutex<Option<Region>>,
    chunk: OnceLock<Result<Bytes, EncodeError>>,
    /// The region's chunk in the coding for slow lines.
    predictive: OnceLock<Result<Bytes, EncodeError>>,
}

/// The part of a region that is cached beside its chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct RegionNote {
    pub coords: [u32; 3],
    pub hash: MeshHash,
    pub triangles: usize,
}

/// Cache key of a chunk: the hash of its mesh, within its volume.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::stream) struct ChunkKey {
    pub volume: Arc<DatasetKey>,
    pub coords: [u32; 3],
    pub hash: u64,
}

/// A cache of chunks.
pub(in crate::stream) trait Chunks {
    fn find(&self, key: &ChunkKey) -> Option<Bytes>;
    fn keep(&self, key: ChunkKey, chunk: &Bytes);
}

impl SharedStep {
    /// Creates it from the result of the device. A region without triangles counts as absent.
    pub(super) async fn new(made: Refinement, volume: &VolumeStep, token: CancellationToken) -> Outcome<Arc<Self>> {
        let volume = Arc::new(volume.dataset().key());
        let hashed = pool::run(move || {
            let mut made = made;
            let regions = std::mem::take(&mut made.surface.regions);
            let hashed = |mesh: Region| match token.is_cancelled() {
                true => Err(WorkError::Cancelled),
                false => Ok(SharedRegion::new(mesh)),
            };
            let regions = (regions.into_par_iter())
                .with_max_len(MAX_TASK_REGIONS)
                .filter(|region| !region.indices.is_empty())
                .map(hashed)
                .collect::<Result<_, _>>()?;
            Ok(Self { made, regions, volume })
        });
        let hashed = hashed.await.map_err(|_| WorkError::Stopped).and_then(|hashed| hashed);
        hashed.map(Arc::new).map_err(Arc::new)
    }

    /// Whether this step suits a viewer who has requested `step`: it is neither too large nor too small for the viewer's line.
    pub(super) fn suits(&self, step: Step) -> bool {
        let triangles = self.regions.iter().map(|region| region.triangles as u64).sum::<u64>();
        let bytes = self.regions.len() as u64 * REGION_BYTES + triangles * BYTES_OF_100_TRIANGLES / 100;
        if bytes > step.bytes.saturating_mul(MAX_LINE_FACTOR).max(ANY_LINE_BYTES) {
            return false;
        }
        let line = step
            .bytes
            .min(step.triangles.saturating_mul(BYTES_OF_100_TRIANGLES) / 100);
        self.made.is_final || step.shown == Shown::Another || bytes >= line / MIN_LINE_PART
    }

    /// Returns the chunk of one of the step's regions; encodes it if it is not cached.
    ///
    /// # Errors
    /// As [`encode::encode`].
    pub(in crate::stream) fn chunk(
        &self,
        region: usize,
        (prefix, coding): (PrefixId, Coding),
        kept: &impl Chunks,
    ) -> Result<Bytes, EncodeError> {
        let region = &self.regions[region];
        let chunk = match coding {
            Coding::Meshopt => self.meshopt_chunk(region, prefix, kept),
            Coding::Predictive => (region.predictive)
                .get_or_init(|| region.encode_predictive(&self.meshopt_chunk(region, prefix, kept)?))
                .clone(),
        };
        chunk.map(|chunk| with_prefix(&chunk, prefix))
    }

    /// Returns the chunk in the coding that every client reads. Its header may name another prefix.
    fn meshopt_chunk(&self, region: &SharedRegion, prefix: PrefixId, kept: &impl Chunks) -> Result<Bytes, EncodeError> {
        let mut was_there = true;
        let chunk = region.chunk.get_or_init(|| {
            let key = self.key_of(region);
            if let Some(chunk) = kept.find(&key) {
                return Ok(chunk);
            }
            was_there = false;
            let chunk = region.encode(prefix)?;
            kept.keep(key, &chunk);
            Ok(chunk)
        });
        metrics::looked_up_chunk(was_there);
        chunk.clone()
    }

    fn key_of(&self, region: &SharedRegion) -> ChunkKey {
        ChunkKey {
            volume: Arc::clone(&self.volume),
            coords: region.coords,
            hash: region.hash.order,
        }
    }

    /// Returns the part of the step that the cache keeps beside its chunks.
    pub(super) fn notes(&self) -> (Refinement, Arc<DatasetKey>, Vec<RegionNote>) {
        let notes = self.regions.iter().map(|region| RegionNote {
            coords: region.coords,
            hash: region.hash,
            triangles: region.triangles,
        });
        (self.made.clone(), Arc::clone(&self.volume), notes.collect())
    }

    /// Restores a step from its [`Self::notes`], with the chunks of its regions in the same order.
    pub(super) fn from_cache(made: Refinement, volume: Arc<DatasetKey>, regions: Vec<(RegionNote, Bytes)>) -> Self {
        let cached = |(note, chunk): (RegionNote, Bytes)| SharedRegion {
            coords: note.coords,
            hash: note.hash,
            triangles: note.triangles,
            mesh: Mutex::new(None),
            chunk: OnceLock::from(Ok(chunk)),
            predictive: OnceLock::new(),
        };
        Self {
            made,
            regions: regions.into_iter().map(cached).collect(),
            volume,
        }
    }
}

impl SharedRegion {
    fn new(mesh: Region) -> Self {
        Self {
            coords: mesh.coords,
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

    /// Encodes the mesh, and frees it.
    fn encode(&self, prefix: PrefixId) -> Result<Bytes, EncodeError> {
        let mesh = self.mesh.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mesh = mesh.ok_or_else(|| EncodeError {
            coords: self.coords,
            why: "its mesh is gone".into(),
        })?;
        encode::encode(&mesh, prefix)
    }

    fn encode_predictive(&self, chunk: &Bytes) -> Result<Bytes, EncodeError> {
        predictive::encode(chunk).map_err(|error| EncodeError {
            coords: self.coords,
            why: error.to_string(),
        })
    }
}
