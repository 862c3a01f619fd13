//! The thread that starts the process of the device, receives its messages, and replaces it when it has ended.

use std::io;
use std::sync::atomic::Ordering;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use isopeel_extraction::{CountedProcess, DeviceReply, JobError, OpenError, WorkError, host_memory_limit, lock};
use tokio::runtime::Handle;

use super::channel::Receiver;
use super::child::{Child, Ended, Killed};
use super::confine::{self, Confinement};
use super::link::{Command, Connection, Link, Open, Sending, Shared};
use super::meshes;
use super::messages::{Event, FromDevice, JobId, Start, ToDevice};
use super::monitor;
use crate::metrics::{self, DeviceNumber};
use crate::service::device_thread::{self, Choice, DeviceOptions, DeviceState, Parts, Preparation};

/// Numbers of engines and cuts that a process may use.
const NUMBERS_A_PROCESS: u64 = 1 << 32;

/// Numbers of engines and cuts that all processes of a device may use. Caches of the server have these numbers as keys.
const NUMBERS_A_DEVICE: u64 = 1 << 48;

/// Time before the second attempt to start a process again; doubled for each further one.
const FIRST_DELAY: Duration = Duration::from_millis(250);

/// Maximum time before an attempt to start a process.
const MAX_DELAY: Duration = Duration::from_secs(10);

/// Number of failed attempts after which jobs are no longer kept waiting.
const WAITING_ATTEMPTS: u32 = 5;

/// Starts the threads that start the process and that send to it. Returns the queue of its jobs.
///
/// # Errors
/// A thread cannot be started.
pub(in crate::service) fn start(options: DeviceOptions, parts: Parts) -> io::Result<(Link, JoinHandle<()>)> {
    let (commands, received) = mpsc::channel();
    let (shared, runtime) = (Arc::new(Shared::default()), Handle::current());
    let sending = Sending {
        commands: received,
        forward: commands.clone(),
        shared: Arc::clone(&shared),
        pins: parts.pins.clone(),
        open_steps: parts.open_steps.clone(),
        runtime: runtime.clone(),
    };
    std::thread::Builder::new()
        .name("isopeel-send".into())
        .spawn(move || sending.run())?;
    let (watched, memory) = (Arc::clone(&shared), parts.memory.subscribe());
    std::thread::Builder::new()
        .name("isopeel-monitor".into())
        .spawn(move || monitor::run(&watched, &memory))?;
    let supervisor = Supervisor {
        parts,
        shared: Arc::clone(&shared),
        commands: commands.clone(),
        runtime,
    };
    let thread = device_thread::spawn(move || supervisor.run(options))?;
    Ok((Link::new(commands, shared), thread))
}

struct Supervisor {
    parts: Parts,
    shared: Arc<Shared>,
    commands: mpsc::Sender<Command>,
    runtime: Handle,
}

/// Why a process is not usable any more.
enum Outcome {
    /// The process has ended.
    Ended(Ended),
    /// The device cannot be used.
    Failed(String),
}

impl Outcome {
    /// Returns why the device could not be opened.
    fn why(self) -> String {
        match self {
            Self::Ended(ended) => format!("the process that opens the device has ended: {}", ended.how),
            Self::Failed(why) => why,
        }
    }
}

/// What a process has done.
#[derive(Clone, Copy, Default)]
struct Done {
    /// It has opened the device.
    was_ready: bool,
    /// It has completed a job.
    has_worked: bool,
}

/// Why no more messages are received from a process.
enum Silence {
    /// The process has ended, or is about to.
    Gone,
    /// Another process has to open the device.
    NeedsNewProcess,
    /// The device cannot be used.
    Failed(String),
}

impl Supervisor {
    /// Chooses the device, and runs processes until the server ends or the device cannot be used.
    fn run(self, options: DeviceOptions) {
        self.serve(options);
        self.shared.connect(Connection::Ended);
        // Jobs that were sent meanwhile: their callers read the reason from the device's state.
        lock(&self.shared.table).end_all();
    }

    fn serve(&self, mut options: DeviceOptions) {
        let choose = std::mem::replace(&mut options.choose, Box::new(|_| Ok(Choice::default())));
        let Some(choice) = self.parts.state.choose(choose) else {
            return;
        };
        self.follow_check(&choice);
        let mut last_number = self.parts.number.index() as u64 * NUMBERS_A_DEVICE;
        let (mut failures, mut has_been_ready, mut has_retried) = (0, false, false);
        let mut is_confined = confine::landlock_version() > 0;
        if !is_confined {
            tracing::info!(
                "the process of the device is not confined: the kernel has no Landlock, or a filter of system calls denies it"
            );
        }
        while !self.shared.is_stopping() {
            let start = start_message(&choice, &options, has_been_ready, last_number);
            let confinement = is_confined.then(|| Confinement::hiding(&options.hidden));
            let (outcome, done) = self.run_process(start, &options.arguments, confinement.as_ref());
            if self.shared.is_stopping() {
                return;
            }
            // Before it is ready, the server knows none of its numbers.
            if done.was_ready {
                last_number += NUMBERS_A_PROCESS;
            }
            has_been_ready |= done.was_ready;
            failures = if done.has_worked { 0 } else { failures + 1 };
            match outcome {
                Outcome::Ended(ended) if has_been_ready => {
                    let device = self.parts.number.index();
                    tracing::error!(
                        device,
                        "the process of the device has ended, and is replaced: {}",
                        ended.how
                    );
                    metrics::device_process_ended(self.parts.number, ended.reason);
                    self.wait_after(failures);
                }
                Outcome::Ended(ended) if is_confined && !ended.is_caused_by_request && !has_retried => {
                    tracing::warn!("the device is opened once more: {}", ended.how);
                    has_retried = true;
                }
                outcome if is_confined && !has_been_ready => {
                    tracing::warn!(
                        "the device is tried once more by a process that is not confined, which can read all files of this user: {}",
                        outcome.why()
                    );
                    is_confined = false;
                }
                outcome => return self.fail(outcome.why()),
            }
        }
    }

    fn report(&self, state: DeviceState) {
        self.parts.state.set_unless_refused(state);
    }

    fn fail(&self, why: String) {
        self.parts
            .state
            .set(DeviceState::Failed(Arc::new(OpenError::Refused(why))));
    }

    /// Waits before the next process is started. After the first failure there is no delay.
    fn wait_after(&self, failures: u32) {
        let Some(doublings) = failures.checked_sub(2) else {
            return;
        };
        if failures > WAITING_ATTEMPTS {
            self.report(DeviceState::Lost);
            self.shared.connect(Connection::Failing);
        }
        let delay = FIRST_DELAY.saturating_mul(1 << doublings.min(10)).min(MAX_DELAY);
        let begun = Instant::now();
        while begun.elapsed() < delay && !self.shared.is_stopping() {
            std::thread::sleep(FIRST_DELAY / 5);
        }
        self.shared.connect(Connection::Starting);
    }

    /// Starts a process, and receives its messages until it ends.
    fn run_process(&self, start: Start, arguments: &[String], confinement: Option<&Confinement>) -> (Outcome, Done) {
        let (child, mut sender, mut receiver) = match Child::start(arguments, confinement) {
            Ok(started) => started,
            Err(error) => return (Outcome::Ended(Ended::not_started(&error)), Done::default()),
        };
        let child = Arc::new(child);
        *lock(&self.shared.child) = Some(Arc::clone(&child));
        let counted = CountedProcess::new(child.id());
        if self.shared.is_stopping() {
            child.kill();
        }
        // If this fails, the process has ended, which the receiver finds.
        let _ = sender.send(&ToDevice::Start(start));
        self.shared.connect(Connection::Open(Open::new(sender)));
        // The check may have gone on since the first message was made.
        if let Some(proven) = self.parts.proven.get() {
            let _ = self.commands.send(Command::Checked(proven.state()));
        }
        let (silence, done) = self.receive(&child, &mut receiver);
        // Comes before the jobs end, so that their callers wait for the next process.
        self.report(DeviceState::Opening(Preparation::default()));
        self.shared.connect(Connection::Starting);
        *lock(&self.shared.child) = None;
        drop(counted);
        match silence {
            Silence::Gone if self.shared.is_stopping() => {}
            Silence::Gone => metrics::device_lost(self.parts.number),
            Silence::NeedsNewProcess | Silence::Failed(_) => _ = child.kill_for(Killed::Replaced),
        }
        let ended = child.end();
        let mut table = lock(&self.shared.table);
        // Comes before the jobs end, so that none of them is tried again although it is refused now.
        if let Some(request) = table.running().filter(|_| ended.is_caused_by_request) {
            lock(&self.shared.blame).add(request);
        }
        table.end_all();
        drop(table);
        match silence {
            Silence::Failed(why) => (Outcome::Failed(why), done),
            Silence::Gone | Silence::NeedsNewProcess => (Outcome::Ended(ended), done),
        }
    }

    /// Receives messages until the process ends, or until it must be replaced.
    fn receive(&self, child: &Child, receiver: &mut Receiver) -> (Silence, Done) {
        let mut done = Done::default();
        loop {
            let (message, arrays) = match receiver.receive_with::<FromDevice>() {
                Ok(received) => received,
                Err(error) => {
                    if error.kind() == io::ErrorKind::InvalidData {
                        tracing::error!(%error, "the process of the device has sent something that is no message");
                        child.kill_for(Killed::Replaced);
                    }
                    return (Silence::Gone, done);
                }
            };
            match message {
                FromDevice::NeedsNewProcess => return (Silence::NeedsNewProcess, done),
                FromDevice::Failed(why) => return (Silence::Failed(why), done),
                FromDevice::Ready { device, engine } => {
                    done.was_ready = true;
                    self.parts.engine.store(engine, Ordering::Relaxed);
                    self.report(DeviceState::Ready(device));
                }
                FromDevice::Opening { done, of } => {
                    self.report(DeviceState::Opening(Preparation { done, of }));
                }
                FromDevice::Lost => self.report(DeviceState::Lost),
                FromDevice::Begun(id) => lock(&self.shared.table).begin(id),
                FromDevice::Ended {
                    id,
                    mut outcome,
                    regions,
                } => {
                    done.has_worked |= outcome.is_ok();
                    match meshes::join(regions, &arrays) {
                        Ok(regions) => meshes::attach(&mut outcome, regions),
                        Err(why) => {
                            tracing::error!(why, "a reply of the process of the device is wrong");
                            *outcome = Err(WorkError::Stopped.into());
                        }
                    }
                    self.end_job(id, *outcome);
                }
                FromDevice::Dropped(id) => lock(&self.shared.table).remove(id),
                FromDevice::Memory(used) => _ = self.parts.memory.send_replace(used),
                FromDevice::Observed(event) => observe(self.parts.number, event),
            }
        }
    }

    /// Gives the caller of a job its outcome. If the process lacks histograms that the server has, they are sent before the job is tried
    /// again.
    fn end_job(&self, id: JobId, outcome: Result<DeviceReply, JobError>) {
        if let Err(JobError::NeedsHistograms(keys)) = &outcome {
            let histograms = &self.parts.histograms;
            let cached = keys.iter().filter_map(|key| Some((key.clone(), histograms.peek(key)?)));
            // The sending thread has ended if the server ends.
            let _ = self.commands.send(Command::Histograms(cached.collect()));
        }
        lock(&self.shared.table).end(id, outcome);
    }

    /// Forwards the progress of a check that is still running, to processes that run meanwhile.
    fn follow_check(&self, choice: &Choice) {
        let Some(proven) = &choice.proven else { return };
        let proven = self.parts.proven.get_or_init(|| Arc::clone(proven));
        let (commands, followed) = (self.commands.clone(), Arc::clone(proven));
        self.runtime.spawn(async move {
            let mut last = followed.state();
            while last.ended.is_none() {
                last = followed.after(&last).await;
                if commands.send(Command::Checked(last.clone())).is_err() {
                    return;
                }
            }
        });
    }
}

/// Returns the first message to a process. `is_later`: a process before it has opened the device. `last_number`: numbers of engines and cuts
/// begin after it.
fn start_message(choice: &Choice, options: &DeviceOptions, is_later: bool, last_number: u64) -> Start {
    Start {
        selector: choice.selector.clone(),
        tuning: choice.tuning,
        is_trusted: choice.is_trusted,
        proven: choice.proven.as_ref().map(|proven| proven.state()),
        // A later process need not make first surfaces: their kernels are compiled.
        types: if is_later { Vec::new() } else { options.types.clone() },
        retries_opening: options.retries_opening || is_later,
        surface_bytes: options.surface_bytes,
        request_time: options.request_time,
        user_time: options.user_time,
        host_bytes: host_memory_limit(),
        last_number,
        server: std::process::id(),
    }
}

/// Forwards an event of the workspace to the metrics.
fn observe(device: DeviceNumber, event: Event) {
    match event {
        Event::LookedUp { cache, is_hit } => metrics::looked_up(device, cache, is_hit),
        Event::Stage { stage, milliseconds } => metrics::stage(device, stage, milliseconds),
        Event::DeviceLost => metrics::device_lost(device),
    }
}
