//! One viewer's state machine, owned by one task.
//!
//! - **Edits.** An edit changes the view at once and marks it as pending. When the device is free of the session's last job, the view
//!   starts a new [`Generation`]. Edits that arrive before change the same view, so they coalesce.
//! - **Steps.** A generation makes and sends its surface in steps (`generation` draws their phases). At most one job is on the device
//!   (`jobs`). `pace` says how large a step may be.
//! - **Outbox.** Frames wait here until the writer takes them. [`LOW_WATER`] bounds what is encoded ahead, [`HIGH_WATER`] what a
//!   client can cause that sends and does not read.
//! - **Supersession.** A newer edit ends a generation of which something was committed: its token cancels the device's job between
//!   two stages, its frames leave the outbox, and `superseded` follows. One of which nothing was committed first commits a step, so that
//!   a viewer who drags a slider faster than surfaces are made still sees some.
//! - **Pictures.** `draw_pause` gives a client on the same machine time to draw.
//! - **Rest.** When no edit follows the final surface, a better one is made where there is one, and its error is measured (`rest`).
//!
//! Invariant: what the client holds changes only when `committed` goes to the writer. Later frames arrive in order or the
//! connection ends, so both sides agree.

mod draw_pause;
mod generation;
mod jobs;
mod open_volume;
mod outbox;
mod pace;
mod rest;

use std::sync::Arc;

use axum::body::Bytes;
use futures_util::StreamExt;
use futures_util::stream::FuturesOrdered;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::backend::Backend;
use crate::extraction::OpeningProgress;
use crate::view::Edit;
use crate::volumes::VolumeStep;
use crate::wire::messages::{
    Capabilities, ClientMessage, CloseCode, MAX_MALFORMED, MAX_MESSAGE_BYTES, ServerMessage, SurfaceEdit,
};
use draw_pause::DrawPause;
use generation::{Generation, Sending};
use jobs::{BoxFuture, DeviceDone, PoolDone, finished};
use open_volume::{OpenVolume, opening_progress};
use outbox::{Frame, Outbox};
use pace::Pace;
pub use pace::StepTimes;
use rest::Rest;

/// Bytes of a surface in the outbox below which its next batch is encoded: the socket has these to send meanwhile.
const LOW_WATER: usize = 4 << 20;
/// Bytes of other frames from which on no message is read: a client that sends and does not read cannot fill memory. On a slow line
/// edits are still read, however much of a surface waits.
const HIGH_WATER: usize = 1 << 20;

/// The surface of a connection; [`Capabilities::SURFACES`] says that there is one.
const SURFACE: u8 = 0;

/// From the reader.
#[derive(Debug)]
pub(super) enum Incoming {
    /// A text frame of at most [`MAX_MESSAGE_BYTES`].
    Text(String),
    /// The answer to a ping that carried this number.
    Pong(u32),
    /// Something that ends the connection.
    Fault(CloseCode),
}

/// To the writer.
#[derive(Debug, PartialEq)]
pub(super) enum Outgoing {
    /// A text frame.
    Text(String),
    /// A chunk.
    Binary(Bytes),
    /// A ping that carries a number.
    Ping(u32),
    /// The close frame; nothing follows.
    Close(CloseCode),
}

enum Event<'a> {
    OpeningProgress(OpeningProgress),
    Shutdown,
    WriterGone,
    Message(Option<Incoming>),
    WriterReady(mpsc::Permit<'a, Outgoing>),
    Device(DeviceDone),
    Pool(PoolDone),
    DrawPauseElapsed,
    PongWaitElapsed,
    RestDue,
}

/// One viewer.
pub(super) struct Session<B> {
    backend: B,
    opened: Option<OpenVolume>,
    /// Counts volumes opened, so that the result of an earlier `open` is recognised.
    opens: u32,
    generation: Option<Generation>,
    last_generation: u32,
    /// The job on the device. It outlives its generation: a cancelled job must return before the next one is queued.
    device: Option<BoxFuture<DeviceDone>>,
    /// Jobs on the CPU pool, whose results are taken in this order.
    pool: FuturesOrdered<BoxFuture<PoolDone>>,
    outbox: Outbox,
    /// Malformed messages in a row.
    malformed: u32,
    draw_pause: DrawPause,
    pace: Pace,
    /// The final surface that the client holds, until its error is measured.
    rest: Option<Rest>,
}

impl<B: Backend> Session<B> {
    pub(super) fn new(backend: B, step_times: StepTimes) -> Self {
        Self {
            backend,
            opened: None,
            opens: 0,
            generation: None,
            last_generation: 0,
            device: None,
            pool: FuturesOrdered::new(),
            outbox: Outbox::default(),
            malformed: 0,
            draw_pause: DrawPause::default(),
            pace: Pace::new(step_times),
            rest: None,
        }
    }

    /// Serves the viewer until it leaves, misbehaves or the server shuts down.
    pub(super) async fn run(
        mut self,
        mut inbox: mpsc::Receiver<Incoming>,
        outgoing: mpsc::Sender<Outgoing>,
        shutdown: CancellationToken,
    ) {
        let code = loop {
            self.advance_pool();
            self.advance_device();
            let listening = self.outbox.kept_bytes() < HIGH_WATER;
            let event = tokio::select! {
                () = shutdown.cancelled() => Event::Shutdown,
                () = outgoing.closed() => Event::WriterGone,
                message = inbox.recv(), if listening => Event::Message(message),
                permit = outgoing.reserve(), if !self.outbox.is_empty() => {
                    permit.map_or(Event::WriterGone, Event::WriterReady)
                }
                done = finished(&mut self.device) => Event::Device(done),
                Some(done) = self.pool.next() => Event::Pool(done),
                () = self.draw_pause.elapsed() => Event::DrawPauseElapsed,
                () = self.pace.pong_wait_elapsed() => Event::PongWaitElapsed,
                () = rest::due(self.rest.as_ref()), if self.device.is_none() => Event::RestDue,
                progress = opening_progress(&mut self.opened) => Event::OpeningProgress(progress),
            };
            let close = match event {
                Event::Shutdown => Some(CloseCode::Shutdown),
                Event::WriterGone | Event::Message(None) => return,
                Event::Message(Some(message)) => self.on_message(message),
                Event::WriterReady(permit) => {
                    self.on_writer_ready(permit);
                    // As many as there is space for, without a turn of the loop for each.
                    while !self.outbox.is_empty()
                        && let Ok(permit) = outgoing.try_reserve()
                    {
                        self.on_writer_ready(permit);
                    }
                    None
                }
                Event::Device(done) => {
                    self.device = None;
                    self.on_device(done);
                    None
                }
                Event::Pool(done) => {
                    self.on_pool(done);
                    None
                }
                Event::OpeningProgress(progress) => {
                    self.on_progress(progress);
                    None
                }
                Event::DrawPauseElapsed => {
                    self.draw_pause.end();
                    None
                }
                // The next turn of the loop starts what waited for it.
                Event::PongWaitElapsed | Event::RestDue => None,
            };
            if let Some(code) = close {
                break code;
            }
        };
        // Work ends at once; control frames are still sent, then the close frame. The writer has a deadline for each.
        self.generation = None;
        while let Some(frame) = self.outbox.pop_front() {
            if let Frame::Control(text) = frame
                && outgoing.send(Outgoing::Text(text)).await.is_err()
            {
                return;
            }
        }
        let _ = outgoing.send(Outgoing::Close(code)).await;
    }

    fn send(&mut self, message: &ServerMessage) {
        self.outbox.push_back(Frame::Control(message.to_json()));
    }

    fn send_error(&mut self, code: &'static str, message: impl Into<String>, open: bool) {
        let message = message.into();
        tracing::debug!(code, message, "error to a viewer");
        self.send(&ServerMessage::Error {
            code,
            message,
            open,
            surface: None,
            suggested_triangles: None,
        });
    }

    fn on_message(&mut self, message: Incoming) -> Option<CloseCode> {
        let text = match message {
            Incoming::Text(text) => text,
            Incoming::Pong(number) => {
                self.pace.received(number);
                return None;
            }
            Incoming::Fault(code) => {
                let code_name = match code {
                    CloseCode::TooLong => "too-large",
                    _ => "bad-message",
                };
                let limit = format!(
                    "{}, messages are text of at most {MAX_MESSAGE_BYTES} bytes",
                    code.reason()
                );
                self.send_error(code_name, limit, false);
                return Some(code);
            }
        };
        match ClientMessage::parse(&text) {
            Ok(message) => {
                self.malformed = 0;
                match message {
                    ClientMessage::Open { volume, step } => self.on_open(&volume, step),
                    ClientMessage::Edit(SurfaceEdit { surface, edit }) => self.on_edit(surface, &edit),
                    ClientMessage::Cancel {} => self.on_cancel(),
                    ClientMessage::Drawn { generation } => self.draw_pause.acknowledge(generation),
                }
                None
            }
            Err(why) => {
                self.malformed += 1;
                let last = self.malformed >= MAX_MALFORMED;
                self.send_error("bad-message", why, !last);
                last.then_some(CloseCode::Malformed)
            }
        }
    }

    fn on_open(&mut self, id: &str, step: u32) {
        self.end_generation();
        self.opened = None;
        self.rest = None;
        self.outbox.drop_opening();
        let Some(dataset) = self.backend.find(id) else {
            let message = format!("no volume has the id {id:?}, GET /api/v1/volumes lists those there are");
            return self.send_error("unknown-volume", message, true);
        };
        let view = match dataset.opening_view() {
            Ok(view) => view,
            Err(error) => return self.send_error("unreadable-volume", format!("opening view: {error}"), true),
        };
        let volume = match VolumeStep::new(dataset, step) {
            Ok(volume) => volume,
            Err(error) => return self.send_error("unknown-step", error.to_string(), true),
        };
        self.opens += 1;
        self.opened = Some(OpenVolume::new(volume, view));
    }

    /// The opening of a volume goes on. A client that does not read gets the newest state alone.
    fn on_progress(&mut self, OpeningProgress { bytes, total_bytes }: OpeningProgress) {
        self.outbox.drop_opening();
        let opening = ServerMessage::Opening { bytes, total_bytes };
        self.outbox.push_back(Frame::Opening(opening.to_json()));
    }

    fn on_edit(&mut self, surface: u32, edit: &Edit) {
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
        match opened.view.apply(edit, &opened.volume.dataset().field_names()) {
            Ok(view) if view.cap => {
                let message = "cap: true, the stream has no caps yet, expected false; exports have them";
                self.send_error("bad-edit", message, true);
            }
            Ok(view) => {
                opened.view = view;
                opened.edit_pending = true;
                self.rest = None;
                match &mut self.generation {
                    Some(generation) if !generation.committed => generation.is_overtaken = true,
                    _ => self.end_generation(),
                }
            }
            Err(error) => self.send_error("bad-edit", error.to_string(), true),
        }
    }

    fn on_cancel(&mut self) {
        self.rest = None;
        if let Some(opened) = &mut self.opened {
            opened.edit_pending = false;
        }
        self.end_generation();
    }

    /// Ends the generation, if there is one: nothing of it is sent any more but `superseded`.
    fn end_generation(&mut self) {
        let Some(generation) = self.generation.take() else {
            return;
        };
        // Dropping the generation cancels its token. The device job returns later; the pool's results are not awaited.
        self.pool = FuturesOrdered::new();
        self.draw_pause.end();
        self.outbox.drop_surface();
        self.send(&ServerMessage::Superseded {
            surface: SURFACE,
            generation: generation.number,
        });
    }

    /// Gives the writer one frame.
    fn on_writer_ready(&mut self, permit: mpsc::Permit<'_, Outgoing>) {
        match self.outbox.pop_front() {
            None => {}
            Some(Frame::Control(text) | Frame::Opening(text)) => permit.send(Outgoing::Text(text)),
            Some(Frame::Prefix(frame)) => {
                let sent = self.generation.as_mut().and_then(Generation::sent);
                sent.map(|sent| sent.handed_over.get_or_insert_with(Instant::now));
                permit.send(frame);
            }
            Some(Frame::Commit(text)) => {
                permit.send(Outgoing::Text(text));
                self.on_commit();
            }
            Some(Frame::Ping(number)) => permit.send(Outgoing::Ping(number)),
            Some(Frame::Done(text)) => {
                permit.send(Outgoing::Text(text));
                self.on_done();
            }
        }
    }

    /// The client holds a step.
    fn on_commit(&mut self) {
        let (Some(generation), Some(opened)) = (&mut self.generation, &mut self.opened) else {
            return;
        };
        let Sending::Committing(sent, held) = std::mem::replace(&mut generation.sending, Sending::Idle) else {
            return;
        };
        opened.held = Arc::new(held);
        opened.shown = Some((generation.view.clone(), sent.cut));
        generation.committed = true;
        generation.can_improve = sent.can_improve;
        let ping = self
            .pace
            .handed_over(sent.bytes, sent.handed_over.unwrap_or(sent.began));
        self.outbox.push_front(Frame::Ping(ping));
        if generation.is_overtaken && !sent.is_final {
            self.end_generation();
        }
    }

    /// The client holds the final surface.
    fn on_done(&mut self) {
        let Some(generation) = self.generation.take() else {
            return;
        };
        self.draw_pause.end();
        let is_resting = self.opened.as_ref().is_some_and(|opened| !opened.edit_pending);
        self.rest = is_resting.then(|| Rest::new(generation.number, generation.view.clone(), generation.can_improve));
    }
}

#[cfg(test)]
mod tests;
