//! Time steps that viewers have open. Read-ahead evicts none of their fields.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_kernels::lock;
use isopeel_volumes::StepKey;

/// Time steps that viewers have open. Clones share them.
#[derive(Clone, Default)]
pub struct OpenSteps(Arc<Mutex<Viewers>>);

#[derive(Default)]
struct Viewers {
    /// Number of viewers that have each time step open. Steps without viewers have no entry.
    of_step: HashMap<StepKey, usize>,
    /// Incremented when a step was opened or closed.
    changes: u64,
}

impl OpenSteps {
    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub fn mark(&self, step: &StepKey) -> OpenStepGuard {
        let mut viewers = lock(&self.0);
        viewers.changes += 1;
        *viewers.of_step.entry(step.clone()).or_default() += 1;
        drop(viewers);
        OpenStepGuard(Some((self.clone(), step.clone())))
    }

    /// Whether a viewer has this step open.
    pub(crate) fn contains(&self, step: &StepKey) -> bool {
        lock(&self.0).of_step.contains_key(step)
    }

    /// Returns the open steps if they have changed since `changes` was returned, with a number for the next call.
    pub fn changed_since(&self, changes: Option<u64>) -> Option<(Vec<StepKey>, u64)> {
        let viewers = lock(&self.0);
        (changes != Some(viewers.changes)).then(|| (viewers.of_step.keys().cloned().collect(), viewers.changes))
    }

    /// Replaces the open steps by those of another process.
    pub fn replace(&self, steps: Vec<StepKey>) {
        lock(&self.0).of_step = steps.into_iter().map(|step| (step, 1)).collect();
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
        let mut open_steps = lock(&open_steps.0);
        open_steps.changes += 1;
        if let Some(viewers) = open_steps.of_step.get_mut(&step) {
            *viewers -= 1;
            if *viewers == 0 {
                open_steps.of_step.remove(&step);
            }
        }
    }
}
