//! Thread pools for work on the CPU: rayon's for work that viewers wait for at each edit, and others of low priority for exports and for
//! reading files.

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};

use tokio::sync::oneshot;

/// The work panicked.
#[derive(Debug, thiserror::Error)]
#[error("the encoder failed, the server's log says why")]
pub struct Panicked;

/// One processor of this many is reserved for the sockets and the device's thread, which send chunks while the pool encodes the next ones.
const PROCESSORS_PER_SOCKET_THREAD: usize = 8;

/// Starts rayon's pool, with as many threads as there are processors, except those that the sockets need; or with `RAYON_NUM_THREADS`. To
/// be called once, before any work.
///
/// # Errors
/// The pool runs already, or its threads could not be started.
pub fn start() -> Result<(), rayon::ThreadPoolBuildError> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if std::env::var_os("RAYON_NUM_THREADS").is_none() {
        let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
        pool = pool.num_threads(processors - processors / PROCESSORS_PER_SOCKET_THREAD);
    }
    pool.build_global()
}

/// Processors for each thread that runs exports.
const PROCESSORS_PER_EXPORT_THREAD: usize = 4;

/// Niceness of exports, readers and compilers that run beside viewers: if processors are short, they get a tenth of the time of other
/// threads.
#[cfg(target_os = "linux")]
pub const NICENESS: libc::c_int = 10;

/// A server's pool of exports.
static EXPORTS: OnceLock<Arc<rayon::ThreadPool>> = OnceLock::new();

/// Number of threads of a pool that reads files; set by a server.
static READ_THREADS: OnceLock<usize> = OnceLock::new();

/// Starts the pool of exports, and lets each [`ReadPool`] start threads of its own, so that rayon's pool is left to viewers. Without this
/// call, exports and readers use rayon's pool.
///
/// # Errors
/// Threads could not be started.
pub fn start_background() -> Result<(), rayon::ThreadPoolBuildError> {
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    // If an earlier call has started a pool, that one is kept.
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

/// Lowers the priority of the calling thread only.
#[cfg(target_os = "linux")]
fn lower_priority() {
    // SAFETY: a system call without pointers; 0 is the calling thread. If it fails, the thread keeps its priority.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) };
}

#[cfg(not(target_os = "linux"))]
fn lower_priority() {}

/// As [`run`], on the pool of exports. `work` may take long, because no interactive viewer waits for it. Its rayon tasks run on that pool
/// too.
pub async fn run_export<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    match EXPORTS.get() {
        Some(pool) => spawn(|work| pool.spawn(work), work).await,
        None => run(work).await,
    }
}

/// Returns the pool of exports, if it was started.
pub fn exports() -> Option<Arc<rayon::ThreadPool>> {
    EXPORTS.get().cloned()
}

/// Thread pool of low priority for reading files, so that viewers do not wait for blocks of files that take long to decode. Each concurrent
/// reader has a pool of its own: on a shared one, a thread that holds the lock of one file could start to read another file, which needs
/// that lock too.
pub struct ReadPool(Option<rayon::ThreadPool>);

impl ReadPool {
    /// Starts the threads. Without [`start_background`], or if the system has no threads left, reads use rayon's pool.
    pub fn start() -> Self {
        let threads = READ_THREADS.get();
        Self(threads.and_then(|&threads| background("isopeel-read", threads).ok()))
    }

    /// Runs `work`, which reads files, and blocks until it is done. Only for threads that may block. Its rayon tasks run on this pool too.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.0 {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Runs `work` on rayon's pool. It runs to its end even if the future is dropped, so it must be short.
pub async fn run<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    spawn(rayon::spawn, work).await
}

async fn spawn<T: Send + 'static>(
    on_pool: impl FnOnce(Box<dyn FnOnce() + Send>),
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Panicked> {
    let (reply, answer) = oneshot::channel();
    on_pool(Box::new(move || {
        // Catches panics, because a panic in a rayon task would end the process.
        if let Ok(value) = catch_unwind(AssertUnwindSafe(work)) {
            let _ = reply.send(value);
        }
    }));
    answer.await.map_err(|_| Panicked)
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
