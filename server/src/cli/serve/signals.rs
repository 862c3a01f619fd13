//! Signals, and the end of the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// What comes before a shutdown: for some time all go on, so that balancers find out that others are to be asked.
pub(super) struct Drain {
    pub time: Duration,
    /// Set when it begins.
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

/// Resolves at ctrl-c or SIGTERM, after [`Drain`], which another such signal ends. SIGHUP, which a terminal sends when it closes and an administrator for a reload, ends nothing: `reload`
/// reads again what can be, and says what it has read. The handlers are installed when this returns.
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
                    // Short files; new connections wait for them.
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

/// Resolves at ctrl-c.
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

/// Ends the process at once, without the exit handlers of libraries: those of an OpenCL driver may wait for its work, or crash beside it.
#[cfg(unix)]
pub(super) fn exit_now(success: bool) -> ! {
    // SAFETY: it takes a number and does not return; no memory of the process is touched.
    unsafe { libc::_exit(i32::from(!success)) }
}

/// Ends the process.
#[cfg(not(unix))]
pub(super) fn exit_now(success: bool) -> ! {
    std::process::exit(i32::from(!success))
}
