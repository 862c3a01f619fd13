//! One surface of a connection: its view, its phase, and the regions that the client holds.

use std::sync::Arc;

use isopeel_extraction::{Shown, SurfaceKey, ViewKey};
use isopeel_view::quality::Budget;
use isopeel_view::{CameraJson, View};

use super::super::groups::FirstStep;
use super::super::shared::HeldRegions;
use super::generation::Generation;
use super::pending::PendingView;
use super::rest::Rest;
use super::shown::HeldSurface;

pub(super) struct SurfaceSession {
    /// The view in force: resolved, with all samples that it uses loaded. Its budget is that of the connection.
    pub view: View,
    /// Whether the surface was created with the opening of the volume, not by an edit.
    pub is_opening: bool,
    /// Key of the view's full surface, once the view has come into force.
    pub key: Option<SurfaceKey>,
    /// Edits that have not come into force yet.
    pub pending: Option<PendingView>,
    /// The last view in force of which the device has counted or made a surface.
    pub proven: Option<View>,
    /// Whether the view in force or the surface's part of the budget has changed since the last generation began.
    pub edit_pending: bool,
    /// Number, among the connection's edits, of the last edit of this surface that came into force.
    pub last_edit: u64,
    pub phase: Phase,
    /// Regions that the client holds.
    pub held: Arc<HeldRegions>,
    /// Triangles that the client holds.
    pub held_triangles: u64,
    /// The view and the cut of the surface that the client holds.
    pub shown: Option<HeldSurface>,
    /// The generation of the surface shown; 0 if none is shown.
    pub shown_generation: u32,
    /// The newest full surface whose triangles were counted, and their number.
    pub full: Option<(SurfaceKey, u64)>,
    /// The surface's part of the budget, for the newest or the next generation.
    pub allotted: Option<Budget>,
    /// The budget of the last final surface that the client got, as an absolute number of triangles or bytes.
    pub held_budget: Option<Budget>,
    /// Set if the last generation of the view in force failed.
    pub failed: Option<Failed>,
    /// Whether the regions that the client holds are of another time step.
    pub holds_another_step: bool,
}

/// A failure of the last generation of a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Failed {
    /// Triangles of all surfaces that shared the budget at that time: the suggested budget depends on them.
    pub shared_triangles: Option<u64>,
    /// Whether a retry may help, because something has changed since the failure, or because the surface's part of the budget may change.
    pub may_retry: bool,
}

/// Phase of a surface. `Idle --edit--> Working --final surface committed--> Resting --measured--> Idle`; a better surface goes from
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
            is_opening: false,
            key: None,
            pending: None,
            proven: None,
            edit_pending: false,
            last_edit: 0,
            phase: Phase::Idle,
            held: Arc::default(),
            held_triangles: 0,
            shown: None,
            shown_generation: 0,
            full: None,
            allotted: None,
            held_budget: None,
            failed: None,
            holds_another_step: false,
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

    /// Returns the view in force with the surface's part of the budget, for a camera.
    pub(super) fn view_for(&self, camera: Option<CameraJson>) -> View {
        View {
            budget: self.view.budget.and(self.allotted.or(self.view.budget)),
            camera: camera.map(Box::new),
            ..self.view.clone()
        }
    }

    /// Begins a generation of the view in force. `key`: key of the view's full surface. `jobs`: number of the connection's jobs so far.
    /// `first_step`: guard of a member of a group.
    pub(super) fn begin(
        &mut self,
        surface: u8,
        number: u32,
        key: SurfaceKey,
        camera: Option<CameraJson>,
        jobs: u64,
        first_step: Option<FirstStep>,
    ) {
        let view = self.view_for(camera);
        // After a change of the time step the regions that differ are replaced in one step. An intermediate coarse surface would send all
        // of them twice.
        let shown = match (&self.shown, self.holds_another_step) {
            (_, true) => Shown::Alike,
            (None, false) => Shown::Another,
            (Some(held), false) => held.shown_for(&key, &view),
        };
        self.key = Some(key.clone());
        let key = ViewKey::new(key, &view);
        let mut generation = Generation::from_edit(surface, number, view, key, shown);
        generation.first_step = first_step;
        self.begin_generation(generation, jobs);
    }

    pub(super) fn begin_generation(&mut self, mut generation: Generation, jobs: u64) {
        generation.waiting_since_job = jobs;
        self.edit_pending = false;
        self.failed = None;
        self.phase = Phase::Working(Box::new(generation));
    }

    /// Switches to another time step of the volume. All values in force stay, including the range of the feature. A surface that an edit
    /// has requested is made again.
    pub(super) fn switch_step(&mut self) {
        self.holds_another_step |= !self.held.is_empty();
        (self.shown, self.shown_generation, self.full, self.key) = (None, 0, None, None);
        self.edit_pending = self.last_edit > 0;
    }

    /// Ends the work for this surface, and returns the generation if there was one. Dropping a generation or a [`Rest`] cancels its token;
    /// the device's job returns later.
    pub(super) fn stop(&mut self) -> Option<Box<Generation>> {
        match std::mem::replace(&mut self.phase, Phase::Idle) {
            Phase::Working(generation) => Some(generation),
            Phase::Idle | Phase::Resting(_) => None,
        }
    }

    /// Marks the view in force as valid, because the device has counted or made a surface of it.
    pub(super) fn mark_proven(&mut self) {
        if !self.edit_pending {
            self.proven = Some(self.view.clone());
        }
    }

    /// Whether a generation is being made, or is still to be made.
    pub(super) fn is_busy(&self) -> bool {
        self.edit_pending || self.generation().is_some()
    }

    /// Whether the surface was added by an edit that has not come into force yet.
    pub(super) fn is_new(&self) -> bool {
        self.last_edit == 0 && !self.is_opening
    }

    /// Whether the surface still has a generation to finish, or an edit that has not come into force.
    pub(super) fn is_awaited(&self) -> bool {
        self.is_busy() || self.pending.is_some()
    }

    /// Returns the view after all edits of the surface, in force or not.
    pub(super) fn edited_view(&self, fields: &[&str]) -> View {
        let pending = self.pending.as_ref();
        pending.map_or_else(|| self.view.clone(), |pending| pending.last_view(fields))
    }
}
