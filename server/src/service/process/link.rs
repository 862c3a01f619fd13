//! The queue of jobs for the process of the device, and the thread that sends them.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use isopeel_extraction::{HistogramKey, OpenSteps, Pins, lock};
use isopeel_kernels::Histogram;
use tokio::runtime::Handle;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::blame::Blame;
use super::channel::{SendError, Sender};
use super::child::Child;
use super::messages::{JobId, ToDevice};
use super::table::{Pending, Table, without_samples};
use crate::device::CheckState;
use crate::service::job::DeviceJob;

/// What is to be sent to the process.
pub(super) enum Command {
    Job(JobId, Box<DeviceJob>),
    Cancel(JobId),
    Checked(CheckState),
    Histograms(Vec<(HistogramKey, Histogram)>),
    /// The link was dropped.
    Stop,
}

/// State that the threads of a link share.
#[derive(Default)]
pub(super) struct Shared {
    pub sender: Mutex<Connection>,
    /// Notified when `sender` changes.
    pub connected: Condvar,
    pub table: Mutex<Table>,
    pub blame: Mutex<Blame>,
    /// The process, unless none is running.
    pub child: Mutex<Option<Arc<Child>>>,
    /// Whether the last handle of the device is gone, so that the process must end.
    pub is_stopping: AtomicBool,
}

/// Whether messages can be sent.
#[derive(Default)]
pub(super) enum Connection {
    /// The process is being started: messages wait.
    #[default]
    Starting,
    /// The process receives messages.
    Open(Open),
    /// The process could not be started so far: jobs are dropped.
    Failing,
    /// No process will be started any more.
    Ended,
}

/// The sending end of a running process, and what the process knows of the state that it shares with the server.
pub(super) struct Open {
    sender: Sender,
    pins: Option<u64>,
    open_steps: Option<u64>,
}

impl Open {
    pub(super) fn new(sender: Sender) -> Self {
        Self {
            sender,
            pins: None,
            open_steps: None,
        }
    }

    /// Sends pins and open time steps that have changed.
    fn update(&mut self, pins: &Pins, open_steps: &OpenSteps) -> Result<(), SendError> {
        if let Some((keys, changes)) = pins.changed_since(self.pins) {
            self.pins = Some(changes);
            self.sender.send(&ToDevice::Pinned(keys))?;
        }
        if let Some((steps, changes)) = open_steps.changed_since(self.open_steps) {
            self.open_steps = Some(changes);
            self.sender.send(&ToDevice::Open(steps))?;
        }
        Ok(())
    }
}

impl Shared {
    /// Changes whether messages can be sent.
    pub(super) fn connect(&self, connection: Connection) {
        *lock(&self.sender) = connection;
        self.connected.notify_all();
    }

    /// Ends the process, because the server ends.
    fn stop(&self) {
        self.is_stopping.store(true, Ordering::Relaxed);
        if let Some(child) = &*lock(&self.child) {
            child.kill();
        }
    }

    pub(super) fn is_stopping(&self) -> bool {
        self.is_stopping.load(Ordering::Relaxed)
    }
}

/// Handle to the process of the device. Dropping it ends the process.
pub(in crate::service) struct Link {
    commands: mpsc::Sender<Command>,
    shared: Arc<Shared>,
    next_id: AtomicU64,
}

impl Link {
    pub(super) fn new(commands: mpsc::Sender<Command>, shared: Arc<Shared>) -> Self {
        Self {
            commands,
            shared,
            next_id: AtomicU64::new(1),
        }
    }

    /// Returns the id of the process; `None` while there is none.
    pub(in crate::service) fn process(&self) -> Option<u32> {
        lock(&self.shared.child).as_ref().map(|child| child.id())
    }

    /// Sends a job. Returns false if no process will run it.
    pub(in crate::service) fn send(&self, job: DeviceJob) -> bool {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        self.commands.send(Command::Job(id, Box::new(job))).is_ok()
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.stop();
        let _ = self.commands.send(Command::Stop);
    }
}

/// The thread that sends.
pub(super) struct Sending {
    pub commands: mpsc::Receiver<Command>,
    /// For forwarding cancellations.
    pub forward: mpsc::Sender<Command>,
    pub shared: Arc<Shared>,
    pub pins: Pins,
    pub open_steps: OpenSteps,
    pub runtime: Handle,
}

impl Sending {
    /// Sends until no process will be started any more, or until the link is dropped.
    pub(super) fn run(self) {
        while let Ok(command) = self.commands.recv() {
            match command {
                Command::Job(id, job) => {
                    if !self.send_job(id, *job) {
                        return;
                    }
                }
                Command::Cancel(id) => {
                    if lock(&self.shared.table).contains(id) {
                        self.send(&ToDevice::Cancel(id));
                    }
                }
                Command::Checked(checked) => self.send(&ToDevice::Checked(checked)),
                Command::Histograms(histograms) => self.send(&ToDevice::Histograms(histograms)),
                Command::Stop => return,
            }
        }
    }

    /// Sends a message, if a process is running. A process that starts later does not need it.
    fn send(&self, message: &ToDevice) {
        if let Connection::Open(open) = &mut *lock(&self.shared.sender) {
            report(open.sender.send(message));
        }
    }

    /// Sends a job, once a process is running. Returns false if none will be.
    fn send_job(&self, id: JobId, job: DeviceJob) -> bool {
        let starting = |connection: &mut Connection| matches!(connection, Connection::Starting);
        let connection = self.shared.connected.wait_while(lock(&self.shared.sender), starting);
        let mut connection = connection.unwrap_or_else(PoisonError::into_inner);
        let open = match &mut *connection {
            Connection::Open(open) => open,
            // The job is dropped: its caller reads the reason from the device's state.
            Connection::Starting | Connection::Failing => return true,
            Connection::Ended => return false,
        };
        if let Err(error) = lock(&self.shared.blame).check(&job.request) {
            job.requester.ended(Err(error.into()));
            return true;
        }
        let forwarding = self.forward_cancellation(id, &job.token);
        let DeviceJob {
            request,
            length,
            requester,
            permit,
            trace,
            ..
        } = job;
        let pending = Pending {
            request: None,
            requester,
            begun: None,
            _permit: permit,
            _forwarding: forwarding,
        };
        // In the table first, because the job may end before `send` returns.
        lock(&self.shared.table).insert(id, pending);
        report(open.update(&self.pins, &self.open_steps));
        let message = ToDevice::Job {
            id,
            length,
            trace,
            request,
        };
        let sent = open.sender.send(&message);
        let mut table = lock(&self.shared.table);
        if let Err(error @ SendError::Message(_)) = &sent {
            table.end(id, Err(error.of_job(open.sender.slot_bytes()).into()));
        }
        report(sent);
        if let ToDevice::Job { request, .. } = message {
            table.set_request(id, without_samples(request));
        }
        true
    }

    /// Forwards the cancellation of a job, until the returned guard is dropped.
    fn forward_cancellation(&self, id: JobId, token: &CancellationToken) -> DropGuard {
        let (token, forward) = (token.clone(), self.forward.clone());
        let ended = CancellationToken::new();
        let guard = ended.clone().drop_guard();
        self.runtime.spawn(async move {
            tokio::select! {
                // The sending thread has ended if the server ends.
                () = token.cancelled() => drop(forward.send(Command::Cancel(id))),
                () = ended.cancelled() => {}
            }
        });
        guard
    }
}

/// Logs that a message could not be sent. If the process is gone, the supervisor replaces it.
fn report(sent: Result<(), SendError>) {
    if let Err(error @ SendError::Message(_)) = sent {
        tracing::error!(%error);
    }
}
