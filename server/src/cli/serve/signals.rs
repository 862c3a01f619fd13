//! Signal handlers, and the exit of the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The time before a shutdown in which the server still answers all requests. Its readiness probe fails in this time, so that load
/// balancers stop sending new requests.
pub(super) struct Drain {
    pub time: Duration,
    /// Set when the drain begins.
    pub has_begun: Arc<AtomicBool>,
}

impl Drain {
    fn begin(&self) {
        if !self.time.is_zero() {
            tracing::info!(
                "/readyz is 503 from now on, new requests are answered for {} s",
                self.time.as_secs_f64()
            );
        }
        self.has_begun.store(true, Ordering::Relaxed);
    }
}

/// Returns a future that resolves after SIGINT or SIGTERM, and after the [`Drain`] that follows. Another such signal ends the drain at
/// once.
///
/// On SIGHUP, calls `reload`, which returns a text for the log about what it has reloaded, and continues. A terminal also sends SIGHUP when
/// it closes. The handlers are installed when this function returns.
///
/// # Errors
/// The handlers cannot be installed.
#[cfg(unix)]
pub(super) fn shutdown(
    reload: impl Fn() -> &'static str + Send + 'static,
    drain: Drain,
) -> std::io::Result<impl Future<Output = ()> + Send + 'static> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    let mut hang_up = signal(SignalKind::hangup())?;
    Ok(async move {
        loop {
            tokio::select! {
                _ = interrupt.recv() => break,
                _ = terminate.recv() => break,
                Some(()) = hang_up.recv() => {
                    // Blocks a thread only briefly, because the files are short.
                    let reloaded = tokio::task::block_in_place(&reload);
                    tracing::info!("SIGHUP: {reloaded}, the server goes on");
                }
            }
        }
        drain.begin();
        tokio::select! {
            () = tokio::time::sleep(drain.time) => (),
            _ = interrupt.recv() => (),
            _ = terminate.recv() => (),
        }
        tracing::info!("shutting down");
    })
}

/// Returns a future that resolves after ctrl-c, and after the drain that follows. Never reloads, because this system has no SIGHUP.
#[cfg(not(unix))]
pub(super) fn shutdown(
    _: impl Fn() -> &'static str + Send + 'static,
    drain: Drain,
) -> std::io::Result<impl Future<Output = ()> + Send + 'static> {
    Ok(async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        drain.begin();
        tokio::time::sleep(drain.time).await;
        tracing::info!("shutting down");
    })
}

/// Ends the process without running exit handlers, because those of an OpenCL driver may wait for running kernels or crash.
#[cfg(unix)]
pub(super) fn exit_now(success: bool) -> ! {
    // SAFETY: the function takes a number, touches no memory, and does not return.
    unsafe { libc::_exit(i32::from(!success)) }
}

/// Ends the process.
#[cfg(not(unix))]
pub(super) fn exit_now(success: bool) -> ! {
    std::process::exit(i32::from(!success))
}
