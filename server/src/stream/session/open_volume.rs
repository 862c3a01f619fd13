//! The open volume and its surfaces.

use isopeel_codec::chunk::MAX_SURFACES;
use isopeel_extraction::{EngineId, OpenStepGuard};
use isopeel_kernels::{DeviceInfo, DeviceKind};
use isopeel_view::View;
use isopeel_volumes::{Lease, VolumeStep};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::backend::Backend;
use super::Session;
use super::generation::{Generation, Sending};
use super::outbox::Newest;
use super::pending::{BudgetEdit, PendingStep};
use super::rest::Rest;
use super::surface::SurfaceSession;
use crate::service::OpeningProgress;

/// The volume of a session, from the message `open` on.
pub(super) struct OpenVolume {
    pub volume: VolumeStep,
    /// The view with which a new surface begins. Resolved once the volume is open.
    opening_view: View,
    pub phase: OpeningPhase,
    /// Progress of the opening, until the volume is open.
    pub progress: Option<watch::Receiver<OpeningProgress>>,
    /// The engine for which the last generation was begun.
    pub engine: EngineId,
    /// Name of the device; empty until the volume is open.
    pub device: String,
    /// Whether the device is this machine's processors, which the pool needs too.
    pub shares_processors: bool,
    /// Surfaces, indexed by their numbers.
    surfaces: [Option<SurfaceSession>; MAX_SURFACES as usize],
    /// The connection's budget, and the edit that has set it.
    budget_edit: Option<BudgetEdit>,
    /// The time step that the client has requested, until it comes into force.
    pub stepping: Option<PendingStep>,
    /// The time step that the client is expected to request next, until its read-ahead begins.
    pub expected: Option<u32>,
    /// When the client began to show a time step whose description it does not have yet.
    pub undescribed_since: Option<Instant>,
    /// Marks the volume as in use, and notifies when it is removed.
    pub lease: Lease,
    /// Keeps the step's samples on the device while others are read ahead.
    pub step_guard: OpenStepGuard,
    /// Cancels the work for this time step.
    pub step_token: CancellationToken,
    /// Cancels `step_token` when another step comes into force.
    pub _cancel_step: DropGuard,
    /// Cancels all work for the volume.
    pub token: CancellationToken,
    /// Cancels `token`, and with it the job that opens the volume, when another one is opened.
    _cancel: DropGuard,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum OpeningPhase {
    /// The job that opens the volume was not yet queued.
    Waiting,
    /// The job is queued or runs.
    Opening,
    Open,
}

/// Resolves when the opening of the volume makes progress; never if no volume is being opened.
pub(super) async fn opening_progress(opened: &mut Option<OpenVolume>) -> OpeningProgress {
    if let Some(progress) = opened.as_mut().and_then(|opened| opened.progress.as_mut())
        && progress.changed().await.is_ok()
    {
        return *progress.borrow_and_update();
    }
    // The job has ended, or there is none.
    std::future::pending().await
}

impl<B: Backend> Session<B> {
    /// Ends all work for the open volume.
    pub(super) fn close_volume(&mut self) {
        for surface in 0..MAX_SURFACES {
            self.end_generation(surface);
        }
        (self.opened, self.resolving) = (None, None);
        self.ahead = None;
        self.questions.clear();
        self.outbox.drop_newest(Newest::Opening);
        self.outbox.drop_annotations();
    }

    /// Handles the removal of the open volume by a user or by its expiry. The viewer keeps its picture.
    pub(super) fn on_removed_volume(&mut self) {
        self.close_volume();
        let message = "this volume was removed from the server and cannot be edited any more, GET /api/v1/volumes lists the others";
        self.send_error("volume-removed", message, true);
    }
}

impl OpenVolume {
    /// Creates an open volume with surface 0, which is not made before an edit requests it.
    pub(super) fn new(volume: VolumeStep, view: View, step_guard: OpenStepGuard, lease: Lease) -> Self {
        let (token, step_token) = (CancellationToken::new(), CancellationToken::new());
        let mut surfaces = [const { None }; MAX_SURFACES as usize];
        surfaces[0] = Some(SurfaceSession {
            is_opening: true,
            ..SurfaceSession::new(view.clone())
        });
        Self {
            volume,
            opening_view: view,
            phase: OpeningPhase::Waiting,
            progress: None,
            engine: EngineId::default(),
            device: String::new(),
            shares_processors: false,
            surfaces,
            budget_edit: None,
            stepping: None,
            expected: None,
            undescribed_since: None,
            lease,
            step_guard,
            _cancel_step: step_token.clone().drop_guard(),
            step_token,
            _cancel: token.clone().drop_guard(),
            token,
        }
    }

    /// Records that the volume is open. `view`: the resolved opening view, which the message `opened` contains; `edits`: number of the
    /// connection's last edit.
    ///
    /// Values that were edited meanwhile stay; the others are taken from the opening view. Edits that need resolving are held back.
    pub(super) fn on_opened(&mut self, view: View, edits: u64) {
        (self.phase, self.progress) = (OpeningPhase::Open, None);
        let unresolved = std::mem::replace(&mut self.opening_view, view);
        for number in 0..MAX_SURFACES {
            self.fill_from_opening_view(number, &unresolved);
            self.hold_back_early_edit(number, edits);
        }
    }

    /// Records that another engine makes the surfaces from now on: the device was opened again, or `device` has taken the volume over.
    pub(super) fn change_engine(&mut self, engine: EngineId, step_guard: OpenStepGuard, device: Option<DeviceInfo>) {
        (self.engine, self.step_guard) = (engine, step_guard);
        if let Some(device) = device {
            self.shares_processors = device.kind == DeviceKind::Cpu;
            self.device = device.name;
        }
    }

    /// Sets the values of a surface that no edit has set. `unresolved`: the opening view before it was resolved.
    fn fill_from_opening_view(&mut self, number: u8, unresolved: &View) {
        let (iso, range) = (self.opening_view.iso, self.opening_view.feature_range);
        let Some(surface) = self.surface_mut(number) else {
            return;
        };
        surface.view.iso = surface.view.iso.or(iso);
        let is_same_feature = surface.view.feature == unresolved.feature && surface.view.field == unresolved.field;
        // A range that was resolved is valid for the feature of the opening view alone.
        if unresolved.feature_range.is_none() && is_same_feature {
            surface.view.feature_range = surface.view.feature_range.or(range);
        }
    }

    /// Holds back the view of a surface that an edit has changed before the volume was open, if the view must be resolved. Until then the
    /// opening view is in force.
    fn hold_back_early_edit(&mut self, number: u8, edits: u64) {
        let opening_view = self.opening_view.clone();
        let Some(surface) = self.surface_mut(number).filter(|surface| surface.edit_pending) else {
            return;
        };
        let budget = surface.view.budget;
        let edited = std::mem::replace(&mut surface.view, View { budget, ..opening_view });
        if self.has_to_resolve(number, &edited) {
            self.hold_back(number, edited, None, edits, None);
            if let Some(surface) = self.surface_mut(number) {
                (surface.edit_pending, surface.last_edit) = (false, 0);
            }
        } else if let Some(surface) = self.surface_mut(number) {
            surface.view = edited;
        }
    }

    pub(super) fn surface(&self, number: u8) -> Option<&SurfaceSession> {
        self.surfaces.get(usize::from(number))?.as_ref()
    }

    pub(super) fn surface_mut(&mut self, number: u8) -> Option<&mut SurfaceSession> {
        self.surfaces.get_mut(usize::from(number))?.as_mut()
    }

    /// Returns all surfaces with their numbers.
    pub(super) fn surfaces(&self) -> impl Iterator<Item = (u8, &SurfaceSession)> {
        (0..)
            .zip(&self.surfaces)
            .filter_map(|(number, s)| Some((number, s.as_ref()?)))
    }

    /// Postpones the work at rest of all surfaces, because the viewer has requested other work. This includes a surface whose edit is being
    /// resolved: resolving would otherwise wait for the device.
    pub(super) fn postpone_rest(&mut self) {
        for (_, surface) in self.surfaces_mut() {
            surface.rest_mut().into_iter().for_each(Rest::postpone);
        }
    }

    pub(super) fn surfaces_mut(&mut self) -> impl Iterator<Item = (u8, &mut SurfaceSession)> {
        (0..)
            .zip(&mut self.surfaces)
            .filter_map(|(number, s)| Some((number, s.as_mut()?)))
    }

    /// Returns the surface whose generation has this number.
    pub(super) fn surface_of_generation(&mut self, number: u32) -> Option<(u8, &mut SurfaceSession)> {
        self.surfaces_mut().find(|(_, surface)| {
            surface
                .generation()
                .is_some_and(|generation| generation.number == number)
        })
    }

    /// Returns the surface that rests after the generation of this number.
    pub(super) fn surface_at_rest(&mut self, number: u32) -> Option<(u8, &mut SurfaceSession)> {
        self.surfaces_mut()
            .find(|(_, surface)| surface.rest().is_some_and(|rest| rest.generation == number))
    }

    /// Returns the surface whose step is being sent. There is at most one, so that prefixes do not mix.
    pub(super) fn sending(&self) -> Option<u8> {
        let is_sending = |generation: &Generation| !matches!(generation.sending, Sending::Idle);
        let mut surfaces = self.surfaces();
        surfaces.find_map(|(number, surface)| surface.generation().is_some_and(is_sending).then_some(number))
    }

    /// Returns the view of a surface after all of its edits, in force or not. A surface that does not exist yet begins with the opening
    /// view and the connection's latest budget, in force or not.
    pub(super) fn edited_view_of(&self, number: u8) -> View {
        let fields = self.volume.dataset().field_names();
        if let Some(surface) = self.surface(number) {
            return surface.edited_view(&fields);
        }
        let budget = self
            .surfaces()
            .find_map(|(_, surface)| surface.edited_view(&fields).budget);
        let mut view = self.opening_view.clone();
        view.budget = budget.or(view.budget);
        view
    }

    /// Returns the view in force of a surface. A surface that does not exist yet begins with the opening view and the connection's budget.
    pub(super) fn view_of(&self, number: u8) -> View {
        if let Some(surface) = self.surface(number) {
            return surface.view.clone();
        }
        let mut view = self.opening_view.clone();
        let budget = self.surfaces().find_map(|(_, surface)| surface.view.budget);
        view.budget = budget.or(view.budget);
        view
    }

    /// Sets the view of a surface that edits have changed. If there is a `budget_edit`, also sets the connection's budget, unless a later
    /// edit has changed the budget.
    pub(super) fn set_view(&mut self, number: u8, mut view: View, budget_edit: Option<BudgetEdit>) {
        if let Some(budget_edit) = budget_edit {
            let newest = self.share_budget(number, budget_edit);
            view.budget = view.budget.and(Some(newest.budget));
        }
        let surface = self.surface_or_new(number, view.clone());
        surface.view = view;
    }

    /// Gives the other surfaces the budget that an edit of this surface has set, unless a later edit has set another one. Returns the
    /// latest budget.
    fn share_budget(&mut self, number: u8, budget_edit: BudgetEdit) -> BudgetEdit {
        if let Some(newer) = self.budget_edit.filter(|newer| newer.edit > budget_edit.edit) {
            return newer;
        }
        self.budget_edit = Some(budget_edit);
        for (_, other) in self.surfaces_mut().filter(|(other, _)| *other != number) {
            other.view.budget = other.view.budget.and(Some(budget_edit.budget));
            if let Some(pending) = &mut other.pending
                && pending.budget_edit.is_none_or(|newer| newer.edit < budget_edit.edit)
            {
                pending.view.budget = pending.view.budget.and(Some(budget_edit.budget));
            }
        }
        budget_edit
    }

    /// Returns a surface; creates it with `view` if it does not exist yet.
    pub(super) fn surface_or_new(&mut self, number: u8, view: View) -> &mut SurfaceSession {
        self.surfaces[usize::from(number)].get_or_insert_with(|| SurfaceSession::new(view))
    }

    /// Returns the view with which a new surface begins.
    pub(super) fn opening_view(&self) -> &View {
        &self.opening_view
    }

    /// Removes a surface at the request of the user. If an edit of that surface has set the budget, the other surfaces keep it, even if
    /// the edit is still being checked.
    pub(super) fn remove_by_user(&mut self, number: u8) {
        let fields = self.volume.dataset().field_names();
        let pending = self.surface(number).and_then(|surface| surface.pending.as_ref());
        let budget_edit = pending.and_then(|pending| pending.last_budget_edit(&fields));
        if let Some(budget_edit) = budget_edit {
            self.share_budget(number, budget_edit);
        }
        self.remove(number);
    }

    /// Drops the state of a surface. Its work is cancelled.
    pub(super) fn remove(&mut self, number: u8) {
        self.surfaces[usize::from(number)] = None;
    }
}
