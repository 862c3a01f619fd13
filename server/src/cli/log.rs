//! The log: lines on standard error. A separate thread writes them, so that no other thread waits or fails if standard error cannot be
//! written, because its reader is stuck or has ended, or because the disk is full. Lines that cannot be written are dropped and counted.
//! When writing works again, a line states their number.

use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, mpsc};
use std::time::Duration;

use tracing_appender::non_blocking::{ErrorCounter, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use super::LogFormat;

/// Maximum number of queued lines. Further lines are dropped.
const QUEUED_LINES: usize = 4096;

/// Maximum time that the end of the process waits for queued lines.
const FLUSH_LIMIT: Duration = Duration::from_secs(1);

/// Guard of the thread that writes. Dropping the guard flushes the queue and ends the thread.
static GUARD: Mutex<Option<WorkerGuard>> = Mutex::new(None);

/// Starts the log. `RUST_LOG` selects its lines by modules and levels, as `isopeel=debug,warn`; if it is not set, `default_level` does.
pub fn start(format: LogFormat, default_level: LevelFilter) {
    let (filter, refused) = filter(&std::env::var("RUST_LOG").unwrap_or_default(), default_level);
    let queue = Arc::new(OnceLock::new());
    let (writer, guard) = NonBlockingBuilder::default()
        .buffered_lines_limit(QUEUED_LINES)
        .thread_name("isopeel-log")
        .finish(Lines::new(standard_error(), format, Arc::clone(&queue)));
    let _ = queue.set(writer.error_counter());
    *GUARD.lock().unwrap_or_else(PoisonError::into_inner) = Some(guard);
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(writer)
        .with_ansi(io::stderr().is_terminal());
    let log = tracing_subscriber::registry();
    match format {
        LogFormat::Text => log.with(lines).with(filter).init(),
        LogFormat::Json => log.with(lines.json().flatten_event(true)).with(filter).init(),
    }
    if let Some(refused) = refused {
        tracing::warn!("{refused}");
    }
}

/// Returns the filter that `RUST_LOG` asks for; if it is empty or refused, lines of `default_level` and above. Also returns why it is
/// refused.
fn filter(wanted: &str, default_level: LevelFilter) -> (Targets, Option<String>) {
    let default = Targets::new().with_default(default_level);
    let directives: Vec<&str> = wanted
        .split(',')
        .map(str::trim)
        .filter(|part| !part.is_empty())
        .collect();
    if directives.is_empty() {
        return (default, None);
    }
    // `Targets` would take a span for the name of a module, and no level for the lowest.
    let is_known = |part: &&str| !part.contains(['[', ' ']) && !part.ends_with('=');
    let filter = directives.join(",").parse();
    match filter {
        Ok(filter) if directives.iter().all(is_known) => (filter, None),
        _ => {
            let expected = "expected modules and levels, as isopeel=debug,warn";
            let refused = format!("RUST_LOG is {wanted:?}, {expected}: {default_level} is used");
            (default, Some(refused))
        }
    }
}

/// Returns a copy of standard error, which does not use the lock of `std::io::stderr`: a blocked write would hold this lock, and block
/// other threads that write to standard error.
#[cfg(unix)]
fn standard_error() -> Box<dyn Write + Send> {
    use std::os::fd::AsFd;
    match io::stderr().as_fd().try_clone_to_owned() {
        Ok(copy) => Box::new(std::fs::File::from(copy)),
        Err(_) => Box::new(io::stderr()),
    }
}

#[cfg(not(unix))]
fn standard_error() -> Box<dyn Write + Send> {
    Box::new(io::stderr())
}

/// Ends the log after all queued lines were written, or after a second.
pub fn finish() {
    let guard = GUARD.lock().unwrap_or_else(PoisonError::into_inner).take();
    let (sender, flushed) = mpsc::channel();
    // Drops the guard in a thread that is not joined. If lines are left, the library writes that to standard error, which may block too.
    std::thread::spawn(move || {
        drop(guard);
        let _ = sender.send(());
    });
    let _ = flushed.recv_timeout(FLUSH_LIMIT);
}

/// Writes lines to `out`. Counts the lines that cannot be written, and reports the number when writing works again.
struct Lines<W> {
    out: W,
    format: LogFormat,
    /// Counter of the lines that the full queue has dropped.
    queue: Arc<OnceLock<ErrorCounter>>,
    /// Number of lines that could not be written.
    unwritten: usize,
    /// Number of dropped lines that were already reported.
    reported: usize,
}

impl<W: Write> Lines<W> {
    fn new(out: W, format: LogFormat, queue: Arc<OnceLock<ErrorCounter>>) -> Self {
        Self {
            out,
            format,
            queue,
            unwritten: 0,
            reported: 0,
        }
    }

    /// Returns the number of all dropped lines.
    fn dropped(&self) -> usize {
        self.unwritten + self.queue.get().map_or(0, ErrorCounter::dropped_lines)
    }

    /// Writes the number of lines that were dropped since the last report.
    fn report_dropped(&mut self) -> io::Result<()> {
        let dropped = self.dropped();
        if dropped == self.reported {
            return Ok(());
        }
        let text = format!(
            "{} lines of the log are missing here: standard error could not be written",
            dropped - self.reported
        );
        match self.format {
            LogFormat::Text => writeln!(self.out, " WARN isopeel: {text}")?,
            LogFormat::Json => writeln!(self.out, "{}", serde_json::json!({"level": "WARN", "message": text}))?,
        }
        self.reported = dropped;
        Ok(())
    }
}

impl<W: Write> Write for Lines<W> {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let written = self.report_dropped().and_then(|()| self.out.write_all(&indented(line)));
        self.unwritten += usize::from(written.is_err());
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        // Failed writes are counted in `write`.
        let _ = self.out.flush();
        Ok(())
    }
}

/// Indents all lines of an event except the first, so that a line break in a name, such as that of a file, cannot forge another event.
fn indented(event: &[u8]) -> Cow<'_, [u8]> {
    let (text, end) = match event.split_last() {
        Some((b'\n', text)) => (text, &b"\n"[..]),
        _ => (event, &b""[..]),
    };
    if !text.iter().any(|byte| matches!(byte, b'\n' | b'\r')) {
        return Cow::Borrowed(event);
    }
    let lines: Vec<&[u8]> = text.split(|byte| matches!(byte, b'\n' | b'\r')).collect();
    Cow::Owned([&lines.join(&b"\n    "[..]), end].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_has_modules_and_levels_or_says_what_is_expected() {
        let is_enabled =
            |(filter, _): &(Targets, Option<String>), module: &str, level| filter.would_enable(module, level);
        let (info, debug) = (tracing::Level::INFO, tracing::Level::DEBUG);
        let by_default = filter("", LevelFilter::INFO);
        assert!(by_default.1.is_none() && is_enabled(&by_default, "isopeel::rest", &info));
        assert!(!is_enabled(&by_default, "isopeel::rest", &debug));
        let wanted = filter("isopeel=debug,warn", LevelFilter::INFO);
        assert!(wanted.1.is_none() && is_enabled(&wanted, "isopeel::rest", &debug));
        assert!(!is_enabled(&wanted, "hyper", &info));
        let spaced = filter(" isopeel=debug, warn,", LevelFilter::INFO);
        assert_eq!((&spaced.0, spaced.1.is_none()), (&wanted.0, true));
        for text in ["isopeel=loud", "isopeel=", "isopeel[edit]=debug", "isopeel debug"] {
            let refused = filter(text, LevelFilter::INFO);
            assert!(is_enabled(&refused, "isopeel::rest", &info), "{text}");
            let said = refused.1.expect("a refusal");
            assert!(said.contains(text) && said.ends_with("info is used"), "{said}");
        }
    }

    /// A writer with limited space.
    #[derive(Default)]
    struct Disk {
        text: String,
        is_full: bool,
    }

    struct Shared<'a>(&'a Mutex<Disk>);

    impl Write for Shared<'_> {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut disk = self.0.lock().expect("no panic");
            if disk.is_full {
                return Err(io::ErrorKind::StorageFull.into());
            }
            disk.text += std::str::from_utf8(bytes).expect("text");
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn names_with_line_breaks_forge_no_events() {
        assert_eq!(*indented(b"one\n"), *b"one\n");
        assert_eq!(*indented(b""), *b"");
        let forged = b" INFO read \"a\n2026-01-01 WARN isopeel: forged\r b\"\n";
        let expected = b" INFO read \"a\n    2026-01-01 WARN isopeel: forged\n     b\"\n";
        assert_eq!(*indented(forged), *expected);
    }

    #[test]
    fn lines_that_could_not_be_written_are_counted_when_there_is_space_again() {
        let disk = Mutex::new(Disk::default());
        let mut lines = Lines::new(Shared(&disk), LogFormat::Text, Arc::default());
        let fill = |is_full| disk.lock().expect("no panic").is_full = is_full;
        lines.write_all(b"one\n").expect("never fails");
        fill(true);
        lines.write_all(b"two\n").expect("never fails");
        lines.write_all(b"three\n").expect("never fails");
        fill(false);
        lines.write_all(b"four\n").expect("never fails");
        lines.write_all(b"five\n").expect("never fails");
        let text = disk.lock().expect("no panic").text.clone();
        let missing = " WARN isopeel: 2 lines of the log are missing here: standard error could not be written";
        assert_eq!(text, format!("one\n{missing}\nfour\nfive\n"));
    }
}
