//! Handles failed generations: decides which error is sent, and whether the client may keep the surface.

use isopeel_extraction::WorkError;
use isopeel_view::View;

use super::super::backend::Backend;
use super::Session;
use super::surface::{Failed, SurfaceSession};
use crate::error::chain;
use crate::metrics;
use crate::wire::messages::ServerMessage;

impl<B: Backend> Session<B> {
    /// Handles the error of a job of a generation. A view that is invalid is reverted; any other error fails the generation.
    pub(super) fn fail_job(&mut self, surface: u8, error: &WorkError) {
        tracing::debug!(error = chain(error), "a generation failed");
        if error.rejects_view() && !self.is_proven(surface) {
            self.send_surface_error(surface, error.code(), error.public_message());
            return self.revert_view(surface);
        }
        metrics::stream_error(error.code());
        let (suggested_triangles, message) = match error.suggested_triangles() {
            Some(suggested) => self.suggest_budget(surface, suggested, error),
            None => (None, error.public_message()),
        };
        let opened = self.opened.as_mut();
        let session = opened.and_then(|opened| opened.surface_mut(surface));
        if let Some(generation) = session.and_then(SurfaceSession::generation_mut) {
            generation.failure = Some(Box::new(ServerMessage::Error {
                code: error.code(),
                message,
                open: true,
                surface: Some(surface),
                suggested_triangles,
            }));
        }
        self.end_failed(surface);
    }

    /// Whether a surface of the view in force was made before, at this or another time step.
    fn is_proven(&self, surface: u8) -> bool {
        let session = self.opened.as_ref().and_then(|opened| opened.surface(surface));
        session.is_some_and(|session| session.proven.as_ref() == Some(&session.view))
    }

    /// Returns a number of triangles that would be accepted as budget, and the error's text. `suggested` is a budget for this surface
    /// alone. If surfaces share the budget, the result is a budget for all of them.
    fn suggest_budget(&self, surface: u8, suggested: u64, error: &WorkError) -> (Option<u64>, String) {
        let (Some(opened), "over-budget") = (&self.opened, error.code()) else {
            return (Some(suggested), error.to_string());
        };
        let whole = opened.whole_of(surface, suggested);
        if whole == suggested {
            return (Some(suggested), error.to_string());
        }
        let message = format!("{error}; it is this surface's part, ask for {whole} or more for all together");
        (Some(whole), message)
    }

    /// Reverts the view in force, which turned out to be invalid, to the last view of which a surface was counted or made.
    /// Followers revert too.
    fn revert_view(&mut self, surface: u8) {
        self.end_generation(surface);
        let Some(opened) = &mut self.opened else { return };
        let opening = opened.opening_view().clone();
        if let Some(session) = opened.surface_mut(surface).filter(|session| !session.edit_pending) {
            let budget = session.view.budget;
            (session.edit_pending, session.key) = (session.proven.is_some(), None);
            if session.proven.is_none() {
                session.last_edit = 0;
            }
            session.view = session.proven.clone().unwrap_or(View { budget, ..opening });
        }
        self.allot(None);
        self.lead_or_follow();
    }

    /// Sends an error, and ends the generation that has failed with it.
    pub(super) fn fail_generation(&mut self, surface: u8, code: &'static str, message: String) {
        self.send_surface_error(surface, code, message);
        self.end_failed(surface);
    }

    /// Ends a failed generation. If the client may not keep the surface, first removes it from the client. Finally allots the budget again,
    /// because other surfaces may have waited for this surface's count of triangles.
    pub(super) fn end_failed(&mut self, surface: u8) {
        let Some(opened) = &mut self.opened else { return };
        let (volume, may_stay) = (opened.volume.clone(), opened.may_stay(surface));
        let failure = opened
            .surface(surface)
            .and_then(|session| session.generation()?.failure.as_deref());
        let failed = Failed {
            shared_triangles: opened.shared_triangles(),
            may_retry: failure.is_some_and(ServerMessage::suggests_budget),
        };
        let Some(session) = opened.surface_mut(surface) else {
            return;
        };
        match session.generation() {
            // The surface of the view in force is there. It follows the next camera.
            Some(generation) if generation.follows_camera => {
                self.stopped_camera = Some(generation.view.camera.as_deref().cloned());
            }
            // The suggested budget is computed from the state at the failure.
            _ => drop(session.failed.get_or_insert(failed)),
        }
        let failure = match session.generation_mut() {
            Some(generation) if !may_stay && generation.failure.is_some() => {
                generation.queue_empty_step(&volume);
                return self.allot(None);
            }
            Some(generation) => generation.failure.take(),
            None => None,
        };
        if let Some(failure) = failure {
            self.send(&failure);
        }
        self.end_generation(surface);
        self.allot(None);
    }
}
