//! Resolves views before they come into force. A view is resolved if its isovalue and the range of its feature are numbers, and if the
//! samples of its fields are loaded, including computed and masked ones. Until then the previous view stays in force and is shown. So an
//! invalid edit changes nothing. Nor does a time step if one of the surfaces cannot be made of it.
//!
//! Messages take effect in the order in which they came. Values that an edit leaves open are resolved for the time step that was pending
//! when the edit came, or else the one in force, even if another step follows soon. An edit that needs no resolving comes into force at
//! once.

use isopeel_extraction::WorkError;
use isopeel_view::{Edit, FeatureName, View};
use isopeel_volumes::{StepKey, VolumeStep};
use tokio_util::sync::CancellationToken;

use super::super::backend::Backend;
use super::Session;
use super::jobs::BoxFuture;
use super::open_volume::{OpenVolume, OpeningPhase};
use super::pending::{KeptEdit, MAX_KEPT_EDITS, NamedBudget, PendingView};
use super::surface::SurfaceSession;
use crate::error::chain;
use crate::metrics;
use crate::wire::messages::ServerMessage;

/// What the device has resolved.
pub(super) enum Resolved {
    View {
        surface: u8,
        asked: Box<PendingView>,
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
        let inputs = |view: &View| (view.field.clone(), view.mask.clone(), view.feature.clone());
        view.iso.is_none() || view.feature_range.is_none() || inputs(view) != inputs(&in_force)
    }

    /// Returns the pending time step, or else the one in force.
    fn newest_step(&self) -> &VolumeStep {
        self.stepping.as_ref().map_or(&self.volume, |stepping| &stepping.volume)
    }

    /// Whether a new surface has to wait because pending edits of other surfaces may change the budget with which it begins.
    fn waits_for_budget(&self, surface: u8) -> bool {
        let fields = self.volume.dataset().field_names();
        let is_open_question = |other: &SurfaceSession| {
            other.pending.is_some() && (other.is_new() || other.edited_view(&fields).budget != other.view.budget)
        };
        self.surface(surface).is_none_or(SurfaceSession::is_new)
            && self
                .surfaces()
                .any(|(number, other)| number != surface && is_open_question(other))
    }

    /// Removes the surfaces that are not in force yet, and returns their waiting edits in the order in which they came.
    fn take_new_surfaces(&mut self) -> Vec<(u8, Vec<KeptEdit>)> {
        let new = self.surfaces().filter_map(|(number, surface)| {
            let pending = surface.pending.as_ref().filter(|pending| !pending.edits.is_empty())?;
            let edits = pending.edits.iter().chain(&pending.queue).cloned().collect();
            surface.is_new().then_some((number, edits))
        });
        let mut new: Vec<(u8, Vec<KeptEdit>)> = new.collect();
        new.sort_by_key(|(_, edits)| edits[0].number);
        for (number, _) in &new {
            self.remove(*number);
        }
        new
    }

    /// Returns the next view to resolve on its own: the one with the oldest waiting edit. Skips views of the pending time step, which wait
    /// for that step.
    fn next_pending(&self) -> Option<(u8, &PendingView)> {
        let comes = self.stepping.as_ref().map(|stepping| stepping.volume.key());
        let pending = self.surfaces().filter_map(|(number, surface)| {
            let pending = surface.pending.as_ref().filter(|pending| !pending.is_paused)?;
            (Some(pending.at.key()) != comes).then_some((number, pending))
        });
        pending.min_by_key(|(_, pending)| pending.first_edit())
    }
}

impl<B: Backend> Session<B> {
    /// Handles an edit that leads to this view. The edit comes into force at once, or when the view is resolved.
    pub(super) fn take_edit(&mut self, surface: u8, view: View, edit: &Edit) {
        self.count_edit();
        let Some(opened) = &mut self.opened else { return };
        let kept = KeptEdit {
            edit: edit.clone(),
            at: opened.newest_step().clone(),
            number: self.edits,
            is_made: true,
        };
        self.apply(surface, view, kept);
    }

    /// As [`Session::take_edit`], for an edit that was kept until now.
    fn apply(&mut self, surface: u8, view: View, kept: KeptEdit) {
        let Some(opened) = &mut self.opened else { return };
        let named = NamedBudget::of(&kept, &view);
        // Before the volume is open, nothing can be resolved.
        if opened.phase != OpeningPhase::Open {
            return self.come_into_force(surface, view, named, self.edits, true);
        }
        let pending = opened.surface_mut(surface).and_then(|session| session.pending.as_mut());
        // Waiting edits come into force with this one, so keep the budget that they have named.
        let named = named.or(pending.as_ref().and_then(|pending| pending.named));
        if let Some(pending) = pending.filter(|pending| !pending.queue.is_empty()) {
            if pending.queue.len() < MAX_KEPT_EDITS {
                pending.queue.push(kept);
            } else {
                self.send_surface_error(surface, "busy", "too many edits wait for one that is checked".into());
            }
            return;
        }
        if !opened.has_to_resolve(surface, &view) && !opened.waits_for_budget(surface) {
            return self.come_into_force(surface, view, named, self.edits, kept.is_made);
        }
        opened.hold_back(surface, view, named, self.edits, Some(kept));
    }

    /// Applies edits that were kept, one by one. The first edit that has to be resolved holds back those behind it.
    fn apply_all(&mut self, surface: u8, edits: Vec<KeptEdit>) {
        let mut edits = edits.into_iter();
        while let Some(kept) = edits.next() {
            let Some(opened) = &mut self.opened else { return };
            let fields = opened.volume.dataset().field_names();
            match opened.edited_view_of(surface).apply(&kept.edit, &fields) {
                Ok(view) => self.apply(surface, view, kept),
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

    /// Counts an edit, and lets it take precedence over questions and over work at rest.
    pub(super) fn count_edit(&mut self) {
        self.edits += 1;
        self.questions.overtaken();
        self.outbox.drop_annotations();
        if let Some(opened) = &mut self.opened {
            opened.postpone_rest();
        }
    }

    /// Replaces the view in force.
    pub(super) fn come_into_force(
        &mut self,
        surface: u8,
        view: View,
        named: Option<NamedBudget>,
        edit: u64,
        is_made: bool,
    ) {
        let Some(opened) = &mut self.opened else { return };
        opened.set_view(surface, view, named);
        if let Some(session) = opened.surface_mut(surface) {
            session.edited = edit;
            (session.pending, session.failed, session.key) = (None, None, None);
        }
        self.change(surface);
        if !is_made && let Some(session) = self.opened.as_mut().and_then(|opened| opened.surface_mut(surface)) {
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
                let made = opened.surfaces().filter(|(_, surface)| surface.edited > 0);
                let views = made.map(|(number, surface)| (number, surface.view.clone())).collect();
                resolve_step(self.backend.clone(), stepping.volume.clone(), views)
            }
            (None, None) => return,
        };
        self.resolving = Some(job);
    }

    pub(super) fn on_resolved(&mut self, resolved: Resolved) {
        match resolved {
            Resolved::View { surface, asked, result } => self.on_resolved_view(surface, &asked, result),
            Resolved::Step { step, result } => self.on_resolved_step(&step, result),
        }
    }

    fn on_resolved_view(&mut self, surface: u8, asked: &PendingView, result: Result<View, WorkError>) {
        let Some(opened) = &mut self.opened else { return };
        let here = opened.volume.clone();
        let Some(session) = opened.surface_mut(surface) else {
            return;
        };
        // A newer edit needs other values: drop this result and resolve that edit next.
        let Some(pending) = session.pending.as_mut().filter(|pending| pending.resolves_like(asked)) else {
            return;
        };
        match result {
            Ok(resolved) => {
                let PendingView {
                    mut view,
                    named,
                    edit,
                    is_made,
                    queue,
                    ..
                } = pending.clone();
                view.iso = view.iso.or(resolved.iso);
                view.feature_range = view.feature_range.or(resolved.feature_range);
                // The view was resolved for a time step that was overtaken. Its values are kept, but its samples must also be loaded for
                // the step in force.
                if pending.at.key() != here.key() {
                    (pending.view, pending.at) = (view, here);
                    return;
                }
                self.come_into_force(surface, view, named, edit, is_made);
                self.apply_all(surface, queue);
                self.lead_or_follow();
            }
            Err(error) if !error.rejects_view() && pending.at.key() != here.key() => {
                tracing::debug!(error = chain(&error), "a time step that was overtaken gives no values");
                pending.at = here;
            }
            Err(error) if !error.rejects_view() => {
                pending.is_paused = true;
                self.send_surface_error(surface, error.code(), error.public_message());
            }
            // Apply the edits one by one to find the invalid one.
            Err(_) if pending.edits.len() > 1 => {
                let edits = std::mem::take(&mut pending.edits);
                session.pending = None;
                self.apply_all(surface, edits);
            }
            Err(error) => {
                tracing::debug!(error = chain(&error), "an edit does not come into force");
                let queue = std::mem::take(&mut pending.queue);
                session.pending = None;
                if session.is_new() {
                    opened.remove(surface);
                }
                let new = opened.take_new_surfaces();
                self.send_surface_error(surface, error.code(), error.public_message());
                self.apply_all(surface, queue);
                // These surfaces may have begun with the budget of the invalid edit.
                for (surface, edits) in new {
                    self.apply_all(surface, edits);
                }
                self.lead_or_follow();
            }
        }
    }

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
                self.step_into_force(stepping);
                self.lead_or_follow();
            }
            Err((surface, error)) => {
                tracing::debug!(error = chain(&error), "a time step does not come into force");
                opened.resolve_here(step);
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
    /// Keeps the view of an edit until it is resolved.
    pub(super) fn hold_back(
        &mut self,
        number: u8,
        view: View,
        named: Option<NamedBudget>,
        edit: u64,
        kept: Option<KeptEdit>,
    ) {
        let at = kept
            .as_ref()
            .map_or_else(|| self.newest_step().clone(), |kept| kept.at.clone());
        let begins = self.view_of(number);
        let surface = self.surface_or_new(number, begins);
        let before = surface.pending.as_ref();
        let is_derived = |view: &View| matches!(view.feature, FeatureName::Derived(_));
        let feature = |view: &View| (view.feature.clone(), is_derived(view).then(|| view.field.clone()));
        // Values that an earlier edit left open are those of that edit's time step.
        let is_still_open =
            |before: &&PendingView| before.view.feature_range.is_none() && feature(&before.view) == feature(&view);
        let at = before.filter(is_still_open).map_or(at, |before| before.at.clone());
        let is_made = kept.as_ref().is_none_or(|kept| kept.is_made);
        let mut edits = before.map_or_else(Vec::new, |before| before.edits.clone());
        let is_first = before.is_none();
        match kept {
            Some(kept) if is_first || (1..MAX_KEPT_EDITS).contains(&edits.len()) => edits.push(kept),
            _ => edits.clear(),
        }
        surface.pending = Some(PendingView {
            view,
            at,
            named,
            edit,
            is_made,
            is_paused: false,
            edits,
            queue: Vec::new(),
        });
    }

    /// After a time step has failed: views that were waiting for that step are resolved for the step in force instead.
    fn resolve_here(&mut self, failed: &StepKey) {
        let here = self.volume.clone();
        let pending = self.surfaces_mut().filter_map(|(_, surface)| surface.pending.as_mut());
        for pending in pending.filter(|pending| pending.at.key() == *failed) {
            pending.at = here.clone();
        }
    }
}

/// Returns the job that resolves a view. Dropping the job cancels it.
fn resolve_view<B: Backend>(backend: B, surface: u8, asked: PendingView) -> BoxFuture<Resolved> {
    let token = CancellationToken::new();
    let guard = token.clone().drop_guard();
    Box::pin(async move {
        let _guard = guard;
        let result = backend.resolve(&asked.at, &asked.view, &token).await;
        Resolved::View {
            surface,
            asked: Box::new(asked),
            result,
        }
    })
}

/// As [`resolve_view`], for all surfaces that are made of a step.
fn resolve_step<B: Backend>(backend: B, volume: VolumeStep, views: Vec<(u8, View)>) -> BoxFuture<Resolved> {
    let token = CancellationToken::new();
    let guard = token.clone().drop_guard();
    Box::pin(async move {
        let _guard = guard;
        let mut resolved = Ok(Vec::new());
        for (number, view) in views {
            match (backend.resolve(&volume, &view, &token).await, &mut resolved) {
                (Ok(view), Ok(all)) => all.push((number, view)),
                (Err(error), _) => {
                    resolved = Err((number, error));
                    break;
                }
                (Ok(_), Err(_)) => {}
            }
        }
        Resolved::Step {
            step: volume.key(),
            result: resolved,
        }
    })
}
