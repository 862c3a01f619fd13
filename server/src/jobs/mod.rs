//! Batch jobs: many surfaces of one volume, made one after another. The results are stored until a user deletes the job. Jobs survive
//! restarts and crashes of the server.
//!
//! - `state`: jobs as clients see them; `error`: why a request fails.
//! - `state_folder`: the folder that stores jobs, used by one server at a time.
//! - `store`: the state of jobs, in SQLite; `results`: the files of jobs, in an object store.
//! - `estimate`: estimates the cost of a job before the job is accepted.
//! - `runner`: runs the jobs; `maker`: makes a single file on the device.

mod error;
mod estimate;
#[cfg(all(test, target_os = "linux"))]
mod faults;
mod maker;
mod results;
mod runner;
mod state;
mod state_folder;
mod store;
#[cfg(test)]
mod testing;

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use data_encoding::HEXLOWER;
use isopeel_view::View;
use isopeel_volumes::{Dataset, InputIdentity, Reader, SeenFiles, SharedCatalog, VolumeStep};
use sha2::{Digest, Sha256};
use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;

pub use error::{JobError, StoreError};
pub(crate) use maker::{MakeFailure, failure};
pub use results::{ReadResultError, ResultBytes};
pub use state::{
    Cause, Estimate, ExtractionState, Failure, JobEvent, JobInfo, JobRequest, JobState, ManifestEntry, Progress,
    file_name,
};
pub use state_folder::{StateFolder, StateFolderError};
pub use store::requests::ResultInfo;

/// Owner of jobs on the command line, which has no server.
pub use crate::access::OPERATOR;
use crate::export::{FileRequest, OtherVolumes};
use crate::service::DevicePool;
use estimate::{EstimateError, estimate};
use maker::DeviceMaker;
use results::Results;
use runner::{Backoff, Runner, Signals};
use store::Store;
use store::requests::{NewJob, RequestKey};

/// Maximum extractions of a job: 2 MB of requests, 10 MB in the store.
pub const MAX_EXTRACTIONS: usize = 10_000;
/// Maximum bytes of a request: 10,000 extractions of some 800 bytes.
pub const MAX_REQUEST_BYTES: usize = 8 << 20;
/// Maximum unfinished jobs of an owner. One job runs at a time, so more would wait for days.
pub const MAX_UNFINISHED_JOBS: u64 = 100;
/// Maximum jobs of an owner. `GET jobs` lists them all, in some 500 bytes each.
pub const MAX_JOBS: u64 = 1_000;
/// Maximum attempts of an extraction. An attempt counts before it starts, so that an extraction that crashes the process is not retried
/// forever.
pub const MAX_ATTEMPTS: u32 = 3;
/// Maximum jobs that are estimated at the same time. An estimate keeps the device busy, and pinning the input reads all of its files.
const CONCURRENT_SUBMITS: usize = 1;

/// Random bytes in the id of a job. 128 bits, so that no user can guess the id of another user's job.
const ID_BYTES: usize = 16;

/// Why the jobs of a state folder cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The folder cannot be used.
    #[error(transparent)]
    Folder(#[from] StateFolderError),
    /// The store cannot be opened.
    #[error("state folder {}", folder.display())]
    Store {
        /// Path of the state folder.
        folder: PathBuf,
        /// Error of the store.
        source: StoreError,
    },
    /// The results cannot be opened.
    #[error("state folder {}: results", folder.display())]
    Results {
        /// Path of the state folder.
        folder: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
}

/// Limits of one owner.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Maximum bytes of all results, including the estimated results of unfinished jobs.
    pub quota_bytes: u64,
}

/// The batch jobs of a server. Clones are cheap.
#[derive(Clone)]
pub struct Jobs(Arc<Shared>);

struct Shared {
    /// The lock on the folder.
    _folder: StateFolder,
    store: Store,
    results: Results,
    catalog: SharedCatalog,
    devices: DevicePool,
    /// Cache of file hashes, so that a submitted job need not hash files that have not changed.
    seen: SeenFiles,
    limits: Limits,
    submits: Semaphore,
    signals: Arc<Signals>,
    stop: CancellationToken,
}

impl Jobs {
    /// Opens the jobs of a folder, and removes incomplete files of earlier processes. Jobs run only while [`Jobs::run`] runs, until `stop`
    /// is cancelled.
    ///
    /// # Errors
    /// [`OpenError`].
    pub async fn open(
        folder: StateFolder,
        limits: Limits,
        catalog: SharedCatalog,
        devices: DevicePool,
        stop: CancellationToken,
    ) -> Result<Self, OpenError> {
        let path = folder.path().to_owned();
        let of_store = |source| OpenError::Store {
            folder: path.clone(),
            source,
        };
        let of_results = |source| OpenError::Results {
            folder: path.clone(),
            source,
        };
        let file = path.join("jobs.sqlite");
        let opened = run_blocking(move || Store::open(&file)).await;
        let store = opened.and_then(|opened| opened).map_err(of_store)?;
        let recorded = store.results().await.map_err(of_store)?;
        let (folder_of_results, volumes) = (path.join("results"), catalog.now());
        let opened = run_blocking(move || {
            let results = Results::open(&folder_of_results)?;
            results.sweep(&recorded)?;
            let seen = SeenFiles::default();
            volumes.datasets().iter().for_each(|dataset| seen.note(dataset));
            Ok((results, seen))
        });
        let (results, seen) = opened.await.map_err(of_store)?.map_err(of_results)?;
        Ok(Self(Arc::new(Shared {
            _folder: folder,
            store,
            results,
            catalog,
            devices,
            seen,
            limits,
            submits: Semaphore::new(CONCURRENT_SUBMITS),
            signals: Arc::default(),
            stop,
        })))
    }

    /// Runs submitted jobs until `stop` is cancelled, then returns soon.
    pub async fn run(self) {
        let shared = &self.0;
        // Waits until a device is open, because an attempt that fails before would count.
        tokio::select! {
            _ = shared.devices.ready() => {}
            () = shared.stop.cancelled() => return,
        }
        let runner = Runner {
            store: shared.store.clone(),
            results: shared.results.clone(),
            maker: DeviceMaker::new(shared.catalog.clone(), shared.devices.clone()),
            signals: Arc::clone(&shared.signals),
            stop: shared.stop.clone(),
            quota_bytes: shared.limits.quota_bytes,
            backoff: Backoff::default(),
        };
        runner.run().await;
    }

    /// Accepts a job. Returns the job, and whether the job is new. If the same request with the same key was accepted before, returns the
    /// earlier job.
    ///
    /// # Errors
    /// The request is invalid, or exceeds a limit.
    pub async fn submit(
        &self,
        who: Reader<'_>,
        key: Option<String>,
        request: JobRequest,
    ) -> Result<(JobInfo, bool), JobError> {
        let shared = &self.0;
        let request_key = request_key(who.user(), key, &request)?;
        if let Some(earlier) = shared.store.repeated(request_key.clone()).await? {
            return Ok((self.with_pause(earlier), false));
        }
        let volume = request.volume.clone();
        let dataset = shared.catalog.find(&volume, who);
        let dataset = &dataset.ok_or_else(|| JobError::UnknownVolume(volume.clone()))?;
        let extractions = views(request, dataset)?;
        let _permit = shared.submits.try_acquire().map_err(|_| JobError::Busy)?;
        // If the client disconnects, this future is dropped, and the guard cancels the estimate.
        let token = CancellationToken::new();
        let _cancel = token.clone().drop_guard();
        let estimated = estimate(&shared.devices, dataset, &extractions, &token).await;
        let estimate = estimated.map_err(|error| match error {
            EstimateError::Work(error) => JobError::Work(error),
            EstimateError::Step(source) => JobError::Step { extraction: 0, source },
        })?;
        let job = NewJob {
            id: new_id(),
            request: request_key,
            volume,
            input: self.pin(dataset, &extractions).await?,
            extractions: extractions
                .iter()
                .map(|(request, _)| json(request))
                .collect::<Result<_, _>>()?,
            estimate,
        };
        let (submitted, is_new) = shared.store.submit(job, shared.limits).await?;
        shared.signals.wake.notify_one();
        Ok((self.with_pause(submitted), is_new))
    }

    /// Returns the identity of the files that the job reads, as JSON.
    async fn pin(&self, dataset: &Arc<Dataset>, extractions: &[(FileRequest, View)]) -> Result<String, JobError> {
        let steps: BTreeSet<u32> = extractions.iter().flat_map(|(request, _)| request.steps()).collect();
        let (jobs, dataset) = (self.clone(), Arc::clone(dataset));
        let pinned = run_blocking(move || InputIdentity::of(&dataset, &steps, &jobs.0.seen));
        json(&pinned.await??)
    }

    /// Returns all jobs of an owner, the latest first.
    ///
    /// # Errors
    /// [`JobError::Store`].
    pub async fn list(&self, owner: &str) -> Result<Vec<JobInfo>, JobError> {
        let jobs = self.0.store.list(owner).await?;
        Ok(jobs.into_iter().map(|job| self.with_pause(job)).collect())
    }

    /// Returns the number of jobs of all owners in each state.
    ///
    /// # Errors
    /// [`JobError::Store`].
    pub async fn counts(&self) -> Result<Vec<(JobState, u64)>, JobError> {
        self.0.store.counts().await
    }

    /// Returns a job with its failed extractions.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn get(&self, owner: &str, id: &str) -> Result<JobInfo, JobError> {
        Ok(self.with_pause(self.0.store.get(owner, id).await?))
    }

    /// Cancels a queued or running job. Results that are complete stay.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::Finished`].
    pub async fn cancel(&self, owner: &str, id: &str) -> Result<JobInfo, JobError> {
        let cancelled = self.0.store.cancel(owner, id).await?;
        self.0.signals.cancel(id).await;
        self.0.signals.changes.send_replace(());
        Ok(cancelled)
    }

    /// Removes a finished job and its results.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::NotFinished`].
    pub async fn delete(&self, owner: &str, id: &str) -> Result<(), JobError> {
        self.0.store.delete(owner, id).await?;
        let (results, job) = (self.0.results.clone(), id.to_owned());
        // An error is ignored, because the next start of the server removes files without a job.
        let _ = run_blocking(move || results.remove_job(&job)).await;
        self.0.signals.changes.send_replace(());
        Ok(())
    }

    /// Returns the next events of a job after the event with id `after`, at most one page, and whether the job is finished.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn events(&self, owner: &str, id: &str, after: i64) -> Result<(Vec<JobEvent>, bool), JobError> {
        self.0.store.events(owner, id, after).await
    }

    /// Returns an event if the job has been paused or resumed since the last notification of the client. `notified` is the reason of the
    /// pause in that notification, or `None` for no pause. Returns `None` if nothing has changed, or if the job is finished.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn pause(&self, owner: &str, id: &str, notified: Option<&str>) -> Result<Option<JobEvent>, JobError> {
        if self.0.signals.paused() == notified {
            return Ok(None);
        }
        let job = self.get(owner, id).await?;
        let is_new = !job.state.is_finished() && job.paused.as_deref() != notified;
        Ok(is_new.then_some(JobEvent {
            id: None,
            state: job.state,
            extractions: job.extractions,
            extraction: None,
            paused: job.paused,
        }))
    }

    /// Returns a receiver that is notified of every change of a job.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.0.signals.changes.subscribe()
    }

    /// Resolves when `stop` is cancelled, so that no more jobs run.
    pub async fn stopped(&self) {
        self.0.stop.cancelled().await;
    }

    /// Returns all extractions of a job, in the order of the request.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn manifest(&self, owner: &str, id: &str) -> Result<Vec<ManifestEntry>, JobError> {
        self.0.store.manifest(owner, id).await
    }

    /// Returns the result of an extraction.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::NoResult`].
    pub async fn result(&self, owner: &str, id: &str, extraction: u32) -> Result<ResultInfo, JobError> {
        self.0.store.result(owner, id, extraction).await
    }

    /// Reads a range of bytes of a result. [`Jobs::result`] must have returned this result before.
    ///
    /// # Errors
    /// [`JobError::Result`].
    pub async fn read(&self, id: &str, extraction: u32, range: Range<u64>) -> Result<ResultBytes, JobError> {
        Ok(self.0.results.read((id, extraction), range).await?)
    }

    /// Returns the path of the file of a result, if the file exists.
    pub fn result_path(&self, id: &str, extraction: u32) -> Option<PathBuf> {
        self.0.results.path((id, extraction))
    }

    /// Adds the reason of the current pause to an unfinished job.
    fn with_pause(&self, job: JobInfo) -> JobInfo {
        let paused = self.0.signals.paused().filter(|_| !job.state.is_finished());
        JobInfo {
            paused: paused.map(str::to_owned),
            ..job
        }
    }
}

/// Runs blocking disk work on the blocking pool of tokio, so that it does not block the tasks of the server.
async fn run_blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    let joined = tokio::task::spawn_blocking(work).await;
    joined.map_err(|_| StoreError::Panicked)
}

/// Maximum bytes of an idempotency key.
const MAX_KEY_BYTES: usize = 255;

fn request_key(owner: &str, key: Option<String>, request: &JobRequest) -> Result<RequestKey, JobError> {
    if let Some(key) = &key
        && !((1..=MAX_KEY_BYTES).contains(&key.len()) && key.bytes().all(|byte| byte.is_ascii_graphic()))
    {
        return Err(JobError::BadKey(key.len()));
    }
    Ok(RequestKey {
        owner: owner.to_owned(),
        key,
        digest: Sha256::digest(json(request)?).into(),
    })
}

/// Checks all extractions, and returns each with the view of its first surface.
fn views(request: JobRequest, dataset: &Arc<Dataset>) -> Result<Vec<(FileRequest, View)>, JobError> {
    let count = request.extractions.len();
    if !(1..=MAX_EXTRACTIONS).contains(&count) {
        return Err(JobError::Extractions(count));
    }
    let view = |(extraction, request): (usize, FileRequest)| {
        let volume = VolumeStep::new(Arc::clone(dataset), request.step);
        let volume = volume.map_err(|source| JobError::Step { extraction, source })?;
        let surfaces = request.surfaces(&volume, &OtherVolumes::new());
        let mut surfaces = surfaces.map_err(|source| JobError::Edit { extraction, source })?;
        Ok((request, surfaces.remove(0).view))
    };
    request.extractions.into_iter().enumerate().map(view).collect()
}

fn json(value: &impl serde::Serialize) -> Result<String, JobError> {
    serde_json::to_string(value).map_err(|error| StoreError::Malformed(error.to_string()).into())
}

fn new_id() -> String {
    let mut bytes = [0; ID_BYTES];
    if let Err(error) = getrandom::fill(&mut bytes) {
        // Falls back to the time, so that ids still differ.
        tracing::warn!(%error, "no random numbers for the id of a job");
        bytes = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos())
            .to_be_bytes();
    }
    HEXLOWER.encode(&bytes)
}
