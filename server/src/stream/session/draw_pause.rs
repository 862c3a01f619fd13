//! The pause in which a client draws the first prefix of a generation.
//!
//! A client that renders on this machine's processors competes with the device for them. Such a client acknowledges the first
//! prefix of each generation with `drawn`; until then, but no longer than [`DRAW_PAUSE`], the device gets no further job but
//! other surfaces' first ones. A client that never sends `drawn` causes no pause.

use std::time::Duration;

use tokio::time::Instant;

/// Longest pause: several times what a picture takes on two cores, and hardly noticed in the final surface.
pub(super) const DRAW_PAUSE: Duration = Duration::from_millis(300);

/// The pause of one generation; it ends with it.
#[derive(Default)]
pub(super) struct DrawPause {
    /// While it waits to be drawn.
    until: Option<Instant>,
}

impl DrawPause {
    /// A coarse prefix was made, before any was committed.
    pub(super) fn begin(&mut self) {
        self.until = Some(Instant::now() + DRAW_PAUSE);
    }

    /// The client has drawn it.
    pub(super) fn end(&mut self) {
        self.until = None;
    }

    /// It lasted long enough.
    pub(super) fn end_if_elapsed(&mut self) {
        self.until = self.until.filter(|until| *until > Instant::now());
    }

    /// When the pause ends at the latest; `None` if there is none.
    pub(super) fn until(&self) -> Option<Instant> {
        self.until
    }
}
