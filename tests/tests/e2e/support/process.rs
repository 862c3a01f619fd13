//! `isopeel serve` as a process of its own: its use of system resources, and signals.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use super::{command, http, server};

/// A running server; dropping it kills it.
pub struct Process {
    child: Child,
    pub address: SocketAddr,
}

/// Starts a server with these files and options on a free port, and waits until its device is ready.
pub fn start(paths: &[PathBuf], options: &[&str]) -> Option<Process> {
    let options: Vec<_> = options.iter().copied().chain(["--no-auth"]).collect();
    Some(launch(paths, &options)?.0)
}

/// As [`start`], with exactly these options; also the line that it prints.
pub fn launch(paths: &[PathBuf], options: &[&str]) -> Option<(Process, String)> {
    let (process, line) = begin(paths, options)?;
    wait_until_ready(&process);
    Some((process, line))
}

/// As [`start`], in an environment that has these variables too.
pub fn start_in(paths: &[PathBuf], options: &[&str], environment: &[(&str, &Path)]) -> Option<Process> {
    let options: Vec<_> = options.iter().copied().chain(["--no-auth"]).collect();
    Some(launch_in(paths, &options, environment)?.0)
}

/// As [`launch`], in an environment that has these variables too.
pub fn launch_in(paths: &[PathBuf], options: &[&str], environment: &[(&str, &Path)]) -> Option<(Process, String)> {
    let mut command = Command::new(command::binary());
    command.envs(environment.iter().copied());
    let (process, line) = spawn(command, paths, options, Stdio::null())?;
    wait_until_ready(&process);
    Some((process, line))
}

/// As [`start_in`], with its log from this level on, and panics, at the end of a file.
pub fn start_logged_in(
    paths: &[PathBuf],
    options: &[&str],
    environment: &[(&str, &Path)],
    level: &str,
    log: &Path,
) -> Option<Process> {
    let mut command = Command::new(command::binary());
    command.envs(environment.iter().copied()).env("RUST_LOG", level);
    let options: Vec<_> = options.iter().copied().chain(["--no-auth"]).collect();
    let log = std::fs::File::options().create(true).append(true).open(log);
    let (process, _) = spawn(command, paths, &options, log.expect("a file").into())?;
    wait_until_ready(&process);
    Some(process)
}

/// A server without volumes that writes all lines of its log there.
pub fn start_logging_to(log: Stdio) -> Option<Process> {
    let mut command = Command::new(command::binary());
    command.env("RUST_LOG", "debug");
    let options = ["--no-auth", "--rate-peer", "0"];
    let (process, _) = spawn(command, &[], &options, log)?;
    wait_until_ready(&process);
    Some(process)
}

fn wait_until_ready(process: &Process) {
    let start = Instant::now();
    while http::get(process.address, "/readyz").status != 200 {
        assert!(start.elapsed() < Duration::from_secs(120), "the device is not ready");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// As [`launch`], but its device may be opening still.
pub fn begin(paths: &[PathBuf], options: &[&str]) -> Option<(Process, String)> {
    spawn(Command::new(command::binary()), paths, options, Stdio::null())
}

/// As [`begin`], with its log at this level, and panics, in a file.
pub fn launch_logged(paths: &[PathBuf], options: &[&str], level: &str, log: &Path) -> Option<(Process, String)> {
    let mut command = Command::new(command::binary());
    command.env("RUST_LOG", level);
    let log = std::fs::File::create(log).expect("a file");
    spawn(command, paths, options, log.into())
}

fn spawn(mut command: Command, paths: &[PathBuf], options: &[&str], log: Stdio) -> Option<(Process, String)> {
    if !server::has_device() {
        return None;
    }
    let mut child = command
        .args(["serve", "--listen", "127.0.0.1:0"])
        .args(options)
        .args(paths)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(log)
        .spawn()
        .expect("the binary starts");
    let mut line = String::new();
    let out = child.stdout.take().expect("a pipe");
    BufReader::new(out).read_line(&mut line).expect("a line");
    let (_, address) = line.trim().split_once("://").unwrap_or(("", &line));
    let address = address.split('/').next();
    let address = address.and_then(|address| address.parse().ok());
    let address = address.unwrap_or_else(|| panic!("expected an address, got {line:?}"));
    Some((Process { child, address }, line.trim().to_owned()))
}

/// Sends a signal to a process: `TERM`, `KILL`. Returns false if the process has ended.
pub fn signal(id: u32, name: &str) -> bool {
    let status = Command::new("kill")
        .args([&format!("-{name}"), &id.to_string()])
        .status();
    status.expect("kill runs").success()
}

impl Process {
    /// Process id of the server.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Process id of the process of its device; `None` while there is none.
    pub fn device_process(&self) -> Option<u32> {
        let parent = self.child.id().to_string();
        let found = Command::new("pgrep").args(["-P", &parent, "-f", " worker "]).output();
        String::from_utf8(found.expect("pgrep runs").stdout)
            .expect("UTF-8")
            .trim()
            .parse()
            .ok()
    }

    /// Sends a signal to the process of its device: `KILL`, `STOP`. Waits until there is one.
    pub fn signal_device(&self, name: &str) {
        let start = Instant::now();
        let id = loop {
            match self.device_process() {
                Some(id) => break id,
                None => assert!(start.elapsed() < Duration::from_secs(60), "no process of the device"),
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        assert!(signal(id, name), "the process has ended");
    }

    /// A file of `/proc` about the server, and about the process of its device.
    fn proc(&self, name: &str) -> Vec<String> {
        let read = |id: u32| {
            let path = format!("/proc/{id}/{name}");
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
        };
        [self.child.id()]
            .into_iter()
            .chain(self.device_process())
            .map(read)
            .collect()
    }

    /// Time of processors that it has used, with the process of its device.
    pub fn cpu_seconds(&self) -> f64 {
        self.proc("stat").iter().map(|stat| seconds_of(stat)).sum()
    }

    /// Bytes of its memory, with the process of its device.
    pub fn resident_bytes(&self) -> u64 {
        self.proc("status").iter().map(|status| resident_of(status)).sum()
    }

    /// Sends it a signal: `TERM`, `HUP`.
    pub fn signal(&self, name: &str) {
        assert!(signal(self.child.id(), name), "the server has ended");
    }

    /// How it ended; panics if it has not within `limit`.
    pub fn ended_within(mut self, limit: Duration) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status;
            }
            assert!(start.elapsed() < limit, "still running after {limit:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Time of processors that a process has used, of `/proc/ID/stat`.
fn seconds_of(stat: &str) -> f64 {
    let (_, fields) = stat.rsplit_once(')').expect("a name in brackets");
    let ticks = fields.split_whitespace().skip(11).take(2);
    // Linux reports 100 ticks per second on all machines.
    ticks.map(|ticks| ticks.parse::<f64>().expect("a number")).sum::<f64>() / 100.0
}

/// Memory of a process without that which it shares, of `/proc/ID/status`.
fn resident_of(status: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.expect("the system says it") << 10
}

impl Drop for Process {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
