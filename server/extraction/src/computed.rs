//! Fields that the device computes from other fields.

use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, DeviceKind, Error, Volume};
use isopeel_volumes::VolumeStep;

use super::WorkError;
use super::context::{JobContext, JobTimes};
use super::job_error::JobError;
use super::keys::{Recipe, VolumeKey, values_inside};
use super::user_time::Payer;
use super::workspace::Workspace;

impl Workspace {
    /// Computes a field from others and makes it resident. The computation is launched in pieces of limited time, and other jobs run
    /// between them. `user` is charged for the device time.
    ///
    /// Returns false if the host has to mask the field instead: its inputs did not fit on the device, or the startup check of the device
    /// has not yet approved the masking program.
    ///
    /// # Errors
    /// [`JobError`]. If the computation exceeds the limit of a request or of the user: [`WorkError::TookTooLong`] or
    /// [`WorkError::UserTime`].
    pub fn compute(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        user: Option<&str>,
        context: &mut JobContext<'_, Self>,
    ) -> Result<bool, JobError> {
        let Some((recipe, inputs)) = key.recipe(volume).filter(|_| !self.is_resident(key)) else {
            return Ok(true);
        };
        let is_mask = matches!(recipe, Recipe::Mask(..));
        if is_mask && !inputs.iter().all(|input| self.is_resident(input)) {
            return Ok(false);
        }
        let payer = user.map(|user| Payer::new(&self.user_times, user));
        let payer = payer.as_ref();
        let limit = TimeLimit::new(self.request_time, payer)?;
        self.use_fields(volume, &inputs)?;
        let resident = |input: &VolumeKey| self.volumes.peek(input).map(Arc::clone).ok_or(WorkError::Stopped);
        // The references keep the inputs from being freed while other jobs run.
        let held = inputs.iter().map(resident).collect::<Result<Vec<_>, _>>()?;
        let fields: Vec<&Volume> = held.iter().map(|field| &**field).collect();
        let bytes = self.make_space(volume, key, &recipe)?;
        let engine = self.shared_engine();
        let take_times = || engine.take_times().unwrap_or_default();
        let smallest_length = volume.dataset().smallest_length() as f32;
        let (start, job_times) = (Instant::now(), JobTimes::default());
        let is_over_limit = || limit.is_exceeded(job_times.time_without_pauses(start));
        let computed = context.run(self, &take_times, &job_times, |cancel| {
            let cancel = &FieldCancel {
                cancel,
                is_over_limit: &is_over_limit,
            };
            match &recipe {
                Recipe::Mask(mask, labels) => {
                    let inside = values_inside(mask, labels);
                    engine.mask(fields[0], fields[1], &inside, cancel).map(Some)
                }
                Recipe::Expression(parsed) if parsed.is_distance => {
                    engine.distance_field(&parsed.expression, &fields, smallest_length, cancel)
                }
                Recipe::Expression(parsed) => engine.evaluate(&parsed.expression, &fields, cancel).map(Some),
            }
        });
        let time = job_times.time_without_pauses(start);
        if let Some(payer) = payer {
            payer.charge(time, Instant::now());
        }
        let computed = match computed {
            Err(Error::ProgramUnchecked(_)) if is_mask => return Ok(false),
            Err(Error::Cancelled) if limit.is_exceeded(time) => return Err(limit.error(payer).into()),
            computed => computed?,
        };
        let computed = computed.ok_or_else(|| WorkError::Edit(key.no_sample_inside_error()))?;
        tracing::info!(
            dataset = key.step.dataset.id,
            field = key.field,
            step = key.step.step,
            bytes,
            "field computed"
        );
        self.computed.insert(key.clone());
        self.add_volume(key.clone(), bytes, Arc::new(computed));
        Ok(true)
    }

    /// Evicts cached data to make space for a computed field on the device. If the device is this machine's processors, makes space in the
    /// host's memory too.
    /// Returns the field's size in bytes.
    fn make_space(&mut self, volume: &VolumeStep, key: &VolumeKey, recipe: &Recipe) -> Result<u64, JobError> {
        let bytes = self.bytes_of(volume, std::slice::from_ref(key))?;
        let bytes: u64 = bytes.iter().map(|(_, bytes)| bytes).sum();
        // Computing distances needs two fields, which are written alternately.
        let is_distance = matches!(recipe, Recipe::Expression(parsed) if parsed.is_distance);
        let needed = if is_distance { 2 * bytes } else { bytes };
        self.evict_for(needed + self.upload_bytes());
        if self.engine().device().kind == DeviceKind::Cpu {
            self.make_host_space(needed)?;
        }
        Ok(bytes)
    }
}

/// Limits of the device time of a field's computation. `None`: no limit.
#[derive(Clone, Copy)]
struct TimeLimit {
    /// Maximum time of a request.
    request: Option<Duration>,
    /// Time that the user had left at the start.
    user: Option<Duration>,
}

impl TimeLimit {
    /// Returns the limits of a computation that begins now.
    ///
    /// # Errors
    /// [`WorkError::UserTime`] if the user has no time left.
    fn new(request: Option<Duration>, payer: Option<&Payer>) -> Result<Self, WorkError> {
        let left = payer.and_then(|payer| payer.left(Instant::now()));
        let limit = Self {
            request,
            user: left.map(|left| left.available),
        };
        match left {
            Some(left) if left.available.is_zero() => Err(limit.error(payer)),
            _ => Ok(limit),
        }
    }

    fn is_exceeded(self, time: Duration) -> bool {
        let limits = self.request.into_iter().chain(self.user);
        limits.min().is_some_and(|limit| time > limit)
    }

    /// Returns the error of a computation that has exceeded the smaller of the limits.
    fn error(self, payer: Option<&Payer>) -> WorkError {
        let request = self.request.unwrap_or(Duration::MAX);
        let left = payer.and_then(|payer| payer.left(Instant::now()));
        match left.filter(|_| self.user.is_some_and(|user| user < request)) {
            Some(left) => WorkError::UserTime {
                limit: left.limit,
                wait: left.wait,
            },
            None => WorkError::TookTooLong { limit: request },
        }
    }
}

/// Cancellation of a field's computation: by its job, or if it exceeds its time limit.
struct FieldCancel<'a> {
    cancel: &'a dyn Cancel,
    is_over_limit: &'a dyn Fn() -> bool,
}

impl Cancel for FieldCancel<'_> {
    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled() || (self.is_over_limit)()
    }

    fn pause(&self) {
        self.cancel.pause();
    }
}
