//! Work on rayon's CPU pool as a future.

use std::panic::{AssertUnwindSafe, catch_unwind};

use tokio::sync::oneshot;

/// The work panicked.
#[derive(Debug, thiserror::Error)]
#[error("the encoder failed, the server's log says why")]
pub struct Panicked;

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
