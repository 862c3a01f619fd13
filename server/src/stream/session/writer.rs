//! Updates the session when the writer takes a frame.

use std::sync::Arc;

use tokio::sync::mpsc;
use tokio::time::Instant;

use super::generation::{Generation, Sending};
use super::outbox::Frame;
use super::rest::Rest;
use super::surface::Phase;
use super::{Outgoing, Session};
use crate::stream::backend::Backend;

impl<B: Backend> Session<B> {
    /// Returns the generation of a surface.
    fn generation(&mut self, surface: u8) -> Option<&mut Generation> {
        self.opened.as_mut()?.surface_mut(surface)?.generation_mut()
    }

    /// Gives the writer one frame.
    pub(super) fn on_writer_ready(&mut self, permit: mpsc::Permit<'_, Outgoing>) {
        let bytes = self.outbox.next_bytes().unwrap_or(0);
        let frame = self.outbox.pop_front();
        if let Some(ping) = self.line.record_frame(bytes) {
            self.outbox.push_front(Frame::Ping(ping));
        }
        match frame {
            None => {}
            Some(Frame::Control(text) | Frame::Newest(_, text)) => permit.send(Outgoing::Text(text)),
            Some(Frame::Prefix(surface, frame)) => {
                let sent = self.generation(surface).and_then(Generation::sent);
                sent.map(|sent| sent.handed_over.get_or_insert_with(Instant::now));
                permit.send(frame);
            }
            Some(Frame::Commit(surface, text)) => {
                permit.send(Outgoing::Text(text));
                self.on_commit(surface);
            }
            Some(Frame::Annotation(_, frame)) => permit.send(frame),
            Some(Frame::Ping(number)) => permit.send(Outgoing::Ping(number)),
            Some(Frame::Done(surface, text)) => {
                permit.send(Outgoing::Text(text));
                self.on_done(surface);
            }
        }
    }

    /// Records that the client holds a step.
    fn on_commit(&mut self, surface: u8) {
        let opened = self.opened.as_mut();
        let Some(session) = opened.and_then(|opened| opened.surface_mut(surface)) else {
            return;
        };
        let Phase::Working(generation) = &mut session.phase else {
            return;
        };
        let Sending::Committing(sent, held) = std::mem::replace(&mut generation.sending, Sending::Idle) else {
            return;
        };
        session.held = Arc::new(held);
        session.held_triangles = sent.surface_triangles;
        session.shown = Some(generation.surface_after(sent.cut));
        session.shown_generation = generation.number;
        session.holds_another_step = false;
        generation.has_committed = true;
        generation.can_improve = sent.can_improve;
        let is_superseded = generation.is_overtaken && !sent.is_final;
        let has_failed = generation.failure.is_some();
        if has_failed && session.held.is_empty() {
            (session.shown, session.held_budget) = (None, None);
        }
        if sent.is_final {
            session.held_budget = generation
                .view
                .budget
                .map(|budget| budget.as_number(session.full_triangles()));
        }
        let ping = self
            .pace
            .record_sent(sent.bytes, sent.handed_over.unwrap_or(sent.began));
        self.outbox.push_front(Frame::Ping(ping));
        if is_superseded {
            self.end_generation(surface);
        } else if has_failed {
            self.end_failed(surface);
        }
    }

    /// Records that the client holds the final surface.
    fn on_done(&mut self, surface: u8) {
        let opened = self.opened.as_mut();
        let Some(session) = opened.and_then(|opened| opened.surface_mut(surface)) else {
            return;
        };
        let Some(generation) = session.stop() else { return };
        if !session.edit_pending {
            let rest = Rest::new(&generation);
            session.phase = Phase::Resting(Box::new(rest));
        }
    }
}
