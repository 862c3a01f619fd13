//! Fields that the device computes from others.

use std::rc::Rc;

use isopeel_kernels::{DeviceKind, Volume};

use super::WorkError;
use super::keys::VolumeKey;
use super::turns::{Aside, Turn};
use super::worker_state::{JobError, WorkerState};
use crate::view::EditError;
use crate::volumes::VolumeStep;

impl WorkerState {
    /// Makes a field resident that is computed from others. Other jobs have a turn every 50 ms or so.
    pub(super) fn compute(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        turn: &mut Turn<'_, Self>,
    ) -> Result<(), JobError> {
        let Some((found, inputs)) = key.computed(volume).filter(|_| !self.is_resident(key)) else {
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
        // Distances are made in two fields in turns.
        let held = if found.is_distance { 2 * bytes } else { bytes };
        self.evict_for(held + self.upload_bytes());
        if self.engine().device().kind == DeviceKind::Cpu {
            self.make_host_space(held)?;
        }
        let engine = Rc::clone(self.engine());
        let take_times = || engine.take_times().unwrap_or_default();
        let world = volume.dataset().smallest_length() as f32;
        let computed = turn.run(self, &take_times, &Aside::default(), |cancel| {
            if found.is_distance {
                engine.distance_field(&found.expression, &fields, world, cancel)
            } else {
                engine.evaluate(&found.expression, &fields, cancel).map(Some)
            }
        })?;
        let computed = computed.ok_or_else(|| WorkError::Edit(nothing_inside(key)))?;
        tracing::info!(
            dataset = key.step.dataset.id,
            field = key.field,
            step = key.step.step,
            bytes,
            "field computed"
        );
        self.computed.insert(key.clone());
        self.add_volume(key.clone(), bytes, Rc::new(computed));
        Ok(())
    }
}

/// There is nothing that distances would be to.
pub(super) fn nothing_inside(key: &VolumeKey) -> EditError {
    EditError {
        field: "feature",
        why: format!(
            "{:?} holds at no sample of step {}, expected at least one",
            key.field, key.step.step
        ),
    }
}
