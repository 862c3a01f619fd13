//! Batch jobs: many surfaces of one volume, made one after the other and kept until a user deletes the job. Jobs survive the end of the
//! server process, including crashes.
//!
//! - `state`: jobs as clients see them; `error`: why a request fails.
//! - `state_folder`: the folder in which they are kept, used by one server at a time.
//! - `store`: their state, in SQLite. `results`: their files, in an object store.
//! - `estimate`: what a job costs, before it is accepted.
//! - `runner`: makes them; `maker`: on the device.

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

/// Owner of jobs that are made without a server.
pub use crate::access::OPERATOR;
use crate::export::{FileRequest, OtherVolumes};
use crate::service::DeviceWorker;
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
/// Maximum jobs of an owner that are not finished. One runs at a time: more would wait for days.
pub const MAX_UNFINISHED_JOBS: u64 = 100;
/// Maximum jobs of an owner in all: what `GET jobs` lists, some 500 bytes each.
pub const MAX_JOBS: u64 = 1_000;
/// Maximum attempts of an extraction. They are counted before they start, so that one which ends the process is not retried for ever.
pub const MAX_ATTEMPTS: u32 = 3;
/// Maximum jobs that are estimated at a time: each counts surfaces on the device and reads the files that it pins.
const CONCURRENT_SUBMITS: usize = 1;

/// Random bytes of a job's id: enough that a user cannot guess the id of another user's job.
const ID_BYTES: usize = 16;

/// Why jobs cannot be kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The folder cannot be used.
    #[error(transparent)]
    Folder(#[from] StateFolderError),
    /// The store cannot be opened.
    #[error("state folder {}", folder.display())]
    Store {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        source: StoreError,
    },
    /// The results cannot be opened.
    #[error("state folder {}: results", folder.display())]
    Results {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
}

/// Limits of one owner.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of all results, those that are estimated included.
    pub quota_bytes: u64,
}

/// The batch jobs of a server. Clones are cheap.
#[derive(Clone)]
pub struct Jobs(Arc<Shared>);

struct Shared {
    /// Keeps the folder locked while anything here is in use.
    _folder: StateFolder,
    store: Store,
    results: Results,
    catalog: SharedCatalog,
    worker: DeviceWorker,
    seen: SeenFiles,
    limits: Limits,
    submits: Semaphore,
    signals: Arc<Signals>,
    stop: CancellationToken,
}

impl Jobs {
    /// Opens the jobs of a folder, and removes files that an earlier process has left unfinished. Jobs are made while [`Jobs::run`] runs,
    /// until `stop` is cancelled.
    ///
    /// # Errors
    /// [`OpenError`].
    pub async fn open(
        folder: StateFolder,
        limits: Limits,
        catalog: SharedCatalog,
        worker: DeviceWorker,
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
        let opened = aside(move || Store::open(&file)).await;
        let store = opened.and_then(|opened| opened).map_err(of_store)?;
        let kept = store.results().await.map_err(of_store)?;
        let (folder_of_results, volumes) = (path.join("results"), catalog.now());
        let opened = aside(move || {
            let results = Results::open(&folder_of_results)?;
            results.sweep(&kept)?;
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
            worker,
            seen,
            limits,
            submits: Semaphore::new(CONCURRENT_SUBMITS),
            signals: Arc::default(),
            stop,
        })))
    }

    /// Makes submitted jobs until `stop` is cancelled, then returns within moments.
    pub async fn run(self) {
        let shared = &self.0;
        // Waits for the device, so that no attempt is spent while it is being opened.
        tokio::select! {
            _ = shared.worker.ready() => {}
            () = shared.stop.cancelled() => return,
        }
        let runner = Runner {
            store: shared.store.clone(),
            results: shared.results.clone(),
            maker: DeviceMaker::new(shared.catalog.clone(), shared.worker.clone()),
            signals: Arc::clone(&shared.signals),
            stop: shared.stop.clone(),
            quota_bytes: shared.limits.quota_bytes,
            backoff: Backoff::default(),
        };
        runner.run().await;
    }

    /// Accepts a job, and returns it with `true`. If the same request with this key was accepted before, returns that job with `false`.
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
        if let Some(made) = shared.store.repeated(request_key.clone()).await? {
            return Ok((self.shown(made), false));
        }
        let volume = request.volume.clone();
        let dataset = shared.catalog.find(&volume, who);
        let dataset = &dataset.ok_or_else(|| JobError::UnknownVolume(volume.clone()))?;
        let extractions = views(request, dataset)?;
        let _permit = shared.submits.try_acquire().map_err(|_| JobError::Busy)?;
        // Dropped with this future when the client disconnects, which cancels the work.
        let token = CancellationToken::new();
        let _cancel = token.clone().drop_guard();
        let estimated = estimate(&shared.worker, dataset, &extractions, &token).await;
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
        let (made, is_new) = shared.store.submit(job, shared.limits).await?;
        shared.signals.wake.notify_one();
        Ok((self.shown(made), is_new))
    }

    /// Returns the identity of the files that the job reads, as JSON.
    async fn pin(&self, dataset: &Arc<Dataset>, extractions: &[(FileRequest, View)]) -> Result<String, JobError> {
        let steps: BTreeSet<u32> = extractions.iter().flat_map(|(request, _)| request.steps()).collect();
        let (jobs, dataset) = (self.clone(), Arc::clone(dataset));
        let pinned = aside(move || InputIdentity::of(&dataset, &steps, &jobs.0.seen));
        json(&pinned.await??)
    }

    /// Returns all jobs of an owner, the latest first.
    ///
    /// # Errors
    /// The store's.
    pub async fn list(&self, owner: &str) -> Result<Vec<JobInfo>, JobError> {
        let jobs = self.0.store.list(owner).await?;
        Ok(jobs.into_iter().map(|job| self.shown(job)).collect())
    }

    /// Returns the number of jobs of all owners in each state.
    ///
    /// # Errors
    /// The store's.
    pub async fn counts(&self) -> Result<Vec<(JobState, u64)>, JobError> {
        self.0.store.counts().await
    }

    /// Returns a job with its failed extractions.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn get(&self, owner: &str, id: &str) -> Result<JobInfo, JobError> {
        Ok(self.shown(self.0.store.get(owner, id).await?))
    }

    /// Ends a job that is queued or running. Its results stay.
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
        // If this fails, the next start of the server removes the results.
        let _ = aside(move || results.remove_job(&job)).await;
        self.0.signals.changes.send_replace(());
        Ok(())
    }

    /// Returns some of the events of a job after the event `after`, and whether the job is finished.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn events(&self, owner: &str, id: &str, after: i64) -> Result<(Vec<JobEvent>, bool), JobError> {
        self.0.store.events(owner, id, after).await
    }

    /// Returns an event if the job has been paused or resumed since its client was last told. `told` is the reason of the pause that the
    /// client knows. `None` if nothing has changed, or the job is finished.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn pause(&self, owner: &str, id: &str, told: Option<&str>) -> Result<Option<JobEvent>, JobError> {
        if self.0.signals.paused() == told {
            return Ok(None);
        }
        let job = self.get(owner, id).await?;
        let is_new = !job.state.is_finished() && job.paused.as_deref() != told;
        Ok(is_new.then_some(JobEvent {
            id: None,
            state: job.state,
            extractions: job.extractions,
            extraction: None,
            paused: job.paused,
        }))
    }

    /// Returns a receiver that is notified whenever something has happened to a job.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.0.signals.changes.subscribe()
    }

    /// Resolves when no more jobs are made.
    pub async fn stopped(&self) {
        self.0.stop.cancelled().await;
    }

    /// Returns all extractions of a job, in their order.
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

    /// Reads bytes of a result that [`Jobs::result`] has found.
    ///
    /// # Errors
    /// [`JobError::Result`].
    pub async fn read(&self, id: &str, extraction: u32, range: Range<u64>) -> Result<ResultBytes, JobError> {
        Ok(self.0.results.read((id, extraction), range).await?)
    }

    /// Returns the path of a result's file, if it is there.
    pub fn result_path(&self, id: &str, extraction: u32) -> Option<PathBuf> {
        self.0.results.path((id, extraction))
    }

    /// Adds the reason why the job is paused, if it is.
    fn shown(&self, job: JobInfo) -> JobInfo {
        let paused = self.0.signals.paused().filter(|_| !job.state.is_finished());
        JobInfo {
            paused: paused.map(str::to_owned),
            ..job
        }
    }
}

/// Runs blocking disk work on a thread of the blocking pool, because the threads of the server's tasks are few.
async fn aside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|_| StoreError::Panicked)
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

/// Returns each extraction with the view of its first surface. All of them have been checked.
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
        // Uses the time instead, so that ids still differ.
        tracing::warn!(%error, "no random numbers for the id of a job");
        bytes = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos())
            .to_be_bytes();
    }
    HEXLOWER.encode(&bytes)
}
