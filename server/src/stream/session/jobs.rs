//! A session's jobs: at most one on the device, on the CPU pool a comparison or [`MAX_BATCHES`], and what their results lead to.

use std::pin::Pin;
use std::sync::Arc;

use axum::body::Bytes;
use tokio::sync::watch;

use super::super::backend::{Backend, Opening};
use super::super::prefix::{Changes, PrefixError, compare, encode, take_batch};
use super::generation::{Generation, Making, Sending};
use super::open_volume::Phase;
use super::outbox::Frame;
use super::rest::RestWork;
use super::{LOW_WATER, Outgoing, SURFACE, Session};
use crate::error::chain;
use crate::extraction::{Measurement, OpeningProgress, Refinement, Shown, Step, WorkError};
use crate::wire::chunk::ChunkKind;
use crate::wire::messages::{Capabilities, RegionError, ServerMessage};

/// Batches that are encoded at once: the next one fills the threads that have nothing left to do of the one before.
const MAX_BATCHES: usize = 2;

/// A finished device job; the numbers are those of the open or of the generation that it was queued for.
pub(super) enum DeviceDone {
    Opened(u32, Result<Opening, WorkError>),
    Refined(u32, Result<Box<Refinement>, WorkError>),
    Improved(u32, Result<Option<Box<Refinement>>, WorkError>),
    Measured(u32, Result<Option<Measurement>, WorkError>),
}

/// A finished pool job.
pub(super) enum PoolDone {
    Compared(Result<Changes, PrefixError>),
    Encoded(Result<Vec<Bytes>, PrefixError>),
}

pub(super) type BoxFuture<T> = Pin<Box<dyn Future<Output = T> + Send>>;

/// Resolves with the job's result; never where there is no job.
pub(super) async fn finished<T>(job: &mut Option<BoxFuture<T>>) -> T {
    match job {
        Some(future) => future.await,
        None => std::future::pending().await,
    }
}

impl<B: Backend> Session<B> {
    /// A result of an earlier open or generation is dropped.
    pub(super) fn on_device(&mut self, done: DeviceDone) {
        match done {
            DeviceDone::Opened(open, result) if open == self.opens => match result {
                Ok(opening) => self.on_opened(opening),
                Err(error) => {
                    self.opened = None;
                    self.send_error(error.code(), chain(&error), true);
                }
            },
            DeviceDone::Refined(number, result) => match (&mut self.generation, result) {
                (Some(generation), result) if generation.number == number => match result {
                    Ok(made) => {
                        if !made.is_final && !generation.committed {
                            self.draw_pause.begin(number);
                        }
                        generation.made(made);
                    }
                    Err(error) => self.fail_job(&error),
                },
                _ => {}
            },
            DeviceDone::Improved(number, result) => self.on_improved(number, result),
            DeviceDone::Measured(number, result) => self.on_measured(number, result),
            DeviceDone::Opened(..) => {}
        }
    }

    fn on_opened(&mut self, opening: Opening) {
        let Some(opened) = &mut self.opened else { return };
        opened.phase = Phase::Open;
        opened.progress = None;
        opened.device = opening.device.clone();
        opened.shares_processors = opening.shares_processors;
        // An isovalue edited meanwhile stays; otherwise it is the one that `opened` states.
        opened.view.iso = opened.view.iso.or(opening.view.iso);
        let message = ServerMessage::Opened {
            volume: opening.volume,
            step: opened.volume.step(),
            edit: opening.view.to_edit(),
            device: opening.device,
            capabilities: Capabilities::default(),
        };
        self.send(&message);
    }

    /// The better surface is sent as one more step of its generation, with another `done`.
    fn on_improved(&mut self, number: u32, result: Result<Option<Box<Refinement>>, WorkError>) {
        let Some(rest) = self.rest.as_mut().filter(|rest| rest.generation == number) else {
            return;
        };
        match result {
            Ok(Some(made)) => {
                let mut generation = Generation::new(number, rest.view.clone(), Shown::Alike);
                generation.made(made);
                self.rest = None;
                self.generation = Some(generation);
            }
            Ok(None) => rest.cannot_improve(),
            Err(WorkError::Cancelled) => {}
            Err(error) => {
                tracing::warn!(error = chain(&error), "a surface could not be improved");
                rest.cannot_improve();
                // Else nobody would know that the surface has parts that were to be removed.
                if rest.view.min_part > 0.0 {
                    self.send_error(error.code(), chain(&error), true);
                }
            }
        }
    }

    /// Measuring is a courtesy: where it fails, nothing is said but in the log.
    fn on_measured(&mut self, number: u32, result: Result<Option<Measurement>, WorkError>) {
        match result {
            Ok(Some(measured)) if self.rest.as_ref().is_some_and(|rest| rest.generation == number) => {
                let regions = measured.regions.iter();
                let message = ServerMessage::Measured {
                    surface: SURFACE,
                    generation: number,
                    error: measured.whole.into(),
                    regions: regions
                        .map(|&(region, error)| RegionError {
                            region,
                            rms: error.rms,
                            max: error.max,
                        })
                        .collect(),
                };
                self.rest = None;
                self.send(&message);
            }
            Ok(_) | Err(WorkError::Cancelled) => {}
            Err(error) => tracing::warn!(error = chain(&error), "a surface could not be measured"),
        }
    }

    pub(super) fn on_pool(&mut self, done: PoolDone) {
        let Some(generation) = &mut self.generation else { return };
        match done {
            PoolDone::Compared(Ok(changes)) => {
                let Some(sent) = generation.sent() else { return };
                let message = ServerMessage::Prefix {
                    surface: SURFACE,
                    generation: sent.id.generation,
                    level: sent.id.level,
                    kind: ChunkKind::Cut,
                    regions: changes.changed.len(),
                    unchanged: changes.unchanged,
                    triangles: sent.surface_triangles,
                    is_final: sent.is_final,
                };
                self.outbox.push_back(Frame::Prefix(Outgoing::Text(message.to_json())));
                generation.compared(changes);
            }
            PoolDone::Encoded(Ok(chunks)) => {
                if let Sending::Encoding { sent, batches, .. } = &mut generation.sending {
                    *batches -= 1;
                    sent.bytes += chunks.iter().map(|chunk| chunk.len() as u64).sum::<u64>();
                }
                let frames = chunks.into_iter().map(|chunk| Frame::Prefix(Outgoing::Binary(chunk)));
                self.outbox.extend(frames);
            }
            PoolDone::Compared(Err(error)) | PoolDone::Encoded(Err(error)) => {
                tracing::error!(%error, "a prefix could not be encoded");
                return self.fail_generation("device", chain(&error));
            }
        }
        self.finish_step();
    }

    /// Queues `committed` behind a step whose regions are all encoded, and `done` behind the final one.
    fn finish_step(&mut self) {
        let Some(generation) = &mut self.generation else { return };
        match std::mem::replace(&mut generation.sending, Sending::Idle) {
            Sending::Encoding {
                mut sent,
                remaining,
                batches: 0,
                held,
            } if remaining.is_empty() => {
                self.pace.made(sent.triangles, sent.time + sent.began.elapsed());
                let committed = ServerMessage::Committed {
                    surface: SURFACE,
                    generation: sent.id.generation,
                    level: sent.id.level,
                    is_final: sent.is_final,
                };
                let done = sent.statistics.take().map(|statistics| ServerMessage::Done {
                    surface: SURFACE,
                    generation: sent.id.generation,
                    statistics,
                });
                self.outbox.push_back(Frame::Commit(committed.to_json()));
                self.outbox.extend(done.map(|done| Frame::Done(done.to_json())));
                generation.sending = Sending::Committing(sent, held);
            }
            other => generation.sending = other,
        }
    }

    /// Starts what the pool can do: the next batches of the step that is being sent, or else the comparison of one that is ready.
    pub(super) fn advance_pool(&mut self) {
        let (Some(generation), Some(opened)) = (&mut self.generation, &self.opened) else {
            return;
        };
        if matches!(generation.sending, Sending::Idle)
            && !self.pace.is_line_full()
            && let Some(made) = generation.take_made()
        {
            let sent = generation.sent_of(&made, opened);
            generation.sending = Sending::Comparing(sent);
            let (held, token) = (Arc::clone(&opened.held), generation.token.clone());
            self.pool.push_back(Box::pin(async move {
                PoolDone::Compared(compare(made.surface, held, token).await)
            }));
        }
        if let Sending::Encoding {
            sent,
            remaining,
            batches,
            ..
        } = &mut generation.sending
        {
            while !remaining.is_empty() && *batches < MAX_BATCHES && self.outbox.surface_bytes() < LOW_WATER {
                let (batch, id, token) = (take_batch(remaining), sent.id, generation.token.clone());
                *batches += 1;
                self.pool.push_back(Box::pin(
                    async move { PoolDone::Encoded(encode(batch, id, token).await) },
                ));
            }
        }
    }

    /// Starts the next device job: the volume to open, the next step of the generation or of a new one, or the measurement of a
    /// surface that rests.
    pub(super) fn advance_device(&mut self) {
        if self.device.is_some() {
            return;
        }
        let Some(opened) = &mut self.opened else { return };
        if opened.phase == Phase::Waiting {
            return self.start_opening();
        }
        if self.generation.is_none() && opened.edit_pending && opened.phase == Phase::Open {
            opened.edit_pending = false;
            self.rest = None;
            self.last_generation += 1;
            let view = opened.view.clone();
            let shown = opened.shown_for(&view);
            self.generation = Some(Generation::new(self.last_generation, view, shown));
        }
        self.start_step();
        self.start_rest_work();
    }

    fn start_opening(&mut self) {
        let Some(opened) = &mut self.opened else { return };
        opened.phase = Phase::Opening;
        let (progress, watched) = watch::channel(OpeningProgress::default());
        opened.progress = Some(watched);
        let (backend, volume) = (self.backend.clone(), opened.volume.clone());
        let (open, token) = (self.opens, opened.token.clone());
        self.device = Some(Box::pin(async move {
            // The view that the dataset opens with, not the one that edits have changed meanwhile.
            let result = match volume.dataset().opening_view() {
                Ok(view) => backend.open(&volume, &view, &token, &progress).await,
                Err(error) => Err(error.into()),
            };
            DeviceDone::Opened(open, result)
        }));
    }

    fn start_step(&mut self) {
        let (Some(generation), Some(opened)) = (&mut self.generation, &self.opened) else {
            return;
        };
        // Until the first step is encoded the next one does not even start where the device would take the processors that the pool
        // needs. Nor does one that a newer edit has overtaken.
        let encoding_first = opened.shares_processors
            && !generation.committed
            && matches!(generation.sending, Sending::Comparing(_) | Sending::Encoding { .. });
        // The size of the next one depends on how fast the line is, which the pong of the first one says.
        let is_sending = !matches!(generation.sending, Sending::Idle) || self.pace.is_line_full();
        let measuring_line = generation.steps_made > 0 && !self.pace.is_line_known() && is_sending;
        let is_waiting = matches!(generation.making, Making::Waiting);
        if !is_waiting
            || measuring_line
            || encoding_first
            || generation.is_overtaken && generation.steps_made > 0
            || self.draw_pause.is_active()
        {
            return;
        }
        let is_first = generation.steps_made == 0;
        let step = Step {
            shown: generation.shown,
            target: generation.target,
            fresh_triangles: self.pace.fresh(),
            triangles: self.pace.changing(is_first),
            bytes: self.pace.bytes(),
        };
        generation.making = Making::OnDevice;
        let (backend, volume, view) = (self.backend.clone(), opened.volume.clone(), generation.view.clone());
        let (number, token) = (generation.number, generation.token.clone());
        self.device = Some(Box::pin(async move {
            DeviceDone::Refined(number, backend.refine(&volume, &view, step, &token).await.map(Box::new))
        }));
    }

    fn start_rest_work(&mut self) {
        let (Some(rest), Some(opened), None, None) = (&mut self.rest, &self.opened, &self.device, &self.generation)
        else {
            return;
        };
        let Some(work) = rest.begin() else { return };
        let (backend, volume, view) = (self.backend.clone(), opened.volume.clone(), rest.view.clone());
        let (number, token) = (rest.generation, rest.token.clone());
        self.device = Some(match work {
            RestWork::Improve => Box::pin(async move {
                let improved = backend.improve(&volume, &view, &token).await;
                DeviceDone::Improved(number, improved.map(|made| made.map(Box::new)))
            }),
            RestWork::Measure => {
                Box::pin(async move { DeviceDone::Measured(number, backend.measure(&volume, &view, &token).await) })
            }
        });
    }

    fn fail_job(&mut self, error: &WorkError) {
        let suggested_triangles = error.suggested_triangles();
        if suggested_triangles.is_none() {
            return self.fail_generation(error.code(), chain(error));
        }
        tracing::debug!(%error, "refused");
        self.send(&ServerMessage::Error {
            code: error.code(),
            message: error.to_string(),
            open: true,
            surface: Some(SURFACE),
            suggested_triangles,
        });
        self.end_generation();
    }

    fn fail_generation(&mut self, code: &'static str, message: String) {
        self.send_error(code, message, true);
        self.end_generation();
    }
}
