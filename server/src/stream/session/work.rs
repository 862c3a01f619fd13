//! What a session gives the device and the pool, and what it does with their answers.

use std::pin::Pin;
use std::sync::Arc;

use axum::body::Bytes;
use isopeel_kernels::Level;
use tokio::time::Instant;

use super::super::backend::{Backend, Opening};
use super::super::prefix::{Changes, PrefixError, compare, encode, take_batch};
use super::run::{PAUSE, Run, Sending, Step};
use super::scene::Phase;
use super::{Frame, LOW_WATER, Outgoing, Session};
use crate::error::chain;
use crate::extraction::statistics::Statistics;
use crate::extraction::{Extraction, Plan, WorkError};
use crate::wire::messages::ServerMessage;

/// What came back from the device.
pub(super) enum DeviceDone {
    Opened(u32, Result<Opening, WorkError>),
    Planned(u32, Result<Plan, WorkError>),
    Extracted(u32, Level, Result<Extraction, WorkError>),
}

/// What came back from the pool.
pub(super) enum PoolDone {
    Compared(Level, Result<Changes, PrefixError>),
    Encoded(Result<Vec<Bytes>, PrefixError>),
}

pub(super) type Boxed<T> = Pin<Box<dyn Future<Output = T> + Send>>;

/// Resolves with the job's result; never when there is none.
pub(super) async fn finished<T>(job: &mut Option<Boxed<T>>) -> T {
    match job {
        Some(future) => future.await,
        None => std::future::pending().await,
    }
}

impl<B: Backend> Session<B> {
    pub(super) fn on_device(&mut self, done: DeviceDone) {
        match done {
            DeviceDone::Opened(open, _) if open != self.opens => {}
            DeviceDone::Opened(_, Ok(opening)) => {
                let Some(scene) = &mut self.scene else { return };
                scene.phase = Phase::Open;
                scene.device = opening.device.clone();
                // Edits that came meanwhile stand; what they left alone has the value that `opened` states.
                scene.view.iso = scene.view.iso.or(opening.view.iso);
                let message = ServerMessage::Opened {
                    volume: opening.volume,
                    step: scene.volume.step(),
                    edit: opening.view.to_edit(),
                    device: opening.device,
                };
                self.say(&message);
            }
            DeviceDone::Opened(_, Err(error)) => {
                self.scene = None;
                self.say_error(error.code(), chain(&error), true);
            }
            DeviceDone::Planned(generation, result) => {
                let (Some(run), Some(scene)) = (&mut self.run, &mut self.scene) else {
                    return;
                };
                if run.generation != generation {
                    return;
                }
                match result {
                    Ok(plan) => run.planned(plan, scene),
                    Err(error) => self.fail_work(&error),
                }
            }
            DeviceDone::Extracted(generation, level, result) => {
                let (Some(run), Some(scene)) = (&mut self.run, &mut self.scene) else {
                    return;
                };
                if run.generation != generation {
                    return;
                }
                match result {
                    Ok(extraction) => {
                        if level == Level::FINEST {
                            scene.last_wall = extraction.wall;
                        } else if self.says_drawn && !run.committed {
                            run.paused_until = Some(Instant::now() + PAUSE);
                        }
                        run.wall += extraction.wall;
                        run.ready = Some((level, extraction));
                    }
                    Err(error) => self.fail_work(&error),
                }
            }
        }
    }

    pub(super) fn on_pool(&mut self, done: PoolDone) {
        let Some(run) = &mut self.run else { return };
        let generation = run.generation;
        match done {
            PoolDone::Compared(level, Ok(changes)) => {
                let message = ServerMessage::Prefix {
                    generation,
                    level: level.get(),
                    regions: changes.changed.len(),
                    standing: changes.standing,
                };
                self.outbox.push_back(Frame::Run(Outgoing::Text(message.to_json())));
                let mut rest = changes.changed;
                rest.reverse();
                run.sending = Some(Sending {
                    level,
                    rest,
                    held: changes.held,
                });
            }
            PoolDone::Encoded(Ok(chunks)) => {
                let frames = chunks.into_iter().map(|chunk| Frame::Run(Outgoing::Binary(chunk)));
                self.outbox.extend(frames);
            }
            PoolDone::Compared(_, Err(error)) | PoolDone::Encoded(Err(error)) => {
                tracing::error!(%error, "a prefix could not be encoded");
                return self.fail_run("device", chain(&error));
            }
        }
        let Some(sending) = run.sending.as_ref().filter(|sending| sending.rest.is_empty()) else {
            return;
        };
        let committed = ServerMessage::Committed {
            generation,
            level: sending.level.get(),
        };
        self.outbox.push_back(Frame::Commit(committed.to_json()));
        if sending.level == Level::FINEST
            && let Some(statistics) = run.statistics.take()
        {
            let done = ServerMessage::Done { generation, statistics };
            self.outbox.push_back(Frame::Done(done.to_json()));
        }
    }

    /// Gives the pool its next piece of the running generation.
    pub(super) fn advance_pool(&mut self) {
        let (Some(run), Some(scene), None) = (&mut self.run, &mut self.scene, &self.pool) else {
            return;
        };
        let token = run.token.clone();
        if let Some(sending) = &mut run.sending {
            if sending.rest.is_empty() || self.outbox.len() >= LOW_WATER {
                return;
            }
            let batch = take_batch(&mut sending.rest);
            let (generation, level) = (run.generation, sending.level.get());
            self.pool = Some(Box::pin(async move {
                PoolDone::Encoded(encode(batch, generation, level, token).await)
            }));
        } else if let Some((level, extraction)) = run.ready.take() {
            if level == Level::FINEST {
                let kernels = &extraction.surface.statistics;
                let spacing = scene.volume.dataset().geometry.spacing;
                run.statistics = Some(Statistics::new(kernels, &run.view, spacing, run.wall, &scene.device));
            }
            let held = Arc::clone(&scene.held);
            self.pool = Some(Box::pin(async move {
                let changes = compare(extraction.surface.regions, held, token).await;
                PoolDone::Compared(level, changes)
            }));
        }
    }

    /// Gives the device its next job: the volume to open, or the next prefix.
    pub(super) fn advance_device(&mut self) {
        let (Some(scene), None) = (&mut self.scene, &self.device) else {
            return;
        };
        let backend = self.backend.clone();
        let volume = scene.volume.clone();
        if scene.phase == Phase::Waiting {
            scene.phase = Phase::Opening;
            // As the dataset opens, whatever edits came since.
            let (open, token) = (self.opens, scene.token.clone());
            self.device = Some(Box::pin(async move {
                let opened = match volume.dataset().opening_view() {
                    Ok(view) => backend.open(&volume, &view, &token).await,
                    Err(error) => Err(error.into()),
                };
                DeviceDone::Opened(open, opened)
            }));
            return;
        }
        if self.run.is_none() && scene.wanted && scene.phase == Phase::Open {
            scene.wanted = false;
            self.generation += 1;
            self.run = Some(Run::new(self.generation, scene, self.answer));
        }
        let Some(run) = self.run.as_mut().filter(|run| run.ready.is_none()) else {
            return;
        };
        // The first prefix has the processors to itself until it is encoded: on a CPU the device would take them.
        if run.paused_until.is_some() || !run.committed && self.pool.is_some() {
            return;
        }
        let Some(step) = run.next_step() else { return };
        let (generation, token) = (run.generation, run.token.clone());
        self.device = Some(Box::pin(async move {
            match step {
                Step::Plan(view, levels) => {
                    DeviceDone::Planned(generation, backend.plan(&volume, &view, levels, &token).await)
                }
                Step::Extract(view, level) => {
                    let extracted = backend.extract(&volume, &view, level, &token).await;
                    DeviceDone::Extracted(generation, level, extracted)
                }
            }
        }));
    }

    fn fail_work(&mut self, error: &WorkError) {
        if let Some(triangles) = error.suggested_triangles() {
            tracing::debug!(%error, "refused");
            self.say(&ServerMessage::Error {
                code: error.code(),
                message: error.to_string(),
                open: true,
                suggested_triangles: Some(triangles),
            });
            return self.end_run();
        }
        self.fail_run(error.code(), chain(error));
    }

    fn fail_run(&mut self, code: &'static str, message: String) {
        self.say_error(code, message, true);
        self.end_run();
    }
}
