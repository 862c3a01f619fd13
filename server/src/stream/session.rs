//! One viewer's state and the one task that owns it.
//!
//! An edit changes the view at once and marks it *wanted*. When the device is free of the session's last job, the view
//! is taken up as a new generation, a [`Run`]: prefix after prefix is extracted (device), compared with what the client
//! holds and encoded in batches (CPU pool), and its frames leave through the outbox as the socket takes them. The device
//! already works on the next prefix meanwhile. A newer edit ends the run: its token stops the device between two stages,
//! its frames leave the outbox, `superseded` follows. Edits that come before the device is free change the same view: so
//! they coalesce.
//!
//! A client that draws on this machine's processors says when it has drawn a generation's first prefix; until then the device
//! waits, a moment at most, instead of taking them for what comes next.
//!
//! A new surface begins with the prefix that the plan of the last one suggests, before anything is counted: what is on
//! screen first depends on nothing that can wait.
//!
//! What the client holds changes in one place, when `committed` goes to the writer. From there on frames arrive in order
//! or the connection ends, so both sides agree.

mod run;
mod scene;
mod work;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::backend::Backend;
use super::prefix::BATCH_CHUNKS;
use crate::extraction::VolumeStep;
use crate::view::Edit;
use crate::wire::messages::{ClientMessage, CloseCode, MAX_MALFORMED, MAX_MESSAGE_BYTES, ServerMessage};
use run::Run;
use scene::{Scene, SurfaceName};
use work::{Boxed, DeviceDone, PoolDone, finished};

/// Frames in the outbox below which the next batch is encoded: while the socket takes these, the pool makes more.
const LOW_WATER: usize = 16;
/// Frames in the outbox above which the session reads no message: a client that asks and does not read fills no memory.
/// Far more than chunks alone can be (a batch on top of the low water), so that a slow line alone keeps no edit waiting.
const HIGH_WATER: usize = 2 * BATCH_CHUNKS;

/// What comes from the reader.
#[derive(Debug)]
pub(super) enum Incoming {
    /// A text frame, at most [`MAX_MESSAGE_BYTES`].
    Text(String),
    /// Something that ends the connection.
    Fault(CloseCode),
}

/// What goes to the writer.
#[derive(Debug, PartialEq)]
pub(super) enum Outgoing {
    /// A text frame.
    Text(String),
    /// A chunk.
    Binary(Bytes),
    /// The close frame; nothing follows.
    Close(CloseCode),
}

/// A frame in the outbox.
enum Frame {
    /// Stays when its run ends.
    Control(String),
    /// Part of the run; leaves with it.
    Run(Outgoing),
    /// `committed`: from here on the client holds this prefix.
    Commit(String),
    /// `done`: the run's end.
    Done(String),
}

#[expect(clippy::large_enum_variant, reason = "lives on the stack for one turn of the loop")]
enum Event<'a> {
    Shutdown,
    WriterGone,
    Message(Option<Incoming>),
    Room(mpsc::Permit<'a, Outgoing>),
    Device(DeviceDone),
    Pool(PoolDone),
    PauseOver,
}

/// One viewer.
pub(super) struct Session<B> {
    backend: B,
    /// By then the viewer should see something of an edit.
    answer: Duration,
    scene: Option<Scene>,
    /// Counts volumes opened, so that a late answer to an earlier `open` is known as such.
    opens: u32,
    run: Option<Run>,
    generation: u32,
    /// The one job on the device. It outlives its run: cancelled, it still has to come back before the next one goes.
    device: Option<Boxed<DeviceDone>>,
    pool: Option<Boxed<PoolDone>>,
    outbox: VecDeque<Frame>,
    malformed: u32,
    /// The client has said `drawn`: it will say it again.
    says_drawn: bool,
}

impl<B: Backend> Session<B> {
    pub(super) fn new(backend: B, answer: Duration) -> Self {
        Self {
            backend,
            answer,
            scene: None,
            opens: 0,
            run: None,
            generation: 0,
            device: None,
            pool: None,
            outbox: VecDeque::new(),
            malformed: 0,
            says_drawn: false,
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
            let listening = self.outbox.len() < HIGH_WATER;
            let event = tokio::select! {
                () = shutdown.cancelled() => Event::Shutdown,
                () = outgoing.closed() => Event::WriterGone,
                message = inbox.recv(), if listening => Event::Message(message),
                permit = outgoing.reserve(), if !self.outbox.is_empty() => {
                    permit.map_or(Event::WriterGone, Event::Room)
                }
                done = finished(&mut self.device) => Event::Device(done),
                done = finished(&mut self.pool) => Event::Pool(done),
                () = run::pause_over(self.run.as_ref()) => Event::PauseOver,
            };
            let close = match event {
                Event::Shutdown => Some(CloseCode::Shutdown),
                Event::WriterGone | Event::Message(None) => return,
                Event::Message(Some(message)) => self.on_message(message),
                Event::Room(permit) => {
                    self.on_room(permit);
                    None
                }
                Event::Device(done) => {
                    self.device = None;
                    self.on_device(done);
                    None
                }
                Event::Pool(done) => {
                    self.pool = None;
                    self.on_pool(done);
                    None
                }
                Event::PauseOver => {
                    self.end_pause();
                    None
                }
            };
            if let Some(code) = close {
                break code;
            }
        };
        // The work ends now; what is to be said is said, then the door closes. The writer has a deadline for each frame.
        self.run = None;
        let said = self.outbox.into_iter().filter_map(|frame| match frame {
            Frame::Control(text) => Some(Outgoing::Text(text)),
            Frame::Run(_) | Frame::Commit(_) | Frame::Done(_) => None,
        });
        for frame in said.chain([Outgoing::Close(code)]) {
            if outgoing.send(frame).await.is_err() {
                return;
            }
        }
    }

    fn say(&mut self, message: &ServerMessage) {
        self.outbox.push_back(Frame::Control(message.to_json()));
    }

    fn say_error(&mut self, code: &'static str, message: impl Into<String>, open: bool) {
        let message = message.into();
        tracing::debug!(code, message, "error to a viewer");
        self.say(&ServerMessage::Error {
            code,
            message,
            open,
            suggested_triangles: None,
        });
    }

    fn on_message(&mut self, message: Incoming) -> Option<CloseCode> {
        let text = match message {
            Incoming::Text(text) => text,
            Incoming::Fault(code) => {
                let code_name = match code {
                    CloseCode::TooLong => "too-large",
                    _ => "bad-message",
                };
                let limit = format!(
                    "{}, messages are text of at most {MAX_MESSAGE_BYTES} bytes",
                    code.reason()
                );
                self.say_error(code_name, limit, false);
                return Some(code);
            }
        };
        match ClientMessage::parse(&text) {
            Ok(message) => {
                self.malformed = 0;
                match message {
                    ClientMessage::Open { volume, step } => self.on_open(&volume, step),
                    ClientMessage::Edit(edit) => self.on_edit(&edit),
                    ClientMessage::Cancel {} => self.on_cancel(),
                    ClientMessage::Drawn { generation } => self.on_drawn(generation),
                }
                None
            }
            Err(why) => {
                self.malformed += 1;
                let last = self.malformed >= MAX_MALFORMED;
                self.say_error("bad-message", why, !last);
                last.then_some(CloseCode::Malformed)
            }
        }
    }

    fn on_open(&mut self, id: &str, step: u32) {
        self.end_run();
        self.scene = None;
        let Some(dataset) = self.backend.find(id) else {
            let message = format!("no volume has the id {id:?}, GET /api/v1/volumes lists those there are");
            return self.say_error("unknown-volume", message, true);
        };
        let view = match dataset.opening_view() {
            Ok(view) => view,
            Err(error) => return self.say_error("unreadable-volume", format!("opening view: {error}"), true),
        };
        let volume = match VolumeStep::new(dataset, step) {
            Ok(volume) => volume,
            Err(error) => return self.say_error("unknown-step", error.to_string(), true),
        };
        self.opens += 1;
        self.scene = Some(Scene::new(volume, view));
    }

    fn on_edit(&mut self, edit: &Edit) {
        let Some(scene) = &mut self.scene else {
            return self.say_error("not-open", "no volume is open, expected `open` first", true);
        };
        match scene.view.apply(edit, &scene.volume.dataset().field_names()) {
            Ok(view) if view.cap => {
                let message = "cap: true, the stream has no caps yet, expected false; exports have them";
                self.say_error("bad-edit", message, true);
            }
            Ok(view) => {
                scene.view = view;
                scene.wanted = true;
                self.end_run();
            }
            Err(error) => self.say_error("bad-edit", error.to_string(), true),
        }
    }

    fn on_cancel(&mut self) {
        if let Some(scene) = &mut self.scene {
            scene.wanted = false;
        }
        self.end_run();
    }

    fn on_drawn(&mut self, generation: u32) {
        self.says_drawn = true;
        if self.run.as_ref().is_some_and(|run| run.generation == generation) {
            self.end_pause();
        }
    }

    fn end_pause(&mut self) {
        if let Some(run) = &mut self.run {
            run.paused_until = None;
        }
    }

    /// Ends the running generation, if there is one: nothing of it is sent any more but `superseded`.
    fn end_run(&mut self) {
        let Some(run) = self.run.take() else { return };
        // Between two stages the device sees the token, whose guard went with the run; the pool's result has no taker.
        self.pool = None;
        self.outbox.retain(|frame| matches!(frame, Frame::Control(_)));
        self.say(&ServerMessage::Superseded {
            generation: run.generation,
        });
        if let Some(scene) = &mut self.scene
            && !run.committed
        {
            scene.starving_since.get_or_insert(run.began);
        }
    }

    /// The writer takes one frame.
    fn on_room(&mut self, permit: mpsc::Permit<'_, Outgoing>) {
        match self.outbox.pop_front() {
            None => {}
            Some(Frame::Control(text)) => permit.send(Outgoing::Text(text)),
            Some(Frame::Run(frame)) => permit.send(frame),
            Some(Frame::Commit(text)) => {
                permit.send(Outgoing::Text(text));
                self.on_commit();
            }
            Some(Frame::Done(text)) => {
                permit.send(Outgoing::Text(text));
                self.run = None;
            }
        }
    }

    fn on_commit(&mut self) {
        let (Some(run), Some(scene)) = (&mut self.run, &mut self.scene) else {
            return;
        };
        if let Some(sending) = run.sending.take() {
            scene.held = Arc::new(sending.held);
            scene.shown = Some((SurfaceName::of(&run.view), sending.level));
            scene.starving_since = None;
            run.committed = true;
        }
    }
}

#[cfg(test)]
mod tests;
