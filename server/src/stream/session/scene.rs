//! The open volume, and what the client holds of it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::Level;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::prefix::Held;
use super::super::schedule::{candidates, guess, prefixes, preview};
use crate::extraction::{Plan, VolumeStep};
use crate::view::{FeatureName, View};

/// For so long edits may overtake each other without a commit before the next one starts with a coarse prefix again,
/// though it could go straight to the final surface: the user should see that something happens.
pub(super) const PATIENCE: Duration = Duration::from_millis(300);

pub(super) struct Scene {
    pub volume: VolumeStep,
    pub view: View,
    pub phase: Phase,
    /// An edit was not yet taken up.
    pub wanted: bool,
    pub device: String,
    /// What the client holds, and of which surface.
    pub held: Arc<Held>,
    pub shown: Option<(SurfaceName, Level)>,
    /// What the last plan that looked at coarse prefixes said.
    known: Option<Known>,
    /// What the device took for the last final surface.
    pub last_wall: Duration,
    /// When the oldest generation began of those that ended without a commit since the last commit.
    pub starving_since: Option<Instant>,
    /// Ends the opening when the scene is replaced.
    _opening: DropGuard,
    pub token: CancellationToken,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    Waiting,
    Opening,
    Open,
}

/// What decides a surface before it is cut. Only the cut differs between two views that share it.
#[derive(Clone, PartialEq)]
pub(super) struct SurfaceName {
    field: String,
    feature: FeatureName,
    iso: Option<u32>,
}

impl SurfaceName {
    pub(super) fn of(view: &View) -> Self {
        Self {
            field: view.field.clone(),
            feature: view.feature.clone(),
            iso: view.iso.map(|iso| iso.get().to_bits()),
        }
    }
}

/// What a plan says of the next surface of the same field. Good enough for its first prefix, which then need not wait until
/// everything after it is counted: an edit mostly moves a surface a little.
struct Known {
    field: String,
    first: Option<Level>,
    preview: Option<Level>,
    /// In force under a budget, until the budget is fitted again.
    beta: f32,
}

/// How a new generation begins.
pub(super) struct Beginning {
    /// A prefix to make before anything is planned, and its β.
    pub guess: Option<(Level, f32)>,
    /// The levels to count then.
    pub candidates: Vec<Level>,
}

impl Scene {
    pub(super) fn new(volume: VolumeStep, view: View) -> Self {
        let token = CancellationToken::new();
        Self {
            volume,
            view,
            phase: Phase::Waiting,
            wanted: false,
            device: String::new(),
            held: Arc::default(),
            shown: None,
            known: None,
            last_wall: Duration::ZERO,
            starving_since: None,
            _opening: token.clone().drop_guard(),
            token,
        }
    }

    /// Where only the cut changes, the final surface alone sends what changed and no more; coarse prefixes would replace what
    /// stays, twice. So it comes with a preview only where it would be later than `answer`, or in the middle of a drag.
    pub(super) fn beginning(&self, answer: Duration) -> Beginning {
        let known = self.known.as_ref().filter(|known| known.field == self.view.field);
        let starving = self.starving_since.is_some_and(|since| since.elapsed() > PATIENCE);
        let name = SurfaceName::of(&self.view);
        let shown = self.shown.as_ref().filter(|(shown, _)| *shown == name);
        let level = match (known, shown) {
            (Some(known), None) => known.first,
            (Some(known), Some(&(_, level))) if level > Level::FINEST || starving || self.last_wall > answer => {
                known.preview
            }
            _ => None,
        };
        let beta = |known: &Known| match self.view.budget {
            Some(_) => known.beta,
            None => self.view.beta,
        };
        Beginning {
            guess: level.zip(known.map(beta)),
            candidates: if shown.is_some() {
                vec![Level::FINEST]
            } else {
                candidates()
            },
        }
    }

    /// What a plan of all candidates says: for the generation that it was made for, and for those after it.
    pub(super) fn take_up(&mut self, plan: &Plan) -> VecDeque<Level> {
        let levels = prefixes(plan);
        let coarse = levels.front().filter(|&&first| first != Level::FINEST);
        self.known = coarse.map(|_| Known {
            field: plan.view.field.clone(),
            first: guess(plan),
            preview: preview(plan),
            beta: plan.view.beta_in_force(),
        });
        levels
    }
}
