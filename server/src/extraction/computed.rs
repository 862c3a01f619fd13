//! Fields that the device computes from others.

use std::rc::Rc;
use std::time::Instant;

use isopeel_kernels::{Cancel, DeviceKind, Error, Volume};

use super::WorkError;
use super::keys::VolumeKey;
use super::turns::{Aside, Turn};
use super::worker_state::{JobError, WorkerState};
use crate::view::EditError;
use crate::volumes::{ReadProgress, VolumeStep};

impl WorkerState {
    /// Makes a field resident that is computed from others. Other jobs run between its launches, which are sized by their time. It ends if
    /// `progress` is cancelled, because no caller waits for the field any more, and when it has taken as much of the device's time as a request may.
    pub(super) fn compute(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        progress: &ReadProgress,
        turn: &mut Turn<'_, Self>,
    ) -> Result<(), JobError> {
        let Some((found, inputs)) = key.computed(volume).filter(|_| !self.is_resident(key)) else {
            return Ok(());
        };
        if progress.is_cancelled() {
            return Err(WorkError::Cancelled.into());
        }
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
        let (limit, start, aside) = (self.request_time, Instant::now(), Aside::default());
        let is_over = || limit.is_some_and(|limit| aside.own_time(start) > limit);
        let computed = turn.run(self, &take_times, &aside, |cancel| {
            let cancel = &Wanted {
                cancel,
                progress,
                is_over: &is_over,
            };
            if found.is_distance {
                engine.distance_field(&found.expression, &fields, world, cancel)
            } else {
                engine.evaluate(&found.expression, &fields, cancel).map(Some)
            }
        });
        let computed = match (computed, limit) {
            (Err(Error::Cancelled), Some(limit)) if is_over() => {
                return Err(WorkError::TookTooLong { limit }.into());
            }
            (computed, _) => computed?,
        };
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

/// Cancellation of a field's computation: by its job, with its last caller, or by its time.
struct Wanted<'a> {
    cancel: &'a dyn Cancel,
    progress: &'a ReadProgress,
    is_over: &'a dyn Fn() -> bool,
}

impl Cancel for Wanted<'_> {
    fn cancelled(&self) -> bool {
        // Other jobs run first.
        self.cancel.cancelled() || self.progress.is_cancelled() || (self.is_over)()
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
