//! Resolves views before they come into force. A view is resolved if its isovalue and the range of its feature are numbers, and if the
//! samples of its fields are loaded, including computed and masked ones. Until then the previous view stays in force and is shown. So an
//! invalid edit changes nothing. A time step is dropped if one of the surfaces cannot be made of it.
//!
//! Messages take effect in the order in which they came. An edit that needs no resolving comes into force at once. If an edit
//! leaves a value open, the value is resolved for the time step that was pending when the edit came, or else for the step in force. A later
//! time step does not change the value.

use isopeel_extraction::WorkError;
use isopeel_view::{Edit, View};
use isopeel_volumes::{StepKey, VolumeStep};
use tokio_util::sync::CancellationToken;

use super::super::backend::Backend;
use super::Session;
use super::jobs::BoxFuture;
use super::open_volume::{OpenVolume, OpeningPhase};
use super::pending::{BudgetEdit, MAX_WAITING_EDITS, PendingView, WaitingEdit};
use super::surface::SurfaceSession;
use crate::error::chain;
use crate::metrics;
use crate::wire::messages::ServerMessage;

/// Result of resolving one view, or those of all surfaces for a time step.
pub(super) enum Resolved {
    View {
        surface: u8,
        requested: Box<PendingView>,
        result: Result<View, WorkError>,
    },
    Step {
        step: StepKey,
        /// The resolved views of all surfaces, or the surface that cannot be made of the step with its error.
        result: Result<Vec<(u8, View)>, (u8, WorkError)>,
    },
}

impl OpenVolume {
    /// Whether the device has to resolve a view before the view may replace the one in force.
    pub(super) fn has_to_resolve(&self, surface: u8, view: &View) -> bool {
        let in_force = self.view_of(surface);
        let has_other_inputs = view.field != in_force.field
            || view.mask != in_force.mask
            || view.feature != in_force.feature
            || view.color_field != in_force.color_field;
        view.iso.is_none() || view.feature_range.is_none() || has_other_inputs
    }

    /// Returns the pending time step, or else the one in force.
    fn newest_step(&self) -> &VolumeStep {
        self.stepping.as_ref().map_or(&self.volume, |stepping| &stepping.volume)
    }

    /// Whether a new surface has to wait because pending edits of other surfaces may change the budget with which it begins.
    fn waits_for_budget(&self, surface: u8) -> bool {
        let fields = self.volume.dataset().field_names();
        let may_change_budget = |other: &SurfaceSession| {
            other.pending.is_some() && (other.is_new() || other.edited_view(&fields).budget != other.view.budget)
        };
        self.surface(surface).is_none_or(SurfaceSession::is_new)
            && self
                .surfaces()
                .any(|(number, other)| number != surface && may_change_budget(other))
    }

    /// Removes the surfaces that are not in force yet, and returns their waiting edits in the order in which they came.
    fn take_new_surfaces(&mut self) -> Vec<(u8, Vec<WaitingEdit>)> {
        let new = self.surfaces().filter_map(|(number, surface)| {
            let pending = surface.pending.as_ref().filter(|pending| !pending.edits.is_empty())?;
            let edits = pending.edits.iter().chain(&pending.queue).cloned().collect();
            surface.is_new().then_some((number, edits))
        });
        let mut new: Vec<(u8, Vec<WaitingEdit>)> = new.collect();
        new.sort_by_key(|(_, edits)| edits[0].number);
        for (number, _) in &new {
            self.remove(*number);
        }
        new
    }

    /// Returns the next view to resolve on its own: the one with the oldest waiting edit. Skips views of the pending time step, which wait
    /// for that step.
    fn next_pending(&self) -> Option<(u8, &PendingView)> {
        let pending_step = self.stepping.as_ref().map(|stepping| stepping.volume.key());
        let pending = self.surfaces().filter_map(|(number, surface)| {
            let pending = surface.pending.as_ref().filter(|pending| !pending.is_paused)?;
            (Some(pending.step.key()) != pending_step).then_some((number, pending))
        });
        pending.min_by_key(|(_, pending)| pending.first_edit())
    }
}

impl<B: Backend> Session<B> {
    /// Handles an edit of a surface. `view`: the view after the edit, which comes into force at once or when it is resolved.
    pub(super) fn accept_edit(&mut self, surface: u8, view: View, edit: &Edit) {
        self.begin_edit();
        let Some(opened) = &mut self.opened else { return };
        let waiting = WaitingEdit {
            edit: edit.clone(),
            step: opened.newest_step().clone(),
            number: self.edits,
            makes_surface: true,
        };
        self.apply_edit(surface, view, waiting);
    }

    /// As [`Session::accept_edit`], for an edit that [`Session::begin_edit`] has numbered before.
    fn apply_edit(&mut self, surface: u8, view: View, waiting: WaitingEdit) {
        let Some(opened) = &mut self.opened else { return };
        let budget_edit = BudgetEdit::new(&waiting, &view);
        // Before the volume is open, nothing can be resolved.
        if opened.phase != OpeningPhase::Open {
            return self.come_into_force(surface, view, budget_edit, self.edits, true);
        }
        let pending = opened.surface_mut(surface).and_then(|session| session.pending.as_mut());
        // Waiting edits come into force with this one, so keep the budget that they have set.
        let budget_edit = budget_edit.or(pending.as_ref().and_then(|pending| pending.budget_edit));
        if let Some(pending) = pending.filter(|pending| !pending.queue.is_empty()) {
            if pending.queue.len() < MAX_WAITING_EDITS {
                pending.queue.push(waiting);
            } else {
                self.send_surface_error(
                    surface,
                    "busy",
                    "too many edits wait for an earlier one to be checked".into(),
                );
            }
            return;
        }
        if !opened.has_to_resolve(surface, &view) && !opened.waits_for_budget(surface) {
            return self.come_into_force(surface, view, budget_edit, self.edits, waiting.makes_surface);
        }
        opened.hold_back(surface, view, budget_edit, self.edits, Some(waiting));
    }

    /// Applies edits one by one. The first one that has to be resolved holds back those behind it.
    fn apply_edits(&mut self, surface: u8, edits: Vec<WaitingEdit>) {
        let mut edits = edits.into_iter();
        while let Some(waiting) = edits.next() {
            let Some(opened) = &mut self.opened else { return };
            let fields = opened.volume.dataset().field_names();
            match opened.edited_view_of(surface).apply(&waiting.edit, &fields) {
                Ok(view) => self.apply_edit(surface, view, waiting),
                Err(error) => self.send_surface_error(surface, "bad-edit", error.to_string()),
            }
            let pending = self
                .opened
                .as_mut()
                .and_then(|opened| opened.surface_mut(surface)?.pending.as_mut());
            if let Some(pending) = pending {
                pending.queue = edits.collect();
                return;
            }
        }
    }

    /// Numbers an edit that has come, and gives it precedence: cancels questions, drops annotations, and postpones work at rest.
    pub(super) fn begin_edit(&mut self) {
        self.edits += 1;
        self.questions.cancel_for_edit();
        self.outbox.drop_annotations();
        if let Some(opened) = &mut self.opened {
            opened.postpone_rest();
        }
    }

    /// Replaces the view in force of a surface. `edit`: number of the last edit that led to the view. `makes_surface`: whether a surface of
    /// the view is made.
    pub(super) fn come_into_force(
        &mut self,
        surface: u8,
        view: View,
        budget_edit: Option<BudgetEdit>,
        edit: u64,
        makes_surface: bool,
    ) {
        let Some(opened) = &mut self.opened else { return };
        opened.set_view(surface, view, budget_edit);
        if let Some(session) = opened.surface_mut(surface) {
            session.last_edit = edit;
            (session.pending, session.failed, session.key) = (None, None, None);
        }
        self.change(surface);
        if !makes_surface && let Some(session) = self.opened.as_mut().and_then(|opened| opened.surface_mut(surface)) {
            session.edit_pending = false;
        }
        if let Some(opened) = &mut self.opened {
            opened.offer_retries();
        }
        self.allot(Some(surface));
    }

    /// Resolves the next edit or time step, if none is being resolved.
    pub(super) fn advance_resolving(&mut self) {
        let Some(opened) = &mut self.opened else { return };
        if self.resolving.is_some() || opened.phase != OpeningPhase::Open {
            return;
        }
        let job = match (opened.next_pending(), &opened.stepping) {
            (Some((surface, pending)), _) => resolve_view(self.backend.clone(), surface, pending.clone()),
            (None, Some(stepping)) => {
                let edited = opened.surfaces().filter(|(_, surface)| surface.last_edit > 0);
                let views = edited.map(|(number, surface)| (number, surface.view.clone())).collect();
                resolve_step(self.backend.clone(), stepping.volume.clone(), views)
            }
            (None, None) => return,
        };
        self.resolving = Some(job);
    }

    /// Handles the result of [`Session::advance_resolving`].
    pub(super) fn on_resolved(&mut self, resolved: Resolved) {
        match resolved {
            Resolved::View {
                surface,
                requested,
                result,
            } => self.on_resolved_view(surface, &requested, result),
            Resolved::Step { step, result } => self.on_resolved_step(&step, result),
        }
    }

    fn on_resolved_view(&mut self, surface: u8, requested: &PendingView, result: Result<View, WorkError>) {
        let session = self.opened.as_mut().and_then(|opened| opened.surface_mut(surface));
        let pending = session.and_then(|session| session.pending.as_mut());
        // A newer edit needs other values: drop this result and resolve that edit next.
        if !pending.is_some_and(|pending| pending.resolves_like(requested)) {
            return;
        }
        match result {
            Ok(resolved) => self.accept_resolved_view(surface, &resolved),
            Err(error) if error.rejects_view() => self.reject_view(surface, &error),
            Err(error) => self.pause_resolving(surface, &error),
        }
    }

    /// Brings the pending view of a surface into force, with the values that were resolved, and applies the edits that wait behind it.
    fn accept_resolved_view(&mut self, surface: u8, resolved: &View) {
        let Some(opened) = &mut self.opened else { return };
        let in_force = opened.volume.clone();
        let session = opened.surface_mut(surface);
        let Some(pending) = session.and_then(|session| session.pending.as_mut()) else {
            return;
        };
        let PendingView {
            mut view,
            budget_edit,
            edit,
            makes_surface,
            queue,
            ..
        } = pending.clone();
        view.iso = view.iso.or(resolved.iso);
        view.feature_range = view.feature_range.or(resolved.feature_range);
        // The view was resolved for a time step that is not in force any more. Its values stay, but its samples must also be loaded for the
        // step in force.
        if pending.step.key() != in_force.key() {
            (pending.view, pending.step) = (view, in_force);
            return;
        }
        self.come_into_force(surface, view, budget_edit, edit, makes_surface);
        self.apply_edits(surface, queue);
        self.lead_or_follow();
    }

    /// Handles an error that a retry may avoid. If the view was to be resolved for a time step that is no longer in force, the view is
    /// resolved for the step in force next. Otherwise the view waits for the next edit.
    fn pause_resolving(&mut self, surface: u8, error: &WorkError) {
        let Some(opened) = &mut self.opened else { return };
        let in_force = opened.volume.clone();
        let session = opened.surface_mut(surface);
        let Some(pending) = session.and_then(|session| session.pending.as_mut()) else {
            return;
        };
        if pending.step.key() == in_force.key() {
            pending.is_paused = true;
            self.send_surface_error(surface, error.code(), error.public_message());
        } else {
            tracing::debug!(
                error = chain(error),
                "a view could not be resolved for a time step that is no longer in force"
            );
            pending.step = in_force;
        }
    }

    /// Rejects the pending view of a surface. If several edits led to it, applies them one by one to find the invalid one.
    fn reject_view(&mut self, surface: u8, error: &WorkError) {
        let Some(opened) = &mut self.opened else { return };
        let Some(session) = opened.surface_mut(surface) else {
            return;
        };
        let Some(pending) = session.pending.take() else { return };
        if pending.edits.len() > 1 {
            return self.apply_edits(surface, pending.edits);
        }
        tracing::debug!(error = chain(error), "an edit does not come into force");
        if session.is_new() {
            opened.remove(surface);
        }
        let new = opened.take_new_surfaces();
        self.send_surface_error(surface, error.code(), error.public_message());
        self.apply_edits(surface, pending.queue);
        // These surfaces may have begun with the budget of the invalid edit.
        for (surface, edits) in new {
            self.apply_edits(surface, edits);
        }
        self.lead_or_follow();
    }

    /// Brings a time step into force, or drops it if a surface cannot be made of it.
    fn on_resolved_step(&mut self, step: &StepKey, result: Result<Vec<(u8, View)>, (u8, WorkError)>) {
        let Some(opened) = &mut self.opened else { return };
        let Some(stepping) = opened.stepping.take_if(|stepping| stepping.volume.key() == *step) else {
            return;
        };
        match result {
            Ok(views) => {
                for (number, resolved) in views {
                    if let Some(session) = opened.surface_mut(number) {
                        session.view.iso = session.view.iso.or(resolved.iso);
                    }
                }
                self.bring_step_into_force(stepping);
                self.lead_or_follow();
            }
            Err((surface, error)) => {
                tracing::debug!(error = chain(&error), "a time step does not come into force");
                opened.resolve_for_step_in_force(step);
                let message = format!(
                    "step {} is not shown, step {} stays: {}",
                    step.step,
                    opened.volume.step(),
                    error.public_message()
                );
                self.send_surface_error(surface, "step-failed", message);
            }
        }
    }

    /// Sends an error that concerns one surface. The volume stays open.
    pub(super) fn send_surface_error(&mut self, surface: u8, code: &'static str, message: String) {
        metrics::stream_error(code);
        self.send(&ServerMessage::Error {
            code,
            message,
            open: true,
            surface: Some(surface),
            suggested_triangles: None,
        });
    }
}

impl OpenVolume {
    /// Stores the view of an edit until the view is resolved. `edit`: number of the edit. `waiting`: the edit itself; if it is `None`, the
    /// edits that led to the view cannot be applied one by one.
    pub(super) fn hold_back(
        &mut self,
        number: u8,
        view: View,
        budget_edit: Option<BudgetEdit>,
        edit: u64,
        waiting: Option<WaitingEdit>,
    ) {
        let step = waiting
            .as_ref()
            .map_or_else(|| self.newest_step().clone(), |waiting| waiting.step.clone());
        let view_in_force = self.view_of(number);
        let surface = self.surface_or_new(number, view_in_force);
        let before = surface.pending.take();
        // A range that an earlier edit left open is still resolved for that edit's time step, unless this edit has another feature.
        let step = match &before {
            Some(before) if before.leaves_range_open(&view) => before.step.clone(),
            _ => step,
        };
        let makes_surface = waiting.as_ref().is_none_or(|waiting| waiting.makes_surface);
        let is_first = before.is_none();
        let mut edits = before.map_or_else(Vec::new, |before| before.edits);
        // An incomplete list could not be applied one by one, so once an edit is missing, the list stays empty.
        match waiting {
            Some(waiting) if is_first || (1..MAX_WAITING_EDITS).contains(&edits.len()) => edits.push(waiting),
            _ => edits.clear(),
        }
        surface.pending = Some(PendingView {
            view,
            step,
            budget_edit,
            edit,
            makes_surface,
            is_paused: false,
            edits,
            queue: Vec::new(),
        });
    }

    /// After a time step has failed, redirects the views that were to be resolved for that step to the step in force.
    fn resolve_for_step_in_force(&mut self, failed: &StepKey) {
        let in_force = self.volume.clone();
        let pending = self.surfaces_mut().filter_map(|(_, surface)| surface.pending.as_mut());
        for pending in pending.filter(|pending| pending.step.key() == *failed) {
            pending.step = in_force.clone();
        }
    }
}

/// Returns the job that resolves a view. Dropping the job cancels it.
fn resolve_view<B: Backend>(backend: B, surface: u8, requested: PendingView) -> BoxFuture<Resolved> {
    let token = CancellationToken::new();
    let guard = token.clone().drop_guard();
    Box::pin(async move {
        let _guard = guard;
        let result = backend.resolve(&requested.step, &requested.view, &token).await;
        Resolved::View {
            surface,
            requested: Box::new(requested),
            result,
        }
    })
}

/// Returns the job that resolves the views of surfaces for a time step, one after the other. The first error ends it. Dropping the job
/// cancels it.
fn resolve_step<B: Backend>(backend: B, volume: VolumeStep, views: Vec<(u8, View)>) -> BoxFuture<Resolved> {
    let token = CancellationToken::new();
    let guard = token.clone().drop_guard();
    Box::pin(async move {
        let _guard = guard;
        let resolve_all = async {
            let mut resolved = Vec::new();
            for (number, view) in views {
                let result = backend.resolve(&volume, &view, &token).await;
                resolved.push((number, result.map_err(|error| (number, error))?));
            }
            Ok(resolved)
        };
        Resolved::Step {
            step: volume.key(),
            result: resolve_all.await,
        }
    })
}
