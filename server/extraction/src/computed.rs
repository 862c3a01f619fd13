//! Fields that the device computes from other fields.

use std::rc::Rc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, DeviceKind, Error, Volume};
use isopeel_volumes::{ReadProgress, VolumeStep};

use super::WorkError;
use super::context::{JobContext, JobTimes};
use super::job_error::JobError;
use super::keys::{Recipe, VolumeKey, values_inside};
use super::user_time::Payer;
use super::workspace::Workspace;

impl Workspace {
    /// Computes a field from others and makes it resident. Returns false if the host has to mask the field: its inputs are not resident
    /// because there was no space for them, or the check of the device has not reached masking yet. The computation is launched in pieces
    /// of limited time, and other jobs run between them. It ends early if `progress` is cancelled, because no caller waits for the field
    /// any more, or if it exceeds the device time of a request or of the user.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn compute(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        progress: &ReadProgress,
        payer: Option<&Payer>,
        context: &mut JobContext<'_, Self>,
    ) -> Result<bool, JobError> {
        let Some((recipe, inputs)) = key.recipe(volume).filter(|_| !self.is_resident(key)) else {
            return Ok(true);
        };
        let is_mask = matches!(recipe, Recipe::Mask(..));
        if is_mask && !inputs.iter().all(|input| self.is_resident(input)) {
            return Ok(false);
        }
        if progress.is_cancelled() {
            return Err(WorkError::Cancelled.into());
        }
        let limit = TimeLimit::of(self.request_time, payer)?;
        self.use_fields(volume, &inputs)?;
        let resident = |input: &VolumeKey| self.volumes.peek(input).map(Rc::clone).ok_or(WorkError::Stopped);
        // Holds the inputs, so that none of them is freed meanwhile.
        let fields = inputs.iter().map(resident).collect::<Result<Vec<_>, _>>()?;
        let fields: Vec<&Volume> = fields.iter().map(|field| &**field).collect();
        let bytes = self.make_space(volume, key, &recipe)?;
        let engine = self.shared_engine();
        let take_times = || engine.take_times().unwrap_or_default();
        let world = volume.dataset().smallest_length() as f32;
        let (start, job_times) = (Instant::now(), JobTimes::default());
        let is_over = || limit.is_over(job_times.own_time(start));
        let computed = context.run(self, &take_times, &job_times, |cancel| {
            let cancel = &FieldCancel {
                cancel,
                progress,
                is_over: &is_over,
            };
            match &recipe {
                Recipe::Mask(mask, labels) => {
                    let inside = values_inside(mask, labels);
                    engine.mask(fields[0], fields[1], &inside, cancel).map(Some)
                }
                Recipe::Expression(found) if found.is_distance => {
                    engine.distance_field(&found.expression, &fields, world, cancel)
                }
                Recipe::Expression(found) => engine.evaluate(&found.expression, &fields, cancel).map(Some),
            }
        });
        let time = job_times.own_time(start);
        if let Some(payer) = payer {
            payer.take(time, Instant::now());
        }
        let computed = match computed {
            // The host masks until the device's check has reached this stage.
            Err(Error::NotYet(_)) if is_mask => return Ok(false),
            Err(Error::Cancelled) if limit.is_over(time) => return Err(limit.error(payer).into()),
            computed => computed?,
        };
        let computed = computed.ok_or_else(|| WorkError::Edit(key.nothing_inside()))?;
        tracing::info!(
            dataset = key.step.dataset.id,
            field = key.field,
            step = key.step.step,
            bytes,
            "field computed"
        );
        self.computed.insert(key.clone());
        self.add_volume(key.clone(), bytes, Rc::new(computed));
        Ok(true)
    }

    /// Makes space for a field that is to be computed; returns its bytes.
    fn make_space(&mut self, volume: &VolumeStep, key: &VolumeKey, recipe: &Recipe) -> Result<u64, JobError> {
        let bytes = self.bytes_of(volume, std::slice::from_ref(key))?;
        let bytes: u64 = bytes.iter().map(|(_, bytes)| bytes).sum();
        // Computing distances takes two fields, which are written alternately.
        let is_distance = matches!(recipe, Recipe::Expression(found) if found.is_distance);
        let held = if is_distance { 2 * bytes } else { bytes };
        self.evict_for(held + self.upload_bytes());
        if self.engine().device().kind == DeviceKind::Cpu {
            self.make_host_space(held)?;
        }
        Ok(bytes)
    }
}

/// Device time that computing a field may take.
#[derive(Clone, Copy)]
struct TimeLimit {
    request: Option<Duration>,
    /// Device time that the user has left; `None`: there is no limit.
    user: Option<Duration>,
}

impl TimeLimit {
    /// # Errors
    /// The user has no time left.
    fn of(request: Option<Duration>, payer: Option<&Payer>) -> Result<Self, WorkError> {
        let left = payer.and_then(|payer| payer.left(Instant::now()));
        let limit = Self {
            request,
            user: left.map(|left| left.now),
        };
        match left {
            Some(left) if left.now.is_zero() => Err(limit.error(payer)),
            _ => Ok(limit),
        }
    }

    fn is_over(self, time: Duration) -> bool {
        let limits = self.request.into_iter().chain(self.user);
        limits.min().is_some_and(|limit| time > limit)
    }

    /// Returns the error of work that was ended because it took too long.
    fn error(self, payer: Option<&Payer>) -> WorkError {
        let of_request = self.request.unwrap_or(Duration::MAX);
        let left = payer.and_then(|payer| payer.left(Instant::now()));
        match left.filter(|_| self.user.is_some_and(|user| user < of_request)) {
            Some(left) => WorkError::UserTime {
                limit: left.limit,
                wait: left.wait,
            },
            None => WorkError::TookTooLong { limit: of_request },
        }
    }
}

/// Cancellation of a field's computation: by its job, when its last caller is gone, or when its time is over.
struct FieldCancel<'a> {
    cancel: &'a dyn Cancel,
    progress: &'a ReadProgress,
    is_over: &'a dyn Fn() -> bool,
}

impl Cancel for FieldCancel<'_> {
    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled() || self.progress.is_cancelled() || (self.is_over)()
    }

    fn pause(&self) {
        self.cancel.pause();
    }
}
