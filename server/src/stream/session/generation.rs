//! One generation: the steps in which an edit's surface is made and sent.
//!
//! A generation has two lanes, making and sending, each in one phase at a time. A step passes through both; the next step is made while the
//! one before is sent. Of all surfaces of a connection, at most one is `OnDevice` and at most one is sent.
//!
//! ```text
//! making    Waiting --device--> OnDevice --made--> Made --taken by the sending lane--> Waiting
//!                                                    \--the final one is taken-------> Finished
//! sending   Idle --Made--> Comparing --pool--> Encoding --all encoded--> Committing --writer--> Idle
//! ```

use std::sync::Arc;
use std::time::Duration;

use isopeel_codec::chunk::{Coding, PrefixId};
use isopeel_extraction::{CutId, ExtractionStatistics, FullCount, Shown, SurfaceKey, ViewKey};
use isopeel_kernels::{StageTime, SurfaceStatistics};
use isopeel_view::View;
use isopeel_view::quality::Budget;
use isopeel_volumes::VolumeStep;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::groups::FirstStep;
use super::super::prefix::{Changes, Part};
use super::super::shared::{HeldRegions, Offered, SharedStep};
use super::draw_pause::DrawPause;
use super::shown::HeldSurface;
use crate::metrics;
use crate::wire::messages::ServerMessage;

pub(super) struct Generation {
    /// Number of the generation's surface.
    pub surface: u8,
    /// Number of the generation, unique among those of all surfaces of a connection.
    pub number: u32,
    /// The resolved view. Its budget is the surface's part of the connection's budget.
    pub view: View,
    /// Key of `view`.
    pub key: ViewKey,
    pub making: Making,
    pub sending: Sending,
    /// The surface that the client shows when all steps that were made are committed.
    pub shown: Shown,
    /// The cut of the final surface, once it is known.
    pub target: Option<CutId>,
    pub steps_made: u32,
    /// Triangles of the surface that the last step has made; 0 before the first step.
    pub made_triangles: u64,
    /// Whether any step was committed.
    pub has_committed: bool,
    /// Whether a better surface may follow the final one.
    pub can_improve: bool,
    /// Whether a newer edit waits until a step of this generation is committed, so that the client sees some surfaces during a drag.
    pub is_overtaken: bool,
    /// Device time of the generation's jobs so far.
    pub wall: Duration,
    /// Time of each stage so far.
    pub stages: Vec<StageTime>,
    /// Pause until the client has drawn the first prefix.
    pub draw_pause: DrawPause,
    /// Number of the connection's last job when this generation began to wait for its next one: the generation with the lowest number has
    /// waited longest.
    pub waiting_since_job: u64,
    /// Error of the generation's work. It is sent after the regions that the client may not keep are removed.
    pub failure: Option<Box<ServerMessage>>,
    /// Guard that delays the further steps of other members of the group until this first step is ready to be sent. `None` if the viewer is
    /// in no group or its line is full.
    pub first_step: Option<FirstStep>,
    /// Whether it only follows a camera, so that an edit ends it at once.
    pub follows_camera: bool,
    /// When an edit began this generation; `None` if it follows a camera, or improves a surface at rest.
    begun: Option<Instant>,
    pub token: CancellationToken,
    /// Cancels `token` when the generation is dropped.
    _cancel: DropGuard,
}

/// State of a generation on the device.
pub(super) enum Making {
    /// The next step was not queued yet.
    Waiting,
    /// A step, or the count before the first one, is queued or runs.
    OnDevice,
    /// A step was made and waits until the one before is encoded.
    Made(Offered),
    /// The final surface was made.
    Finished,
}

/// A step on its way to the client.
pub(super) enum Sending {
    Idle,
    /// The pool compares the step with the regions that the client holds.
    Comparing(StepBeingSent),
    /// The regions of the step are encoded in batches.
    Encoding {
        sent: StepBeingSent,
        step: Arc<SharedStep>,
        coding: Coding,
        /// Regions that are in no batch yet, in reverse order: the last one is taken next.
        remaining: Vec<Part>,
        /// Batches on the pool.
        batches: usize,
        /// Regions that the client will hold.
        held: HeldRegions,
    },
    /// `committed` waits for the writer. Then the client holds these regions.
    Committing(StepBeingSent, HeldRegions),
}

/// The properties of a step that is being sent.
pub(super) struct StepBeingSent {
    pub id: PrefixId,
    pub cut: CutId,
    pub is_final: bool,
    /// Whether a better surface of the same view may follow when the viewer rests.
    pub can_improve: bool,
    /// Triangles of the whole surface once the step is committed.
    pub surface_triangles: u64,
    /// Size and time of the step for the pace; `None` if the job of another viewer made the step.
    pub own_step: Option<OwnStep>,
    /// When the comparison of the step began.
    pub began: Instant,
    /// Bytes of the step's chunks so far.
    pub bytes: u64,
    /// When the writer took the first frame.
    pub handed_over: Option<Instant>,
    /// Statistics of the final surface; `None` for other steps.
    pub statistics: Option<ExtractionStatistics>,
}

/// Triangles of a step that was made for this viewer, and the time for them: a measurement for the pace.
pub(super) struct OwnStep {
    pub triangles: u64,
    /// Time of meshing, counted from when the cut of the step was known.
    pub time: Duration,
}

impl Generation {
    pub(super) fn new(surface: u8, number: u32, view: View, key: ViewKey, shown: Shown) -> Self {
        let token = CancellationToken::new();
        Self {
            surface,
            number,
            view,
            key,
            making: Making::Waiting,
            sending: Sending::Idle,
            shown,
            target: None,
            steps_made: 0,
            made_triangles: 0,
            has_committed: false,
            can_improve: false,
            is_overtaken: false,
            wall: Duration::ZERO,
            stages: Vec::new(),
            draw_pause: DrawPause::default(),
            waiting_since_job: 0,
            failure: None,
            first_step: None,
            follows_camera: false,
            begun: None,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// Whether no edit has requested this generation, and none of its frames was sent.
    pub(super) fn is_unrequested_and_unsent(&mut self) -> bool {
        let was_handed_over = |sent: &mut StepBeingSent| sent.handed_over.is_some();
        self.begun.is_none() && !self.has_committed && !self.sent().is_some_and(was_handed_over)
    }

    /// Creates a generation that an edit has requested.
    pub(super) fn from_edit(surface: u8, number: u32, view: View, key: ViewKey, shown: Shown) -> Self {
        metrics::edit_begun();
        Self {
            begun: Some(Instant::now()),
            ..Self::new(surface, number, view, key, shown)
        }
    }

    /// Creates a generation in which a surface that the client holds follows a camera. `key`: key of the view's full surface.
    pub(super) fn for_camera(surface: u8, number: u32, view: View, key: SurfaceKey, shown: Shown) -> Self {
        let key = ViewKey::new(key, &view);
        Self {
            follows_camera: true,
            ..Self::new(surface, number, view, key, shown)
        }
    }

    /// Records that a step is ready to be committed.
    pub(super) fn record_commit(&mut self, is_final: bool) {
        self.first_step = None;
        let Some(begun) = self.begun else { return };
        if !self.has_committed {
            metrics::edit_committed(begun.elapsed());
        }
        if is_final {
            metrics::edit_done(begun.elapsed());
        }
    }

    /// Records that the device has counted the full surface.
    pub(super) fn record_count(&mut self, count: &FullCount) {
        self.add_times(count.wall, &count.stages);
        self.making = Making::Waiting;
    }

    /// Records that the device has made a step.
    pub(super) fn record_step(&mut self, offered: Offered) {
        let refinement = &offered.step.refinement;
        self.add_times(refinement.wall, &refinement.surface.statistics.stages);
        self.shown = self
            .surface_after(refinement.cut)
            .shown_for(self.key.surface(), &self.view);
        self.target = refinement.target;
        self.steps_made += 1;
        self.made_triangles = refinement.surface.statistics.triangles;
        // Keep the threshold that was fitted to the budget, so that the next steps need not search for it again.
        self.view.fitted = refinement.view.fitted;
        self.making = Making::Made(offered);
    }

    /// Returns the surface that the client holds once this cut is committed.
    pub(super) fn surface_after(&self, cut: CutId) -> HeldSurface {
        HeldSurface {
            view: self.view.clone(),
            key: self.key.surface().clone(),
            cut,
        }
    }

    /// Changes the surface's part of the budget. Does nothing if the view has no budget. Called only before the first step is begun.
    pub(super) fn set_budget(&mut self, budget: Option<Budget>) {
        if self.view.budget.is_some() && budget.is_some() && self.view.budget != budget {
            self.view.budget = budget;
            self.key = ViewKey::new(self.key.surface().clone(), &self.view);
        }
    }

    /// Adds the times of a job to the sums.
    fn add_times(&mut self, wall: Duration, stages: &[StageTime]) {
        self.wall += wall;
        for stage in stages {
            match self.stages.iter_mut().find(|sum| sum.stage == stage.stage) {
                Some(sum) => sum.milliseconds += stage.milliseconds,
                None => self.stages.push(stage.clone()),
            }
        }
    }

    /// Whether no step was begun. Until then the part of the budget may change.
    pub(super) fn has_no_step(&self) -> bool {
        self.steps_made == 0 && matches!(self.making, Making::Waiting)
    }

    /// After a failure, queues an empty surface as the next step, which removes the surface from the client. If another step is being sent,
    /// the generation waits.
    pub(super) fn queue_empty_step(&mut self, volume: &VolumeStep) {
        self.making = match self.sending {
            Sending::Idle => Making::Made(Offered::nothing(&self.view, volume)),
            _ => Making::Waiting,
        };
    }

    /// Takes the step that waits to be sent.
    pub(super) fn take_made_step(&mut self) -> Option<Offered> {
        match std::mem::replace(&mut self.making, Making::Waiting) {
            Making::Made(offered) => {
                if offered.step.refinement.is_final {
                    self.making = Making::Finished;
                }
                Some(offered)
            }
            other => {
                self.making = other;
                None
            }
        }
    }

    /// Returns the properties of a step that are needed while it is sent. `smallest_length`: the smallest edge of
    /// the volume's cells, in world units.
    pub(super) fn step_being_sent(&self, offered: &Offered, smallest_length: f64, device: &str) -> StepBeingSent {
        let refinement = &offered.step.refinement;
        let statistics = refinement.is_final.then(|| {
            let kernels = SurfaceStatistics {
                stages: self.stages.clone(),
                ..refinement.surface.statistics.clone()
            };
            ExtractionStatistics::new(&kernels, &refinement.view, smallest_length, self.wall, device)
        });
        let triangles = offered.step.regions.iter().map(|region| region.triangles as u64);
        // Of a cut of the tree, the time is that of the whole cut, even if few regions differ.
        let is_part_of_tree_cut = refinement.surface.remade.is_some() && refinement.target.is_none();
        let own_step = (offered.is_own && !is_part_of_tree_cut).then(|| OwnStep {
            triangles: triangles.sum(),
            time: refinement.meshing,
        });
        StepBeingSent {
            id: PrefixId::cut(self.surface, self.number, refinement.surface.prefix.get()),
            cut: refinement.cut,
            is_final: refinement.is_final,
            can_improve: refinement.can_improve,
            surface_triangles: refinement.surface.statistics.triangles,
            own_step,
            began: Instant::now(),
            bytes: 0,
            handed_over: None,
            statistics,
        }
    }

    /// Records that the pool has compared the step that is being sent.
    pub(super) fn record_comparison(&mut self, changes: Changes) {
        let Sending::Comparing(sent) = std::mem::replace(&mut self.sending, Sending::Idle) else {
            return;
        };
        let mut remaining = changes.changed;
        remaining.reverse();
        self.sending = Sending::Encoding {
            sent,
            step: changes.step,
            coding: changes.coding,
            remaining,
            batches: 0,
            held: changes.held,
        };
    }

    /// Returns the step that is being sent, if there is one.
    pub(super) fn sent(&mut self) -> Option<&mut StepBeingSent> {
        match &mut self.sending {
            Sending::Idle => None,
            Sending::Comparing(sent) | Sending::Encoding { sent, .. } | Sending::Committing(sent, _) => Some(sent),
        }
    }
}
