//! The process of the device: receives jobs, runs them on the device's thread, and sends their outcomes.

use std::collections::HashMap;
use std::os::fd::{FromRawFd, OwnedFd, RawFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc as sync_mpsc;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use isopeel_extraction::{
    CountedProcess, DeviceReply, HistogramCache, JobError, Observer, OpenSteps, Pins, UserTimes, count_further_bytes,
    limit_host_memory, lock, number_from,
};
use isopeel_kernels::Region;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::channel::{Receiver, SendError, Sender};
use super::meshes;
use super::messages::{Event, FromDevice, JobId, Start, ToDevice};
use super::shared_memory::{Beat, End, SharedMemory};
use crate::device::Proven;
use crate::error::{BoxError, chain};
use crate::pool;
use crate::service::device_thread::{self, Choice, DeviceState, DeviceThread, SharedActivity, StateReporter};
use crate::service::job::{DeviceJob, Requester};
use crate::service::worker::QUEUED_JOBS;

/// Interval of signs of life.
pub(super) const BEAT_INTERVAL: Duration = Duration::from_millis(200);

/// Score by which Linux chooses the process that ends when memory runs out: the device's process ends before the server.
const OUT_OF_MEMORY_SCORE: &str = "500";

/// Runs the process of a device until the server ends or closes the channel. `socket` and `memory`: open files that the process has
/// inherited.
///
/// # Errors
/// The files are not those of a server, or a thread cannot be started.
pub fn run(socket: RawFd, memory: RawFd) -> Result<(), BoxError> {
    // SAFETY: the server has opened these files for this process, which uses them nowhere else.
    let (socket, memory) = unsafe { (UnixStream::from_raw_fd(socket), OwnedFd::from_raw_fd(memory)) };
    rustix::io::fcntl_setfd(&socket, rustix::io::FdFlags::CLOEXEC)?;
    let memory = {
        let mapped = SharedMemory::map(&memory)?;
        drop(memory);
        Arc::new(mapped)
    };
    end_with_server_alone();
    write_no_core();
    let mut receiver = Receiver::new(socket.try_clone()?, Arc::clone(&memory), End::Device);
    let ToDevice::Start(start) = receiver.receive()? else {
        return Err("the server did not begin with its options".into());
    };
    // An error is ignored: another process may end first then.
    let _ = std::fs::write("/proc/self/oom_score_adj", OUT_OF_MEMORY_SCORE);
    start.host_bytes.into_iter().for_each(limit_host_memory);
    let _server = CountedProcess::new(start.server);
    number_from(start.last_number);
    pool::start_background()?;
    let outbox = Outbox::start(Sender::new(socket, Arc::clone(&memory), End::Device))?;
    let device = Device::start(start, &outbox, memory)?;
    device.serve(&mut receiver);
    // The server is gone, or wants this process to end. A driver that compiles or hangs must not delay that.
    // No handler of the driver may run either.
    // SAFETY: the call does not return.
    unsafe { libc::_exit(0) }
}

/// Ignores signals by which a service manager or a terminal ends all processes of a service: the server decides when this one ends.
fn end_with_server_alone() {
    for signal in [libc::SIGTERM, libc::SIGINT, libc::SIGHUP] {
        // SAFETY: the call only sets how the process handles a signal.
        unsafe { libc::signal(signal, libc::SIG_IGN) };
    }
}

/// Prevents that the system writes the memory of this process to a file or to another program if it crashes: that takes seconds, in which
/// the server would take the process for a silent one, and the memory has the samples of users' volumes.
fn write_no_core() {
    // Of 1 byte, because a limit of 0 does not hold for a core that goes to a program. An error is ignored: cores only take time.
    let _ = rlimit::Resource::CORE.set(1, 1);
}

/// Messages that a thread sends to the server, in order. Clones share it.
#[derive(Clone)]
struct Outbox(sync_mpsc::Sender<(FromDevice, Vec<Region>)>);

impl Outbox {
    /// Starts the thread.
    fn start(mut sender: Sender) -> std::io::Result<Self> {
        let (outbox, messages) = sync_mpsc::channel::<(FromDevice, Vec<Region>)>();
        let send = move || {
            for (message, regions) in messages {
                match sender.send_with(&message, &meshes::arrays(&regions)) {
                    Ok(()) => {}
                    Err(error @ SendError::Message(_)) => send_failure(&mut sender, message, &error),
                    // The receiving thread ends the process.
                    Err(SendError::Gone(_)) => return,
                }
            }
        };
        std::thread::Builder::new().name("isopeel-send".into()).spawn(send)?;
        Ok(Self(outbox))
    }

    fn send(&self, message: FromDevice) {
        // The thread has ended if the server is gone.
        let _ = self.0.send((message, Vec::new()));
    }

    /// Sends the outcome of a job.
    fn send_outcome(&self, id: JobId, mut outcome: Result<DeviceReply, JobError>) {
        let regions = meshes::detach(&mut outcome);
        let message = FromDevice::Ended {
            id,
            outcome: Box::new(outcome),
            regions: meshes::heads(&regions),
        };
        let _ = self.0.send((message, regions));
    }
}

/// Sends an error in place of an outcome that is too large for shared memory.
fn send_failure(sender: &mut Sender, message: FromDevice, error: &SendError) {
    tracing::error!(error = chain(error), "a message cannot be sent to the server");
    if let FromDevice::Ended { id, .. } = message {
        let outcome = Box::new(Err(error.of_job(sender.slot_bytes()).into()));
        // If this fails too, the server is gone.
        let _ = sender.send(&FromDevice::Ended {
            id,
            outcome,
            regions: Vec::new(),
        });
    }
}

/// The server, which has sent a job.
struct RemoteRequester {
    id: JobId,
    outbox: Outbox,
    tokens: Tokens,
    /// Whether the outcome was sent.
    has_ended: bool,
}

/// Cancellation of the jobs that have not ended.
type Tokens = Arc<Mutex<HashMap<JobId, CancellationToken>>>;

impl Requester for RemoteRequester {
    fn begun(&self) {
        self.outbox.send(FromDevice::Begun(self.id));
    }

    fn ended(mut self: Box<Self>, outcome: Result<DeviceReply, JobError>) {
        self.has_ended = true;
        self.outbox.send_outcome(self.id, outcome);
    }
}

impl Drop for RemoteRequester {
    fn drop(&mut self) {
        lock(&self.tokens).remove(&self.id);
        if !self.has_ended {
            self.outbox.send(FromDevice::Dropped(self.id));
        }
    }
}

/// Sends the events of the workspace.
struct Forwarding(Outbox);

impl Observer for Forwarding {
    fn looked_up(&self, cache: &'static str, is_hit: bool) {
        self.0.send(FromDevice::Observed(Event::LookedUp { cache, is_hit }));
    }

    fn stage(&self, stage: &'static str, milliseconds: f64) {
        self.0.send(FromDevice::Observed(Event::Stage { stage, milliseconds }));
    }

    fn device_lost(&self) {
        self.0.send(FromDevice::Observed(Event::DeviceLost));
    }
}

/// The device's thread, and the state that it shares with the thread that receives messages.
struct Device {
    jobs: mpsc::Sender<DeviceJob>,
    tokens: Tokens,
    outbox: Outbox,
    pins: Pins,
    open_steps: OpenSteps,
    histograms: HistogramCache,
    proven: Option<Arc<Proven>>,
}

impl Device {
    /// Starts the device's thread, and a thread that sends signs of life.
    fn start(start: Start, outbox: &Outbox, memory: Arc<SharedMemory>) -> std::io::Result<Self> {
        // The server limits the number of jobs; those that are deferred have left this queue.
        let (jobs, receiver) = mpsc::channel(2 * QUEUED_JOBS);
        let proven = start.proven.map(|checked| {
            let proven = Arc::new(Proven::default());
            proven.set(checked);
            proven
        });
        let (activity, engine) = (SharedActivity::default(), Arc::new(AtomicU64::default()));
        let device = Self {
            jobs,
            tokens: Tokens::default(),
            outbox: outbox.clone(),
            pins: Pins::default(),
            open_steps: OpenSteps::default(),
            histograms: HistogramCache::default(),
            proven: proven.clone(),
        };
        let (used_memory, state) = (outbox.clone(), outbox.clone());
        let number = Arc::clone(&engine);
        let thread = DeviceThread {
            types: start.types,
            retries_opening: start.retries_opening,
            surface_bytes: start.surface_bytes,
            request_time: start.request_time,
            user_times: UserTimes::new(start.user_time),
            report: StateReporter::forwarding(move |new| state.send(message_of(new, number.load(Ordering::Relaxed)))),
            report_memory: Box::new(move |used| used_memory.send(FromDevice::Memory(used))),
            engine,
            histograms: device.histograms.clone(),
            pins: device.pins.clone(),
            open_steps: device.open_steps.clone(),
            observer: Arc::new(Forwarding(outbox.clone())),
            activity: Arc::clone(&activity),
            proven: Arc::new(OnceLock::new()),
        };
        let choice = Choice {
            selector: start.selector,
            tuning: start.tuning,
            is_trusted: start.is_trusted,
            proven,
        };
        device_thread::spawn(move || thread.run(Box::new(|_| Ok(choice)), receiver))?;
        let beat = move || {
            loop {
                memory.beat(beat_of(&activity));
                count_further_bytes(memory.further_bytes().load(Ordering::Relaxed));
                std::thread::sleep(BEAT_INTERVAL);
            }
        };
        std::thread::Builder::new().name("isopeel-beat".into()).spawn(beat)?;
        Ok(device)
    }

    /// Receives messages until the server is gone.
    fn serve(&self, receiver: &mut Receiver) {
        loop {
            match receiver.receive() {
                Ok(message) => self.handle(message),
                Err(error) if error.kind() == std::io::ErrorKind::InvalidData => {
                    return tracing::error!(%error, "the server has sent something that is no message");
                }
                Err(_) => return,
            }
        }
    }

    fn handle(&self, message: ToDevice) {
        match message {
            // The process starts once.
            ToDevice::Start(_) => {}
            ToDevice::Job {
                id,
                length,
                trace,
                request,
            } => {
                let token = CancellationToken::new();
                lock(&self.tokens).insert(id, token.clone());
                let requester = RemoteRequester {
                    id,
                    outbox: self.outbox.clone(),
                    tokens: Arc::clone(&self.tokens),
                    has_ended: false,
                };
                let job = DeviceJob {
                    request,
                    length,
                    token,
                    requester: Box::new(requester),
                    permit: None,
                    span: match trace {
                        Some(trace) => tracing::info_span!("edit", trace),
                        None => tracing::Span::none(),
                    },
                    trace: None,
                };
                // A job that is refused is dropped, which sends a message.
                let _ = self.jobs.try_send(job);
            }
            ToDevice::Cancel(id) => {
                if let Some(token) = lock(&self.tokens).get(&id) {
                    token.cancel();
                }
            }
            ToDevice::Checked(checked) => self.proven.iter().for_each(|proven| proven.set(checked.clone())),
            ToDevice::Pinned(keys) => self.pins.replace(keys),
            ToDevice::Open(steps) => self.open_steps.replace(steps),
            ToDevice::Histograms(histograms) => histograms
                .into_iter()
                .for_each(|(key, histogram)| self.histograms.insert(key, histogram)),
        }
    }
}

fn message_of(state: &DeviceState, engine: u64) -> FromDevice {
    match state {
        DeviceState::Opening(preparation) => FromDevice::Opening {
            done: preparation.done,
            of: preparation.of,
        },
        DeviceState::Ready(device) => FromDevice::Ready {
            device: device.clone(),
            engine,
        },
        DeviceState::Lost => FromDevice::Lost,
        DeviceState::NeedsNewProcess => FromDevice::NeedsNewProcess,
        DeviceState::Failed(error) => FromDevice::Failed(chain(&**error)),
    }
}

fn beat_of(activity: &SharedActivity) -> Beat {
    match &*lock(activity) {
        Some(activity) => Beat {
            commands: Some(activity.commands()),
            may_compile: activity.may_compile(),
        },
        None => Beat::default(),
    }
}
