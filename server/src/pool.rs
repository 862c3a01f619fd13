//! Thread pools for CPU work: rayon's global pool for the edits of viewers, and pools of low priority for exports and for reading files.

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};

use tokio::sync::oneshot;

/// Work on a pool panicked.
#[derive(Debug, thiserror::Error)]
#[error("the encoder failed, the server's log says why")]
pub struct Panicked;

/// One in this many processors is reserved for the sockets and the device's thread, which send chunks while the pool encodes the next ones.
const PROCESSORS_PER_SOCKET_THREAD: usize = 8;

/// Starts rayon's global pool with a thread for each processor that is not reserved, or with `RAYON_NUM_THREADS` threads. Call this once,
/// before any work.
///
/// # Errors
/// The pool is already running, or its threads could not be started.
pub fn start() -> Result<(), rayon::ThreadPoolBuildError> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if std::env::var_os("RAYON_NUM_THREADS").is_none() {
        let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
        pool = pool.num_threads(processors - processors / PROCESSORS_PER_SOCKET_THREAD);
    }
    pool.build_global()
}

/// The export pool has one thread for this many processors.
const PROCESSORS_PER_EXPORT_THREAD: usize = 4;

/// Niceness of threads for exports, for reading and for compiling. If all processors are busy, such a thread gets a tenth of the time of
/// other threads.
#[cfg(target_os = "linux")]
pub const NICENESS: libc::c_int = 10;

/// The export pool. Only a server starts it.
static EXPORTS: OnceLock<Arc<rayon::ThreadPool>> = OnceLock::new();

/// Number of threads of a [`ReadPool`]. Only a server sets it.
static READ_THREADS: OnceLock<usize> = OnceLock::new();

/// Starts the export pool, and lets each [`ReadPool`] start its own threads, so that rayon's global pool is free for viewers. Without this
/// call, exports and readers use rayon's global pool.
///
/// # Errors
/// The threads could not be started.
pub fn start_background() -> Result<(), rayon::ThreadPoolBuildError> {
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    // The errors of `set` are ignored: a pool of an earlier call stays in use.
    let threads = processors.div_ceil(PROCESSORS_PER_EXPORT_THREAD);
    let _ = EXPORTS.set(Arc::new(background("isopeel-export", threads)?));
    let _ = READ_THREADS.set(processors);
    Ok(())
}

fn background(name: &'static str, threads: usize) -> Result<rayon::ThreadPool, rayon::ThreadPoolBuildError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |i| format!("{name}-{i}"))
        .start_handler(|_| lower_priority())
        .build()
}

/// Lowers the priority of the calling thread.
#[cfg(target_os = "linux")]
fn lower_priority() {
    // SAFETY: a system call without pointers; 0 is the calling thread. If it fails, the thread keeps its priority.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) };
}

#[cfg(not(target_os = "linux"))]
fn lower_priority() {}

/// Runs `work` on the export pool. It may take long, because no viewer waits for it. Its rayon tasks run on the same pool.
pub async fn run_export<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    match EXPORTS.get() {
        Some(pool) => spawn(|work| pool.spawn(work), work).await,
        None => run(work).await,
    }
}

/// Returns the export pool, if it was started.
pub fn exports() -> Option<Arc<rayon::ThreadPool>> {
    EXPORTS.get().cloned()
}

/// Thread pool of low priority for reading files, so that viewers do not wait while a reader decodes large blocks.
///
/// Each concurrent reader has its own pool. With a shared pool, a thread that holds the lock of a file could steal a task of another reader
/// that needs the same lock.
pub struct ReadPool(Option<rayon::ThreadPool>);

impl ReadPool {
    /// Starts the threads. Without [`start_background`], or if the threads cannot be started, reads use rayon's global pool.
    pub fn start() -> Self {
        let threads = READ_THREADS.get();
        Self(threads.and_then(|&threads| background("isopeel-read", threads).ok()))
    }

    /// Runs `work`, which reads files, and blocks the calling thread until it is done. The rayon tasks of `work` run on this pool.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.0 {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Runs `work` on rayon's global pool. `work` must be short, because it runs to its end even if the future is dropped.
pub async fn run<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    spawn(rayon::spawn, work).await
}

/// Runs `work` by `spawn_on_pool`, and waits for its result.
async fn spawn<T: Send + 'static>(
    spawn_on_pool: impl FnOnce(Box<dyn FnOnce() + Send>),
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Panicked> {
    let (sender, result) = oneshot::channel();
    spawn_on_pool(Box::new(move || {
        // Catches panics, because a panic in a rayon task would end the process.
        if let Ok(value) = catch_unwind(AssertUnwindSafe(work)) {
            let _ = sender.send(value);
        }
    }));
    result.await.map_err(|_| Panicked)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[tokio::test]
    async fn exports_and_readers_have_threads_of_low_priority_and_all_they_do_stays_there() {
        let niceness = || {
            rayon::join(|| (), || ());
            let name = std::thread::current().name().unwrap_or_default().to_owned();
            // SAFETY: a system call without pointers; 0 is the calling thread.
            (unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) }, name)
        };
        start_background().unwrap();
        let (of_export, name) = run_export(niceness).await.unwrap();
        assert!(of_export >= NICENESS, "{of_export}");
        assert!(name.starts_with("isopeel-export-"), "{name}");
        let (of_read, name) = ReadPool::start().run(niceness);
        assert!(of_read >= NICENESS, "{of_read}");
        assert!(name.starts_with("isopeel-read-"), "{name}");
        assert!(run(niceness).await.unwrap().0 < of_export.min(of_read));
    }
}
