//! The open volume: its view, what the client holds of it, and what the last plan predicts for the next generation.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::Level;
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::prefix::RegionHashes;
use super::super::schedule::{levels_to_count, predicted_first, prefixes, preview};
use crate::extraction::{OpeningProgress, Plan};
use crate::view::{FeatureName, View};
use crate::volumes::VolumeStep;

/// Time without a commit, while edits supersede each other, after which the next generation starts with a coarse prefix even
/// where the final surface alone would do: the user sees progress during a drag.
pub(super) const STARVATION_LIMIT: Duration = Duration::from_millis(300);

pub(super) struct OpenVolume {
    pub volume: VolumeStep,
    pub view: View,
    pub phase: Phase,
    /// How far its opening is, until it is open.
    pub progress: Option<watch::Receiver<OpeningProgress>>,
    /// The view has changed since the last generation began.
    pub edit_pending: bool,
    pub device: String,
    /// What the client holds.
    pub held: Arc<RegionHashes>,
    /// The surface and the level of what the client holds.
    pub shown: Option<(SurfaceKey, Level)>,
    /// From the last plan that counted coarse prefixes.
    prediction: Option<Prediction>,
    /// Device time of the last final surface.
    pub last_wall: Duration,
    /// When the oldest generation began of those that were superseded since the last commit, none of their own committed.
    pub waiting_since: Option<Instant>,
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

/// What decides a surface before it is cut: two views with equal keys differ in the cut alone.
#[derive(Clone, PartialEq)]
pub(super) struct SurfaceKey {
    field: String,
    feature: FeatureName,
    iso: Option<u32>,
}

impl SurfaceKey {
    pub(super) fn of(view: &View) -> Self {
        Self {
            field: view.field.clone(),
            feature: view.feature.clone(),
            iso: view.iso.map(|iso| iso.get().to_bits()),
        }
    }
}

/// What a plan says of the next surface of the same field. An edit mostly changes a surface a little, so the prediction is good
/// enough for the first prefix, which then is made before anything is counted.
struct Prediction {
    field: String,
    first: Option<Level>,
    preview: Option<Level>,
    /// In force under a budget, until the budget is fitted again.
    beta: f32,
}

/// A prefix that is made before the plan.
pub(super) struct PredictedPrefix {
    pub level: Level,
    pub beta: f32,
}

/// How a generation starts.
pub(super) struct Start {
    pub predicted_prefix: Option<PredictedPrefix>,
    pub levels_to_count: Vec<Level>,
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
            held: Arc::default(),
            shown: None,
            prediction: None,
            last_wall: Duration::ZERO,
            waiting_since: None,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// How the next generation starts.
    ///
    /// A new surface starts with a coarse prefix. Where only the cut changes, the final surface alone is sent: its unchanged
    /// regions stay, and coarse prefixes would replace each of them twice. A preview precedes it where the final surface would
    /// be later than `first_prefix_target`, where the client holds a preview (in the middle of a drag), and where no
    /// generation was committed within [`STARVATION_LIMIT`].
    pub(super) fn start(&self, first_prefix_target: Duration) -> Start {
        let prediction = self.prediction.as_ref().filter(|p| p.field == self.view.field);
        let is_starved = self
            .waiting_since
            .is_some_and(|since| since.elapsed() > STARVATION_LIMIT);
        let key = SurfaceKey::of(&self.view);
        let shown = self.shown.as_ref().filter(|(shown, _)| *shown == key);
        let level = match (prediction, shown) {
            (Some(prediction), None) => prediction.first,
            (Some(prediction), Some(&(_, level)))
                if level > Level::FINEST || is_starved || self.last_wall > first_prefix_target =>
            {
                prediction.preview
            }
            _ => None,
        };
        let beta = |prediction: &Prediction| match self.view.budget {
            Some(_) => prediction.beta,
            None => self.view.beta,
        };
        let predicted_prefix = level.zip(prediction.map(beta));
        Start {
            predicted_prefix: predicted_prefix.map(|(level, beta)| PredictedPrefix { level, beta }),
            levels_to_count: if shown.is_some() {
                vec![Level::FINEST]
            } else {
                levels_to_count()
            },
        }
    }

    /// The prefixes of a plan that counted all levels; keeps its prediction for the generations that follow.
    pub(super) fn schedule(&mut self, plan: &Plan) -> VecDeque<Level> {
        let levels = prefixes(plan);
        let coarse = levels.front().filter(|&&first| first != Level::FINEST);
        self.prediction = coarse.map(|_| Prediction {
            field: plan.view.field.clone(),
            first: predicted_first(plan),
            preview: preview(plan),
            beta: plan.view.beta_in_force(),
        });
        levels
    }
}
