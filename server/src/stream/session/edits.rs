//! Applies a client's edits to its surfaces, and ends generations that they supersede.

use futures_util::stream::FuturesOrdered;
use isopeel_codec::chunk::MAX_SURFACES;
use isopeel_view::Edit;

use super::super::backend::Backend;
use super::Session;
use super::generation::Sending;
use super::open_volume::OpenVolume;
use crate::access::Role;
use crate::wire::messages::{Capabilities, ServerMessage};

impl<B: Backend> Session<B> {
    pub(super) fn on_edit(&mut self, surface: u32, edit: &Edit) {
        if surface >= Capabilities::SURFACES {
            let message = format!(
                "surface: {surface}, this server has {} a connection, expected 0 to {}",
                Capabilities::SURFACES,
                Capabilities::SURFACES - 1
            );
            return self.send_error("bad-edit", message, true);
        }
        let Some(opened) = &mut self.opened else {
            return self.send_error("not-open", "no volume is open, expected `open` first", true);
        };
        let surface = surface as u8;
        let before = opened.edited_view_of(surface);
        match before.apply(edit, &opened.volume.dataset().field_names()) {
            Ok(_) if edit.camera.is_some() => {
                self.send_error("bad-edit", "camera: given, expected the message camera", true);
            }
            Ok(view) if view.cap => {
                let message = "cap: true, the stream has no caps yet, expected false; exports have them";
                self.send_error("bad-edit", message, true);
            }
            // Without the role `edit` only an edit that changes nothing is allowed: it requests the opening view.
            Ok(view) if view != before && !self.who.may(Role::Edit) => self.refuse_edit(),
            Ok(view) => self.accept_edit(surface, view, edit),
            Err(error) => self.send_error("bad-edit", error.to_string(), true),
        }
    }

    /// Sends the error of a viewer whose token lacks the role `edit`.
    pub(super) fn refuse_edit(&mut self) {
        let message = format!("this token is for {}, expected one for edit", self.who.roles());
        self.send_error("forbidden", message, true);
    }

    /// Marks a surface as changed. The surface's generation ends at once if one of its steps was committed or if it only follows a camera,
    /// else after its first commit.
    pub(super) fn change(&mut self, surface: u8) {
        let opened = self.opened.as_mut();
        let Some(session) = opened.and_then(|opened| opened.surface_mut(surface)) else {
            return;
        };
        session.edit_pending = true;
        match session.generation_mut() {
            Some(generation) if !generation.has_committed && !generation.follows_camera => {
                generation.is_overtaken = true;
            }
            _ => self.end_generation(surface),
        }
    }

    /// Gives each surface its part of the budget, once all surfaces that share the budget are counted. Remakes the surfaces whose parts
    /// have changed, except `edited`, which is marked as changed before; a generation without a step only gets its new part. Also
    /// tries again the surfaces that could not be counted, or whose part was too small.
    pub(super) fn allot(&mut self, edited: Option<u8>) {
        let uncounted = self.opened.as_mut().map(OpenVolume::uncounted_to_retry);
        uncounted.into_iter().flatten().for_each(|number| self.change(number));
        let Some(allotments) = self.opened.as_ref().and_then(|opened| opened.allotments()) else {
            return;
        };
        for (number, budget) in (0..).zip(allotments) {
            let opened = self.opened.as_mut();
            let Some(session) = opened.and_then(|opened| opened.surface_mut(number)) else {
                continue;
            };
            let is_same = std::mem::replace(&mut session.allotted, budget) == budget;
            match session.generation_mut() {
                Some(generation) if generation.has_no_step() => generation.set_budget(budget),
                Some(generation) if generation.is_overtaken => {}
                _ if is_same || budget.is_none() || Some(number) == edited => {}
                _ => self.change(number),
            }
        }
        let failed = self.opened.as_ref().map(OpenVolume::failed_to_retry);
        failed.into_iter().flatten().for_each(|number| self.change(number));
    }

    /// Handles `cancel`: ends all work for the surfaces, which stay as the client holds them.
    pub(super) fn on_cancel(&mut self) {
        self.stopped_camera = Some(self.camera_in_force());
        self.questions.clear();
        self.outbox.drop_annotations();
        for number in 0..MAX_SURFACES {
            let opened = self.opened.as_mut();
            let Some(session) = opened.and_then(|opened| opened.surface_mut(number)) else {
                continue;
            };
            if session.is_busy() {
                // The surface was not made with its part of the budget. Clearing the part makes the next edit remake the surface.
                session.allotted = None;
            }
            session.edit_pending = false;
            if let Some(pending) = &mut session.pending {
                pending.cancel();
            }
            self.end_generation(number);
        }
        if let Some(stepping) = self.opened.as_mut().and_then(|opened| opened.stepping.as_mut()) {
            stepping.cancelled_after = Some(self.edits);
        }
    }

    /// Returns the number of a surface if it exists; otherwise sends the error `unknown-surface`, or `not-open` if no volume is open.
    pub(super) fn find_surface(&mut self, surface: u32) -> Option<u8> {
        let Some(opened) = &self.opened else {
            self.send_error("not-open", "no volume is open, expected `open` first", true);
            return None;
        };
        let numbers: Vec<u8> = opened.surfaces().map(|(number, _)| number).collect();
        let number = numbers.iter().copied().find(|&number| u32::from(number) == surface);
        if number.is_none() {
            let existing: Vec<String> = numbers.iter().map(u8::to_string).collect();
            let message = format!(
                "surface: {surface} is not there, expected one of {}",
                existing.join(", ")
            );
            self.send_error("unknown-surface", message, true);
        }
        number
    }

    pub(super) fn on_remove(&mut self, surface: u32) {
        let Some(number) = self.find_surface(surface) else {
            return;
        };
        self.end_generation(number);
        self.questions.drop_surface(number);
        self.outbox.drop_annotations();
        if let Some(opened) = &mut self.opened {
            opened.remove_by_user(number);
        }
        self.send(&ServerMessage::Removed { surface: number });
        if let Some(opened) = &mut self.opened {
            opened.offer_retries();
        }
        self.allot(None);
    }

    /// Handles `drawn`: the client has drawn the first prefix of a generation.
    pub(super) fn on_drawn(&mut self, generation: u32) {
        self.acknowledges = true;
        let surface = self
            .opened
            .as_mut()
            .and_then(|opened| opened.surface_of_generation(generation));
        if let Some(generation) = surface.and_then(|(_, surface)| surface.generation_mut()) {
            generation.draw_pause.end();
        }
    }

    /// Ends the work for a surface. If the surface has a generation, only `superseded` is still sent for that generation.
    pub(super) fn end_generation(&mut self, surface: u8) {
        let opened = self.opened.as_mut();
        let Some(session) = opened.and_then(|opened| opened.surface_mut(surface)) else {
            return;
        };
        let Some(mut generation) = session.stop() else { return };
        if !matches!(generation.sending, Sending::Idle) {
            // Drops the jobs on the pool, because their results are not needed any more.
            self.pool = FuturesOrdered::new();
        }
        self.outbox.drop_surface(surface);
        if generation.is_unrequested_and_unsent() {
            return;
        }
        self.send(&ServerMessage::Superseded {
            surface,
            generation: generation.number,
        });
    }
}
