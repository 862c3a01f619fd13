//! The open volume and its surfaces.

use isopeel_codec::chunk::MAX_SURFACES;
use isopeel_view::View;
use isopeel_volumes::{Lease, VolumeStep};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::backend::Backend;
use super::Session;
use super::generation::{Generation, Sending};
use super::outbox::Newest;
use super::pending::{NamedBudget, PendingStep};
use super::rest::Rest;
use super::surface::SurfaceSession;
use crate::service::{OpenStepGuard, OpeningProgress};

pub(super) struct OpenVolume {
    pub volume: VolumeStep,
    /// The opening view, with which a new surface begins.
    view: View,
    pub phase: OpeningPhase,
    /// Progress of the opening, until the volume is open.
    pub progress: Option<watch::Receiver<OpeningProgress>>,
    pub device: String,
    /// Whether the device is this machine's processors, which the pool needs too.
    pub shares_processors: bool,
    /// Surfaces, indexed by their numbers.
    surfaces: [Option<SurfaceSession>; MAX_SURFACES as usize],
    /// The connection's budget, once an edit has named one.
    named: Option<NamedBudget>,
    /// The time step that the client has requested, until it comes into force.
    pub stepping: Option<PendingStep>,
    /// The time step that the client is expected to request next, until it is read ahead.
    pub expected: Option<u32>,
    /// Since when the client shows a time step whose description it does not have.
    pub undescribed_since: Option<Instant>,
    /// Marks the volume as in use, and tells when it is removed.
    pub lease: Lease,
    /// Keeps the step's samples on the device while others are read ahead.
    pub step_guard: OpenStepGuard,
    /// Token of the work for this time step.
    pub step_token: CancellationToken,
    pub _cancel_step: DropGuard,
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
        let message = "this volume was removed from the server: nothing more is made of it, GET /api/v1/volumes lists those there are";
        self.send_error("volume-removed", message, true);
    }
}

impl OpenVolume {
    /// Creates an open volume with surface 0, which is not made before an edit.
    pub(super) fn new(volume: VolumeStep, view: View, step_guard: OpenStepGuard, lease: Lease) -> Self {
        let (token, step_token) = (CancellationToken::new(), CancellationToken::new());
        let mut surfaces = [const { None }; MAX_SURFACES as usize];
        surfaces[0] = Some(SurfaceSession {
            is_opening: true,
            ..SurfaceSession::new(view.clone())
        });
        Self {
            volume,
            view,
            phase: OpeningPhase::Waiting,
            progress: None,
            device: String::new(),
            shares_processors: false,
            surfaces,
            named: None,
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

    /// Records that the volume is open, with its resolved opening view. Values that were edited meanwhile stay; the others are taken from
    /// this view, which `opened` states. Edits that need resolving are held back.
    pub(super) fn opened(&mut self, view: View, edits: u64) {
        (self.phase, self.progress) = (OpeningPhase::Open, None);
        let opening = std::mem::replace(&mut self.view, view);
        let has_own_range = opening.feature_range.is_none();
        let opening_feature = (opening.feature, opening.field);
        for number in 0..MAX_SURFACES {
            let (begins, iso, range) = (self.view.clone(), self.view.iso, self.view.feature_range);
            let Some(surface) = self.surface_mut(number) else {
                continue;
            };
            surface.view.iso = surface.view.iso.or(iso);
            let feature = (surface.view.feature.clone(), surface.view.field.clone());
            if has_own_range && feature == opening_feature {
                surface.view.feature_range = surface.view.feature_range.or(range);
            }
            if surface.edit_pending {
                let budget = surface.view.budget;
                let edited = std::mem::replace(&mut surface.view, View { budget, ..begins });
                if self.has_to_resolve(number, &edited) {
                    self.hold_back(number, edited, None, edits, None);
                    if let Some(surface) = self.surface_mut(number) {
                        (surface.edit_pending, surface.edited) = (false, 0);
                    }
                } else if let Some(surface) = self.surface_mut(number) {
                    surface.view = edited;
                }
            }
        }
    }

    pub(super) fn surface(&self, number: u8) -> Option<&SurfaceSession> {
        self.surfaces.get(usize::from(number))?.as_ref()
    }

    pub(super) fn surface_mut(&mut self, number: u8) -> Option<&mut SurfaceSession> {
        self.surfaces.get_mut(usize::from(number))?.as_mut()
    }

    /// All surfaces with their numbers.
    pub(super) fn surfaces(&self) -> impl Iterator<Item = (u8, &SurfaceSession)> {
        (0..)
            .zip(&self.surfaces)
            .filter_map(|(number, s)| Some((number, s.as_ref()?)))
    }

    /// Postpones the work at rest of all surfaces, because the viewer wants something else: also that of a surface whose edit is being
    /// resolved, which would wait for the device otherwise.
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
    pub(super) fn of_generation(&mut self, number: u32) -> Option<(u8, &mut SurfaceSession)> {
        self.surfaces_mut().find(|(_, surface)| {
            surface
                .generation()
                .is_some_and(|generation| generation.number == number)
        })
    }

    /// Returns the surface that rests after the generation of this number.
    pub(super) fn of_rest(&mut self, number: u32) -> Option<(u8, &mut SurfaceSession)> {
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
        let mut view = self.view.clone();
        view.budget = budget.or(view.budget);
        view
    }

    /// Returns the view in force of a surface. A surface that does not exist yet begins with the opening view and the connection's budget.
    pub(super) fn view_of(&self, number: u8) -> View {
        if let Some(surface) = self.surface(number) {
            return surface.view.clone();
        }
        let mut view = self.view.clone();
        let budget = self.surfaces().find_map(|(_, surface)| surface.view.budget);
        view.budget = budget.or(view.budget);
        view
    }

    /// Sets the view of a surface that edits have changed. `named`: also sets the connection's budget, unless a later edit has changed it.
    pub(super) fn set_view(&mut self, number: u8, mut view: View, named: Option<NamedBudget>) {
        if let Some(named) = named {
            let newest = self.name_budget(number, named);
            view.budget = view.budget.and(Some(newest.budget));
        }
        let surface = self.surface_or_new(number, view.clone());
        surface.view = view;
    }

    /// Gives the other surfaces the budget that an edit of this surface has named, unless a later edit has named another budget. Returns
    /// the latest budget.
    fn name_budget(&mut self, number: u8, named: NamedBudget) -> NamedBudget {
        if let Some(newer) = self.named.filter(|newer| newer.edit > named.edit) {
            return newer;
        }
        self.named = Some(named);
        for (_, other) in self.surfaces_mut().filter(|(other, _)| *other != number) {
            other.view.budget = other.view.budget.and(Some(named.budget));
            if let Some(pending) = &mut other.pending
                && pending.named.is_none_or(|newer| newer.edit < named.edit)
            {
                pending.view.budget = pending.view.budget.and(Some(named.budget));
            }
        }
        named
    }

    /// Returns a surface; creates it with `view` if it does not exist yet.
    pub(super) fn surface_or_new(&mut self, number: u8, view: View) -> &mut SurfaceSession {
        self.surfaces[usize::from(number)].get_or_insert_with(|| SurfaceSession::new(view))
    }

    /// Returns the view with which a new surface begins.
    pub(super) fn opening_view(&self) -> &View {
        &self.view
    }

    /// Removes a surface at the request of its user. The other surfaces keep a budget that one of its edits has named, even if that edit
    /// is still being checked.
    pub(super) fn remove_at_wish(&mut self, number: u8) {
        let fields = self.volume.dataset().field_names();
        let pending = self.surface(number).and_then(|surface| surface.pending.as_ref());
        let named = pending.and_then(|pending| pending.last_named(&fields));
        if let Some(named) = named {
            self.name_budget(number, named);
        }
        self.remove(number);
    }

    /// Drops the state of a surface.
    pub(super) fn remove(&mut self, number: u8) {
        self.surfaces[usize::from(number)] = None;
    }
}
