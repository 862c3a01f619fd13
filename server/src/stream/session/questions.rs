//! Questions of a viewer about one of its surfaces.
//!
//! Only the newest question of each kind waits. One question is answered at a time, and only when no generation of any surface is running:
//! questions wait for edits, and edits never wait for questions. An edit cancels the running question, which is repeated for the new
//! surface. Work at rest pauses for an answer.
//!
//! An annotation, such as the distances of all vertices, takes long. So it comes after the work at rest, and an edit drops it.

use std::sync::Arc;

use axum::body::Bytes;
use isopeel_codec::chunk::{ChunkKind, PrefixId};
use isopeel_extraction::{Answer, Question, ShownSurface, WorkError};
use isopeel_kernels::DistanceOf;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::backend::Backend;
use super::super::prefix::{PrefixError, encode_errors};
use super::Outgoing;
use super::Session;
use super::jobs::BoxFuture;
use super::open_volume::OpeningPhase;
use super::outbox::Frame;
use super::shown::HeldSurface;
use crate::wire::messages::{Annotation, ServerMessage};

/// Number and result of a finished question.
pub(super) type Answered = (u32, Result<QuestionResult, WorkError>);

/// Result of a question, ready to be sent.
pub(super) enum QuestionResult {
    Answer(Answer),
    /// Chunks of an annotation.
    Chunks(Vec<Bytes>),
}

/// A question that the device is answering. Dropping this cancels the job.
struct Running {
    number: u32,
    /// The surface that the question is about.
    surface: u8,
    generation: u32,
    question: Question,
    _cancel: DropGuard,
}

/// A viewer's questions.
#[derive(Default)]
pub(super) struct Questions {
    /// The newest waiting question of each kind with its surface, in order of priority ([`priority`]).
    waiting: [Option<(u8, Question)>; 4],
    running: Option<Running>,
    /// Number of the last question that was started.
    last_number: u32,
    /// The job of the running question. A cancelled job must also return before the next question is queued.
    pub job: Option<BoxFuture<Answered>>,
}

/// Index of annotations in [`Questions::waiting`]: the last one, because they have the lowest priority.
const ANNOTATIONS: usize = 3;

/// Returns the question to the device for an annotation.
pub(super) fn annotation_question(annotation: Annotation) -> Question {
    Question::VertexErrors(match annotation {
        Annotation::Error => DistanceOf::Vertex,
        Annotation::ErrorAround => DistanceOf::Around,
    })
}

/// Returns the priority of a question's kind, which is the kind's index in [`Questions::waiting`]. Questions that follow the pointer come
/// first.
fn priority(question: Question) -> usize {
    match question {
        Question::Probe(_) => 0,
        Question::Distribution(_) => 1,
        Question::Curve => 2,
        Question::VertexErrors(_) => ANNOTATIONS,
    }
}

impl Questions {
    /// Queues a question in place of a waiting one of its kind.
    fn enqueue(&mut self, surface: u8, question: Question) {
        self.waiting[priority(question)] = Some((surface, question));
    }

    /// Takes the waiting question of the highest priority. An annotation, which takes long, is taken only if all surfaces are idle.
    fn take_next(&mut self, is_idle: bool) -> Option<(u8, Question)> {
        let end = if is_idle { self.waiting.len() } else { ANNOTATIONS };
        self.waiting[..end].iter_mut().find_map(Option::take)
    }

    /// Cancels the running question because an edit goes first. The question is repeated afterwards, unless a newer one of its kind waits.
    /// An annotation is dropped, because it belongs to the surface that was shown before the edit.
    pub(super) fn cancel_for_edit(&mut self) {
        self.drop_annotation();
        if let Some(Running { surface, question, .. }) = self.running.take() {
            self.waiting[priority(question)].get_or_insert((surface, question));
        }
    }

    /// Whether a question waits or is being answered, besides annotations.
    pub(super) fn is_asked(&self) -> bool {
        let is_annotation = |question: &Question| priority(*question) == ANNOTATIONS;
        let is_running = self
            .running
            .as_ref()
            .is_some_and(|running| !is_annotation(&running.question));
        is_running || self.waiting[..ANNOTATIONS].iter().any(Option::is_some)
    }

    /// Drops an annotation of any surface: an edit of one surface may change the others through their parts of the budget.
    pub(super) fn drop_annotation(&mut self) {
        self.waiting[ANNOTATIONS] = None;
        self.running
            .take_if(|running| matches!(running.question, Question::VertexErrors(_)));
    }

    /// Drops the questions about a surface that was removed.
    pub(super) fn drop_surface(&mut self, surface: u8) {
        self.drop_annotation();
        for waiting in &mut self.waiting {
            waiting.take_if(|(about, _)| *about == surface);
        }
        self.running.take_if(|running| running.surface == surface);
    }

    /// Drops all questions: the viewer no longer waits for answers.
    pub(super) fn clear(&mut self) {
        self.waiting = Default::default();
        self.running = None;
    }

    /// Takes the running question of this number; `None` if it was cancelled meanwhile.
    fn take_running(&mut self, number: u32) -> Option<Running> {
        self.running.take_if(|running| running.number == number)
    }
}

impl<B: Backend> Session<B> {
    /// Handles a question of the client.
    pub(super) fn on_question(&mut self, surface: u32, question: Question) {
        if let Err(why) = question.check() {
            return self.send_error("bad-question", why, true);
        }
        if let Some(surface) = self.find_surface(surface) {
            self.questions.enqueue(surface, question);
        }
    }

    /// Starts the next question, if no other one is being answered and no surface is still to be made.
    pub(super) fn advance_questions(&mut self) {
        let (Some(opened), None) = (&self.opened, &self.questions.job) else {
            return;
        };
        if opened.phase != OpeningPhase::Open || opened.is_awaited() {
            return;
        }
        // No annotation is started while the chunks of another one wait in the outbox.
        let is_idle = self.device.is_none()
            && self.outbox.surface_bytes() == 0
            && opened.surfaces().all(|(_, surface)| surface.rest().is_none());
        let Some((surface, question)) = self.questions.take_next(is_idle) else {
            return;
        };
        self.start_question(surface, question);
    }

    /// Starts the job that answers a question about a surface.
    fn start_question(&mut self, surface: u8, question: Question) {
        let Some(opened) = &self.opened else { return };
        let Some(session) = opened.surface(surface) else { return };
        self.questions.last_number += 1;
        let (number, token) = (self.questions.last_number, CancellationToken::new());
        let shown = session
            .shown
            .clone()
            .map(|HeldSurface { view, cut, .. }| ShownSurface { view, cut });
        self.questions.running = Some(Running {
            number,
            surface,
            generation: session.shown_generation,
            question,
            _cancel: token.clone().drop_guard(),
        });
        let (backend, volume, held) = (self.backend.clone(), opened.volume.clone(), Arc::clone(&session.held));
        let chunk_id = PrefixId {
            kind: ChunkKind::Error,
            ..PrefixId::cut(surface, session.shown_generation, 0)
        };
        self.questions.job = Some(Box::pin(async move {
            let result = match backend.answer(&volume, shown.as_ref(), question, &token).await {
                Ok(Answer::VertexErrors(errors)) => match encode_errors(errors, held, chunk_id, token).await {
                    Ok(chunks) => Ok(QuestionResult::Chunks(chunks)),
                    Err(PrefixError::Cancelled) => Err(WorkError::Cancelled),
                    Err(error) => {
                        tracing::error!(%error, "errors of vertices could not be encoded");
                        Err(WorkError::Stopped)
                    }
                },
                answer => answer.map(QuestionResult::Answer),
            };
            (number, result)
        }));
    }

    /// Sends the result of a question. If the question was cancelled meanwhile, drops it.
    pub(super) fn on_answer(&mut self, (number, result): Answered) {
        self.questions.job = None;
        let Some(Running {
            surface,
            generation,
            question,
            ..
        }) = self.questions.take_running(number)
        else {
            return;
        };
        let message = match result {
            Ok(QuestionResult::Chunks(chunks)) => return self.send_annotation(surface, generation, question, chunks),
            // The job has encoded errors of vertices as chunks.
            Ok(QuestionResult::Answer(Answer::VertexErrors(_))) => return,
            Ok(QuestionResult::Answer(Answer::Probe(probe))) => ServerMessage::Probed {
                surface,
                generation,
                probe,
            },
            Ok(QuestionResult::Answer(Answer::Distribution(distribution))) => ServerMessage::Distribution {
                surface,
                generation,
                distribution,
            },
            Ok(QuestionResult::Answer(Answer::Curve(curve))) => ServerMessage::Curve {
                surface,
                generation,
                curve,
            },
            Err(WorkError::Cancelled) => return,
            Err(error) => return self.send_work_error(&error),
        };
        self.send(&message);
    }

    /// Queues the message of an annotation, and its chunks behind it.
    fn send_annotation(&mut self, surface: u8, generation: u32, question: Question, chunks: Vec<Bytes>) {
        let message = ServerMessage::Annotated {
            surface,
            generation,
            annotation: match question {
                Question::VertexErrors(DistanceOf::Around) => Annotation::ErrorAround,
                _ => Annotation::Error,
            },
            regions: chunks.len(),
        };
        self.outbox
            .push_back(Frame::Annotation(surface, Outgoing::Text(message.to_json())));
        let chunks = chunks
            .into_iter()
            .map(|chunk| Frame::Annotation(surface, Outgoing::Binary(chunk)));
        self.outbox.extend(chunks);
    }
}
