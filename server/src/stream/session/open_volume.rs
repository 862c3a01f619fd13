//! The open volume: its view, and what the client holds of it.

use std::sync::Arc;

use tokio::sync::watch;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::prefix::RegionHashes;
use crate::extraction::{CutId, OpeningProgress, Shown};
use crate::view::View;
use crate::view::quality::MesherName;
use crate::volumes::VolumeStep;

pub(super) struct OpenVolume {
    pub volume: VolumeStep,
    pub view: View,
    pub phase: Phase,
    /// How far its opening is, until it is open.
    pub progress: Option<watch::Receiver<OpeningProgress>>,
    /// The view has changed since the last generation began.
    pub edit_pending: bool,
    pub device: String,
    /// Whether the device is this machine's processors, which the pool needs too.
    pub shares_processors: bool,
    /// What the client holds.
    pub held: Arc<RegionHashes>,
    /// The view and the cut of what the client holds.
    pub shown: Option<(View, CutId)>,
    pub token: CancellationToken,
    /// Cancels `token`, and with it the job that opens the volume, when another one is opened.
    _cancel: DropGuard,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// The job that opens the volume was not yet queued.
    Waiting,
    /// It is queued or runs.
    Opening,
    Open,
}

/// Resolves when the opening of the volume goes on; never where none is being opened.
pub(super) async fn opening_progress(opened: &mut Option<OpenVolume>) -> OpeningProgress {
    if let Some(progress) = opened.as_mut().and_then(|opened| opened.progress.as_mut())
        && progress.changed().await.is_ok()
    {
        return *progress.borrow_and_update();
    }
    // The job has ended, or there is none.
    std::future::pending().await
}

impl OpenVolume {
    pub(super) fn new(volume: VolumeStep, view: View) -> Self {
        let token = CancellationToken::new();
        Self {
            volume,
            view,
            phase: Phase::Waiting,
            progress: None,
            edit_pending: false,
            device: String::new(),
            shares_processors: false,
            held: Arc::default(),
            shown: None,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// How what the client holds relates to a surface of this view.
    pub(super) fn shown_for(&self, view: &View) -> Shown {
        let shown = self.shown.as_ref();
        shown.map_or(Shown::Another, |(shown, cut)| shown_for(shown, *cut, view))
    }
}

/// How a surface that was made of a view relates to one of another view.
pub(super) fn shown_for(shown: &View, cut: CutId, view: &View) -> Shown {
    if (shown.iso, &shown.field) != (view.iso, &view.field) {
        return Shown::Another;
    }
    // Values of the feature are in every vertex; the paper's mesher makes whole surfaces.
    let by_region = |view: &View| view.mesher == MesherName::Dual;
    let same_feature = (&shown.feature, shown.feature_range) == (&view.feature, view.feature_range);
    if same_feature && by_region(shown) && by_region(view) {
        Shown::Cut(cut)
    } else {
        Shown::Alike
    }
}
