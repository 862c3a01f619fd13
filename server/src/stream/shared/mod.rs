//! Coalesces and caches equal requests of viewers: one job on the device, and chunks that are encoded once.
//!
//! - `single_flight`: jobs in flight, which equal requests join.
//! - `step`: a step that was made, shared by all viewers who are sent it.
//! - `chunk_cache`: the cache of steps and chunks, within a budget of bytes.
//!
//! Two requests are equal if they have the same volume, time step and view (colours do not count), and if their clients show the same
//! surface and have the same target. There is no access check here: a session requests only volumes that it has opened, which checked that
//! the viewer may see them.

mod chunk_cache;
mod single_flight;
mod step;

use std::sync::Arc;

use isopeel_extraction::{CutId, FittedKey, FullCount, Measurement, Refinement, Shown, Step, ViewKey, WorkError};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::backend::Backend;
use crate::metrics;
pub(super) use chunk_cache::ChunkCache;
pub(super) use single_flight::Outcome;
use single_flight::SingleFlight;
pub(super) use step::{HeldRegion, HeldRegions, SharedStep};

/// Maximum number of other viewers' jobs that a request waits for. If none of their steps suits the viewer's line, the request starts its
/// own job.
const MAX_JOINED: usize = 2;

/// An existing step is used if it has at most this many times the bytes that suit the viewer's line. A smaller step would have to be made
/// first, which takes time too.
const MAX_LINE_FACTOR: u64 = 4;
/// A step of at most this many bytes suits any line.
const ANY_LINE_BYTES: u64 = 256 << 10;
/// An existing step that is not final must have at least the bytes that suit the viewer's line, divided by this number. A smaller step
/// would waste the line, so a step is made for this viewer.
const MIN_LINE_DIVISOR: u64 = 8;

/// A request for a result about a view's surface, with the backend and the volume to make it.
#[derive(Clone)]
pub(super) struct SurfaceRequest<B> {
    pub backend: B,
    pub volume: VolumeStep,
    pub view: View,
    /// Key of `view`.
    pub key: ViewKey,
}

/// Key of a requested result. Two requests with the same key have the same result, except for how fine a step is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct RequestKey {
    view: ViewKey,
    /// The threshold that an earlier step has found to keep the budget.
    fitted: Option<FittedKey>,
    kind: RequestKind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum RequestKind {
    Count,
    Refine { shown: Shown, target: Option<CutId> },
    Improve,
    Measure,
}

impl RequestKey {
    /// Estimates the bytes that this key takes.
    fn bytes(&self) -> usize {
        size_of::<Self>() + self.view.bytes()
    }
}

/// Single-flight jobs and cached results of all viewers. Clones share them.
#[derive(Clone)]
pub(super) struct Shared(Arc<Inner>);

struct Inner {
    steps: SingleFlight<RequestKey, Arc<SharedStep>>,
    improved: SingleFlight<RequestKey, Option<Arc<SharedStep>>>,
    measured: SingleFlight<RequestKey, Option<Arc<Measurement>>>,
    counted: SingleFlight<RequestKey, FullCount>,
    cache: Arc<ChunkCache>,
}

/// A step for a viewer, and whether the viewer's own request has made it.
pub(super) struct Offered {
    pub step: Arc<SharedStep>,
    /// Whether the step was made for this request. Only then does its time predict how long the next steps take.
    pub is_own: bool,
}

impl Offered {
    /// Returns an empty step, after which the client holds nothing of the surface.
    pub(super) fn nothing(view: &View, volume: &VolumeStep) -> Self {
        let volume = Arc::new(volume.dataset().key());
        Self {
            step: Arc::new(SharedStep::from_cache(Refinement::nothing(view), volume, Vec::new())),
            is_own: false,
        }
    }
}

impl Shared {
    /// Creates a cache of `budget` bytes. With 0 nothing is cached, but requests still join jobs in flight.
    pub(super) fn new(budget: u64) -> Self {
        Self(Arc::new(Inner {
            steps: SingleFlight::default(),
            improved: SingleFlight::default(),
            measured: SingleFlight::default(),
            counted: SingleFlight::default(),
            cache: Arc::new(ChunkCache::new(budget)),
        }))
    }

    /// Returns the cache of chunks.
    pub(super) fn chunk_cache(&self) -> Arc<ChunkCache> {
        Arc::clone(&self.0.cache)
    }

    /// Counts the triangles of the full surface of a view.
    pub(super) async fn count<B: Backend>(
        &self,
        request: SurfaceRequest<B>,
        token: &CancellationToken,
    ) -> Outcome<FullCount> {
        let key = request.key_for(RequestKind::Count);
        let make = |token: CancellationToken| async move {
            let counted = request.backend.count(&request.volume, &request.view, &token).await;
            counted.map_err(Arc::new)
        };
        self.0.counted.join_or_start(&key, token, make).await.0
    }

    /// Makes a step from the surface that a client shows to the surface of a view, or finds one in the cache or in flight.
    pub(super) async fn refine<B: Backend>(
        &self,
        request: SurfaceRequest<B>,
        step: Step,
        token: &CancellationToken,
    ) -> Outcome<Offered> {
        let key = request.key_for(RequestKind::Refine {
            shown: step.shown,
            target: step.target,
        });
        let mut joined = 0;
        loop {
            if let Some(cached) = self.0.cache.find_step(&key).filter(|cached| cached.suits(step)) {
                metrics::found_step("hit");
                return Ok(Offered {
                    step: cached,
                    is_own: false,
                });
            }
            let (request, own_key) = (request.clone(), key.clone());
            let cache = self.chunk_cache();
            let make = |token: CancellationToken| async move {
                let refinement = request.refine(&cache, step, &token).await?;
                let shared_step = SharedStep::new(refinement, &request.volume, token).await?;
                cache.insert_step(own_key, &shared_step);
                Ok(shared_step)
            };
            // If the steps of other viewers did not suit, a step is made for this viewer alone, and other requests do not join the job.
            let (outcome, was_joined) = match joined {
                ..MAX_JOINED => self.0.steps.join_or_start(&key, token, make).await,
                MAX_JOINED.. => (make(token.clone()).await, false),
            };
            let shared_step = outcome?;
            if !was_joined || shared_step.suits(step) {
                metrics::found_step(if was_joined { "joined" } else { "miss" });
                return Ok(Offered {
                    step: shared_step,
                    is_own: !was_joined,
                });
            }
            joined += 1;
        }
    }

    /// Makes a better surface of the same view, or finds it in the cache; `None` if there is no better surface.
    pub(super) async fn improve<B: Backend>(
        &self,
        request: SurfaceRequest<B>,
        token: &CancellationToken,
    ) -> Outcome<Option<Offered>> {
        let key = request.key_for(RequestKind::Improve);
        if let Some(step) = self.0.cache.find_step(&key) {
            metrics::found_step("hit");
            return Ok(Some(Offered { step, is_own: false }));
        }
        let (own_key, cache) = (key.clone(), self.chunk_cache());
        let make = |token: CancellationToken| async move {
            let improved = request.backend.improve(&request.volume, &request.view, &token).await;
            let Some(refinement) = improved.map_err(Arc::new)? else {
                return Ok(None);
            };
            let shared_step = SharedStep::new(refinement, &request.volume, token).await?;
            cache.insert_step(own_key, &shared_step);
            Ok(Some(shared_step))
        };
        let (outcome, was_joined) = self.0.improved.join_or_start(&key, token, make).await;
        metrics::found_step(if was_joined { "joined" } else { "miss" });
        let is_own = !was_joined;
        Ok(outcome?.map(|step| Offered { step, is_own }))
    }

    /// Measures how far the final surface of a view is from the undecimated one; `None` as in [`Backend::measure`].
    pub(super) async fn measure<B: Backend>(
        &self,
        request: SurfaceRequest<B>,
        token: &CancellationToken,
    ) -> Outcome<Option<Arc<Measurement>>> {
        let key = request.key_for(RequestKind::Measure);
        if let Some(cached) = self.0.cache.find_measured(&key) {
            return Ok(Some(cached));
        }
        let (own_key, cache) = (key.clone(), self.chunk_cache());
        let make = |token: CancellationToken| async move {
            let measured = request.backend.measure(&request.volume, &request.view, &token).await;
            let measured = measured.map_err(Arc::new)?.map(Arc::new);
            if let Some(measured) = &measured {
                cache.insert_measured(own_key, measured);
            }
            Ok(measured)
        };
        self.0.measured.join_or_start(&key, token, make).await.0
    }
}

impl<B: Backend> SurfaceRequest<B> {
    /// Returns the key of a result of this kind.
    fn key_for(&self, kind: RequestKind) -> RequestKey {
        RequestKey {
            view: self.key.clone(),
            fitted: self.view.fitted.map(FittedKey::from),
            kind,
        }
    }

    /// Makes a step. If the host has too little memory for the step, evicts the cache and retries once.
    async fn refine(&self, cache: &ChunkCache, step: Step, token: &CancellationToken) -> Outcome<Refinement> {
        let make = || self.backend.refine(&self.volume, &self.view, step, token);
        let outcome = match make().await {
            Err(WorkError::HostBusy { .. }) if cache.clear() => make().await,
            outcome => outcome,
        };
        outcome.map_err(Arc::new)
    }
}
