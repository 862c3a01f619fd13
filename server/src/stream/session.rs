//! One viewer's state machine, owned by one task.
//!
//! The state of one surface (`surface`: view, phase, the regions that the client holds) is separate from that of the connection: the job on
//! the device, the step that is being sent, outbox, pace, and the open volume (`open_volume`), which holds up to four surfaces by their
//! numbers.
//!
//! ```text
//! a surface     Idle --edit--> Working(generation) --final surface committed--> Resting --measured--> Idle
//!                                    <--edit, another part of the budget, a better surface--
//! the device    one job: opening a volume, or what `schedule` says: a count, a step, or work for a surface that rests
//! the line      one step: compared and encoded on the pool, then in the outbox; prefixes do not mix
//! ```
//!
//! - **Edits.** An edit comes into force when all samples that it uses are loaded and every value is resolved (`resolving`); for most edits
//!   this is at once. Then the edit's surface is marked as changed. When the session's last job has left the device, the view starts a new
//!   [`generation::Generation`]. Edits that arrive before that change the same view, so they coalesce.
//! - **Steps.** A generation makes and sends its surface in steps (see the diagram in `generation`). At most one job is on the device
//!   (`jobs`). `pace` limits the size of a step, and `line` the bytes in flight.
//! - **Scheduling.** First steps come before further steps of other surfaces, and the surface that was edited last comes before others. A
//!   surface that has waited for a few jobs of others comes before all (`schedule`).
//! - **Budget.** A connection has one budget. Surfaces share it in proportion to their full triangles, which are counted first if two or
//!   more share. A surface whose part of the budget changes is made again, and surfaces that shrink are shown before those that grow
//!   (`sharing`).
//! - **Outbox.** Frames wait here until the writer takes them. [`super::viewers::Viewers::ahead_bytes`] bounds what is encoded ahead.
//!   [`HIGH_WATER`] bounds the memory of a client that sends but does not read.
//! - **Supersession.** A newer edit ends a generation of which something was committed: its token cancels the device's job between two
//!   stages, its frames leave the outbox, and `superseded` follows. A generation of which nothing was committed first commits a step, so
//!   that a viewer who drags a slider faster than surfaces are made still sees some of them.
//! - **Camera.** When nothing else is waited for, surfaces that were made for another camera follow it (`camera`).
//! - **Pictures.** `draw_pause` gives a client on the same machine time to draw.
//! - **Questions.** Queries on a surface are answered when no generation is running (`questions`).
//! - **Time.** At another time step the surfaces are made again, and regions that are equal are not sent again. The next step is
//!   prefetched (`time`).
//! - **Rest.** When no edit of any surface follows a final surface, a better surface is made if possible, and its error is measured
//!   (`rest`). An edit of another surface postpones this work.
//!
//! Invariant: the regions that the client holds of a surface change only when `committed` goes to the writer. Later frames arrive in order
//! or the connection ends, so both sides agree.

mod camera;
mod draw_pause;
mod edits;
mod failing;
mod generation;
mod group;
mod heartbeat;
mod jobs;
mod line;
mod open_pace;
mod open_volume;
mod outbox;
mod pace;
mod pending;
mod questions;
mod resolving;
mod rest;
mod schedule;
mod sharing;
mod shown;
mod surface;
mod time;
mod writer;

use std::sync::Arc;

use axum::body::Bytes;
use futures_util::StreamExt;
use futures_util::stream::FuturesOrdered;
use isopeel_codec::chunk::Coding;
use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{Question, WorkError};
use isopeel_view::CameraJson;
use isopeel_volumes::{Dataset, Lease, StepKey, VolumeStep};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::Common;
use super::backend::Backend;
use super::groups::{GroupEvent, Member, next_group_event};
use crate::access::Identity;
use crate::error::chain;
use crate::metrics;
use crate::problem::of_another_server;
use crate::service::OpeningProgress;
use crate::wire::messages::{ClientMessage, CloseCode, MAX_MALFORMED, MAX_MESSAGE_BYTES, ServerMessage};
use heartbeat::{BEFORE_BEAT, Heartbeat};
use jobs::{BoxFuture, DeviceDone, PoolDone, finished};
use line::Line;
use open_pace::OpenPace;
use open_volume::{OpenVolume, opening_progress};
use outbox::{Frame, Newest, Outbox};
use pace::Pace;
pub use pace::StepTimes;
use questions::{Answered, Questions};
use resolving::Resolved;
use time::{Ahead, read_ahead};
use trace::ConnectionId;

/// Maximum bytes of waiting frames that belong to no generation; above this, the session stops reading messages. So a client that sends but
/// does not read cannot fill memory. Frames of a surface do not count, so edits are read on a slow line too.
const HIGH_WATER: usize = 1 << 20;
/// Frames of at most this many bytes are sent even if the line is full.
const SMALL_FRAME: usize = 1 << 10;

/// Input from the reader.
#[derive(Debug)]
pub(super) enum Incoming {
    /// A text frame of at most [`MAX_MESSAGE_BYTES`].
    Text(String),
    /// The answer to a ping that carried this number.
    Pong(u32),
    /// Something that ends the connection.
    Fault(CloseCode),
}

/// Output to the writer.
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
    /// The viewer's token has ended.
    TokenEnded,
    WriterGone,
    /// A heartbeat is due.
    Beat,
    Message(Option<Incoming>),
    WriterReady(mpsc::Permit<'a, Outgoing>),
    Device(DeviceDone),
    Pool(PoolDone),
    Answered(Answered),
    Resolved(Resolved),
    DrawPauseElapsed,
    PongWaitElapsed,
    OpenPaceElapsed,
    RestDue,
    ReadAhead,
    /// The open volume is no longer on the server.
    VolumeRemoved,
    Group(GroupEvent),
}

/// One viewer.
pub(super) struct Session<B> {
    backend: B,
    common: Common,
    who: Identity,
    id: ConnectionId,
    opened: Option<OpenVolume>,
    /// Number of volumes opened so far. It distinguishes the result of an earlier `open` from that of the current one.
    opens: u32,
    open_pace: OpenPace,
    last_generation: u32,
    /// Number of edits so far. The surface that was edited last has priority.
    edits: u64,
    /// Number of jobs for surfaces on the device so far. The waiting time of a surface is counted in these jobs.
    jobs: u64,
    /// The job on the device. It outlives its generation: a cancelled job must return before the next one is queued.
    device: Option<BoxFuture<DeviceDone>>,
    /// Jobs on the CPU pool for the step that is being sent. Their results are handled in the order of the jobs.
    pool: FuturesOrdered<BoxFuture<PoolDone>>,
    outbox: Outbox,
    /// Malformed messages in a row.
    malformed: u32,
    /// Whether the client has sent `drawn` before. A client that has done so acknowledges later pictures too.
    acknowledges: bool,
    pace: Pace,
    heartbeat: Heartbeat,
    /// The best coding that the client can read.
    coding: Coding,
    /// Whether the client reads values of a field behind a mesh.
    reads_values: bool,
    /// Bytes in flight, which the client has not confirmed.
    line: Line,
    questions: Questions,
    /// The time step that is read ahead.
    ahead: Option<Ahead>,
    /// The camera of the viewer, for the open volume.
    camera: Option<CameraJson>,
    /// The camera in force at the last `cancel`, or for which a surface could not be made: surfaces that were made for another one do not
    /// follow it.
    stopped_camera: Option<Option<CameraJson>>,
    /// The viewer's membership of a group.
    member: Option<Member>,
    /// The last volume that this session tried to open because the member in control has opened it.
    tried: Option<StepKey>,
    /// The job that resolves an edit or a time step on the device. Dropping it cancels the job.
    resolving: Option<BoxFuture<Resolved>>,
}

impl<B: Backend> Session<B> {
    pub(super) fn new(backend: B, step_times: StepTimes, common: Common, who: Identity) -> Self {
        Self {
            backend,
            common,
            who,
            id: ConnectionId::random(),
            opened: None,
            opens: 0,
            open_pace: OpenPace::default(),
            last_generation: 0,
            edits: 0,
            jobs: 0,
            device: None,
            pool: FuturesOrdered::new(),
            outbox: Outbox::default(),
            malformed: 0,
            acknowledges: false,
            pace: Pace::new(step_times),
            heartbeat: Heartbeat::new(),
            coding: Coding::default(),
            reads_values: false,
            line: Line::new(),
            questions: Questions::default(),
            ahead: None,
            camera: None,
            stopped_camera: None,
            member: None,
            tried: None,
            resolving: None,
        }
    }

    /// Serves the viewer until it leaves, misbehaves or the server shuts down.
    pub(super) async fn run(
        mut self,
        mut inbox: mpsc::Receiver<Incoming>,
        outgoing: mpsc::Sender<Outgoing>,
        shutdown: CancellationToken,
    ) {
        let who = self.who.clone();
        let mut token_ended = std::pin::pin!(who.ended());
        let code = loop {
            self.advance_resolving();
            self.advance_pool();
            self.advance_device();
            self.advance_questions();
            self.advance_ahead();
            let held_until = self.open_pace.held_until(Instant::now());
            let is_listening = self.outbox.kept_bytes() < HIGH_WATER && held_until.is_none();
            let draw_pause_until = self.opened.as_ref().and_then(|opened| opened.draw_pause_until());
            let line_capacity_at = self.line.capacity_at();
            let rest_due = self.opened.as_ref().and_then(|opened| opened.rest_due());
            let lease = self
                .opened
                .as_ref()
                .map(|opened| opened.lease.clone())
                .unwrap_or_default();
            let event = tokio::select! {
                () = shutdown.cancelled() => Event::Shutdown,
                () = token_ended.as_mut() => Event::TokenEnded,
                () = outgoing.closed() => Event::WriterGone,
                message = inbox.recv(), if is_listening => Event::Message(message),
                permit = outgoing.reserve(), if self.may_write() => {
                    permit.map_or(Event::WriterGone, Event::WriterReady)
                }
                done = finished(&mut self.device) => Event::Device(done),
                Some(done) = self.pool.next() => Event::Pool(done),
                answered = finished(&mut self.questions.job) => Event::Answered(answered),
                resolved = finished(&mut self.resolving) => Event::Resolved(resolved),
                () = read_ahead(&mut self.ahead) => Event::ReadAhead,
                () = lease.removed() => Event::VolumeRemoved,
                () = reached(draw_pause_until) => Event::DrawPauseElapsed,
                () = self.pace.pong_wait_elapsed() => Event::PongWaitElapsed,
                () = reached(line_capacity_at) => Event::PongWaitElapsed,
                () = reached(self.heartbeat.due()) => Event::Beat,
                () = reached(held_until) => Event::OpenPaceElapsed,
                () = reached(rest_due), if self.device.is_none() => Event::RestDue,
                event = next_group_event(&mut self.member) => Event::Group(event),
                progress = opening_progress(&mut self.opened) => Event::OpeningProgress(progress),
            };
            let close = match event {
                Event::Shutdown => Some(CloseCode::Shutdown),
                Event::TokenEnded => {
                    let code = CloseCode::TokenEnded;
                    self.send_error("unauthorized", code.reason(), false);
                    Some(code)
                }
                Event::WriterGone | Event::Message(None) => return,
                Event::Message(Some(message)) => self.on_message(message),
                Event::WriterReady(permit) => {
                    self.on_writer_ready(permit);
                    // Sends as many frames as there is space for, without an iteration of the loop for each.
                    while self.may_write()
                        && let Ok(permit) = outgoing.try_reserve()
                    {
                        self.on_writer_ready(permit);
                    }
                    None
                }
                Event::Beat => self.on_beat(is_listening),
                Event::Device(done) => {
                    self.device = None;
                    self.on_device(done);
                    None
                }
                Event::Pool(done) => {
                    self.on_pool(done);
                    None
                }
                Event::Answered(answered) => {
                    self.on_answer(answered);
                    None
                }
                Event::Resolved(resolved) => {
                    self.resolving = None;
                    self.on_resolved(resolved);
                    None
                }
                Event::VolumeRemoved => {
                    self.on_removed_volume();
                    None
                }
                Event::OpeningProgress(progress) => {
                    self.on_progress(progress);
                    None
                }
                Event::Group(event) => {
                    self.on_group_event(event);
                    None
                }
                Event::DrawPauseElapsed => {
                    let surfaces = self.opened.iter_mut().flat_map(|opened| opened.surfaces_mut());
                    for generation in surfaces.filter_map(|(_, surface)| surface.generation_mut()) {
                        generation.draw_pause.end_if_elapsed();
                    }
                    None
                }
                // These events need no action: the next iteration of the loop starts the work that waited for them.
                Event::PongWaitElapsed | Event::OpenPaceElapsed | Event::RestDue | Event::ReadAhead => None,
            };
            if let Some(code) = close {
                break code;
            }
        };
        // Work ends at once; control frames are still sent, then the close frame. The writer has a deadline for each.
        (self.opened, self.resolving) = (None, None);
        self.questions.clear();
        self.ahead = None;
        self.member = None;
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
        metrics::stream_error(code);
        self.send(&ServerMessage::Error {
            code,
            message,
            open,
            surface: None,
            suggested_triangles: None,
        });
    }

    /// As [`Session::send_error`]; the log gets the chain of causes too.
    fn send_work_error(&mut self, error: &WorkError) {
        tracing::debug!(error = chain(error), "work failed");
        self.send_error(error.code(), error.public_message(), true);
    }

    /// Whether the writer may take the next frame. A small frame, such as the ping whose pong frees capacity, is sent on a full line too.
    fn may_write(&self) -> bool {
        let next = self.outbox.next_bytes();
        next.is_some_and(|bytes| bytes <= SMALL_FRAME || self.line.has_capacity())
    }

    /// Sends a heartbeat before all frames that wait, so that a client can tell a slow line from a dead one. The ping makes the client
    /// answer.
    fn on_beat(&mut self, is_listening: bool) -> Option<CloseCode> {
        let Some(longest) = self.heartbeat.beat(is_listening, self.line.time_of(BEFORE_BEAT)) else {
            return Some(CloseCode::Silent);
        };
        let message = ServerMessage::Heartbeat {
            seconds: longest.as_secs_f64(),
        };
        self.outbox.push_front(Frame::Ping(0));
        self.outbox.push_front(Frame::Control(message.to_json()));
        None
    }

    fn on_message(&mut self, message: Incoming) -> Option<CloseCode> {
        self.heartbeat.record_frame(matches!(message, Incoming::Pong(_)));
        let text = match message {
            Incoming::Text(text) => text,
            Incoming::Pong(number) => {
                if Line::is_own(number) {
                    self.line.on_pong(number);
                } else {
                    self.pace.on_pong(number);
                }
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
                    ClientMessage::Open { .. }
                    | ClientMessage::Step { .. }
                    | ClientMessage::Edit(_)
                    | ClientMessage::Remove { .. } => self.on_change(message),
                    ClientMessage::Camera { camera } => self.on_camera(camera),
                    ClientMessage::Cancel {} => self.on_cancel(),
                    ClientMessage::Heartbeat {} => self.heartbeat.begin(),
                    ClientMessage::Lead { .. }
                    | ClientMessage::Join { .. }
                    | ClientMessage::Leave {}
                    | ClientMessage::Pose(_)
                    | ClientMessage::AskControl { .. }
                    | ClientMessage::GiveControl { .. } => self.on_group_message(message),
                    ClientMessage::Probe { surface, position } => self.on_question(surface, Question::Probe(position)),
                    ClientMessage::Distribution { surface, bins } => {
                        self.on_question(surface, Question::Distribution(bins));
                    }
                    ClientMessage::Annotate { surface, annotation } => {
                        self.on_question(surface, questions::annotation_question(annotation));
                    }
                    ClientMessage::Curve { surface } => self.on_question(surface, Question::Curve),
                    ClientMessage::Drawn { generation } => self.on_drawn(generation),
                }
                None
            }
            Err(why) => {
                self.malformed += 1;
                let is_last = self.malformed >= MAX_MALFORMED;
                self.send_error("bad-message", why, !is_last);
                is_last.then_some(CloseCode::Malformed)
            }
        }
    }

    fn on_open(&mut self, id: &str, step: u32) {
        // Lease the volume first, so that the session notices if the volume is removed from here on.
        let lease = self.backend.lease(id);
        match self.backend.find(id, &self.who) {
            Some(dataset) => self.open_step(dataset, step, lease),
            None => self.refuse_volume(id),
        }
    }

    /// Opens the volume of the member in control, if this viewer may see it. Uses that member's samples, even if the catalogue has newer
    /// ones under this id.
    fn open_led(&mut self, led: &VolumeStep) {
        let id = &led.dataset().id;
        let lease = self.backend.lease(id);
        match self.backend.find(id, &self.who) {
            Some(_) => self.open_step(Arc::clone(led.dataset()), led.step(), lease),
            None => self.refuse_volume(id),
        }
    }

    fn refuse_volume(&mut self, id: &str) {
        self.open_pace.record_opening(Instant::now());
        self.close_volume();
        let where_else = of_another_server(id);
        let message = format!("no volume has the id {id:?}, GET /api/v1/volumes lists those there are{where_else}");
        self.send_error("unknown-volume", message, true);
    }

    fn open_step(&mut self, dataset: Arc<Dataset>, step: u32, lease: Lease) {
        self.open_pace.record_opening(Instant::now());
        self.close_volume();
        let view = match opening_view(&dataset) {
            Ok(view) => view,
            Err(error) => return self.send_error("unreadable-volume", format!("opening view: {error}"), true),
        };
        let volume = match VolumeStep::new(dataset, step) {
            Ok(volume) => volume,
            Err(error) => return self.send_error("unknown-step", error.to_string(), true),
        };
        self.opens += 1;
        // A camera is in the world of one volume.
        self.camera = None;
        self.broadcast_camera();
        let step_guard = self.backend.mark_open(&volume);
        self.opened = Some(OpenVolume::new(volume, view, step_guard, lease));
    }

    /// Sends the progress of opening a volume. A client that does not read gets only the newest state.
    fn on_progress(&mut self, progress: OpeningProgress) {
        let opening = ServerMessage::Opening {
            bytes: progress.bytes,
            total_bytes: progress.total_bytes,
            device: progress.device,
        };
        self.outbox.push_newest(Newest::Opening, opening.to_json());
    }
}

/// Resolves at a point in time; never if that is `None`.
async fn reached(when: Option<Instant>) {
    match when {
        Some(when) => tokio::time::sleep_until(when).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
mod trace;
