//! A child process as its parent sees it: its messages, and how it ended.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use super::child::{Message, Request};

/// Maximum time between two messages of a child, unless `ISOPEEL_CHECK_SECONDS` is set. Slow compilers take minutes for a large kernel.
const STEP_LIMIT: Duration = Duration::from_secs(600);

/// Maximum time for a list of the devices, unless `ISOPEEL_CHECK_SECONDS` is set: the first process to use eight GPUs may wait most of a
/// minute.
const LIST_LIMIT: Duration = Duration::from_secs(120);

/// Bytes of a child's standard error that a report may quote.
const QUOTED_BYTES: usize = 600;

/// Environment variables in addition to the parent's own.
pub(super) type Environment = Vec<(String, String)>;

/// How a child ended that did not report [`Message::Done`].
#[derive(Clone, Debug, thiserror::Error)]
pub enum Ended {
    /// It ended without a final message, by a signal or with an exit code.
    #[error("the driver ended the process in stage {stage} ({how}){quoted}")]
    Crashed {
        /// Stage that was running.
        stage: String,
        /// The signal or exit code.
        how: String,
        /// What was written on standard error.
        quoted: String,
    },
    /// Something else killed it: the system, which had no memory left, or a service manager that stops the server.
    #[error("the process was killed in stage {stage} ({how})")]
    Killed {
        /// Stage that was running.
        stage: String,
        /// The signal.
        how: String,
    },
    /// It sent no message within the time limit.
    #[error("stage {stage} did not end within {seconds} s")]
    Hung {
        /// Stage that was running.
        stage: String,
        /// The limit.
        seconds: u64,
    },
    /// It reported an error that a retry would not cure.
    #[error("{0}")]
    Wrong(String),
    /// It reported an error of the device whose cause may be gone at the next attempt.
    #[error("{0}")]
    Failed(String),
    /// The child could not be started.
    #[error("the check could not be started: {0}")]
    NotStarted(String),
}

impl Ended {
    /// Whether the cause may be gone at the next attempt.
    pub fn is_temporary(&self) -> bool {
        matches!(self, Self::Killed { .. } | Self::Failed(_) | Self::NotStarted(_))
    }
}

/// A running child.
pub(super) struct Running {
    child: Child,
    lines: Receiver<String>,
    errors: Receiver<String>,
    stage: String,
    /// Maximum time between two messages.
    limit: Duration,
}

/// Returns the limit that the environment sets, or else `default`.
fn limit(default: Duration) -> Duration {
    let seconds = std::env::var("ISOPEEL_CHECK_SECONDS").ok();
    let seconds = seconds.and_then(|text| text.parse().ok());
    seconds.map_or(default, Duration::from_secs)
}

impl Running {
    /// Starts a child, which ends with the calling thread.
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
            // Ctrl-C at the terminal must reach the parent alone: a child that it ended would be taken for a crash of the driver.
            .process_group(0);
        end_with_parent(&mut command);
        let mut child = command.spawn().map_err(failed)?;
        let lines = lines_of(child.stdout.take());
        let errors = tail_of(child.stderr.take());
        Ok(Self {
            child,
            lines,
            errors,
            stage: "open".to_owned(),
            limit: limit(match request {
                Request::List => LIST_LIMIT,
                Request::Build { .. } | Request::Check { .. } => STEP_LIMIT,
            }),
        })
    }

    /// Returns the next message; `None` after [`Message::Done`].
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
                Err(RecvTimeoutError::Disconnected) => return Err(self.crashed()),
            };
            // Skips lines that are not messages: drivers write on standard output too.
            match serde_json::from_str(&line) {
                Ok(Message::Done) => return Ok(None),
                Ok(Message::Wrong { text }) => return Err(Ended::Wrong(text)),
                Ok(Message::Failed { text }) => return Err(Ended::Failed(text)),
                Ok(Message::Begin { stage, done, of }) => {
                    self.stage.clone_from(&stage);
                    return Ok(Some(Message::Begin { stage, done, of }));
                }
                Ok(message) => return Ok(Some(message)),
                Err(_) => {}
            }
        }
    }

    /// Lowers the priority of all threads of a child, so that it does not slow down work beside it.
    #[cfg(target_os = "linux")]
    pub fn lower_priority(&self) {
        use rustix::process::{Pid, setpriority_process};
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id()));
        let names = threads.into_iter().flatten().flatten().map(|thread| thread.file_name());
        let ids = names.filter_map(|name| Pid::from_raw(name.to_str()?.parse().ok()?));
        // A thread that has ended meanwhile has no priority to set.
        ids.for_each(|id| _ = setpriority_process(Some(id), crate::pool::NICENESS));
    }

    /// Does nothing: other systems do not list the threads of a process.
    #[cfg(not(target_os = "linux"))]
    pub fn lower_priority(&self) {}

    fn crashed(&mut self) -> Ended {
        // The child has closed its standard output. If it is already exiting, killing it does not change its exit status.
        let _ = self.child.kill();
        let status = self.child.wait();
        let how = match &status {
            Ok(status) => describe(*status),
            Err(error) => error.to_string(),
        };
        let signal = status.ok().and_then(|status| status.signal());
        if signal.is_some_and(|signal| [libc::SIGKILL, libc::SIGTERM].contains(&signal)) {
            return Ended::Killed {
                stage: self.stage.clone(),
                how,
            };
        }
        let quoted = self.errors.recv_timeout(Duration::from_secs(1)).unwrap_or_default();
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

fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(signal), _) => format!("signal {signal}"),
        (None, Some(code)) => format!("exit code {code}"),
        (None, None) => "unknown".to_owned(),
    }
}

/// Returns the path of this executable. On Linux it stays valid if the file is replaced.
fn program() -> std::io::Result<std::path::PathBuf> {
    #[cfg(target_os = "linux")]
    return Ok("/proc/self/exe".into());
    #[cfg(not(target_os = "linux"))]
    std::env::current_exe()
}

#[cfg(target_os = "linux")]
fn end_with_parent(command: &mut Command) {
    // SAFETY: a system call alone, which may be made between fork and exec.
    unsafe {
        command.pre_exec(|| {
            rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
            Ok(())
        });
    }
}

#[cfg(not(target_os = "linux"))]
fn end_with_parent(_: &mut Command) {}

fn lines_of(out: Option<impl Read + Send + 'static>) -> Receiver<String> {
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

/// Returns a receiver of the last [`QUOTED_BYTES`] of `out`, which are sent when `out` ends.
fn tail_of(out: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (send, tail) = channel();
    std::thread::spawn(move || {
        let (mut kept, mut piece) = (Vec::new(), [0; 4096]);
        if let Some(mut out) = out {
            while let Ok(count @ 1..) = out.read(&mut piece) {
                kept.extend_from_slice(&piece[..count]);
                kept.drain(..kept.len().saturating_sub(QUOTED_BYTES));
            }
        }
        let _ = send.send(String::from_utf8_lossy(&kept).trim().to_owned());
    });
    tail
}
