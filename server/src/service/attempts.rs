//! Retries a job until it has a result: after its volumes were loaded, as a long job, or on a device that was reopened.

use std::pin::Pin;

use isopeel_extraction::{HistogramKey, JobContext, JobError, Pinned, VolumeKey, WorkError, Workspace};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

/// How often a request's job is queued before it fails with [`WorkError::Busy`]. It is queued again after its volumes were loaded (they are
/// pinned, but if the device runs out of memory, all volumes except those of the running job are evicted), and after histograms were made.
/// Jobs of viewers and of caches are retried without a limit.
const MAX_REQUEST_ATTEMPTS: usize = 6;

/// How often a job is queued again after the device was lost while it ran: a job that loses every device it runs on is given up.
const MAX_LOSSES: usize = 1;

/// State that earlier attempts at a job, or at slices of work, leave to the next attempt.
#[derive(Default)]
pub(super) struct Failures {
    /// Keeps the fields that were loaded for the next attempt.
    pin: Option<Pinned>,
    losses: usize,
}

impl DeviceWorker {
    /// Prepares another attempt after a failure: loads and pins fields that were not resident, makes histograms, or counts a loss of the
    /// device.
    ///
    /// # Errors
    /// The failure, if another attempt would fail as well.
    pub(super) async fn after_failure(
        &self,
        volume: &VolumeStep,
        error: JobError,
        failures: &mut Failures,
        token: &CancellationToken,
    ) -> Result<(), WorkError> {
        let prepared = match error {
            JobError::NotResident { needed, budget } => {
                // A caller that waits for pins holds none, so callers cannot deadlock.
                drop(failures.pin.take());
                let loaded = self.load_pinned(volume, needed, budget, token).await;
                loaded.map(|pin| failures.pin = Some(pin))
            }
            JobError::NeedsHistograms(keys) => {
                // Making histograms pins the fields that they are made of, and a caller that waits for pins must hold none.
                drop(failures.pin.take());
                self.make_histograms(volume, keys, token).await
            }
            error => Err(error.into()),
        };
        match prepared {
            Err(WorkError::DeviceLost) if failures.losses < MAX_LOSSES => {
                failures.losses += 1;
                Ok(())
            }
            prepared => prepared,
        }
    }

    /// Runs a job; runs it again after loading volumes that were not resident, as a long job, or on a device that was reopened.
    pub(super) async fn with_volumes<T, F>(
        &self,
        volume: &VolumeStep,
        token: &CancellationToken,
        caller: Caller,
        mut length: Length,
        job: F,
    ) -> Result<T, WorkError>
    where
        T: Send + 'static,
        F: Fn(&mut Workspace, &VolumeStep, &mut JobContext<'_, Workspace>) -> Result<T, JobError>
            + Clone
            + Send
            + 'static,
    {
        let mut failures = Failures::default();
        let attempts = match caller {
            Caller::Request => MAX_REQUEST_ATTEMPTS,
            Caller::Viewer | Caller::Cache => usize::MAX,
        };
        for _ in 0..attempts {
            let (job, step) = (job.clone(), volume.clone());
            let outcome = self.run_when_proven(token, caller, length, move |state, context| job(state, &step, context));
            match outcome.await {
                Ok(value) => return Ok(value),
                Err(JobError::TakesLong) => length = caller.long(),
                Err(error) => self.after_failure(volume, error, &mut failures, token).await?,
            }
        }
        Err(WorkError::Busy)
    }

    /// Makes histograms that a job needs.
    fn make_histograms<'a>(
        &'a self,
        volume: &'a VolumeStep,
        keys: Vec<HistogramKey>,
        token: &'a CancellationToken,
    ) -> Pin<Box<dyn Future<Output = Result<(), WorkError>> + Send + 'a>> {
        // Boxed because the future is recursive: a histogram takes jobs.
        Box::pin(async move {
            let make = async {
                for key in keys {
                    self.histogram_of(volume, &key).await?;
                }
                Ok(())
            };
            tokio::select! {
                made = make => made,
                () = token.cancelled() => Err(WorkError::Cancelled),
            }
        })
    }

    /// Loads fields that are not resident, and pins them until the returned guard is dropped.
    pub(super) async fn load_pinned(
        &self,
        volume: &VolumeStep,
        needed: Vec<(VolumeKey, u64)>,
        budget: u64,
        token: &CancellationToken,
    ) -> Result<Pinned, WorkError> {
        let load = async {
            let pin = self.shared.pins.pin(&needed, budget).await;
            for (key, _) in needed {
                self.load(volume, key).await?;
            }
            Ok(pin)
        };
        tokio::select! {
            loaded = load => loaded,
            () = token.cancelled() => Err(WorkError::Cancelled),
        }
    }
}
