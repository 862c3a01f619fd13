//! The pause in which a client draws the first prefix of a generation.
//!
//! A client that renders on this machine's processors competes with the device for them. Such a client acknowledges the first
//! prefix of each generation with `drawn`; until then, but no longer than [`DRAW_PAUSE`], the device gets no further job. A
//! client that never sends `drawn` causes no pause.

use std::time::Duration;

use tokio::time::Instant;

/// Longest pause: several times what a picture takes on two cores, and hardly noticed in the final surface.
pub(super) const DRAW_PAUSE: Duration = Duration::from_millis(300);

#[derive(Default)]
pub(super) struct DrawPause {
    /// The client has sent `drawn` before, so it will again.
    acknowledges: bool,
    /// The generation that waits to be drawn, and until when.
    active: Option<(u32, Instant)>,
}

impl DrawPause {
    /// A coarse prefix of a generation was made, before any of it was committed.
    pub(super) fn begin(&mut self, generation: u32) {
        if self.acknowledges {
            self.active = Some((generation, Instant::now() + DRAW_PAUSE));
        }
    }

    /// The client sent `drawn`.
    pub(super) fn acknowledge(&mut self, generation: u32) {
        self.acknowledges = true;
        if self.active.is_some_and(|(waiting, _)| waiting == generation) {
            self.end();
        }
    }

    /// The pause lasted long enough, or its generation ended.
    pub(super) fn end(&mut self) {
        self.active = None;
    }

    pub(super) fn is_active(&self) -> bool {
        self.active.is_some()
    }

    /// Resolves when the pause has lasted long enough; never where there is none.
    pub(super) async fn elapsed(&self) {
        match self.active {
            Some((_, until)) => tokio::time::sleep_until(until).await,
            None => std::future::pending().await,
        }
    }
}
