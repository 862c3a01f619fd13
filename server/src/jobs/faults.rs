//! Tests that jobs survive faults. A child process makes a job. In each run, one of its writes, fsyncs, truncations and renames fails, or
//! ends the process. The calls are real system calls: the test starts its own executable, and preloads `faults.c` to intercept them.

use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::OPERATOR;
use super::state::JobState;
use super::testing::{FakeMaker, LIMITS, checksum, job, open, runner};

/// Set if this test is the child process whose calls fail. Its value is the state folder.
const CHILD: &str = "ISOPEEL_FAULT_CHILD";
const EXTRACTIONS: u32 = 2;
/// The kind of fault that ends the process, and its status then.
const CRASH: &str = "crash";
const CRASHED: i32 = 137;
/// Processes at a time.
const WORKERS: usize = 4;
/// Longest life of a process.
const LIMIT: Duration = Duration::from_secs(60);

/// Opens the jobs of a folder as a server does, submits one and makes it.
async fn make(folder: &Path) {
    let (store, results) = open(folder).await;
    let start = Instant::now();
    // As a client that sends its request again if there was no answer.
    while let Err(error) = store.submit(job("x", Some("k"), EXTRACTIONS), LIMITS).await {
        assert!(start.elapsed() < LIMIT, "{error}");
    }
    let runner = runner(&store, &results, FakeMaker::default());
    let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
    while !store.get(OPERATOR, "x").await.is_ok_and(|job| job.state.is_finished()) {
        assert!(start.elapsed() < LIMIT, "not finished");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    stop.cancel();
    running.await.unwrap();
}

/// Runs a process that makes the job. Returns its status, and the number of calls that `faults.c` has counted.
fn run(folder: &Path, shim: &Path, at: u64, kind: &str) -> (ExitStatus, u64) {
    let count = folder.with_extension("count");
    let mut child = Command::new(std::env::current_exe().unwrap());
    child
        .args(["--exact", "jobs::faults::each_write_and_fsync_may_fail_or_be_the_last"])
        .env(CHILD, folder)
        .env("LD_PRELOAD", shim)
        .env("FAULT_FOLDER", folder)
        .env("FAULT_AT", at.to_string())
        .env("FAULT_KIND", kind)
        .env("FAULT_COUNT", &count)
        .env("RUST_BACKTRACE", "0")
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let status = child.status().unwrap();
    let calls = std::fs::read_to_string(&count).ok().and_then(|text| text.parse().ok());
    (status, calls.unwrap_or(0))
}

/// Checks what a restarted server finds: the job is done, and exactly its results are there.
async fn check(folder: &Path, why: &str) {
    let (store, _) = open(folder).await;
    let jobs = store.list(OPERATOR).await.unwrap();
    assert_eq!(jobs.len(), 1, "{why}");
    let (state, done) = (jobs[0].state, jobs[0].extractions.done);
    assert_eq!((state, done), (JobState::Done, u64::from(EXTRACTIONS)), "{why}");
    let names = std::fs::read_dir(folder.join("results/x")).unwrap();
    assert_eq!(names.count(), EXTRACTIONS as usize, "{why}");
    for extraction in 0..EXTRACTIONS {
        let bytes = std::fs::read(folder.join(format!("results/x/{extraction}"))).unwrap();
        let info = store.result(OPERATOR, "x", extraction).await.unwrap();
        assert_eq!(
            (info.bytes, info.checksum),
            (bytes.len() as u64, checksum(&bytes)),
            "{why}"
        );
    }
}

fn block_on(work: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.unwrap().block_on(work);
}

/// Runs a process whose call number `at` fails or, for a crash, is its last one. If that process did not succeed, runs a second one without
/// faults. Returns whether the process ended at that call.
fn disturb(parent: &Path, shim: &Path, at: u64, kind: &str) -> bool {
    let (folder, why) = (parent.join(format!("{kind}-{at}")), format!("{kind} at call {at}"));
    std::fs::create_dir(&folder).unwrap();
    let (first, _) = run(&folder, shim, at, kind);
    let is_hit = first.code() == Some(CRASHED);
    if kind == CRASH {
        assert!(first.success() || is_hit, "{why}: {first}");
    }
    if !first.success() {
        let (second, _) = run(&folder, shim, 0, CRASH);
        assert!(second.success(), "{why}: {second}");
    }
    block_on(check(&folder, &why));
    std::fs::remove_dir_all(&folder).unwrap();
    is_hit
}

/// Returns a folder in memory if the system has `/dev/shm`: calls are made to fail, so that the test need not wait for a disk.
fn folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

#[test]
fn each_write_and_fsync_may_fail_or_be_the_last() {
    if let Some(folder) = std::env::var_os(CHILD) {
        return block_on(make(Path::new(&folder)));
    }
    let parent = folder();
    let parent = &parent.path().canonicalize().unwrap();
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/src/jobs/faults.c");
    let shim = &parent.join("faults.so");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-shared", "-fPIC", "-O1", source, "-o"])
        .arg(shim)
        .arg("-ldl");
    assert!(compiler.status().unwrap().success());

    let undisturbed = parent.join("undisturbed");
    std::fs::create_dir(&undisturbed).unwrap();
    let (status, calls) = run(&undisturbed, shim, 0, CRASH);
    assert!(status.success());
    block_on(check(&undisturbed, "undisturbed"));
    assert!(calls > 50, "{calls} calls: store and results are written");

    let (eio, enospc) = (libc::EIO.to_string(), libc::ENOSPC.to_string());
    let error = |at: u64| if at.is_multiple_of(4) { &*enospc } else { &*eio };
    let runs = (1..=calls).flat_map(|at| [(at, CRASH), (at, error(at))]);
    let (runs, crashes) = (Mutex::new(runs), AtomicU64::new(0));
    let next = || runs.lock().unwrap().next();
    std::thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                while let Some((at, kind)) = next() {
                    let is_hit = disturb(parent, shim, at, kind);
                    crashes.fetch_add(is_hit.into(), Ordering::Relaxed);
                }
            });
        }
    });
    // How many calls there are varies by a few: when the WAL is copied back depends on concurrent readers.
    let crashes = crashes.into_inner();
    assert!(crashes * 10 >= calls * 9, "{crashes} of {calls} calls were the last");
}
