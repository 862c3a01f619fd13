//! Work on the CPU as a future: on rayon's pool what viewers wait for, on a small one of low priority what exports do.

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;

use tokio::sync::oneshot;

/// The work panicked.
#[derive(Debug, thiserror::Error)]
#[error("the encoder failed, the server's log says why")]
pub struct Panicked;

/// Of so many processors, one is left to the sockets and the device's thread: what the pool encodes has to be sent meanwhile.
const PROCESSORS_PER_SOCKET_THREAD: usize = 8;

/// Starts rayon's pool, of as many threads as there are processors but for those that the sockets need; or `RAYON_NUM_THREADS`. To be
/// called once, before any work.
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

/// Of so many processors, one is for exports at a time.
const PROCESSORS_PER_EXPORT_THREAD: usize = 4;

/// Priority of exports, as `nice` counts: where processors are short, they get a tenth of what others get.
#[cfg(target_os = "linux")]
const EXPORT_NICENESS: libc::c_int = 10;

/// The pool of exports, of a server.
static EXPORTS: OnceLock<rayon::ThreadPool> = OnceLock::new();

/// Starts the pool of exports, where viewers need the other one meanwhile. Without it exports use that.
///
/// # Errors
/// Its threads could not be started.
pub fn start_exports() -> Result<(), rayon::ThreadPoolBuildError> {
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(processors.div_ceil(PROCESSORS_PER_EXPORT_THREAD))
        .thread_name(|i| format!("isopeel-export-{i}"))
        .start_handler(|_| lower_priority())
        .build()?;
    // Another one that runs does as well.
    let _ = EXPORTS.set(pool);
    Ok(())
}

/// Of this thread alone.
#[cfg(target_os = "linux")]
fn lower_priority() {
    // SAFETY: a system call without pointers; 0 is the calling thread. Where it fails the thread keeps its priority.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, EXPORT_NICENESS) };
}

#[cfg(not(target_os = "linux"))]
fn lower_priority() {}

/// As [`run`], on the pool of exports: nobody at a screen waits for it, so it may take long. What it does with rayon stays on that pool.
pub async fn run_export<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    match EXPORTS.get() {
        Some(pool) => spawn(|work| pool.spawn(work), work).await,
        None => run(work).await,
    }
}

/// Runs `work` on the pool of exports and waits for it, on a thread of no pool.
pub fn install_export<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match EXPORTS.get() {
        Some(pool) => pool.install(work),
        None => work(),
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
        // A panic in a rayon task would end the process.
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
    async fn exports_have_threads_of_low_priority_and_all_they_do_stays_there() {
        let niceness = || {
            rayon::join(|| (), || ());
            let name = std::thread::current().name().unwrap_or_default().to_owned();
            // SAFETY: a system call without pointers; 0 is the calling thread.
            (unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) }, name)
        };
        start_exports().unwrap();
        let (of_export, name) = run_export(niceness).await.unwrap();
        assert!(of_export >= EXPORT_NICENESS, "{of_export}");
        assert!(name.starts_with("isopeel-export-"), "{name}");
        assert!(run(niceness).await.unwrap().0 < of_export);
    }
}
