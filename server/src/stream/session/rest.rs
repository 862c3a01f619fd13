//! What is done for a final surface while no edit comes: its error is measured.

use std::time::Duration;

use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::view::View;

/// Time without an edit after which a viewer rests: longer than between two edits of a hand that still moves.
pub(super) const REST_AFTER: Duration = Duration::from_millis(250);

/// A final surface whose viewer may rest. Dropping it cancels the measurement.
pub(super) struct Rest {
    pub generation: u32,
    pub view: View,
    due: Instant,
    is_measuring: bool,
    pub token: CancellationToken,
    _cancel: DropGuard,
}

impl Rest {
    /// The final surface of a generation was committed.
    pub(super) fn new(generation: u32, view: View) -> Self {
        let token = CancellationToken::new();
        Self {
            generation,
            view,
            due: Instant::now() + REST_AFTER,
            is_measuring: false,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// Whether to measure now.
    pub(super) fn is_due(&self) -> bool {
        !self.is_measuring && Instant::now() >= self.due
    }

    /// The measurement is queued.
    pub(super) fn begin(&mut self) {
        self.is_measuring = true;
    }
}

/// Resolves when the viewer rests; never where there is nothing to measure.
pub(super) async fn due(rest: Option<&Rest>) {
    match rest {
        Some(rest) if !rest.is_measuring => tokio::time::sleep_until(rest.due).await,
        _ => std::future::pending().await,
    }
}
