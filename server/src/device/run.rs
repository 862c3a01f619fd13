//! The parent's side of a child process: starts the child, receives its messages, and determines how it ended.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use isopeel_extraction::CountedProcess;

use super::child::{Message, Request};

/// Maximum time between two messages of a child that compiles or checks, unless `ISOPEEL_CHECK_SECONDS` is set. Slow compilers take minutes
/// for a large kernel.
const STEP_LIMIT: Duration = Duration::from_secs(600);

/// Maximum time between two messages of a child that lists devices, unless `ISOPEEL_CHECK_SECONDS` is set. With eight GPUs, the driver may
/// need most of a minute to start.
const LIST_LIMIT: Duration = Duration::from_secs(120);

/// Maximum bytes of a child's standard error that a report quotes.
const QUOTED_BYTES: usize = 600;

/// Environment variables in addition to the parent's own.
pub(super) type Environment = Vec<(String, String)>;

/// Why a child ended without [`Message::Done`].
#[derive(Clone, Debug, thiserror::Error)]
pub enum Ended {
    /// A signal or an exit ended the child before its final message: a fault of the driver.
    #[error("the driver ended the process in stage {stage} ({how}){quoted}")]
    Crashed {
        /// Stage that was running at that time.
        stage: String,
        /// The signal or exit code.
        how: String,
        /// A colon and the end of the child's standard error; empty if the child wrote nothing there.
        quoted: String,
    },
    /// Another process killed the child: the kernel because memory ran out, or a service manager that stops the server.
    #[error("the process was killed in stage {stage} ({how})")]
    Killed {
        /// Stage that was running at that time.
        stage: String,
        /// The signal.
        how: String,
    },
    /// The child sent no message within the time limit.
    #[error("stage {stage} did not end within {seconds} s")]
    Hung {
        /// Stage that was running at that time.
        stage: String,
        /// The time limit.
        seconds: u64,
    },
    /// The child reported a permanent error: a retry would fail too.
    #[error("{0}")]
    PermanentError(String),
    /// The child reported an error of the device that may be temporary: a retry may succeed.
    #[error("{0}")]
    TemporaryError(String),
    /// The child could not be started.
    #[error("the check could not be started: {0}")]
    NotStarted(String),
}

impl Ended {
    /// Whether a retry may succeed.
    pub fn is_temporary(&self) -> bool {
        matches!(
            self,
            Self::Killed { .. } | Self::TemporaryError(_) | Self::NotStarted(_)
        )
    }
}

/// A running child. Dropping it kills the child.
pub(super) struct Running {
    child: Child,
    /// Counts the memory of the child with that of this process.
    _counted: CountedProcess,
    /// Lines of the child's standard output.
    lines: Receiver<String>,
    /// Receives the last bytes of the child's standard error after the child has closed it.
    error_tail: Receiver<String>,
    /// The stage that the child has begun most recently.
    stage: String,
    /// Maximum time between two messages.
    limit: Duration,
}

/// Returns the time limit that `ISOPEEL_CHECK_SECONDS` sets, or else `default`.
fn time_limit(default: Duration) -> Duration {
    let seconds = std::env::var("ISOPEEL_CHECK_SECONDS").ok();
    let seconds = seconds.and_then(|text| text.parse().ok());
    seconds.map_or(default, Duration::from_secs)
}

impl Running {
    /// Starts a child. On Linux the child is killed when the calling thread ends.
    pub fn start(request: &Request, environment: &Environment) -> Result<Self, Ended> {
        let failed = |error: std::io::Error| Ended::NotStarted(error.to_string());
        let text = serde_json::to_string(request).map_err(|error| Ended::NotStarted(error.to_string()))?;
        let mut command = Command::new(program().map_err(failed)?);
        command
            .args(["devices", "--child", &text])
            .envs(environment.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A separate group does not receive Ctrl-C at the terminal. Otherwise the parent would see its end as a crash of the driver.
            .process_group(0);
        end_with_parent(&mut command);
        let mut child = command.spawn().map_err(|error| failed(not_started(error)))?;
        let lines = read_lines(child.stdout.take());
        let error_tail = read_tail(child.stderr.take());
        Ok(Self {
            _counted: CountedProcess::new(child.id()),
            child,
            lines,
            error_tail,
            stage: "open".to_owned(),
            limit: time_limit(match request {
                Request::List => LIST_LIMIT,
                Request::Build { .. } | Request::Check { .. } => STEP_LIMIT,
            }),
        })
    }

    /// Waits for the next message. Returns `None` after [`Message::Done`].
    ///
    /// # Errors
    /// The child reported an error, ended, or sent no message within the limit.
    pub fn next(&mut self) -> Result<Option<Message>, Ended> {
        loop {
            let line = match self.lines.recv_timeout(self.limit) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => {
                    return Err(Ended::Hung {
                        stage: self.stage.clone(),
                        seconds: self.limit.as_secs(),
                    });
                }
                Err(RecvTimeoutError::Disconnected) => return Err(self.end_of_child()),
            };
            // Skips lines that are not messages, because drivers also write to standard output.
            match serde_json::from_str(&line) {
                Ok(Message::Done) => return Ok(None),
                Ok(Message::Wrong { text }) => return Err(Ended::PermanentError(text)),
                Ok(Message::Failed { text }) => return Err(Ended::TemporaryError(text)),
                Ok(Message::Begin { stage, done, of }) => {
                    self.stage.clone_from(&stage);
                    return Ok(Some(Message::Begin { stage, done, of }));
                }
                Ok(message) => return Ok(Some(message)),
                Err(_) => {}
            }
        }
    }

    /// Lowers the priority of all threads of a child, so that it does not slow down other work.
    #[cfg(target_os = "linux")]
    pub fn lower_priority(&self) {
        use rustix::process::{Pid, setpriority_process};
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id()));
        let names = threads.into_iter().flatten().flatten().map(|thread| thread.file_name());
        let ids = names.filter_map(|name| Pid::from_raw(name.to_str()?.parse().ok()?));
        // An error is ignored: the thread may have ended meanwhile.
        ids.for_each(|id| _ = setpriority_process(Some(id), crate::pool::NICENESS));
    }

    /// Does nothing: other systems do not list the threads of a process.
    #[cfg(not(target_os = "linux"))]
    pub fn lower_priority(&self) {}

    /// Waits for the end of a child that has closed its standard output, and returns how it ended.
    fn end_of_child(&mut self) -> Ended {
        // If the child is already exiting, killing it does not change its exit status.
        let _ = self.child.kill();
        let status = self.child.wait();
        let how = match &status {
            Ok(status) => describe(*status),
            Err(error) => error.to_string(),
        };
        if status.is_ok_and(was_killed) {
            return Ended::Killed {
                stage: self.stage.clone(),
                how,
            };
        }
        let quoted = self.error_tail.recv_timeout(Duration::from_secs(1)).unwrap_or_default();
        Ended::Crashed {
            stage: self.stage.clone(),
            how,
            quoted: if quoted.is_empty() {
                quoted
            } else {
                format!(": {quoted}")
            },
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Whether another process has ended this one: the kernel because memory ran out, or a service manager.
pub(crate) fn was_killed(status: ExitStatus) -> bool {
    matches!(status.signal(), Some(libc::SIGKILL | libc::SIGTERM))
}

/// Returns the signal or the exit code with which a process has ended.
pub(crate) fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(signal), _) => format!("signal {signal}"),
        (None, Some(code)) => format!("exit code {code}"),
        (None, None) => "unknown".to_owned(),
    }
}

/// Returns the path of this executable. On Linux the path stays valid if an update replaces the file.
pub(crate) fn program() -> std::io::Result<std::path::PathBuf> {
    #[cfg(target_os = "linux")]
    return Ok("/proc/self/exe".into());
    #[cfg(not(target_os = "linux"))]
    std::env::current_exe()
}

/// Adds the path of [`program`] to the error with which it was not started: without `/proc`, the path is not there.
pub(crate) fn not_started(error: std::io::Error) -> std::io::Error {
    let path = program().unwrap_or_default();
    std::io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Makes the kernel kill the child when the thread that started the child ends.
#[cfg(target_os = "linux")]
pub(crate) fn end_with_parent(command: &mut Command) {
    // SAFETY: the closure only makes a system call, which is allowed between fork and exec.
    unsafe {
        command.pre_exec(|| {
            rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
            Ok(())
        });
    }
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn end_with_parent(_: &mut Command) {}

/// Reads lines from `out` in a thread. Bytes that are not UTF-8 are replaced.
fn read_lines(out: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (send, lines) = channel();
    std::thread::spawn(move || {
        let lines = out.into_iter().flat_map(|out| BufReader::new(out).split(b'\n'));
        for line in lines.map_while(Result::ok) {
            if send.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                return;
            }
        }
    });
    lines
}

/// Reads `out` to its end in a thread, which then sends the last [`QUOTED_BYTES`].
fn read_tail(out: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (send, tail) = channel();
    std::thread::spawn(move || {
        let (mut tail, mut piece) = (Vec::new(), [0; 4096]);
        if let Some(mut out) = out {
            while let Ok(count @ 1..) = out.read(&mut piece) {
                tail.extend_from_slice(&piece[..count]);
                tail.drain(..tail.len().saturating_sub(QUOTED_BYTES));
            }
        }
        let _ = send.send(String::from_utf8_lossy(&tail).trim().to_owned());
    });
    tail
}
