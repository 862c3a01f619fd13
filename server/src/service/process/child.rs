//! The process of the device, as its parent sees it.

use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Command, ExitStatus};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use isopeel_extraction::lock;

use super::channel::{Receiver, Sender};
use super::confine::Confinement;
use super::shared_memory::{Beat, End, SharedMemory};
use crate::device::{describe, end_with_parent, not_started, program, was_killed};

/// Why the server has killed the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Killed {
    /// The process has sent no sign of life.
    Silent,
    /// The driver has not executed a command for too long.
    Stuck,
    /// The process has taken too much memory.
    Memory,
    /// The process is replaced: its driver can only be used by a new one, or it has sent something that is no message.
    Replaced,
    /// The server ends.
    Stopping,
}

/// How the process has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Ended {
    /// Text for the log.
    pub how: String,
    /// Label in the metrics.
    pub reason: &'static str,
    /// Whether the running request may be the cause.
    pub is_caused_by_request: bool,
}

impl Ended {
    /// Returns the end of a process that could not be started.
    pub(super) fn not_started(error: &io::Error) -> Self {
        Self {
            how: format!("it cannot be started: {error}"),
            reason: "unknown",
            is_caused_by_request: false,
        }
    }
}

/// A running process.
pub(super) struct Child {
    process: Mutex<std::process::Child>,
    killed: Mutex<Option<Killed>>,
    /// Has the signs of life.
    memory: Arc<SharedMemory>,
}

impl Child {
    /// Starts the process, which confines itself if `confinement` is given. Returns it with both ends of its channel. On Linux the process
    /// is killed when the calling thread ends.
    ///
    /// # Errors
    /// The system has no memory or process left.
    pub(super) fn start(
        arguments: &[String],
        confinement: Option<&Confinement>,
    ) -> io::Result<(Self, Sender, Receiver)> {
        let (memory, file) = SharedMemory::create()?;
        let (socket, inherited) = UnixStream::pair()?;
        let rules = confinement.map(Confinement::to_file).transpose()?;
        let mut files = vec![("--socket", inherited.as_raw_fd()), ("--memory", file.as_raw_fd())];
        files.extend(rules.as_ref().map(|rules| ("--confinement", rules.as_raw_fd())));
        let mut command = Command::new(program()?);
        command
            // The name in lists of processes.
            .arg0("isopeel")
            .arg("worker")
            .args(arguments)
            .args(
                files
                    .iter()
                    .flat_map(|(name, file)| [(*name).to_owned(), file.to_string()]),
            )
            .envs(
                confinement
                    .and_then(Confinement::temporary)
                    .map(|folder| ("TMPDIR", folder)),
            )
            .stdin(std::process::Stdio::null())
            // A separate group does not receive Ctrl-C at the terminal.
            .process_group(0);
        // Keys of stores are for the server, which reads volumes.
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.as_encoded_bytes().starts_with(b"AWS_")) {
            command.env_remove(name);
        }
        // SAFETY: the closure only makes system calls, which is allowed between fork and exec.
        unsafe {
            command.pre_exec(move || {
                for (_, file) in &files {
                    if libc::fcntl(*file, libc::F_SETFD, 0) < 0 {
                        return Err(io::Error::last_os_error());
                    }
                }
                Ok(())
            });
        }
        end_with_parent(&mut command);
        let memory = Arc::new(memory);
        let sender = Sender::new(socket.try_clone()?, Arc::clone(&memory), End::Server);
        let receiver = Receiver::new(socket, Arc::clone(&memory), End::Server);
        let process = command.spawn().map_err(not_started)?;
        drop::<(UnixStream, OwnedFd, Option<OwnedFd>)>((inherited, file, rules));
        let child = Self {
            process: Mutex::new(process),
            killed: Mutex::default(),
            memory,
        };
        Ok((child, sender, receiver))
    }

    /// Returns the process id.
    pub(super) fn id(&self) -> u32 {
        lock(&self.process).id()
    }

    /// Returns the number of signs of life so far, and the last one.
    pub(super) fn beats(&self) -> (u64, Beat) {
        self.memory.beats()
    }

    /// Tells the process how much memory it cannot count.
    pub(super) fn count_further_bytes(&self, bytes: u64) {
        self.memory.further_bytes().store(bytes, Ordering::Relaxed);
    }

    /// Kills the process because the server ends.
    pub(super) fn kill(&self) {
        let _ = self.kill_for(Killed::Stopping);
    }

    /// Kills the process. Returns whether this is the first reason to kill it.
    pub(super) fn kill_for(&self, why: Killed) -> bool {
        let mut killed = lock(&self.killed);
        let is_first = killed.is_none();
        killed.get_or_insert(why);
        drop(killed);
        // An error is ignored: the process has ended.
        let _ = lock(&self.process).kill();
        is_first
    }

    /// Waits for the end of a process that has closed its end of the channel, and returns how it ended.
    pub(super) fn end(&self) -> Ended {
        let killed = *lock(&self.killed);
        let status = wait_or_kill(&mut lock(&self.process));
        let ended = |how: &str, reason, is_caused_by_request| Ended {
            how: how.to_owned(),
            reason,
            is_caused_by_request,
        };
        match (killed, status) {
            (Some(Killed::Stopping), _) => ended("the server ends", "stopped", false),
            (Some(Killed::Replaced), _) => ended("it cannot use the driver any more", "replaced", false),
            (Some(Killed::Silent), _) => ended("it gave no sign of life and was killed", "silent", false),
            (Some(Killed::Stuck), _) => ended("its driver was stuck, and it was killed", "stuck", true),
            (Some(Killed::Memory), _) => ended("it took too much memory and was killed", "memory", true),
            (None, Err(error)) => ended(&error.to_string(), "unknown", false),
            (None, Ok(status)) if was_killed(status) => {
                let how = format!("another process has killed it ({})", describe(status));
                ended(&how, "killed", false)
            }
            (None, Ok(status)) => ended(&describe(status), "crashed", is_fault(status)),
        }
    }
}

/// Whether a process has ended by a fault of its own, not by a signal that others send.
fn is_fault(status: ExitStatus) -> bool {
    let faults = [
        libc::SIGABRT,
        libc::SIGBUS,
        libc::SIGFPE,
        libc::SIGILL,
        libc::SIGSEGV,
        libc::SIGSYS,
        libc::SIGTRAP,
    ];
    status.signal().is_none_or(|signal| faults.contains(&signal))
}

impl Drop for Child {
    fn drop(&mut self) {
        let mut process = lock(&self.process);
        let _ = process.kill();
        let _ = process.wait();
    }
}

/// Waits for a process for a moment, and kills it if it has not ended then.
fn wait_or_kill(process: &mut std::process::Child) -> io::Result<ExitStatus> {
    for _ in 0..100 {
        if let Some(status) = process.try_wait()? {
            return Ok(status);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    process.kill()?;
    process.wait()
}
