//! Time steps that viewers have open, and the turn of those that are read ahead of them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use tokio::sync::Semaphore;

use super::keys::VolumeKey;
use super::lock::lock;

/// Time steps that are read ahead at the same time: one, as each takes a disk, and a processor where it is decoded.
const CONCURRENT: usize = 1;

/// A time step of a dataset.
type OpenStep = (String, u32, u32);

/// How many viewers have each time step open.
type OpenSteps = Arc<Mutex<HashMap<OpenStep, usize>>>;

/// What reading ahead has to leave alone, and its turn.
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

    /// A viewer has the time step of this field open.
    pub(super) fn hold(&self, key: &VolumeKey) -> Held {
        let (open, step) = (Arc::clone(&self.open), step_of(key));
        *lock(&open).entry(step.clone()).or_default() += 1;
        Held {
            held: Some((open, step)),
        }
    }

    /// Whether a viewer has the time step of a field open.
    pub(super) fn is_open(&self) -> impl Fn(&VolumeKey) -> bool + Send + use<> {
        let open = Arc::clone(&self.open);
        move |key| lock(&open).contains_key(&step_of(key))
    }
}

/// A time step that a viewer has open: its samples stay on the device while others are read ahead. The default holds nothing.
#[derive(Default)]
pub struct Held {
    held: Option<(OpenSteps, OpenStep)>,
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

fn step_of(key: &VolumeKey) -> OpenStep {
    (key.dataset.clone(), key.revision, key.step)
}
