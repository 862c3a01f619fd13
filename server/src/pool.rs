//! The CPU pool behind the encoder: work goes in, a future comes out.

use std::panic::{AssertUnwindSafe, catch_unwind};

use tokio::sync::oneshot;

/// The work panicked; the log says where.
#[derive(Debug, thiserror::Error)]
#[error("the encoder failed, the server's log says why")]
pub struct Panicked;

/// Runs `work` on rayon's pool. Dropping the future lets it run to its end; it must be short.
pub async fn run<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    let (reply, answer) = oneshot::channel();
    rayon::spawn(move || {
        // A panic that leaves a rayon task ends the process.
        if let Ok(value) = catch_unwind(AssertUnwindSafe(work)) {
            let _ = reply.send(value);
        }
    });
    answer.await.map_err(|_| Panicked)
}
