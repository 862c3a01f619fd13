//! Time steps that viewers have open, and the semaphore that limits read-ahead.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_extraction::lock;
use isopeel_volumes::StepKey;
use tokio::sync::Semaphore;

/// Maximum number of time steps that are read ahead at the same time. One, because each occupies a disk, and a processor if it is
/// compressed.
const CONCURRENT_READS: usize = 1;

/// Number of viewers that have each time step open. Steps without viewers have no entry.
type OpenSteps = Arc<Mutex<HashMap<StepKey, usize>>>;

/// State of read-ahead: the open steps, which it must not evict, and its semaphore.
pub(super) struct AheadState {
    open_steps: OpenSteps,
    pub permits: Semaphore,
}

impl AheadState {
    pub(super) fn new() -> Self {
        Self {
            open_steps: Arc::default(),
            permits: Semaphore::new(CONCURRENT_READS),
        }
    }

    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub(super) fn mark_open(&self, step: &StepKey) -> OpenStepGuard {
        *lock(&self.open_steps).entry(step.clone()).or_default() += 1;
        OpenStepGuard(Some((Arc::clone(&self.open_steps), step.clone())))
    }

    /// Returns the time steps that viewers have open.
    pub(super) fn open(&self) -> Vec<StepKey> {
        lock(&self.open_steps).keys().cloned().collect()
    }
}

/// Guard of a time step that a viewer has open: read-ahead does not evict its samples. The default guards no step.
#[derive(Default)]
pub struct OpenStepGuard(Option<(OpenSteps, StepKey)>);

impl Drop for OpenStepGuard {
    fn drop(&mut self) {
        let Some((open_steps, step)) = self.0.take() else {
            return;
        };
        let mut open_steps = lock(&open_steps);
        if let Some(viewers) = open_steps.get_mut(&step) {
            *viewers -= 1;
            if *viewers == 0 {
                open_steps.remove(&step);
            }
        }
    }
}
