//! Work on rayon's CPU pool as a future.

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};

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

/// Runs `work` on rayon's pool. It runs to its end even if the future is dropped, so it must be short.
pub async fn run<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    let (reply, answer) = oneshot::channel();
    rayon::spawn(move || {
        // A panic in a rayon task would end the process.
        if let Ok(value) = catch_unwind(AssertUnwindSafe(work)) {
            let _ = reply.send(value);
        }
    });
    answer.await.map_err(|_| Panicked)
}
