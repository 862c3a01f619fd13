//! Frees the data of a time step that will not be used again.

use isopeel_kernels::lock;
use isopeel_volumes::StepKey;

use super::workspace::Workspace;

impl Workspace {
    /// Frees the samples, pyramids and trees of a time step, except volumes that are pinned.
    pub fn release(&mut self, step: &StepKey) {
        let pins = &self.pins;
        self.volumes.retain(|key| key.step != *step || pins.holds(key));
        self.pyramids.retain(|key| key.samples().step != *step);
        lock(&self.trees).retain(|key| key.samples().step != *step);
    }
}
