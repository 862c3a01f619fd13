//! The device's thread: opens the device, runs jobs, and reopens the device after it was lost.
//!
//! A driver reports a lost device only by failing each call, sometimes with "out of resources". So after a failure the thread reads back a
//! byte from the device. If that fails too, the device is lost with all of its data. Later jobs find that their volumes are not resident,
//! and their callers load the volumes again.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;

use isopeel_extraction::{
    HistogramCache, Observer, OpenError, OpenSteps, Options, Pins, UserTimes, Workspace, WorkspaceMemory, lock,
    resident_bytes,
};
use isopeel_kernels::check::{Check, STEPS, Scope};
use isopeel_kernels::{Activity, DeviceInfo, Engine, SampleType, Tuning};
use serde::Serialize;
use tokio::sync::{mpsc, watch};

use super::job::DeviceJob;
use super::scheduler::Queue;
use crate::device::{Proven, cache};
use crate::error::chain;
use crate::metrics::{self, DeviceNumber};
use crate::pool;

/// Time between two attempts to open a lost device. Meanwhile jobs fail at once.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Stack of the device's thread. Drivers for CPUs run kernels on this stack. With Intel's runtime, some kernels have 3 MB of private
/// variables.
const STACK_BYTES: usize = 16 << 20;

/// Forwards the events of a workspace to the metrics of a device.
pub(super) struct Metrics(pub DeviceNumber);

impl Observer for Metrics {
    fn looked_up(&self, cache: &'static str, is_hit: bool) {
        metrics::looked_up(self.0, cache, is_hit);
    }

    fn stage(&self, stage: &'static str, milliseconds: f64) {
        metrics::stage(self.0, stage, milliseconds);
    }

    fn device_lost(&self) {
        metrics::device_lost(self.0);
    }
}

/// Locked while a device is being opened.
static OPENING: Mutex<()> = Mutex::new(());

/// State of the device.
#[derive(Clone, Debug)]
pub enum DeviceState {
    /// The device is being checked and opened, and its programs are being built. Jobs wait.
    Opening(Preparation),
    /// Ready.
    Ready(DeviceInfo),
    /// The device was lost, and attempts to reopen it have failed so far; jobs fail until one succeeds.
    Lost,
    /// Only a new process can use the device; every job fails.
    NeedsNewProcess,
    /// The device must not be used, or could not be opened when the server started; every job fails.
    Failed(Arc<OpenError>),
}

/// Progress of the steps before a device's first surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Preparation {
    /// Number of steps that are done.
    pub done: usize,
    /// Total number of steps; 0 if it is not known.
    pub of: usize,
}

/// The device to open, and how.
#[derive(Default)]
pub struct Choice {
    /// Index of the device or a part of its name, as `isopeel devices` lists them; `None`: the first device.
    pub selector: Option<String>,
    /// How the kernels are built and launched, if not by default.
    pub tuning: Option<Tuning>,
    /// Whether the user trusts the device without a check.
    pub is_trusted: bool,
    /// Programs that have passed the check so far; `None` if the check is complete. Until the check is complete, only these programs and
    /// those of a first surface run.
    pub proven: Option<Arc<Proven>>,
}

/// Why no device can be opened by this process.
#[derive(Debug)]
pub enum ChoiceError {
    /// No device may be used; the text says why, and what to do.
    Refused(String),
    /// This process cannot use the device, but a new one can.
    NewProcess,
}

/// Reports the state of the device: progress before the device is open, and failures of the check, which may continue after the device is
/// open.
#[derive(Clone)]
pub struct StateReporter(Arc<watch::Sender<DeviceState>>, Option<Arc<ForwardState>>);

/// Called with each new state of the device.
type ForwardState = dyn Fn(&DeviceState) + Send + Sync;

impl StateReporter {
    pub(super) fn new(state: watch::Sender<DeviceState>) -> Self {
        Self(Arc::new(state), None)
    }

    /// Returns a reporter that calls `forward` with each new state.
    pub(super) fn forwarding(forward: impl Fn(&DeviceState) + Send + Sync + 'static) -> Self {
        let (state, _) = watch::channel(DeviceState::Opening(Preparation::default()));
        Self(Arc::new(state), Some(Arc::new(forward)))
    }

    /// Reports a state.
    pub(super) fn set(&self, state: DeviceState) {
        self.change(|old| {
            *old = state;
            true
        });
    }

    /// Changes the state. `change` returns whether it has changed it.
    fn change(&self, change: impl FnOnce(&mut DeviceState) -> bool) {
        if self.0.send_if_modified(change)
            && let Some(forward) = &self.1
        {
            forward(&self.0.borrow());
        }
    }

    /// Reports a state, unless a check that is still running has refused the device meanwhile.
    pub(super) fn set_unless_refused(&self, new: DeviceState) {
        self.change(|state| {
            let is_refused = matches!(state, DeviceState::Failed(_) | DeviceState::NeedsNewProcess);
            if !is_refused {
                *state = new;
            }
            !is_refused
        });
    }

    /// Reports progress: `done` of `of` steps. Without effect once the device is open.
    pub fn progress(&self, done: usize, of: usize) {
        self.change(|state| {
            let is_opening = matches!(state, DeviceState::Opening(_));
            if is_opening {
                *state = DeviceState::Opening(Preparation { done, of });
            }
            is_opening
        });
    }

    /// Chooses the device. Returns `None` after reporting why there is none.
    pub(super) fn choose(&self, choose: DeviceChooser) -> Option<Choice> {
        match choose(self) {
            Ok(choice) => Some(choice),
            Err(ChoiceError::Refused(why)) => {
                self.refuse(why);
                None
            }
            Err(ChoiceError::NewProcess) => {
                self.need_new_process();
                None
            }
        }
    }

    /// Reports that this process must not use the device any more: a new process replaces it.
    pub fn need_new_process(&self) {
        self.set(DeviceState::NeedsNewProcess);
    }

    /// Reports that the device must not be used any more. The server ends with the error message `why`.
    pub fn refuse(&self, why: String) {
        self.set(DeviceState::Failed(Arc::new(OpenError::Refused(why))));
    }
}

/// Chooses the device. Called on the device's thread, before the device is first opened.
pub type DeviceChooser = Box<dyn FnOnce(&StateReporter) -> Result<Choice, ChoiceError> + Send>;

/// Options of a device's thread.
pub struct DeviceOptions {
    /// Number of the device among those of the server.
    pub number: DeviceNumber,
    /// Chooses the device.
    pub choose: DeviceChooser,
    /// Sample types of which a first surface is made before the device is ready, so that no viewer waits for a compiler.
    pub types: Vec<SampleType>,
    /// Whether to retry opening the device until it succeeds. For a device that has worked before.
    pub retries_opening: bool,
    /// Maximum bytes of cached data of earlier edits, limited to a third of the device's memory. The default is that third, or
    /// [`isopeel_extraction::PROCESSOR_BYTES`] if the device is this machine's processors.
    pub surface_bytes: Option<u64>,
    /// Maximum device time that a request may take to compute a field.
    pub request_time: Option<Duration>,
    /// Maximum device time that one user's computed fields may take within [`isopeel_extraction::USER_TIME_PERIOD`]; `None`: no limit.
    pub user_time: Option<Duration>,
    /// Arguments of the process of the device, if it has one: how it writes its log.
    pub arguments: Vec<String>,
    /// Files and folders that this process may not use if it is the device's own.
    pub hidden: Vec<PathBuf>,
}

impl DeviceOptions {
    /// Returns options to open the device that `selector` names, without a check.
    pub fn unchecked(selector: Option<String>) -> Self {
        Self {
            number: DeviceNumber::default(),
            choose: Box::new(|_| {
                Ok(Choice {
                    selector,
                    ..Choice::default()
                })
            }),
            types: Vec::new(),
            retries_opening: false,
            surface_bytes: None,
            request_time: None,
            user_time: None,
            arguments: Vec::new(),
            hidden: Vec::new(),
        }
    }
}

/// State that the handles of a device share with the thread that serves their jobs.
pub(super) struct Parts {
    pub number: DeviceNumber,
    pub state: StateReporter,
    pub memory: watch::Sender<WorkspaceMemory>,
    /// Number of the current engine.
    pub engine: Arc<AtomicU64>,
    pub histograms: HistogramCache,
    pub pins: Pins,
    pub open_steps: OpenSteps,
    /// Programs that have passed the check, if it is still running when the device is opened.
    pub proven: Arc<OnceLock<Arc<Proven>>>,
}

/// What the engine that is open does now; `None` while none is open.
pub(super) type SharedActivity = Arc<Mutex<Option<Arc<Activity>>>>;

/// Starts the device's thread.
pub(super) fn spawn(run: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name("isopeel-device".into())
        .stack_size(STACK_BYTES)
        .spawn(run)
}

/// Options and shared state of the device's thread, apart from the choice of the device.
pub(super) struct DeviceThread {
    pub types: Vec<SampleType>,
    pub retries_opening: bool,
    pub surface_bytes: Option<u64>,
    pub request_time: Option<Duration>,
    pub user_times: Arc<UserTimes>,
    pub report: StateReporter,
    /// Called with the memory of the workspace after each job.
    pub report_memory: Box<dyn Fn(WorkspaceMemory) + Send>,
    /// Number of the current engine.
    pub engine: Arc<AtomicU64>,
    pub histograms: HistogramCache,
    pub pins: Pins,
    pub open_steps: OpenSteps,
    pub observer: Arc<dyn Observer + Send + Sync>,
    pub activity: SharedActivity,
    /// Programs that have passed the check, shared with the handles.
    pub proven: Arc<OnceLock<Arc<Proven>>>,
}

impl DeviceThread {
    /// Runs jobs until all senders of the queue are dropped, or the device cannot be opened.
    pub(super) fn run(mut self, choose: DeviceChooser, mut jobs: mpsc::Receiver<DeviceJob>) {
        let Some(choice) = self.report.choose(choose) else {
            return;
        };
        let engine = loop {
            match self.open(&choice) {
                Ok(engine) => break engine,
                Err(OpenError::Device(error)) if self.retries_opening && error.needs_new_process() => {
                    tracing::error!(error = chain(&error), "this process cannot use the driver");
                    self.report.set(DeviceState::NeedsNewProcess);
                    return;
                }
                Err(error) if self.retries_opening && !error.has_wrong_results() && !jobs.is_closed() => {
                    self.report_lost(&error);
                    // Their callers read the reason from the device's state.
                    while jobs.try_recv().is_ok() {}
                }
                Err(error) => {
                    // The state is set before the queue is dropped, so that the callers of waiting jobs find the error there.
                    self.report.set(DeviceState::Failed(Arc::new(error)));
                    return;
                }
            }
            std::thread::sleep(RETRY_INTERVAL);
        };
        let process_bytes = resident_bytes();
        let report = std::mem::replace(&mut self.report_memory, Box::new(|_| ()));
        let report_memory = move |workspace: &Workspace| {
            if let Ok(used) = workspace.memory(process_bytes) {
                report(used);
            }
        };
        let device = engine.device().clone();
        let mut workspace = self.new_workspace(engine, &choice);
        report_memory(&workspace);
        self.report_ready(device);
        Queue::new(jobs, report_memory).run(&mut workspace, |workspace, queue| {
            if workspace.is_lost() {
                self.reopen(&choice, workspace, queue);
            }
        });
    }

    /// Opens the device, and makes a first surface of each type: drivers finish compiling when a kernel is first launched.
    fn open(&self, choice: &Choice) -> Result<Engine, OpenError> {
        // PoCL 3.1 crashes or finds no device if two threads of a process open it at once.
        let _guard = lock(&OPENING);
        let engine = Engine::open_tuned(choice.selector.as_deref(), None, choice.tuning)?;
        for &sample_type in &self.types {
            let mut check = Check::new(&engine, sample_type);
            for step in STEPS.iter().filter(|step| step.scope == Scope::FirstSurface) {
                match check.run(step) {
                    Err(error) if choice.is_trusted => {
                        tracing::warn!(error = chain(&error), "the trusted device is wrong")
                    }
                    outcome => outcome.map_err(|why| OpenError::check(engine.device(), why))?,
                }
            }
        }
        if let Some(proven) = choice.proven.clone() {
            engine.set_gate(Box::new(move |program| proven.has_passed(program)));
        }
        // PoCL ends the process if it cannot write a compiled program to disk. So each build first checks the space there.
        if engine.device().pocl_version().is_some() {
            engine.check_compiler(Box::new(cache::check_space));
        }
        Ok(engine)
    }

    fn report_ready(&self, device: DeviceInfo) {
        tracing::info!(device = device.name, platform = device.platform, "device ready");
        self.report.set_unless_refused(DeviceState::Ready(device));
    }

    /// Reports a failed attempt to open the device again.
    fn report_lost(&self, error: &OpenError) {
        tracing::error!(
            error = chain(error),
            "the device could not be reopened, and will be tried again"
        );
        self.report.set(DeviceState::Lost);
    }

    /// Creates the workspace of a newly opened engine, and publishes the engine's number and the proven programs to the handles.
    fn new_workspace(&self, engine: Engine, choice: &Choice) -> Workspace {
        let workspace = Workspace::new(
            engine,
            Options {
                histograms: self.histograms.clone(),
                pins: self.pins.clone(),
                open_steps: self.open_steps.clone(),
                surface_bytes: self.surface_bytes,
                request_time: self.request_time,
                user_times: Arc::clone(&self.user_times),
                observer: Arc::clone(&self.observer),
                long_work: pool::exports(),
            },
        );
        if let Some(proven) = &choice.proven {
            self.proven.get_or_init(|| Arc::clone(proven));
        }
        self.engine.store(workspace.id().number(), Ordering::Relaxed);
        *lock(&self.activity) = Some(workspace.engine().activity());
        workspace
    }

    /// Reopens a lost device, and replaces the workspace. Retries until the device is open or all handles are dropped. Meanwhile waiting
    /// jobs fail.
    fn reopen(&self, choice: &Choice, workspace: &mut Workspace, queue: &mut Queue<DeviceJob>) {
        self.report.set(DeviceState::Opening(Preparation::default()));
        *lock(&self.activity) = None;
        // Buffers of the lost device may prevent it from being reopened.
        discard(|| workspace.clear());
        loop {
            match self.open(choice) {
                Ok(engine) => {
                    let device = engine.device().clone();
                    let old = std::mem::replace(workspace, self.new_workspace(engine, choice));
                    discard(|| drop(old));
                    self.report_ready(device);
                    return;
                }
                Err(OpenError::Device(error)) if error.needs_new_process() => {
                    tracing::error!(error = chain(&error), "this process can no longer use the driver");
                    self.report.set(DeviceState::NeedsNewProcess);
                }
                Err(error) => self.report_lost(&error),
            }
            if !queue.drop_waiting() {
                return;
            }
            std::thread::sleep(RETRY_INTERVAL);
        }
    }
}

/// Runs `free`, which drops objects of a lost device. A panic of the driver is logged and otherwise ignored, because no caller could act on
/// it.
fn discard(free: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(free)).is_err() {
        tracing::warn!("the driver of the lost device did not free all its objects");
    }
}
