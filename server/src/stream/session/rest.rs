//! What is done for a final surface while no edit comes: a better one takes its place where there is one, then its error is measured.

use std::time::Duration;

use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::view::View;

/// Time without an edit after which a viewer rests: longer than between two edits of a hand that still moves.
pub(super) const REST_AFTER: Duration = Duration::from_millis(250);

/// Work for a viewer that rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RestWork {
    /// Make a better surface of the same view.
    Improve,
    /// Measure the surface's error.
    Measure,
}

/// A final surface whose viewer may rest. Dropping it cancels what is done.
pub(super) struct Rest {
    pub generation: u32,
    pub view: View,
    due: Instant,
    /// What is done next; nothing once the measurement is queued.
    next: Option<RestWork>,
    pub token: CancellationToken,
    _cancel: DropGuard,
}

impl Rest {
    /// The final surface of a generation was committed.
    pub(super) fn new(generation: u32, view: View, can_improve: bool) -> Self {
        let token = CancellationToken::new();
        Self {
            generation,
            view,
            due: Instant::now() + REST_AFTER,
            next: Some(if can_improve {
                RestWork::Improve
            } else {
                RestWork::Measure
            }),
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// What to do now; it is queued.
    pub(super) fn begin(&mut self) -> Option<RestWork> {
        if Instant::now() < self.due {
            return None;
        }
        self.next.take()
    }

    /// There is no better surface: this one is measured.
    pub(super) fn cannot_improve(&mut self) {
        self.next = Some(RestWork::Measure);
    }
}

/// Resolves when the viewer rests; never where there is nothing to do.
pub(super) async fn due(rest: Option<&Rest>) {
    match rest {
        Some(rest) if rest.next.is_some() => tokio::time::sleep_until(rest.due).await,
        _ => std::future::pending().await,
    }
}
