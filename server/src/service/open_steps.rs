//! Time steps that viewers have open, and the semaphore that limits read-ahead.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_extraction::{VolumeKey, lock};
use isopeel_volumes::StepKey;
use tokio::sync::Semaphore;

/// Maximum number of time steps that are read ahead at the same time. One, because each occupies a disk, and a processor if it has to be
/// decoded.
const CONCURRENT: usize = 1;

/// How many viewers have each time step open.
type OpenSteps = Arc<Mutex<HashMap<StepKey, usize>>>;

/// State of read-ahead: the open steps, which it must not evict, and its semaphore.
pub(super) struct AheadState {
    open: OpenSteps,
    pub turn: Semaphore,
}

impl AheadState {
    pub(super) fn new() -> Self {
        Self {
            open: Arc::default(),
            turn: Semaphore::new(CONCURRENT),
        }
    }

    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub(super) fn hold(&self, step: &StepKey) -> Held {
        let (open, step) = (Arc::clone(&self.open), step.clone());
        *lock(&open).entry(step.clone()).or_default() += 1;
        Held {
            held: Some((open, step)),
        }
    }

    /// Whether a viewer has the time step of a field open.
    pub(super) fn is_open(&self) -> impl Fn(&VolumeKey) -> bool + Send + use<> {
        let open = Arc::clone(&self.open);
        move |key| lock(&open).contains_key(&key.step)
    }
}

/// A time step that a viewer has open: its samples stay on the device while others are read ahead. The default holds nothing.
#[derive(Default)]
pub struct Held {
    held: Option<(OpenSteps, StepKey)>,
}

impl Drop for Held {
    fn drop(&mut self) {
        let Some((open, step)) = self.held.take() else { return };
        let mut open = lock(&open);
        if let Some(count) = open.get_mut(&step) {
            *count -= 1;
            if *count == 0 {
                open.remove(&step);
            }
        }
    }
}
