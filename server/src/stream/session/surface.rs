//! One surface of a connection: its view, what is done for it, and what the client holds of it.

use std::sync::Arc;

use super::super::groups::FirstStep;
use super::super::shared::RegionHashes;
use super::generation::Generation;
use super::rest::Rest;
use super::shown::{is_same_surface, shown_for};
use crate::extraction::{CutId, Shown};
use crate::view::quality::Budget;
use crate::view::{FeatureName, View};

pub(super) struct SurfaceSession {
    /// As edits left it; its budget is that of the connection.
    pub view: View,
    /// The view or its part of the budget has changed since the last generation began.
    pub edit_pending: bool,
    /// Counts the connection's edits: which was the last of this surface.
    pub edited: u64,
    pub phase: Phase,
    /// What the client holds.
    pub held: Arc<RegionHashes>,
    /// The view and the cut of what the client holds.
    pub shown: Option<(View, CutId)>,
    /// The generation that it belongs to; 0 where there is none.
    pub shown_generation: u32,
    /// Triangles of the full surface, and of which view: the newest one of which that is known.
    pub full: Option<(View, u64)>,
    /// What it gets of the budget: its newest generation is made with this, or the next one will be.
    pub allotted: Option<Budget>,
    /// The budget of the last final surface that the client got, as a number.
    pub kept: Option<Budget>,
    /// What the client holds is of another time step.
    pub holds_another_step: bool,
    /// The range of the feature, and of which: the newest one with which a surface was made.
    pub feature_range: Option<(String, FeatureName, [f32; 2])>,
}

/// What is done for a surface. `Idle --edit--> Working --final surface committed--> Resting --measured--> Idle`; a better surface goes from
/// `Resting` to `Working` and back.
pub(super) enum Phase {
    Idle,
    /// A generation is made and sent.
    Working(Box<Generation>),
    /// The final surface is held; it may be improved and measured.
    Resting(Box<Rest>),
}

impl SurfaceSession {
    pub(super) fn new(view: View) -> Self {
        Self {
            view,
            edit_pending: false,
            edited: 0,
            phase: Phase::Idle,
            held: Arc::default(),
            shown: None,
            shown_generation: 0,
            full: None,
            allotted: None,
            kept: None,
            holds_another_step: false,
            feature_range: None,
        }
    }

    pub(super) fn generation(&self) -> Option<&Generation> {
        match &self.phase {
            Phase::Working(generation) => Some(generation),
            Phase::Idle | Phase::Resting(_) => None,
        }
    }

    pub(super) fn generation_mut(&mut self) -> Option<&mut Generation> {
        match &mut self.phase {
            Phase::Working(generation) => Some(generation),
            Phase::Idle | Phase::Resting(_) => None,
        }
    }

    pub(super) fn rest(&self) -> Option<&Rest> {
        match &self.phase {
            Phase::Resting(rest) => Some(rest),
            Phase::Idle | Phase::Working(_) => None,
        }
    }

    pub(super) fn rest_mut(&mut self) -> Option<&mut Rest> {
        match &mut self.phase {
            Phase::Resting(rest) => Some(rest),
            Phase::Idle | Phase::Working(_) => None,
        }
    }

    /// Begins the generation of the view. `first_step`: of a member of a group.
    pub(super) fn begin(&mut self, surface: u8, number: u32, jobs: u64, first_step: Option<FirstStep>) {
        let mut view = self.view.clone();
        view.budget = view.budget.and(self.allotted.or(view.budget));
        // What differs replaces what is shown at once: a coarse surface in between would be sent as a whole, twice.
        let shown = match self.holds_another_step {
            true => Shown::Alike,
            false => self.shown_for(&view),
        };
        let mut generation = Generation::of_edit(surface, number, view, shown);
        generation.waits_since = jobs;
        generation.first_step = first_step;
        self.edit_pending = false;
        self.phase = Phase::Working(Box::new(generation));
    }

    /// The volume is at another time step. Values in force stay, the range of the feature too; what was made once is made anew.
    pub(super) fn step(&mut self) {
        if let (None, Some((field, feature, range))) = (self.view.feature_range, &self.feature_range)
            && (field, feature) == (&self.view.field, &self.view.feature)
        {
            self.view.feature_range = Some(*range);
        }
        self.holds_another_step |= !self.held.is_empty();
        (self.shown, self.shown_generation, self.full) = (None, 0, None);
        self.edit_pending = self.edited > 0;
    }

    /// Ends what is done. Dropping a generation or a rest cancels its token: the device's job returns later.
    pub(super) fn stop(&mut self) -> Option<Box<Generation>> {
        match std::mem::replace(&mut self.phase, Phase::Idle) {
            Phase::Working(generation) => Some(generation),
            Phase::Idle | Phase::Resting(_) => None,
        }
    }

    /// Whether a generation is made, or is to be.
    pub(super) fn is_busy(&self) -> bool {
        self.edit_pending || self.generation().is_some()
    }

    /// How what the client holds relates to a surface of this view.
    pub(super) fn shown_for(&self, view: &View) -> Shown {
        let shown = self.shown.as_ref();
        shown.map_or(Shown::Another, |(shown, cut)| shown_for(shown, *cut, view))
    }

    /// Triangles of the full surface of a view, where that is known.
    pub(super) fn full_of(&self, view: &View) -> Option<u64> {
        let (of, triangles) = self.full.as_ref()?;
        is_same_surface(of, view).then_some(*triangles)
    }
}
