//! Handles to the thread that owns the device, and the bounded queue of its jobs.
//!
//! The OpenCL context stays on one named thread; [`DeviceWorker`] is a cheap handle to it. The queue is first in, first out. Most jobs are
//! short: one slice of a histogram, one prefix. A viewer queues a new job for each further prefix, so that viewers take turns and none
//! starves. A long job, such as building a vertex tree, measuring an error or an export, pauses for waiting jobs (`scheduler`).
//!
//! Files are read on tokio's blocking pool, never on the device's thread: a job whose volumes are not resident fails with
//! [`JobError::NotResident`]. Its caller then loads the volumes and queues the job again.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use isopeel_extraction::{
    CheckAnswers, DeviceReply, DeviceRequest, EngineId, FindResident, HistogramCache, JobError, OpenSteps, Request,
    UserTimes, VolumeKey, WorkError, WorkspaceMemory,
};
use isopeel_kernels::{DeviceInfo, Error};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::device_thread::{
    self, DeviceOptions, DeviceState, DeviceThread, Metrics, Parts, Preparation, StateReporter,
};
use super::job::{DeviceJob, LocalRequester, TRACE, length_of};
use super::loading::{FieldWork, Loads, OpeningWatch};
use super::means::Mean;
use super::overview_cache::Overviews;
use super::pins::WaitingPins;
use super::process::{self, Link};
use super::scheduler::{Caller, Length, Permits, job_labels};
use super::unfinished::UnfinishedHistograms;
use crate::device::Proven;
use crate::metrics::DeviceNumber;

/// Maximum number of waiting jobs: some 3 s of work, at 50 ms for a typical prefix. If the queue is full, requests are refused as busy, and
/// viewers wait.
pub const QUEUED_JOBS: usize = 64;

/// Maximum number of viewers' short jobs in the queue. The other half is left for REST.
const VIEWER_JOBS: usize = QUEUED_JOBS / 2;

/// How long the result of a successful probe of the device is reused.
const PROBE_LIFETIME: Duration = Duration::from_secs(1);

/// Interval at which [`DeviceWorker::end_within`] polls whether the thread has ended.
const END_POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Handle to the thread that owns the device. Clones are cheap. Dropping the last one ends the thread, and waits for its
/// end.
#[derive(Clone)]
pub struct DeviceWorker {
    pub(super) shared: Arc<Shared>,
    /// Observes the progress of this handle's jobs while a volume is opened.
    pub(super) watch: Option<Arc<OpeningWatch>>,
    /// The user who is charged for computing fields with this handle.
    pub(super) user: Option<Arc<str>>,
    /// Maximum triangles of a surface.
    pub(super) ceiling: u64,
}

pub(super) struct Shared {
    /// Number of the device among those of the server.
    pub number: DeviceNumber,
    /// Where jobs go; `None` once the last handle is being dropped.
    jobs: Option<Jobs>,
    /// Space in the queue. A job takes some until it begins.
    space: Arc<Semaphore>,
    pub state: watch::Receiver<DeviceState>,
    pub memory: watch::Receiver<WorkspaceMemory>,
    /// Number of the engine, set by the thread.
    engine: Arc<AtomicU64>,
    pub histograms: HistogramCache,
    pub unfinished_histograms: UnfinishedHistograms,
    pub overviews: Overviews,
    /// Permit to queue a slice of work on a whole volume: edits wait for at most one slice, and callers take turns.
    slice_permit: Semaphore,
    /// Time of the last successful probe. Locked during a probe, so that other callers wait for its result.
    last_probe: tokio::sync::Mutex<Option<Instant>>,
    pub loads: Loads,
    /// Time steps that viewers have open. Shared with the thread, which does not evict the fields of these steps for read-ahead.
    pub open_steps: OpenSteps,
    /// Mean time of a job, in seconds.
    job_seconds: Arc<Mean>,
    /// Mean bytes of samples that are loaded in a second.
    pub load_rate: Mean,
    /// Permit to read a time step ahead. There is only one, because each read-ahead occupies a disk, and a processor too if the samples are
    /// compressed.
    pub ahead_permits: Semaphore,
    permits: Permits,
    /// Pinned volumes. Shared with the thread, which evicts other volumes first.
    pub pins: WaitingPins,
    /// Programs that have passed the check so far. Set by the thread if the check is still running when the device is opened.
    proven: Arc<OnceLock<Arc<Proven>>>,
    thread: Option<JoinHandle<()>>,
}

/// Where jobs go.
enum Jobs {
    /// To the device's thread in this process.
    Thread(mpsc::Sender<DeviceJob>),
    /// To the process that has the device.
    Process(Link),
}

impl Jobs {
    /// Sends a job. Returns false if the device is not used any more.
    fn send(&self, job: DeviceJob) -> bool {
        match self {
            // There is space: the job has its permit.
            Self::Thread(thread) => thread.try_send(job).is_ok(),
            Self::Process(link) => link.send(job),
        }
    }
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
        let (jobs, receiver) = mpsc::channel(QUEUED_JOBS);
        Self::start_device(options.number, |parts| {
            let Parts {
                number,
                state,
                memory,
                engine,
                histograms,
                pins,
                open_steps,
                proven,
            } = parts;
            let thread = DeviceThread {
                types: options.types,
                retries_opening: options.retries_opening,
                surface_bytes: options.surface_bytes,
                request_time: options.request_time,
                user_times: UserTimes::new(options.user_time),
                report: state,
                report_memory: Box::new(move |used| _ = memory.send_replace(used)),
                engine,
                histograms,
                pins,
                open_steps,
                proven,
                observer: Arc::new(Metrics(number)),
                activity: Arc::default(),
            };
            let thread = device_thread::spawn(move || thread.run(options.choose, receiver))?;
            Ok((Jobs::Thread(jobs), thread))
        })
    }

    /// Starts the device of a server: in this process, or in a process of its own.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn start_for_server(options: DeviceOptions, in_process: bool) -> std::io::Result<Self> {
        if in_process {
            Self::start_with(options)
        } else {
            Self::start_process(options)
        }
    }

    /// As [`DeviceWorker::start_with`], but the device is opened and used by a process of its own, so that a driver that crashes, hangs or
    /// takes all memory ends that process alone. The process is then replaced. Call this within a runtime of tokio.
    ///
    /// # Errors
    /// The thread that starts the process cannot be started.
    fn start_process(options: DeviceOptions) -> std::io::Result<Self> {
        Self::start_device(options.number, |parts| {
            let (link, thread) = process::start(options, parts)?;
            Ok((Jobs::Process(link), thread))
        })
    }

    /// Creates a worker. `start` starts the thread that serves the jobs.
    fn start_device(
        number: DeviceNumber,
        start: impl FnOnce(Parts) -> std::io::Result<(Jobs, JoinHandle<()>)>,
    ) -> std::io::Result<Self> {
        let (state, state_receiver) = watch::channel(DeviceState::Opening(Preparation::default()));
        let (memory, memory_receiver) = watch::channel(WorkspaceMemory::default());
        let pins = WaitingPins::default();
        let parts = Parts {
            number,
            state: StateReporter::new(state),
            memory,
            engine: Arc::default(),
            histograms: HistogramCache::default(),
            pins: pins.pins.clone(),
            open_steps: OpenSteps::default(),
            proven: Arc::default(),
        };
        let (engine, proven) = (Arc::clone(&parts.engine), Arc::clone(&parts.proven));
        let (histograms, open_steps) = (parts.histograms.clone(), parts.open_steps.clone());
        let (jobs, thread) = start(parts)?;
        Ok(Self {
            shared: Arc::new(Shared {
                number,
                jobs: Some(jobs),
                space: Arc::new(Semaphore::new(QUEUED_JOBS)),
                state: state_receiver,
                memory: memory_receiver,
                engine,
                histograms,
                unfinished_histograms: UnfinishedHistograms::default(),
                overviews: Overviews::default(),
                slice_permit: Semaphore::new(1),
                last_probe: tokio::sync::Mutex::default(),
                loads: Loads::new(),
                open_steps,
                job_seconds: Arc::default(),
                load_rate: Mean::default(),
                ahead_permits: Semaphore::new(1),
                permits: Permits::new(VIEWER_JOBS),
                pins,
                proven,
                thread: Some(thread),
            }),
            watch: None,
            user: None,
            ceiling: u64::MAX,
        })
    }

    /// Returns a handle that charges the device time of computed fields to this user; `None`: to no user.
    #[must_use]
    pub fn charged_to(&self, user: Option<&str>) -> Self {
        Self {
            user: user.map(Arc::from),
            ..self.clone()
        }
    }

    /// Returns a handle that refuses surfaces of more triangles; `u64::MAX`: no limit.
    #[must_use]
    pub fn with_ceiling(&self, triangles: u64) -> Self {
        Self {
            ceiling: triangles,
            ..self.clone()
        }
    }

    /// Ends the thread. Returns false if other handles still exist, or if ending takes longer than `limit`: the thread then runs until the
    /// process ends.
    pub fn end_within(self, limit: Duration) -> bool {
        Self::end_all_within(vec![self], limit)
    }

    /// As [`DeviceWorker::end_within`], for several devices at once.
    pub(super) fn end_all_within(workers: Vec<Self>, limit: Duration) -> bool {
        let count = workers.len();
        let only = workers.into_iter().filter_map(|worker| Arc::into_inner(worker.shared));
        let mut ending: Vec<_> = only.collect();
        let mut all_end = ending.len() == count;
        for shared in &mut ending {
            shared.jobs = None;
        }
        let start = Instant::now();
        for shared in &mut ending {
            while shared.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
                if start.elapsed() > limit {
                    // Detaches the thread: otherwise dropping `shared` would wait for it.
                    drop(shared.thread.take());
                    all_end = false;
                    break;
                }
                std::thread::sleep(END_POLL_INTERVAL);
            }
        }
        all_end
    }

    /// Returns the id of the process of the device; `None` if it has none now, or never.
    pub fn process(&self) -> Option<u32> {
        match self.shared.jobs.as_ref()? {
            Jobs::Thread(_) => None,
            Jobs::Process(link) => link.process(),
        }
    }

    /// Returns the number of the device among those of the server.
    pub fn number(&self) -> DeviceNumber {
        self.shared.number
    }

    /// Returns the expected time until a job that is queued now begins.
    pub(super) fn wait(&self) -> Duration {
        let job_seconds = self.shared.job_seconds.get().unwrap_or(0.0);
        Duration::try_from_secs_f64(self.queued() as f64 * job_seconds).unwrap_or(Duration::MAX)
    }

    /// Returns the id of the engine that jobs run on now.
    pub fn engine(&self) -> EngineId {
        EngineId::of_number(self.shared.engine.load(Ordering::Relaxed))
    }

    /// Runs a probe job, and returns whether the device answers within the limit. If the device does not, the driver is stuck or the queued
    /// jobs take longer. The result of a successful probe is reused for a second.
    pub async fn answers_within(&self, limit: Duration) -> bool {
        let probe = async {
            let mut last = self.shared.last_probe.lock().await;
            if last.is_some_and(|last| last.elapsed() < PROBE_LIFETIME) {
                return true;
            }
            let never_cancelled = CancellationToken::new();
            // A probe that fails counts as an answer: such errors are visible in the device's state.
            let answers = self
                .run(Caller::Viewer, CheckAnswers, &never_cancelled)
                .await
                .unwrap_or(true);
            *last = answers.then(Instant::now);
            answers
        };
        tokio::time::timeout(limit, probe).await.unwrap_or(false)
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
        let settled = state.wait_for(|state| !matches!(state, DeviceState::Opening(_))).await;
        match settled.map(|state| state.clone()) {
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

    /// Returns a handle for opening a volume, and a watch of its progress: the work to describe the volume and to resolve the view.
    ///
    /// # Errors
    /// [`WorkError`], but never `Cancelled`.
    pub async fn with_watch(&self, volume: &VolumeStep, view: &View) -> Result<(Self, Arc<OpeningWatch>), WorkError> {
        let keys: Vec<_> = volume
            .dataset()
            .fields
            .iter()
            .map(|field| VolumeKey::new(volume, &field.name, false))
            .collect();
        let never_cancelled = CancellationToken::new();
        let resident = self.run(Caller::Viewer, FindResident { keys }, &never_cancelled);
        let fields = volume.dataset().fields.iter().zip(resident.await?);
        let histograms = &self.shared.histograms;
        let field_work = fields
            .map(|(field, is_resident)| FieldWork::new(volume, view, field, is_resident, histograms))
            .collect();
        let watch = Arc::new(OpeningWatch::new(field_work));
        let worker = Self {
            watch: Some(Arc::clone(&watch)),
            ..self.clone()
        };
        Ok((worker, watch))
    }

    /// Queues a request and waits for its reply. A cancelled job stays in the queue until the thread takes it, and its caller waits for
    /// that too, so a caller never has two jobs in the queue. The exception is a job of [`Length::Rest`]: its caller returns as soon as the
    /// job is cancelled, because an export may run to its end while the job pauses. There is at most one such job.
    pub(super) async fn run<R: Request>(
        &self,
        caller: Caller,
        request: R,
        token: &CancellationToken,
    ) -> Result<R::Reply, JobError> {
        let request = request.into();
        let length = length_of(&request, caller);
        let reply = self.run_as(length, caller, request, token).await?;
        Ok(reply_of::<R>(reply)?)
    }

    /// As [`DeviceWorker::run`], but queues the job with this length.
    pub(super) async fn run_as(
        &self,
        length: Length,
        caller: Caller,
        request: DeviceRequest,
        token: &CancellationToken,
    ) -> Result<DeviceReply, JobError> {
        if matches!(self.state(), DeviceState::Lost | DeviceState::NeedsNewProcess) {
            return Err(WorkError::Reopening.into());
        }
        let permit = tokio::select! {
            permit = self.shared.permits.wait(caller, length) => permit,
            () = token.cancelled() => return Err(WorkError::Cancelled.into()),
        };
        let space = self.space(caller).await?;
        let (requester, outcome) = LocalRequester::new(
            job_labels(self.shared.number, caller, length),
            space,
            Arc::clone(&self.shared.job_seconds),
        );
        let token = token.child_token();
        // Cancels the job if its caller is gone.
        let _guard = (caller != Caller::Cache).then(|| token.clone().drop_guard());
        let job = DeviceJob {
            request,
            length,
            token: token.clone(),
            requester: Box::new(requester),
            permit,
            span: tracing::Span::current(),
            trace: TRACE.try_with(Clone::clone).ok(),
        };
        if !self.shared.jobs.as_ref().is_some_and(|jobs| jobs.send(job)) {
            return Err(self.stop_error().into());
        }
        tokio::select! {
            outcome = outcome => outcome.unwrap_or_else(|_| Err(self.stop_error().into())),
            () = token.cancelled(), if length == Length::Rest => Err(WorkError::Cancelled.into()),
        }
    }

    /// Runs a request that needs no resident field. The request is not retried, and runs to its end even if its caller is gone.
    pub(super) async fn run_for_cache<R: Request>(&self, request: R) -> Result<R::Reply, WorkError> {
        Ok(self.run(Caller::Cache, request, &CancellationToken::new()).await?)
    }

    /// Returns space for a job in the queue. If the queue is full, refuses the job of a request. Other callers wait.
    async fn space(&self, caller: Caller) -> Result<OwnedSemaphorePermit, WorkError> {
        let space = Arc::clone(&self.shared.space);
        match caller {
            Caller::Request => space.try_acquire_owned().map_err(|_| WorkError::Busy),
            // The semaphore is never closed.
            Caller::Viewer | Caller::Cache => space.acquire_owned().await.map_err(|_| WorkError::Stopped),
        }
    }

    /// Returns the number of jobs that wait in the queue.
    pub fn queued(&self) -> usize {
        QUEUED_JOBS - self.shared.space.available_permits()
    }

    /// Runs a slice of work on a whole volume. Callers take turns: only one slice is queued at a time.
    pub(super) async fn run_slice<R: Request + Clone>(&self, caller: Caller, request: R) -> Result<R::Reply, JobError> {
        let never_cancelled = CancellationToken::new();
        loop {
            let permit = self.shared.slice_permit.acquire().await;
            let outcome = self.run(caller, request.clone(), &never_cancelled).await;
            drop(permit);
            match outcome {
                Err(error) => self.wait_until_proven(error, &never_cancelled).await?,
                outcome => return outcome,
            }
        }
    }

    /// If a job failed because a program that it needs is still being checked, waits for that check. Other jobs use the device meanwhile.
    ///
    /// # Errors
    /// The failure, if it has another cause.
    pub(super) async fn wait_until_proven(&self, error: JobError, token: &CancellationToken) -> Result<(), JobError> {
        let JobError::Failed(WorkError::Device(Error::ProgramUnchecked(program))) = &error else {
            return Err(error);
        };
        let Some(proven) = self.shared.proven.get() else {
            return Err(error);
        };
        tracing::debug!(program, "a job waits for the check of a program");
        tokio::select! {
            () = proven.settled(program) => Ok(()),
            () = token.cancelled() => Err(WorkError::Cancelled.into()),
        }
    }

    /// Returns the error of a job that the thread has dropped, or does not accept.
    fn stop_error(&self) -> WorkError {
        match self.state() {
            DeviceState::Failed(error) => WorkError::NoDevice(error),
            DeviceState::Lost | DeviceState::NeedsNewProcess => WorkError::Reopening,
            DeviceState::Opening(_) | DeviceState::Ready(_) => WorkError::Stopped,
        }
    }
}

/// Returns the reply to a request of this type.
///
/// # Errors
/// The reply is that of another type, which is a fault of this program.
pub(super) fn reply_of<R: Request>(reply: DeviceReply) -> Result<R::Reply, WorkError> {
    R::take_reply(reply).ok_or_else(|| {
        tracing::error!(request = std::any::type_name::<R>(), "the reply is of another request");
        WorkError::Stopped
    })
}
