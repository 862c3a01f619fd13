//! Handlers of signals, and the end of the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The time before a shutdown in which the server still answers all requests, but is not ready any more, so that load balancers stop
/// sending it new ones.
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

/// Returns a future that resolves after ctrl-c or SIGTERM and the [`Drain`] that follows. Another such signal ends the drain at once.
///
/// SIGHUP calls `reload`, which returns a text for the log on what it has reloaded, and the server continues. A terminal also sends SIGHUP
/// when it closes. The handlers are installed when this function returns.
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
                    // The files are short; new connections wait until they are read.
                    let read = tokio::task::block_in_place(&reload);
                    tracing::info!("SIGHUP: {read}, the server goes on");
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

/// Returns a future that resolves after ctrl-c and the drain that follows. There is no reload without SIGHUP.
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

/// Ends the process at once, without the exit handlers of libraries: those of an OpenCL driver may wait for running kernels, or crash.
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
