//! Fields that the device computes from others.

use std::rc::Rc;

use isopeel_kernels::Volume;

use super::WorkError;
use super::keys::VolumeKey;
use super::worker_state::{JobError, WorkerState};
use crate::volumes::VolumeStep;

impl WorkerState {
    /// Makes a field resident that is computed from others.
    pub(super) fn compute(&mut self, volume: &VolumeStep, key: &VolumeKey) -> Result<(), JobError> {
        let Some((expression, inputs)) = key.computed(volume).filter(|_| !self.is_resident(key)) else {
            return Ok(());
        };
        self.use_fields(volume, &inputs)?;
        let bytes: u64 = self
            .bytes_of(volume, std::slice::from_ref(key))?
            .iter()
            .map(|(_, bytes)| bytes)
            .sum();
        let resident = |input: &VolumeKey| self.volumes.peek(input).map(Rc::clone).ok_or(WorkError::Stopped);
        // Held, so that none of them goes.
        let fields = inputs.iter().map(resident).collect::<Result<Vec<_>, _>>()?;
        let fields: Vec<&Volume> = fields.iter().map(|field| &**field).collect();
        self.evict_for(bytes + self.upload_bytes());
        let computed = self.engine().evaluate(&expression, &fields)?;
        tracing::info!(
            dataset = key.dataset,
            field = key.field,
            step = key.step,
            bytes,
            "field computed"
        );
        self.add_volume(key.clone(), bytes, Rc::new(computed));
        Ok(())
    }
}
