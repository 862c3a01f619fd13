//! Work at rest: when no edit has arrived for [`REST_AFTER`] after a final surface, the server replaces the surface with a better one if
//! possible, and then measures the error of the surface that is shown.

use std::time::Duration;

use isopeel_extraction::ViewKey;
use isopeel_view::View;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::generation::Generation;

/// Time without an edit after which a viewer counts as resting. It is longer than the time between two edits during a drag.
pub(super) const REST_AFTER: Duration = Duration::from_millis(250);

/// Work at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum RestWork {
    /// Make a better surface of the same view.
    Improve,
    /// Measure the surface's error.
    Measure,
}

/// State of a committed final surface until the next edit: the work at rest that is still to be done. Dropping it cancels this work.
pub(super) struct Rest {
    /// Number of the generation that has made the surface.
    pub generation: u32,
    pub view: View,
    /// Key of `view`.
    pub key: ViewKey,
    due: Instant,
    /// The work that is next or queued, or that runs.
    work: RestWork,
    is_queued: bool,
    pub token: CancellationToken,
    _cancel: DropGuard,
}

impl Rest {
    /// Creates the state after the final surface of a generation was committed.
    pub(super) fn new(generation: &Generation) -> Self {
        let token = CancellationToken::new();
        Self {
            generation: generation.number,
            view: generation.view.clone(),
            key: generation.key.clone(),
            due: Instant::now() + REST_AFTER,
            work: if generation.can_improve {
                RestWork::Improve
            } else {
                RestWork::Measure
            },
            is_queued: false,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// Returns the next work and when it is due; `None` while it is queued or runs.
    pub(super) fn due(&self) -> Option<(Instant, RestWork)> {
        (!self.is_queued).then_some((self.due, self.work))
    }

    /// Records that the work is queued.
    pub(super) fn mark_queued(&mut self) {
        self.is_queued = true;
    }

    /// Records that there is no better surface, so that this one is measured next.
    pub(super) fn cannot_improve(&mut self) {
        self.work = RestWork::Measure;
        self.is_queued = false;
    }

    /// Postpones the work because the viewer does not rest. If it is queued or runs, it is cancelled and starts over.
    pub(super) fn postpone(&mut self) {
        self.due = Instant::now() + REST_AFTER;
        if self.is_queued {
            self.is_queued = false;
            self.token = CancellationToken::new();
            // Replacing the guard cancels the work that holds the previous token.
            self._cancel = self.token.clone().drop_guard();
        }
    }
}
