//! Time steps that viewers have open. Read-ahead evicts none of their fields.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_kernels::lock;
use isopeel_volumes::StepKey;

/// Number of viewers that have each time step open. Steps without viewers have no entry. Clones share the numbers.
#[derive(Clone, Default)]
pub struct OpenSteps(Arc<Mutex<HashMap<StepKey, usize>>>);

impl OpenSteps {
    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub fn mark(&self, step: &StepKey) -> OpenStepGuard {
        *lock(&self.0).entry(step.clone()).or_default() += 1;
        OpenStepGuard(Some((self.clone(), step.clone())))
    }

    /// Whether a viewer has this step open.
    pub(crate) fn contains(&self, step: &StepKey) -> bool {
        lock(&self.0).contains_key(step)
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
        if let Some(viewers) = open_steps.get_mut(&step) {
            *viewers -= 1;
            if *viewers == 0 {
                open_steps.remove(&step);
            }
        }
    }
}
