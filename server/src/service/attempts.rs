//! Retries a job until it has a result. Before a retry, its volumes are loaded, its histograms are made, or the device is reopened. A job
//! that takes long is retried as a long job.

use std::pin::Pin;

use isopeel_extraction::{HistogramKey, JobError, Pinned, VolumeKey, VolumeRequest, WorkError};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::job::length_of;
use super::scheduler::Caller;
use super::worker::{DeviceWorker, reply_of};

/// Maximum attempts at a request's job before the job fails with [`WorkError::Busy`]. Loading the job's volumes once is not always enough:
/// if the device runs out of memory, all volumes except those of the running job are evicted, even pinned ones. Jobs of viewers and of
/// caches are retried without a limit.
const MAX_REQUEST_ATTEMPTS: usize = 6;

/// Maximum retries of a job after the device was lost while the job ran. There are few, because the job itself may be the cause.
const MAX_DEVICE_LOSSES: usize = 1;

/// Maximum retries of a job that did not begin before the process of the device ended.
const MAX_NOT_BEGUN: usize = 5;

/// State of the retries of a job, or of all slices of one piece of work.
#[derive(Default)]
pub(super) struct Retries {
    /// Keeps the fields that were loaded for the next attempt resident.
    pin: Option<Pinned>,
    device_losses: usize,
    /// How often the process of the device has ended before the job began.
    not_begun: usize,
}

impl DeviceWorker {
    /// Prepares another attempt after a failure: loads and pins the fields that were not resident, makes the missing histograms, or counts
    /// a loss of the device.
    ///
    /// # Errors
    /// The failure, if another attempt would fail as well.
    async fn prepare_retry(
        &self,
        volume: &VolumeStep,
        error: JobError,
        retries: &mut Retries,
        token: &CancellationToken,
    ) -> Result<(), WorkError> {
        let prepared = match error {
            JobError::NotResident { needed, budget } => {
                // A caller that waits for pins holds none, so callers cannot deadlock.
                drop(retries.pin.take());
                let loaded = self.load_pinned(volume, needed, budget, token).await;
                loaded.map(|pin| retries.pin = Some(pin))
            }
            JobError::NeedsHistograms(keys) => {
                // Making histograms pins the fields that they are made of, and a caller that waits for pins must hold none.
                drop(retries.pin.take());
                self.make_histograms(volume, keys, token).await
            }
            JobError::NotBegun if retries.not_begun < MAX_NOT_BEGUN => {
                retries.not_begun += 1;
                Ok(())
            }
            // The request is not the cause, so it may be done on another device.
            JobError::NotBegun => Err(WorkError::Reopening),
            error => Err(error.into()),
        };
        match prepared {
            Err(WorkError::DeviceLost) if retries.device_losses < MAX_DEVICE_LOSSES => {
                retries.device_losses += 1;
                Ok(())
            }
            prepared => prepared,
        }
    }

    /// Runs a request until it has a result. Retries the request
    /// - after volumes that were not resident were loaded, or missing histograms were made,
    /// - after a program that it needs has passed its check,
    /// - as a long job if it takes long,
    /// - after a lost device was reopened, or the process that has it was replaced.
    ///
    /// # Errors
    /// [`WorkError`].
    pub(super) async fn perform<R: VolumeRequest>(
        &self,
        caller: Caller,
        request: R,
        token: &CancellationToken,
    ) -> Result<R::Reply, WorkError> {
        let (mut retries, mut length) = (Retries::default(), None);
        let mut attempts = match caller {
            Caller::Request => MAX_REQUEST_ATTEMPTS,
            Caller::Viewer | Caller::Cache => usize::MAX,
        };
        while attempts > 0 {
            let attempt = request.clone().into();
            let attempt_length = length.unwrap_or_else(|| length_of(&attempt, caller));
            let error = match self.run_as(attempt_length, caller, attempt, token).await {
                Ok(reply) => return reply_of::<R>(reply),
                Err(error) => error,
            };
            let Err(error) = self.wait_until_proven(error, token).await else {
                continue;
            };
            match error {
                JobError::TakesLong => length = Some(caller.length_if_long()),
                error => self.prepare_retry(request.volume(), error, &mut retries, token).await?,
            }
            attempts -= 1;
        }
        Err(WorkError::Busy)
    }

    /// As [`DeviceWorker::perform`], for a slice of work on a whole volume ([`DeviceWorker::run_slice`]). `retries`: those of all slices of
    /// the work.
    ///
    /// # Errors
    /// [`WorkError`].
    pub(super) async fn perform_slice<R: VolumeRequest>(
        &self,
        caller: Caller,
        request: R,
        retries: &mut Retries,
    ) -> Result<R::Reply, WorkError> {
        let never_cancelled = CancellationToken::new();
        loop {
            match self.run_slice(caller, request.clone()).await {
                Ok(reply) => return Ok(reply),
                Err(error) => {
                    self.prepare_retry(request.volume(), error, retries, &never_cancelled)
                        .await?
                }
            }
        }
    }

    /// Makes histograms that a job needs.
    fn make_histograms<'a>(
        &'a self,
        volume: &'a VolumeStep,
        keys: Vec<HistogramKey>,
        token: &'a CancellationToken,
    ) -> Pin<Box<dyn Future<Output = Result<(), WorkError>> + Send + 'a>> {
        // Boxed because the future is recursive: making a histogram runs jobs with retries.
        Box::pin(async move {
            let make = async {
                for key in keys {
                    self.histogram_of(volume, &key).await?;
                }
                Ok(())
            };
            tokio::select! {
                outcome = make => outcome,
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
