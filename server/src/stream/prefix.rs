//! Makes the frames of one prefix from a surface: finds the regions that differ from those that the client holds, and encodes them in
//! batches on the CPU pool.

use std::sync::Arc;

use axum::body::Bytes;
use isopeel_codec::chunk::{Coding, PrefixId};
use isopeel_codec::encode::{self, EncodeError, MAX_TASK_REGIONS, MeshHash};
use isopeel_extraction::VertexErrors;
use isopeel_kernels::RegionKey;
use rayon::prelude::*;
use rustc_hash::FxHashSet;
use tokio_util::sync::CancellationToken;

use super::shared::{ChunkCache, HeldRegion, HeldRegions, SharedStep};
use crate::pool::{self, Panicked};

/// Maximum triangles of a batch for each thread of the pool. Another viewer's work waits for at most two batches, which take about 5 ms.
const BATCH_TRIANGLES: usize = 25_000;
/// Maximum chunks of a batch for each thread. It bounds the number of frames that wait for the socket, because the coarsest prefixes
/// consist of many tiny chunks.
const BATCH_CHUNKS: usize = 128;

/// Maximum number of regions, of both surfaces together, that are compared on the calling task. Dispatching so small a comparison to the
/// pool would take longer than the comparison.
const FEW_REGIONS: usize = 512;

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
    /// The step that has the changed regions.
    pub step: Arc<SharedStep>,
    /// Coding in which the regions are sent.
    pub coding: Coding,
    /// Regions to send or to remove.
    pub changed: Vec<Part>,
    /// Number of regions that the client holds already.
    pub unchanged: usize,
    /// Regions that the client holds after the step.
    pub held: HeldRegions,
}

/// The change of one region: a part of a prefix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// The mesh of a region, by the index of the region in the step.
    Made(usize),
    /// The region has no mesh any more.
    Gone(RegionKey),
}

impl Part {
    fn triangles(self, step: &SharedStep) -> usize {
        match self {
            Self::Made(region) => step.regions[region].triangles,
            Self::Gone(_) => 0,
        }
    }

    /// Whether the region's chunk is encoded already. The prefix in the chunk's header is set when the chunk is sent.
    fn is_encoded(self, step: &SharedStep, coding: Coding) -> bool {
        match self {
            Self::Made(region) => step.regions[region].is_encoded(coding),
            Self::Gone(_) => true,
        }
    }

    fn encode(self, step: &SharedStep, id: (PrefixId, Coding), cache: &ChunkCache) -> Result<Bytes, EncodeError> {
        match self {
            Self::Made(region) => step.chunk(region, id, cache),
            Self::Gone(key) => encode::encode_gone(key, id.0),
        }
    }
}

/// Returns the regions of a step that differ from `held`, to be sent in this coding. A step contains all regions of a surface, or only the
/// regions that were remade. If smaller regions give way to a larger one, or the other way, the former are sent as gone.
pub(super) async fn compare(
    step: Arc<SharedStep>,
    held: Arc<HeldRegions>,
    coding: Coding,
    token: CancellationToken,
) -> Result<Changes, PrefixError> {
    if step.regions.len() + held.len() <= FEW_REGIONS {
        return Ok(differences(step, &held, coding));
    }
    pool::run(move || match token.is_cancelled() {
        true => Err(PrefixError::Cancelled),
        false => Ok(differences(step, &held, coding)),
    })
    .await?
}

fn differences(step: Arc<SharedStep>, held: &HeldRegions, coding: Coding) -> Changes {
    let with_mesh: FxHashSet<RegionKey> = step.regions.iter().map(|region| region.key).collect();
    let remade = step.refinement.surface.remade.as_ref();
    let mut gone: Vec<RegionKey> = match remade {
        Some(remade) => remade.iter().filter(|key| held.contains_key(*key)).copied().collect(),
        None => held.keys().copied().collect(),
    };
    gone.retain(|key| !with_mesh.contains(key));
    gone.sort_unstable();
    let mut after = if remade.is_some() {
        held.clone()
    } else {
        HeldRegions::default()
    };
    for key in &gone {
        after.remove(key);
    }
    let mut changed = Vec::new();
    for (index, region) in step.regions.iter().enumerate() {
        let before = held.get(&region.key);
        let unchanged_region = before.filter(|before| before.hash.unordered == region.hash.unordered);
        if unchanged_region.is_none() {
            changed.push(Part::Made(index));
        }
        // Regions that are not sent again keep the order and the coding in which they were sent.
        let sent = HeldRegion {
            hash: region.hash,
            coding,
        };
        after.insert(region.key, *unchanged_region.unwrap_or(&sent));
    }
    let unchanged = after.len() - changed.len();
    changed.extend(gone.into_iter().map(Part::Gone));
    Changes {
        step,
        coding,
        changed,
        unchanged,
        held: after,
    }
}

/// Takes the next batch from the end of a step's `parts`, which are in reverse order. Returns at least one part if any is left.
pub(super) fn take_batch(step: &SharedStep, parts: &mut Vec<Part>) -> Vec<Part> {
    take_batch_for(rayon::current_num_threads(), |part| part.triangles(step), parts)
}

fn take_batch_for<P>(threads: usize, triangles_of: impl Fn(&P) -> usize, parts: &mut Vec<P>) -> Vec<P> {
    let mut triangles = 0;
    let fits = |part: &&P| {
        triangles += triangles_of(part);
        triangles <= BATCH_TRIANGLES * threads
    };
    let count = parts.iter().rev().take(BATCH_CHUNKS * threads).take_while(fits).count();
    let mut batch = parts.split_off(parts.len() - count.max(1).min(parts.len()));
    batch.reverse();
    batch
}

/// Returns the chunks of a batch of a step. Chunks that were not encoded before are quantised and encoded in parallel on the pool. If all
/// chunks were encoded before, the pool is not used.
pub(super) async fn encode(
    step: Arc<SharedStep>,
    batch: Vec<Part>,
    id: (PrefixId, Coding),
    cache: Arc<ChunkCache>,
    token: CancellationToken,
) -> Result<Vec<Bytes>, PrefixError> {
    if batch.iter().all(|part| part.is_encoded(&step, id.1)) {
        let chunks = batch.into_iter().map(|part| part.encode(&step, id, &cache));
        return Ok(chunks.collect::<Result<_, _>>()?);
    }
    pool::run(move || {
        let encode = |part: Part| match part {
            _ if token.is_cancelled() => Err(PrefixError::Cancelled),
            part => Ok(part.encode(&step, id, &cache)?),
        };
        batch
            .into_par_iter()
            .with_max_len(MAX_TASK_REGIONS)
            .map(encode)
            .collect()
    })
    .await?
}

/// Encodes the vertex errors of regions in parallel. Skips a region if the client does not hold the mesh that was measured.
pub(super) async fn encode_errors(
    errors: Vec<VertexErrors>,
    held: Arc<HeldRegions>,
    prefix: PrefixId,
    token: CancellationToken,
) -> Result<Vec<Bytes>, PrefixError> {
    pool::run(move || {
        let encode = |VertexErrors { region, distances }: VertexErrors| {
            if token.is_cancelled() {
                return Err(PrefixError::Cancelled);
            }
            let held = (held.get(&region.key())).filter(|held| held.hash == MeshHash::of(&region));
            let Some(held) = held else { return Ok(None) };
            Ok(Some(encode::encode_errors(&region, &distances, (prefix, held.coding))?))
        };
        let errors = errors.into_par_iter().with_max_len(MAX_TASK_REGIONS);
        errors.map(encode).filter_map(Result::transpose).collect()
    })
    .await?
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_codec::chunk::{Coding, PrefixId};
    use isopeel_codec::decode::decode;
    use isopeel_extraction::Refinement;
    use isopeel_kernels::{Region, RegionKey, Surface, Vertex};
    use isopeel_view::View;
    use isopeel_volumes::{VolumeStep, testing};
    use tokio_util::sync::CancellationToken;

    use super::{
        BATCH_CHUNKS, BATCH_TRIANGLES, Changes, ChunkCache, HeldRegions, SharedStep, differences, take_batch_for,
    };

    /// Eight regions that are one region of size 1 together, and a region beside them.
    const SMALL: [[u32; 3]; 8] = [
        [0, 0, 0],
        [0, 0, 1],
        [0, 1, 0],
        [0, 1, 1],
        [1, 0, 0],
        [1, 0, 1],
        [1, 1, 0],
        [1, 1, 1],
    ];
    const LARGE: RegionKey = RegionKey {
        coords: [0; 3],
        size: 1,
    };
    const BESIDE: RegionKey = RegionKey {
        coords: [2, 0, 0],
        size: 0,
    };

    /// A region with one triangle, the same one in all regions.
    fn region(key: RegionKey) -> Region {
        let vertex = |position| Vertex {
            position,
            normal: [0, 0],
            smoothness: 0,
            feature: 0,
        };
        Region {
            coords: key.coords,
            size: key.size,
            vertices: [[0, 0, 0], [65536, 0, 0], [0, 65536, 0]].map(vertex).to_vec().into(),
            indices: vec![0, 1, 2].into(),
            values: Vec::new().into(),
            level_triangles: [1, 0, 0, 0, 0, 0],
            error: None,
        }
    }

    /// Compares a surface of these regions with the regions that a client holds.
    async fn changes(regions: &[RegionKey], remade: Option<&[RegionKey]>, held: &HeldRegions) -> Changes {
        let mut refinement = Refinement::nothing(&View::plain(&["density"]));
        refinement.surface = Surface {
            regions: regions.iter().copied().map(region).collect(),
            remade: remade.map(<[_]>::to_vec),
            ..refinement.surface
        };
        let dataset = Arc::new(testing::dataset("ball", [65; 3], &["density"]));
        let volume = VolumeStep::new(dataset, 0).expect("a step");
        let step = SharedStep::new(refinement, &volume, CancellationToken::new()).await;
        differences(step.expect("a step"), held, Coding::Meshopt)
    }

    /// Returns the regions whose chunks are sent: those with a mesh, and those without.
    fn sent(changes: &Changes, cache: &ChunkCache) -> [Vec<RegionKey>; 2] {
        let mut sent = [Vec::new(), Vec::new()];
        for part in &changes.changed {
            let id = (PrefixId::cut(0, 1, 0), changes.coding);
            let frame = part.encode(&changes.step, id, cache).expect("a chunk");
            let header = decode(&frame).expect("a valid chunk").header;
            sent[usize::from(header.vertex_count == 0)].push(header.region);
        }
        sent
    }

    #[tokio::test]
    async fn regions_that_merge_and_split_are_sent_and_removed() {
        let cache = ChunkCache::new(1 << 20);
        let small = SMALL.map(RegionKey::smallest);
        let (with_small, with_large) = ([&small[..], &[BESIDE]].concat(), [LARGE, BESIDE]);
        let all = changes(&with_small, None, &HeldRegions::default()).await;
        assert_eq!(
            (all.unchanged, sent(&all, &cache)),
            (0, [with_small.clone(), Vec::new()])
        );

        // The large region has the mesh and the low corner of the first small one, whose chunk is cached, but it is another region.
        let both = [&small[..], &[LARGE]].concat();
        let merged = changes(&[LARGE], Some(&both), &all.held).await;
        assert_eq!(
            (merged.unchanged, sent(&merged, &cache)),
            (1, [vec![LARGE], small.to_vec()])
        );
        let mut held: Vec<_> = merged.held.keys().copied().collect();
        held.sort_unstable();
        assert_eq!(held, with_large);

        // Only two of the small regions have triangles now.
        let split = changes(&[small[0], small[7]], Some(&both), &merged.held).await;
        assert_eq!(
            (split.unchanged, sent(&split, &cache)),
            (1, [vec![small[0], small[7]], vec![LARGE]])
        );

        // As a whole surface, without a list of what was remade.
        let whole = changes(&with_large, None, &split.held).await;
        assert_eq!(
            (whole.unchanged, sent(&whole, &cache)),
            (1, [vec![LARGE], vec![small[0], small[7]]])
        );
        let same = changes(&with_large, None, &whole.held).await;
        assert_eq!((same.unchanged, same.changed), (2, Vec::new()));
    }

    #[test]
    fn batches_are_bounded_and_take_everything() {
        // Each region is given by its number of triangles.
        let take = |regions: &mut Vec<usize>| take_batch_for(2, |triangles| *triangles, regions).len();
        let mut regions = vec![1; 2 * BATCH_CHUNKS + 3];
        assert_eq!(take(&mut regions), 2 * BATCH_CHUNKS);
        assert_eq!(take(&mut regions), 3);
        assert_eq!(take(&mut regions), 0);

        let mut regions = vec![BATCH_TRIANGLES * 4, BATCH_TRIANGLES, BATCH_TRIANGLES];
        assert_eq!(take(&mut regions), 2);
        assert_eq!(take(&mut regions), 1, "one that is too large still goes");
    }
}
