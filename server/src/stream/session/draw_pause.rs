//! The pause in which a client draws the first prefix of a generation.
//!
//! A client that renders on this machine's processors competes with the device for them. Such a client acknowledges the first prefix of
//! each generation with `drawn`. Until then, but no longer than [`DRAW_PAUSE`], the device gets no further jobs except first steps of other
//! surfaces. A client that never sends `drawn` causes no pause.

use std::time::Duration;

use tokio::time::Instant;

/// Maximum length of the pause: several times as long as drawing a picture takes on two cores, but so short that it hardly delays the final
/// surface.
pub(super) const DRAW_PAUSE: Duration = Duration::from_millis(300);

/// The draw pause of one generation. It ends with the generation.
#[derive(Default)]
pub(super) struct DrawPause {
    /// The latest end of the pause, while the client is drawing.
    until: Option<Instant>,
}

impl DrawPause {
    /// Begins the pause: a coarse prefix was made, before any was committed.
    pub(super) fn begin(&mut self) {
        self.until = Some(Instant::now() + DRAW_PAUSE);
    }

    /// Ends the pause: the client has drawn the prefix.
    pub(super) fn end(&mut self) {
        self.until = None;
    }

    /// Ends the pause if it has lasted for [`DRAW_PAUSE`].
    pub(super) fn end_if_elapsed(&mut self) {
        self.until = self.until.filter(|until| *until > Instant::now());
    }

    /// Returns the latest end of the pause; `None` if there is no pause.
    pub(super) fn until(&self) -> Option<Instant> {
        self.until
    }
}
