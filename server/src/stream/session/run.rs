//! A generation at work: prefix after prefix, from the device to the pool to the outbox.

use std::collections::VecDeque;
use std::time::Duration;

use isopeel_kernels::Level;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::prefix::Held;
use super::scene::{Beginning, Scene};
use crate::extraction::statistics::Statistics;
use crate::extraction::{Extraction, Plan};
use crate::view::View;
use crate::wire::encode::WireRegion;

/// For so long after it was made the first prefix has the processors to itself, where the client does not say `drawn`
/// earlier: several times what its picture takes on two cores, and hardly noticed in the final surface.
pub(super) const PAUSE: Duration = Duration::from_millis(300);

pub(super) struct Run {
    pub generation: u32,
    pub view: View,
    pub began: Instant,
    /// A prefix to make before anything is planned, and its β.
    guess: Option<(Level, f32)>,
    /// The level of that prefix, once it was asked for.
    guessed: Option<Level>,
    /// The levels to count, until that was asked for.
    candidates: Option<Vec<Level>>,
    /// The prefixes that the device has yet to make, once planned.
    levels: VecDeque<Level>,
    /// A prefix that waits for the one before to be sent.
    pub ready: Option<(Level, Extraction)>,
    pub sending: Option<Sending>,
    pub committed: bool,
    /// The device waits for the client to draw, until then.
    pub paused_until: Option<Instant>,
    pub wall: Duration,
    /// For `done`, once the final surface is made.
    pub statistics: Option<Statistics>,
    pub token: CancellationToken,
    _cancel: DropGuard,
}

/// A prefix on its way to the client.
pub(super) struct Sending {
    pub level: Level,
    /// Regions not yet encoded, the next one last.
    pub rest: Vec<WireRegion>,
    pub held: Held,
}

/// Resolves when the run's pause has lasted long enough; never when there is none.
pub(super) async fn pause_over(run: Option<&Run>) {
    match run.and_then(|run| run.paused_until) {
        Some(until) => tokio::time::sleep_until(until).await,
        None => std::future::pending().await,
    }
}

/// What the device does next for a run.
pub(super) enum Step {
    Plan(View, Vec<Level>),
    Extract(View, Level),
}

impl Run {
    pub(super) fn new(generation: u32, scene: &Scene, answer: Duration) -> Self {
        let token = CancellationToken::new();
        let Beginning { guess, candidates } = scene.beginning(answer);
        Self {
            generation,
            view: scene.view.clone(),
            began: Instant::now(),
            guess,
            guessed: None,
            candidates: Some(candidates),
            levels: VecDeque::new(),
            ready: None,
            sending: None,
            committed: false,
            paused_until: None,
            wall: Duration::ZERO,
            statistics: None,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// The next job, while there is one. Each is asked for once.
    pub(super) fn next_step(&mut self) -> Option<Step> {
        if let Some((level, beta)) = self.guess.take() {
            self.guessed = Some(level);
            let view = View {
                beta,
                ..self.view.clone()
            };
            return Some(Step::Extract(view, level));
        }
        if let Some(levels) = self.candidates.take() {
            return Some(Step::Plan(self.view.clone(), levels));
        }
        let level = self.levels.pop_front()?;
        Some(Step::Extract(self.view.clone(), level))
    }

    /// Takes its plan up. What was guessed stands for the first prefix.
    pub(super) fn planned(&mut self, plan: Plan, scene: &mut Scene) {
        self.levels = if plan.prefixes.len() > 1 {
            scene.take_up(&plan)
        } else {
            VecDeque::from([Level::FINEST])
        };
        if let Some(guessed) = self.guessed {
            if self.levels.len() > 1 {
                self.levels.pop_front();
            }
            self.levels.retain(|&level| level < guessed);
        }
        self.wall += plan.wall;
        self.view = plan.view;
    }
}
