//! The bounded queue to the thread that owns the device.
//!
//! The OpenCL context stays on one named thread; [`DeviceWorker`] is a cheap handle to it. The queue is first in, first out, and a job is
//! short (one slice of a histogram, one prefix). A caller queues a new job for each further prefix, so viewers take turns and none starves.
//! A long job, such as building a vertex tree, measuring an error or an export, pauses for waiting jobs (`scheduler`).
//!
//! Files are read on tokio's blocking pool, never on the device's thread: a job whose volumes are not resident fails with
//! [`JobError::NotResident`]. Its caller then loads the volumes and queues the job again.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use isopeel_extraction::{
    EngineId, HistogramCache, JobContext, JobError, Payer, UserTimes, VolumeKey, WorkError, Workspace, WorkspaceMemory,
};
use isopeel_kernels::{DeviceInfo, Error};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio::sync::{Semaphore, mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use super::device_thread::{DeviceOptions, DeviceState, DeviceThread, Preparation};
use super::loading::{FieldWork, Loads, OpeningWatch};
use super::open_steps::AheadState;
use super::overview_cache::Overviews;
use super::pins::WaitingPins;
use super::scheduler::{Caller, Job, Length, PausedQueue, Permits, Queue, Token, job_labels};
use super::unfinished::Unfinished;
use crate::device::Proven;
use crate::metrics;

/// Maximum number of waiting jobs. At the 50 ms of a typical prefix a full queue is 3 s of work; further requests are refused as busy, and
/// viewers wait.
pub const QUEUED_JOBS: usize = 64;

/// Maximum number of viewers' jobs in the queue: the other half is left for REST.
const VIEWERS_JOBS: usize = QUEUED_JOBS / 2;

/// How long the result of a probe is reused.
const ANSWER_AGE: Duration = Duration::from_secs(1);

/// How often the end of the thread is polled.
const END_INTERVAL: Duration = Duration::from_millis(5);

/// Stack of the device's thread. Drivers for CPUs run kernels on it, some of which have 3 MB of private variables with Intel's runtime.
const STACK_BYTES: usize = 16 << 20;

/// Handle to the thread that owns the device. Clones are cheap; the last one ends the thread and waits for it.
#[derive(Clone)]
pub struct DeviceWorker {
    pub(super) shared: Arc<Shared>,
    /// Observes the jobs of this handle.
    pub(super) watch: Option<Arc<OpeningWatch>>,
    /// The user who is charged for computing fields with this handle.
    pub(super) payer: Option<Payer>,
}

pub(super) struct Shared {
    /// `None` once the last handle is being dropped.
    pub jobs: Option<mpsc::Sender<Job<Workspace>>>,
    state: watch::Receiver<DeviceState>,
    pub memory: watch::Receiver<WorkspaceMemory>,
    /// Number of the engine, set by the thread.
    engine: Arc<AtomicU64>,
    pub histograms: HistogramCache,
    pub unfinished: Unfinished,
    pub overviews: Overviews,
    /// Held while a slice of work on a whole volume is queued: edits wait for at most one slice, and callers take turns.
    pub slices: Semaphore,
    /// Time of the last successful probe.
    last_answer: tokio::sync::Mutex<Option<Instant>>,
    user_times: Arc<UserTimes>,
    pub loads: Loads,
    pub ahead: AheadState,
    permits: Permits,
    /// Shared with the thread, which evicts.
    pub pins: WaitingPins,
    /// Shared with the thread: the programs that have passed the device's check so far; set if it is still running when the device is opened.
    proven: Arc<OnceLock<Arc<Proven>>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Shared {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the device thread panicked");
        }
    }
}

impl DeviceWorker {
    /// As [`DeviceWorker::start_with`], for the device that `selector` names and without a check. `selector` is an index or a part of a
    /// name, as `isopeel devices` lists them.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start(selector: Option<String>) -> std::io::Result<Self> {
        Self::start_with(DeviceOptions::unchecked(selector))
    }

    /// Starts the thread and returns at once. The thread chooses and opens the device while jobs wait; [`DeviceWorker::ready`] waits until
    /// it is open.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start_with(options: DeviceOptions) -> std::io::Result<Self> {
        let DeviceOptions {
            choose,
            types,
            retries_opening,
            surface_bytes,
            request_time,
            user_time,
        } = options;
        let (jobs, waiting) = mpsc::channel::<Job<Workspace>>(QUEUED_JOBS);
        let (state, watched) = watch::channel(DeviceState::Opening(Preparation::default()));
        let (memory, watched_memory) = watch::channel(WorkspaceMemory::default());
        let histograms = HistogramCache::default();
        let pins = WaitingPins::default();
        let proven = Arc::new(OnceLock::new());
        let engine = Arc::new(AtomicU64::default());
        let thread = DeviceThread {
            types,
            retries_opening,
            surface_bytes,
            request_time,
            state: Arc::new(state),
            memory,
            engine: Arc::clone(&engine),
            histograms: histograms.clone(),
            pins: pins.pins.clone(),
            proven: Arc::clone(&proven),
        };
        let thread = std::thread::Builder::new()
            .name("isopeel-device".into())
            .stack_size(STACK_BYTES)
            .spawn(move || thread.run(choose, waiting))?;
        Ok(Self {
            shared: Arc::new(Shared {
                jobs: Some(jobs),
                state: watched,
                memory: watched_memory,
                engine,
                histograms,
                unfinished: Unfinished::default(),
                overviews: Overviews::default(),
                slices: Semaphore::new(1),
                last_answer: tokio::sync::Mutex::default(),
                user_times: UserTimes::new(user_time),
                loads: Loads::new(),
                ahead: AheadState::new(),
                permits: Permits::new(VIEWERS_JOBS),
                pins,
                proven,
                thread: Some(thread),
            }),
            watch: None,
            payer: None,
        })
    }

    /// Returns a handle that charges the device time of computed fields to this user. `None`: to no user.
    #[must_use]
    pub fn paid_by(&self, user: Option<&str>) -> Self {
        Self {
            payer: user.map(|user| Payer::new(&self.shared.user_times, user)),
            ..self.clone()
        }
    }

    /// Ends the thread, once all other handles are gone. Returns false if that takes longer than `limit`: the thread then runs until the
    /// process ends.
    pub fn end_within(self, limit: Duration) -> bool {
        let Some(mut shared) = Arc::into_inner(self.shared) else {
            return false;
        };
        shared.jobs = None;
        let start = Instant::now();
        while shared.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            if start.elapsed() > limit {
                // Detaches the thread: otherwise dropping `shared` would wait for it.
                drop(shared.thread.take());
                return false;
            }
            std::thread::sleep(END_INTERVAL);
        }
        true
    }

    /// Returns the id of the engine that jobs run on now.
    pub fn engine(&self) -> EngineId {
        EngineId::of_number(self.shared.engine.load(Ordering::Relaxed))
    }

    /// Runs a probe job and returns whether the device answers within the limit. If it does not, the driver is stuck or the queue takes
    /// longer. A probe that has succeeded counts for a second.
    pub async fn answers_within(&self, limit: Duration) -> bool {
        let ask = async {
            // One probe at a time: other callers wait for its answer.
            let mut last = self.shared.last_answer.lock().await;
            if last.is_some_and(|last| last.elapsed() < ANSWER_AGE) {
                return true;
            }
            let never = CancellationToken::new();
            let asked = self.run(&never, Caller::Viewer, Length::Short, |state, _| {
                Ok(state.engine().answers())
            });
            // A probe that fails counts as an answer: such errors are visible in the device's state.
            let answers = asked.await.unwrap_or(true);
            *last = answers.then(Instant::now);
            answers
        };
        tokio::time::timeout(limit, ask).await.unwrap_or(false)
    }

    /// Returns the current state of the device.
    pub fn state(&self) -> DeviceState {
        self.shared.state.borrow().clone()
    }

    /// Subscribes to the state of the device.
    pub fn states(&self) -> watch::Receiver<DeviceState> {
        self.shared.state.clone()
    }

    /// Waits until the device is open.
    ///
    /// # Errors
    /// [`WorkError::NoDevice`] if it could not be opened, [`WorkError::Reopening`] if it was lost, [`WorkError::Stopped`] if the thread has
    /// ended.
    pub async fn ready(&self) -> Result<DeviceInfo, WorkError> {
        let mut state = self.states();
        let settled = state.wait_for(|s| !matches!(s, DeviceState::Opening(_))).await;
        match settled.map(|s| s.clone()) {
            Ok(DeviceState::Ready(info)) => Ok(info),
            Ok(DeviceState::Failed(error)) => Err(WorkError::NoDevice(error)),
            Ok(DeviceState::Lost | DeviceState::NeedsNewProcess) => Err(WorkError::Reopening),
            Ok(DeviceState::Opening(_)) | Err(_) => Err(WorkError::Stopped),
        }
    }

    /// Resolves when this process can never use the device: with the error if it could not be opened at the start or its thread has ended,
    /// and with `None` if only a new process can use it.
    pub async fn unusable(&self) -> Option<WorkError> {
        let mut state = self.states();
        let is_final = |state: &DeviceState| matches!(state, DeviceState::Failed(_) | DeviceState::NeedsNewProcess);
        match state.wait_for(is_final).await.map(|state| state.clone()) {
            Ok(DeviceState::Failed(error)) => Some(WorkError::NoDevice(error)),
            Ok(_) => None,
            Err(_) => Some(WorkError::Stopped),
        }
    }

    /// Returns a handle for opening a volume, and a watch of its progress. The progress covers describing the volume and resolving the
    /// view.
    ///
    /// # Errors
    /// [`WorkError`], but never `Cancelled`.
    pub async fn watched(&self, volume: &VolumeStep, view: &View) -> Result<(Self, Arc<OpeningWatch>), WorkError> {
        let keys: Vec<_> = volume
            .dataset()
            .fields
            .iter()
            .map(|f| VolumeKey::new(volume, &f.name, false))
            .collect();
        let never = CancellationToken::new();
        let resident = self.run(&never, Caller::Viewer, Length::Short, move |state, _| {
            Ok(keys.iter().map(|key| state.is_resident(key)).collect::<Vec<_>>())
        });
        let fields = volume.dataset().fields.iter().zip(resident.await?);
        let histograms = &self.shared.histograms;
        let work = fields
            .map(|(field, is_resident)| FieldWork::new(volume, view, field, is_resident, histograms))
            .collect();
        let watch = Arc::new(OpeningWatch::new(work));
        let worker = Self {
            watch: Some(Arc::clone(&watch)),
            ..self.clone()
        };
        Ok((worker, watch))
    }

    /// Queues a job and waits for its end. A cancelled job stays in the queue until its turn, and its caller waits for that too, so a
    /// caller never has two jobs in the queue. The exception is a job of [`Length::Rest`]: its caller returns as soon as the job is
    /// cancelled, because an export may run to its end while the job pauses. At most one such job exists.
    pub(super) async fn run<T, F>(
        &self,
        token: &CancellationToken,
        caller: Caller,
        length: Length,
        job: F,
    ) -> Result<T, JobError>
    where
        T: Send + 'static,
        F: FnOnce(&mut Workspace, &mut JobContext<'_, Workspace>) -> Result<T, JobError> + Send + 'static,
    {
        if matches!(self.state(), DeviceState::Lost | DeviceState::NeedsNewProcess) {
            return Err(WorkError::Reopening.into());
        }
        let permit = tokio::select! {
            permit = self.shared.permits.wait(caller, length) => permit,
            () = token.cancelled() => return Err(WorkError::Cancelled.into()),
        };
        let (reply, answer) = oneshot::channel();
        let token = token.child_token();
        let _guard = (caller != Caller::Cache).then(|| token.clone().drop_guard());
        // Log entries of the job on the thread belong to the caller's span.
        let span = tracing::Span::current();
        let (labels, arrived) = (job_labels(caller, length), Instant::now());
        let (asked, ended) = (token.clone(), token.clone());
        let run = Box::new(move |state: &mut Workspace, queue: &mut Queue<Workspace>| {
            let (_permit, _span, begun) = (permit, span.entered(), Instant::now());
            metrics::job_begun(labels, begun - arrived);
            let outcome = if asked.is_cancelled() {
                Err(WorkError::Cancelled.into())
            } else {
                let (cancel, mut waiting) = (Token(&asked), PausedQueue { queue, length });
                let mut context = match length {
                    Length::Short => JobContext::short(&cancel),
                    Length::Long | Length::Field | Length::Export | Length::Rest => {
                        JobContext::long(&cancel, &mut waiting)
                    }
                };
                job(state, &mut context).map_err(|error| state.look_for_loss(error))
            };
            metrics::job_ended(labels, begun.elapsed());
            // Sending fails if the caller is gone, which is no error.
            let _ = reply.send(outcome);
        });
        let work = Job { length, token, run };
        let jobs = self.shared.jobs.as_ref().ok_or(WorkError::Stopped)?;
        let queued = match caller {
            Caller::Request => jobs.try_send(work).map_err(|refused| match refused {
                mpsc::error::TrySendError::Full(_) => WorkError::Busy,
                mpsc::error::TrySendError::Closed(_) => self.why_stopped(),
            }),
            Caller::Viewer | Caller::Cache => jobs.send(work).await.map_err(|_| self.why_stopped()),
        };
        queued?;
        tokio::select! {
            outcome = answer => outcome.unwrap_or_else(|_| Err(self.why_stopped().into())),
            () = ended.cancelled(), if length == Length::Rest => Err(WorkError::Cancelled.into()),
        }
    }

    /// As [`DeviceWorker::run`], but if a program of the job is still being checked, waits for that check and retries. Other jobs use the
    /// device meanwhile.
    pub(super) async fn run_when_proven<T, F>(
        &self,
        token: &CancellationToken,
        caller: Caller,
        length: Length,
        job: F,
    ) -> Result<T, JobError>
    where
        T: Send + 'static,
        F: FnOnce(&mut Workspace, &mut JobContext<'_, Workspace>) -> Result<T, JobError> + Clone + Send + 'static,
    {
        loop {
            let outcome = self.run(token, caller, length, job.clone()).await;
            let Some((program, proven)) = self.unproven(&outcome) else {
                return outcome;
            };
            tracing::debug!(program, "a job waits for the check of a program");
            tokio::select! {
                () = proven.settled(&program) => (),
                () = token.cancelled() => return Err(WorkError::Cancelled.into()),
            }
        }
    }

    /// Runs a slice of work on a whole volume. Callers take turns: only one slice is queued at a time. If a program is still being checked,
    /// gives up the turn, waits for the check and retries.
    pub(super) async fn run_slice<T, F>(&self, caller: Caller, job: F) -> Result<T, JobError>
    where
        T: Send + 'static,
        F: FnOnce(&mut Workspace) -> Result<T, JobError> + Clone + Send + 'static,
    {
        let never = CancellationToken::new();
        loop {
            let turn = self.shared.slices.acquire().await;
            let job = job.clone();
            let outcome = self
                .run(&never, caller, Length::Short, move |state, _| job(state))
                .await;
            drop(turn);
            match self.unproven(&outcome) {
                Some((program, proven)) => proven.settled(&program).await,
                None => return outcome,
            }
        }
    }

    /// If a job failed because a program that it needs is still being checked, returns the program and the state of the check.
    fn unproven<T>(&self, outcome: &Result<T, JobError>) -> Option<(String, Arc<Proven>)> {
        match outcome {
            Err(JobError::Failed(WorkError::Device(Error::NotYet(program)))) => {
                Some((program.clone(), Arc::clone(self.shared.proven.get()?)))
            }
            _ => None,
        }
    }

    fn why_stopped(&self) -> WorkError {
        match self.state() {
            DeviceState::Failed(error) => WorkError::NoDevice(error),
            DeviceState::Lost | DeviceState::NeedsNewProcess => WorkError::Reopening,
            DeviceState::Opening(_) | DeviceState::Ready(_) => WorkError::Stopped,
        }
    }
}
