//! From a surface to the frames of one prefix: what differs from what the client holds, encoded in batches. On the CPU pool.

use std::sync::Arc;

use axum::body::Bytes;
use isopeel_kernels::{Region, Surface};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use tokio_util::sync::CancellationToken;

use crate::extraction::VertexErrors;
use crate::pool::{self, Panicked};
use crate::wire::chunk::PrefixId;
use crate::wire::encode::{self, EncodeError, MAX_TASK_REGIONS, content_hash};

/// Content hash of each region that a client holds.
pub(super) type RegionHashes = FxHashMap<[u32; 3], u64>;

/// Triangles in a batch for each thread of the pool. Two batches take about 5 ms: so long another viewer's work waits.
const BATCH_TRIANGLES: usize = 25_000;
/// Chunks in a batch for each thread; bounds the frames that wait for the socket. The coarsest prefixes are many tiny chunks.
const BATCH_CHUNKS: usize = 128;

/// Why a prefix could not be made.
#[derive(Debug, thiserror::Error)]
pub(super) enum PrefixError {
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    Panicked(#[from] Panicked),
    #[error("cancelled")]
    Cancelled,
}

/// The difference between two surfaces.
#[derive(Debug)]
pub(super) struct Changes {
    /// Regions to send; those without vertices remove what was there.
    pub changed: Vec<Region>,
    /// How many regions stay as they are.
    pub unchanged: usize,
    /// What the client holds afterwards.
    pub held: RegionHashes,
}

/// Keeps what of a surface, or of what was made anew of it, differs from `held`.
pub(super) async fn compare(
    surface: Surface,
    held: Arc<RegionHashes>,
    token: CancellationToken,
) -> Result<Changes, PrefixError> {
    pool::run(move || {
        let hashed = |region: Region| {
            if token.is_cancelled() {
                return Err(PrefixError::Cancelled);
            }
            let (coords, hash) = (region.coords, content_hash(&region));
            let is_unchanged = held.get(&coords) == Some(&hash);
            Ok((coords, hash, (!is_unchanged).then_some(region)))
        };
        // A region without triangles counts as absent.
        let regions = (surface.regions.into_par_iter())
            .with_max_len(MAX_TASK_REGIONS)
            .filter(|r| !r.indices.is_empty());
        let compared: Vec<_> = regions.map(hashed).collect::<Result<_, _>>()?;
        let made: FxHashSet<[u32; 3]> = compared.iter().map(|(coords, ..)| *coords).collect();
        let remade = surface.remade.as_ref();
        let mut gone: Vec<[u32; 3]> = match remade {
            Some(remade) => remade.iter().filter(|c| held.contains_key(*c)).copied().collect(),
            None => held.keys().copied().collect(),
        };
        gone.retain(|coords| !made.contains(coords));
        gone.sort_unstable();
        let mut after = if remade.is_some() {
            (*held).clone()
        } else {
            RegionHashes::default()
        };
        for coords in &gone {
            after.remove(coords);
        }
        let mut changed = Vec::new();
        for (coords, hash, region) in compared {
            after.insert(coords, hash);
            changed.extend(region);
        }
        let unchanged = after.len() - changed.len();
        changed.extend(gone.into_iter().map(|coords| Region {
            coords,
            ..Region::default()
        }));
        Ok(Changes {
            changed,
            unchanged,
            held: after,
        })
    })
    .await?
}

/// Takes the next batch off the end of `regions`, the last region first. At least one region, while there is one.
pub(super) fn take_batch(regions: &mut Vec<Region>) -> Vec<Region> {
    take_batch_for(rayon::current_num_threads(), regions)
}

fn take_batch_for(threads: usize, regions: &mut Vec<Region>) -> Vec<Region> {
    let mut triangles = 0;
    let fits = |region: &&Region| {
        triangles += region.indices.len() / 3;
        triangles <= BATCH_TRIANGLES * threads
    };
    let count = regions
        .iter()
        .rev()
        .take(BATCH_CHUNKS * threads)
        .take_while(fits)
        .count();
    let mut batch = regions.split_off(regions.len() - count.max(1).min(regions.len()));
    batch.reverse();
    batch
}

/// Quantises and encodes a batch, in parallel.
pub(super) async fn encode(
    batch: Vec<Region>,
    prefix: PrefixId,
    token: CancellationToken,
) -> Result<Vec<Bytes>, PrefixError> {
    pool::run(move || {
        let encode = |region: Region| {
            if token.is_cancelled() {
                return Err(PrefixError::Cancelled);
            }
            Ok(encode::encode(&region, prefix)?)
        };
        batch
            .into_par_iter()
            .with_max_len(MAX_TASK_REGIONS)
            .map(encode)
            .collect()
    })
    .await?
}

/// Encodes the errors of those regions that the client holds as they are, in parallel.
pub(super) async fn encode_errors(
    errors: Vec<VertexErrors>,
    held: Arc<RegionHashes>,
    prefix: PrefixId,
    token: CancellationToken,
) -> Result<Vec<Bytes>, PrefixError> {
    pool::run(move || {
        let encode = |VertexErrors { region, distances }: VertexErrors| {
            if token.is_cancelled() {
                return Err(PrefixError::Cancelled);
            }
            if held.get(&region.coords) != Some(&content_hash(&region)) {
                return Ok(None);
            }
            Ok(Some(encode::encode_errors(&region, &distances, prefix)?))
        };
        let errors = errors.into_par_iter().with_max_len(MAX_TASK_REGIONS);
        errors.map(encode).filter_map(Result::transpose).collect()
    })
    .await?
}

#[cfg(test)]
mod tests {
    use super::{BATCH_CHUNKS, BATCH_TRIANGLES, Region, take_batch_for};

    fn region(triangles: usize) -> Region {
        Region {
            indices: vec![0; triangles * 3].into(),
            ..Region::default()
        }
    }

    #[test]
    fn batches_are_bounded_and_take_everything() {
        let mut regions = vec![region(1); 2 * BATCH_CHUNKS + 3];
        assert_eq!(take_batch_for(2, &mut regions).len(), 2 * BATCH_CHUNKS);
        assert_eq!(take_batch_for(2, &mut regions).len(), 3);
        assert_eq!(take_batch_for(2, &mut regions).len(), 0);

        let sizes = [BATCH_TRIANGLES * 4, BATCH_TRIANGLES, BATCH_TRIANGLES];
        let mut regions = sizes.map(region).to_vec();
        assert_eq!(take_batch_for(2, &mut regions).len(), 2);
        assert_eq!(
            take_batch_for(2, &mut regions).len(),
            1,
            "one that is too large still goes"
        );
    }
}
