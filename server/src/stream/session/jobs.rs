//! A session's jobs: at most one on the device and one on the CPU pool, and what their results lead to.

use std::pin::Pin;
use std::sync::Arc;

use axum::body::Bytes;
use isopeel_kernels::Level;
use tokio::sync::watch;

use super::super::backend::{Backend, Opening};
use super::super::prefix::{Changes, PrefixError, compare, encode, take_batch};
use super::generation::{Generation, Sending, Step};
use super::open_volume::Phase;
use super::{Frame, LOW_WATER, Outgoing, SURFACE, Session};
use crate::error::chain;
use crate::extraction::{Extraction, ExtractionStatistics, OpeningProgress, Plan, WorkError};
use crate::wire::chunk::{ChunkKind, PrefixId};
use crate::wire::messages::{Capabilities, ServerMessage};

/// A finished device job; the numbers are those of the open or of the generation that it was queued for.
pub(super) enum DeviceDone {
    Opened(u32, Result<Opening, WorkError>),
    Planned(u32, Result<Plan, WorkError>),
    Extracted(u32, Level, Result<Extraction, WorkError>),
}

/// A finished pool job.
pub(super) enum PoolDone {
    Compared(Level, Result<Changes, PrefixError>),
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
        let is_current = match done {
            DeviceDone::Opened(open, _) => open == self.opens,
            DeviceDone::Planned(number, _) | DeviceDone::Extracted(number, ..) => self
                .generation
                .as_ref()
                .is_some_and(|generation| generation.number == number),
        };
        if !is_current {
            return;
        }
        match done {
            DeviceDone::Opened(_, Ok(opening)) => self.on_opened(opening),
            DeviceDone::Opened(_, Err(error)) => {
                self.opened = None;
                self.send_error(error.code(), chain(&error), true);
            }
            DeviceDone::Planned(_, Ok(plan)) => {
                if let (Some(generation), Some(opened)) = (&mut self.generation, &mut self.opened) {
                    generation.planned(plan, opened);
                }
            }
            DeviceDone::Extracted(_, level, Ok(extraction)) => self.on_extracted(level, extraction),
            DeviceDone::Planned(_, Err(error)) | DeviceDone::Extracted(_, _, Err(error)) => self.fail_job(&error),
        }
    }

    fn on_opened(&mut self, opening: Opening) {
        let Some(opened) = &mut self.opened else { return };
        opened.phase = Phase::Open;
        opened.progress = None;
        opened.device = opening.device.clone();
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

    fn on_extracted(&mut self, level: Level, extraction: Extraction) {
        let (Some(generation), Some(opened)) = (&mut self.generation, &mut self.opened) else {
            return;
        };
        if level == Level::FINEST {
            opened.last_wall = extraction.wall;
        } else if !generation.committed {
            self.draw_pause.begin(generation.number);
        }
        generation.wall += extraction.wall;
        generation.ready = Some((level, extraction));
    }

    pub(super) fn on_pool(&mut self, done: PoolDone) {
        let Some(generation) = &mut self.generation else { return };
        match done {
            PoolDone::Compared(level, Ok(changes)) => {
                let message = ServerMessage::Prefix {
                    surface: SURFACE,
                    generation: generation.number,
                    level: level.get(),
                    kind: ChunkKind::Cut,
                    regions: changes.changed.len(),
                    unchanged: changes.unchanged,
                    triangles: changes.triangles,
                    is_final: level == Level::FINEST,
                };
                self.outbox.push_back(Frame::Prefix(Outgoing::Text(message.to_json())));
                let mut remaining = changes.changed;
                remaining.reverse();
                generation.sending = Some(Sending {
                    level,
                    remaining,
                    held: changes.held,
                });
            }
            PoolDone::Encoded(Ok(chunks)) => {
                let frames = chunks.into_iter().map(|chunk| Frame::Prefix(Outgoing::Binary(chunk)));
                self.outbox.extend(frames);
            }
            PoolDone::Compared(_, Err(error)) | PoolDone::Encoded(Err(error)) => {
                tracing::error!(%error, "a prefix could not be encoded");
                return self.fail_generation("device", chain(&error));
            }
        }
        self.finish_prefix();
    }

    /// Queues `committed` behind a prefix whose regions are all encoded, and `done` behind the final one.
    fn finish_prefix(&mut self) {
        let Some(generation) = &mut self.generation else { return };
        let Some(sending) = generation
            .sending
            .as_ref()
            .filter(|sending| sending.remaining.is_empty())
        else {
            return;
        };
        let number = generation.number;
        let committed = ServerMessage::Committed {
            surface: SURFACE,
            generation: number,
            level: sending.level.get(),
            is_final: sending.level == Level::FINEST,
        };
        self.outbox.push_back(Frame::Commit(committed.to_json()));
        if sending.level == Level::FINEST
            && let Some(statistics) = generation.statistics.take()
        {
            let done = ServerMessage::Done {
                surface: SURFACE,
                generation: number,
                statistics,
            };
            self.outbox.push_back(Frame::Done(done.to_json()));
        }
    }

    /// Starts the next pool job: the next batch of the prefix that is being sent, or else the comparison of one that is ready.
    pub(super) fn advance_pool(&mut self) {
        let (Some(generation), Some(opened), None) = (&mut self.generation, &mut self.opened, &self.pool) else {
            return;
        };
        let token = generation.token.clone();
        if let Some(sending) = &mut generation.sending {
            if sending.remaining.is_empty() || self.outbox.len() >= LOW_WATER {
                return;
            }
            let batch = take_batch(&mut sending.remaining);
            let prefix = PrefixId::cut(SURFACE, generation.number, sending.level.get());
            self.pool = Some(Box::pin(async move {
                PoolDone::Encoded(encode(batch, prefix, token).await)
            }));
        } else if let Some((level, extraction)) = generation.ready.take() {
            if level == Level::FINEST {
                let kernels = &extraction.surface.statistics;
                let spacing = opened.volume.dataset().geometry.spacing;
                let statistics =
                    ExtractionStatistics::new(kernels, &generation.view, spacing, generation.wall, &opened.device);
                generation.statistics = Some(statistics);
            }
            let held = Arc::clone(&opened.held);
            self.pool = Some(Box::pin(async move {
                let changes = compare(extraction.surface.regions, held, token).await;
                PoolDone::Compared(level, changes)
            }));
        }
    }

    /// Starts the next device job: the volume to open, or the next step of the generation, or of a new one.
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
            self.last_generation += 1;
            let generation = Generation::new(self.last_generation, opened, self.first_prefix_target);
            self.generation = Some(generation);
        }
        self.start_step();
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
        // A prefix that waits for the pool is as far ahead as the device may be. Until the first one is encoded it does not
        // even start the next: a CPU device would take the processors that the pool needs.
        let encoding_first = !generation.committed && self.pool.is_some();
        if generation.ready.is_some() || encoding_first || self.draw_pause.is_active() {
            return;
        }
        let Some(step) = generation.next_step() else { return };
        let (backend, volume) = (self.backend.clone(), opened.volume.clone());
        let (number, token) = (generation.number, generation.token.clone());
        self.device = Some(Box::pin(async move {
            match step {
                Step::Plan(view, levels) => {
                    DeviceDone::Planned(number, backend.plan(&volume, &view, levels, &token).await)
                }
                Step::Extract(view, level) => {
                    let extracted = backend.extract(&volume, &view, level, &token).await;
                    DeviceDone::Extracted(number, level, extracted)
                }
            }
        }));
    }

    fn fail_job(&mut self, error: &WorkError) {
        if let Some(triangles) = error.suggested_triangles() {
            tracing::debug!(%error, "refused");
            self.send(&ServerMessage::Error {
                code: error.code(),
                message: error.to_string(),
                open: true,
                surface: Some(SURFACE),
                suggested_triangles: Some(triangles),
            });
            return self.end_generation();
        }
        self.fail_generation(error.code(), chain(error));
    }

    fn fail_generation(&mut self, code: &'static str, message: String) {
        tracing::debug!(code, message, "a generation failed");
        self.send(&ServerMessage::Error {
            code,
            message,
            open: true,
            surface: Some(SURFACE),
            suggested_triangles: None,
        });
        self.end_generation();
    }
}
