//! One generation: its steps on the device, and the prefix that is on its way to the client.

use std::collections::VecDeque;
use std::time::Duration;

use isopeel_kernels::Level;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::prefix::RegionHashes;
use super::open_volume::{OpenVolume, PredictedPrefix, Start};
use crate::extraction::{Extraction, ExtractionStatistics, Plan};
use crate::view::View;
use crate::wire::encode::WireRegion;

pub(super) struct Generation {
    pub number: u32,
    pub view: View,
    pub began: Instant,
    /// A prefix to make before the plan; taken when its job starts.
    predicted_prefix: Option<PredictedPrefix>,
    /// The level of that prefix, once its job has started.
    predicted_level: Option<Level>,
    /// The levels that the plan counts; taken when its job starts.
    levels_to_count: Option<Vec<Level>>,
    /// The prefixes that the device has yet to make, once planned.
    prefixes: VecDeque<Level>,
    /// A prefix that waits until the one before is sent.
    pub ready: Option<(Level, Extraction)>,
    pub sending: Option<Sending>,
    /// Whether any prefix was committed.
    pub committed: bool,
    /// Device time so far.
    pub wall: Duration,
    /// For `done`, once the final surface is made.
    pub statistics: Option<ExtractionStatistics>,
    pub token: CancellationToken,
    /// Cancels `token` when the generation is dropped.
    _cancel: DropGuard,
}

/// A prefix on its way to the client.
pub(super) struct Sending {
    pub level: Level,
    /// Regions not yet encoded, the next one last.
    pub remaining: Vec<WireRegion>,
    /// What the client holds once the prefix is committed.
    pub held: RegionHashes,
}

/// A job for the device.
pub(super) enum Step {
    Plan(View, Vec<Level>),
    Extract(View, Level),
}

impl Generation {
    pub(super) fn new(number: u32, opened: &OpenVolume, first_prefix_target: Duration) -> Self {
        let token = CancellationToken::new();
        let Start {
            predicted_prefix,
            levels_to_count,
        } = opened.start(first_prefix_target);
        Self {
            number,
            view: opened.view.clone(),
            began: Instant::now(),
            predicted_prefix,
            predicted_level: None,
            levels_to_count: Some(levels_to_count),
            prefixes: VecDeque::new(),
            ready: None,
            sending: None,
            committed: false,
            wall: Duration::ZERO,
            statistics: None,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// The next device job: the predicted prefix, then the plan, then the planned prefixes.
    pub(super) fn next_step(&mut self) -> Option<Step> {
        if let Some(PredictedPrefix { level, beta }) = self.predicted_prefix.take() {
            self.predicted_level = Some(level);
            let view = View {
                beta,
                ..self.view.clone()
            };
            return Some(Step::Extract(view, level));
        }
        if let Some(levels) = self.levels_to_count.take() {
            return Some(Step::Plan(self.view.clone(), levels));
        }
        let level = self.prefixes.pop_front()?;
        Some(Step::Extract(self.view.clone(), level))
    }

    /// Takes the view's values and the prefixes from its plan. The predicted prefix, which is made already, replaces the first
    /// one, and those that are not finer are left out.
    pub(super) fn planned(&mut self, plan: Plan, opened: &mut OpenVolume) {
        self.prefixes = if plan.prefixes.len() > 1 {
            opened.schedule(&plan)
        } else {
            VecDeque::from([Level::FINEST])
        };
        if let Some(predicted) = self.predicted_level {
            if self.prefixes.len() > 1 {
                self.prefixes.pop_front();
            }
            self.prefixes.retain(|&level| level < predicted);
        }
        self.wall += plan.wall;
        self.view = plan.view;
    }
}
