//! The thread that writes the audit log, so that no request waits for a disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

use super::{COUNTING_PERIOD, Line, Outcome, SideChannel, WRITE_INTERVAL, lock, now};

/// A command to the writer.
pub(super) enum Command {
    Write(Vec<u8>),
    /// Replies after all earlier lines were written.
    Flush(SyncSender<()>),
    /// Makes the writer look at [`SideChannel`] at once.
    Wake,
}

fn open(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.create(true).append(true).open(path)
}

/// State of the writer thread.
pub(super) struct Writer {
    path: PathBuf,
    file: File,
    side_channel: Arc<SideChannel>,
    /// Whether an error was logged. Further errors are not logged until a write succeeds.
    error_logged: bool,
}

impl Writer {
    /// Opens the file, or creates it. The writer adds lines that state the number of lost lines and the counts of refusals in `side_channel`.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub(super) fn open(path: &Path, side_channel: &Arc<SideChannel>) -> io::Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            file: open(path)?,
            side_channel: Arc::clone(side_channel),
            error_logged: false,
        })
    }

    /// Executes commands until all senders are dropped. Meanwhile writes due counts of refusals.
    pub(super) fn run(mut self, commands: &Receiver<Command>) {
        let mut counts_written = Instant::now();
        loop {
            let received = commands.recv_timeout(WRITE_INTERVAL);
            if self.side_channel.must_reopen.swap(false, Ordering::Relaxed) {
                self.reopen();
            }
            self.write_lost();
            match received {
                Ok(Command::Write(line)) => self.write(&line),
                Ok(Command::Flush(done)) => {
                    self.write_counts(Duration::ZERO);
                    let _ = done.send(());
                }
                Ok(Command::Wake) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.write_counts(Duration::ZERO),
            }
            if counts_written.elapsed() >= WRITE_INTERVAL {
                self.write_counts(COUNTING_PERIOD);
                counts_written = Instant::now();
            }
        }
    }

    /// Writes the number of lines that were dropped since the last such line.
    fn write_lost(&mut self) {
        let lost = self.side_channel.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let line = serde_json::json!({"time": now(), "event": "lost", "count": lost});
            self.write(format!("{line}\n").as_bytes());
        }
    }

    fn reopen(&mut self) {
        match open(&self.path) {
            Ok(file) => self.file = file,
            Err(error) => tracing::error!(%error, "the audit log cannot be opened again, the old file goes on"),
        }
    }

    /// Writes the counts of the kinds whose first refusal was at least `age` ago.
    fn write_counts(&mut self, age: Duration) {
        let counts = lock(&self.side_channel.refusals).take_due(Instant::now(), age);
        for (kind, count) in counts {
            let who = kind.who.as_ref();
            let line = Line {
                time: now(),
                event: kind.event,
                result: Outcome::Refused,
                status: kind.status,
                code: kind.code,
                user: who.map(|(user, _)| &**user),
                token: who.map(|(_, token)| &**token),
                peer: kind.peer,
                job: None,
                upload: None,
                count: Some(count),
            };
            self.write(&line.text());
        }
    }

    fn write(&mut self, line: &[u8]) {
        match self.file.write_all(line) {
            Ok(()) => self.error_logged = false,
            Err(error) if !self.error_logged => {
                tracing::error!(%error, "the audit log cannot be written");
                self.error_logged = true;
            }
            Err(_) => {}
        }
    }
}
