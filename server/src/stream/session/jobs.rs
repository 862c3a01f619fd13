//! A session's jobs and their results: at most one job on the device, and on the CPU pool a comparison or [`MAX_BATCHES`] batches.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use isopeel_codec::chunk::{ChunkKind, Coding, without_values};
use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{FullCount, Measurement, Shown, Step, SurfaceKey, WorkError};
use serde_json::value::RawValue;
use tokio::sync::watch;

use super::super::backend::{Backend, Opening};
use super::super::groups::Member;
use super::super::prefix::{Changes, PrefixError, compare, encode, take_batch};
use super::super::shared::{Offered, Outcome, SurfaceRequest};
use super::generation::{Generation, Making, OwnStep, Sending};
use super::open_volume::OpeningPhase;
use super::outbox::Frame;
use super::rest::RestWork;
use super::schedule::NextJob;
use super::sharing::Verdict;
use super::surface::Phase;
use super::{Outgoing, Session};
use crate::error::chain;
use crate::service::OpeningProgress;
use crate::wire::messages::{Capabilities, RegionError, ServerMessage};

/// Maximum triangles of a new surface's first step, summed over the followers of a group. On two cores, a thousand followers get that many
/// triangles within 70 ms.
const FOLLOWED_TRIANGLES: u64 = 2_000_000;

/// Minimum rate of a fast line, in bytes a second. On a fast line the coding for slow lines is not used: encoding in it takes longer than
/// sending the bytes that it saves.
const MIN_FAST_LINE: u64 = 4_000_000;
/// As [`MIN_FAST_LINE`], for an intermediate step. This rate is lower, because coarse meshes are harder to predict: the coding for slow
/// lines saves only a fifth of their bytes.
const MIN_FAST_LINE_OF_COARSE: u64 = 1_250_000;

/// Maximum number of batches that are encoded at once: the second one uses the threads that are idle at the end of the first.
const MAX_BATCHES: usize = 2;

/// A finished device job, with the number of the `open` or of the generation for which it was queued.
pub(super) enum DeviceDone {
    Opened(u32, Result<Box<Opening>, WorkError>),
    Counted(u32, Outcome<FullCount>),
    Refined(u32, Outcome<Offered>),
    Improved(u32, Outcome<Option<Offered>>),
    Measured(u32, Outcome<Option<Arc<Measurement>>>),
    /// Description of a time step, with the number of the `open` and the step.
    Described(u32, u32, Result<Box<RawValue>, WorkError>),
}

/// A finished pool job.
pub(super) enum PoolDone {
    Compared(Result<Changes, PrefixError>),
    Encoded(Result<Vec<Bytes>, PrefixError>),
}

pub(super) type BoxFuture<T> = Pin<Box<dyn Future<Output = T> + Send>>;

/// Resolves with the job's result; never if there is no job.
pub(super) async fn finished<T>(job: &mut Option<BoxFuture<T>>) -> T {
    match job {
        Some(future) => future.await,
        None => std::future::pending().await,
    }
}

impl<B: Backend> Session<B> {
    /// Handles a result of the device. Drops a result of an earlier open or generation.
    pub(super) fn on_device(&mut self, done: DeviceDone) {
        match done {
            DeviceDone::Opened(open, result) if open == self.opens => match result {
                Ok(opening) => self.on_opened(*opening),
                Err(error) => {
                    self.opened = None;
                    self.questions.clear();
                    self.send_work_error(&error);
                }
            },
            DeviceDone::Counted(number, result) => self.on_counted(number, result),
            DeviceDone::Refined(number, result) => self.on_refined(number, result),
            DeviceDone::Improved(number, result) => self.on_improved(number, result),
            DeviceDone::Measured(number, result) => self.on_measured(number, result),
            DeviceDone::Described(open, step, result) => self.on_described(open, step, result),
            DeviceDone::Opened(..) => {}
        }
    }

    fn on_opened(&mut self, opening: Opening) {
        let Some(opened) = &mut self.opened else { return };
        opened.on_opened(opening.view.clone(), self.edits);
        opened.device = opening.device.clone();
        opened.shares_processors = opening.shares_processors;
        let message = ServerMessage::Opened {
            volume: opening.volume,
            step: opened.volume.step(),
            edit: opening.view.to_edit(),
            device: opening.device,
            capabilities: Capabilities {
                watches: self.backend.watches(),
                ..Capabilities::default()
            },
        };
        self.send(&message);
        self.lead_or_follow();
    }

    fn on_counted(&mut self, number: u32, result: Outcome<FullCount>) {
        let Some((surface, session)) = self
            .opened
            .as_mut()
            .and_then(|opened| opened.surface_of_generation(number))
        else {
            return;
        };
        match result {
            Ok(count) => {
                if let Phase::Working(generation) = &mut session.phase {
                    generation.record_count(&count);
                    session.full = Some((generation.key.surface().clone(), count.triangles));
                    session.mark_proven();
                }
                self.allot(None);
            }
            Err(error) => self.fail_job(surface, &error),
        }
    }

    fn on_refined(&mut self, number: u32, result: Outcome<Offered>) {
        let acknowledges = self.acknowledges;
        let Some((surface, session)) = self
            .opened
            .as_mut()
            .and_then(|opened| opened.surface_of_generation(number))
        else {
            return;
        };
        match result {
            Ok(offered) => {
                let Phase::Working(generation) = &mut session.phase else {
                    return;
                };
                let refinement = &offered.step.refinement;
                if acknowledges && !refinement.is_final && !generation.has_committed {
                    generation.draw_pause.begin();
                }
                let statistics = &refinement.surface.statistics;
                let removed = statistics.removed.map_or(0, |removed| removed.full_triangles);
                session.full = Some((generation.key.surface().clone(), statistics.full_triangles + removed));
                generation.record_step(offered);
                session.mark_proven();
                self.allot(None);
            }
            Err(error) => self.fail_job(surface, &error),
        }
    }

    /// Handles the better surface of a viewer at rest: it is sent as one more step of the same generation, with another `done`.
    fn on_improved(&mut self, number: u32, result: Outcome<Option<Offered>>) {
        let Some((surface, session)) = self.opened.as_mut().and_then(|opened| opened.surface_at_rest(number)) else {
            return;
        };
        let Phase::Resting(rest) = &mut session.phase else {
            return;
        };
        match result {
            Ok(Some(offered)) => {
                let mut generation = Box::new(Generation::new(
                    surface,
                    number,
                    rest.view.clone(),
                    rest.key.clone(),
                    Shown::Alike,
                ));
                generation.waiting_since_job = self.jobs;
                generation.record_step(offered);
                session.phase = Phase::Working(generation);
            }
            Ok(None) => rest.cannot_improve(),
            Err(error) if error.is_cancelled() => {}
            Err(error) => {
                tracing::warn!(error = chain(&error), "a surface could not be improved");
                rest.cannot_improve();
            }
        }
    }

    /// Sends a measurement to the client. If measuring failed, only logs the error, because no viewer depends on a measurement.
    fn on_measured(&mut self, number: u32, result: Outcome<Option<Arc<Measurement>>>) {
        let Some((surface, session)) = self.opened.as_mut().and_then(|opened| opened.surface_at_rest(number)) else {
            return;
        };
        match result {
            Ok(measured) => {
                session.phase = Phase::Idle;
                let Some(measured) = measured else { return };
                let regions = measured.regions.iter();
                let message = ServerMessage::Measured {
                    surface,
                    generation: number,
                    error: measured.whole,
                    regions: regions
                        .map(|&(region, error)| RegionError {
                            region,
                            rms: error.rms,
                            max: error.max,
                        })
                        .collect(),
                };
                self.send(&message);
            }
            Err(error) if error.is_cancelled() => {}
            Err(error) => {
                session.phase = Phase::Idle;
                tracing::warn!(error = chain(&error), "a surface could not be measured");
            }
        }
    }

    /// Returns the generation whose step is being sent.
    fn sending(&mut self) -> Option<&mut Generation> {
        let opened = self.opened.as_mut()?;
        let surface = opened.sending()?;
        opened.surface_mut(surface)?.generation_mut()
    }

    /// Handles a result of the pool for the step that is being sent. Results of a dropped step never arrive.
    pub(super) fn on_pool(&mut self, done: PoolDone) {
        let reads_values = self.reads_values;
        let Some(generation) = self.sending() else { return };
        let (surface, mesher) = (generation.surface, generation.view.mesher);
        match done {
            PoolDone::Compared(Ok(changes)) => {
                let color_field = generation.view.color_field.clone();
                let Some(sent) = generation.sent() else { return };
                let message = ServerMessage::Prefix {
                    surface,
                    generation: sent.id.generation,
                    level: sent.id.level,
                    kind: ChunkKind::Cut,
                    mesher,
                    regions: changes.changed.len(),
                    unchanged: changes.unchanged,
                    triangles: sent.surface_triangles,
                    color_field,
                    is_final: sent.is_final,
                };
                generation.record_comparison(changes);
                let frame = Outgoing::Text(message.to_json());
                self.outbox.push_back(Frame::Prefix(surface, frame));
            }
            PoolDone::Encoded(Ok(mut chunks)) => {
                if generation.view.color_field.is_some() && !reads_values {
                    chunks = chunks.iter().map(without_values).collect();
                }
                if let Sending::Encoding { sent, batches, .. } = &mut generation.sending {
                    *batches -= 1;
                    sent.bytes += chunks.iter().map(|chunk| chunk.len() as u64).sum::<u64>();
                }
                let frames = chunks.into_iter().map(Outgoing::Binary);
                self.outbox.extend(frames.map(|frame| Frame::Prefix(surface, frame)));
            }
            PoolDone::Compared(Err(error)) | PoolDone::Encoded(Err(error)) => {
                tracing::error!(%error, "a prefix could not be encoded");
                return self.fail_generation(surface, "device", chain(&error));
            }
        }
        self.finish_step();
    }

    /// Queues `committed` behind a step whose regions are all encoded, and `done` behind the final one.
    fn finish_step(&mut self) {
        let id = self.id;
        let Some(generation) = self.sending() else { return };
        let (surface, trace) = (generation.surface, id.trace(generation.number));
        match std::mem::replace(&mut generation.sending, Sending::Idle) {
            Sending::Encoding {
                mut sent,
                remaining,
                batches: 0,
                held,
                ..
            } if remaining.is_empty() => {
                let own_step = sent.own_step.take();
                let encoding = sent.began.elapsed();
                let committed = ServerMessage::Committed {
                    surface,
                    generation: sent.id.generation,
                    level: sent.id.level,
                    is_final: sent.is_final,
                };
                let done = sent.statistics.take().map(|statistics| ServerMessage::Done {
                    surface,
                    generation: sent.id.generation,
                    trace: trace.to_string(),
                    statistics,
                });
                if sent.is_final {
                    let milliseconds = generation.wall.as_secs_f64() * 1e3;
                    tracing::debug!(%trace, surface, triangles = sent.surface_triangles, milliseconds, "a surface is done");
                }
                generation.record_commit(sent.is_final);
                generation.sending = Sending::Committing(sent, held);
                if let Some(OwnStep { triangles, time }) = own_step {
                    self.pace.record_made(triangles, time + encoding);
                }
                self.outbox.push_back(Frame::Commit(surface, committed.to_json()));
                self.outbox
                    .extend(done.map(|done| Frame::Done(surface, done.to_json())));
            }
            other => generation.sending = other,
        }
    }

    /// Starts the next work on the pool: batches of the step that is being sent, or else the comparison of a step that is ready.
    pub(super) fn advance_pool(&mut self) {
        while let Some(opened) = &self.opened
            && opened.sending().is_none()
            && !self.pace.is_line_full()
            && let Some((surface, verdict)) = opened.next_made_step()
        {
            match verdict {
                Verdict::GiveUp => self.end_generation(surface),
                Verdict::Send | Verdict::Wait => self.send_step(surface),
            }
        }
        let ahead_bytes = self.common.viewers.ahead_bytes();
        let Some(opened) = &mut self.opened else { return };
        let Some(surface) = opened.sending() else { return };
        if let Some(generation) = opened.surface_mut(surface).and_then(|session| session.generation_mut())
            && let Sending::Encoding {
                sent,
                step,
                coding,
                remaining,
                batches,
                ..
            } = &mut generation.sending
        {
            while !remaining.is_empty() && *batches < MAX_BATCHES && self.outbox.surface_bytes() < ahead_bytes {
                let (batch, id, token) = (
                    take_batch(step, remaining),
                    (sent.id, *coding),
                    generation.token.clone(),
                );
                let (step, cache) = (Arc::clone(step), self.common.shared.chunk_cache());
                *batches += 1;
                self.pool.push_back(Box::pin(async move {
                    PoolDone::Encoded(encode(step, batch, id, cache, token).await)
                }));
            }
        }
    }

    /// Begins to send the step that was made of a surface.
    fn send_step(&mut self, surface: u8) {
        let (final_coding, coarse_coding) = (
            self.line_coding(MIN_FAST_LINE),
            self.line_coding(MIN_FAST_LINE_OF_COARSE),
        );
        let Some(opened) = &mut self.opened else { return };
        let (smallest, device) = (opened.volume.dataset().smallest_length(), opened.device.clone());
        let Some(session) = opened.surface_mut(surface) else {
            return;
        };
        let Phase::Working(generation) = &mut session.phase else {
            return;
        };
        let Some(offered) = generation.take_made_step() else {
            return;
        };
        let coding = if offered.step.refinement.is_final {
            final_coding
        } else {
            coarse_coding
        };
        generation.sending = Sending::Comparing(generation.step_being_sent(&offered, smallest, &device));
        let (held, token) = (Arc::clone(&session.held), generation.token.clone());
        self.pool.push_back(Box::pin(async move {
            PoolDone::Compared(compare(offered.step, held, coding, token).await)
        }));
    }

    /// Starts the next device job: opening a volume, the next step of a surface, or work at rest.
    pub(super) fn advance_device(&mut self) {
        if self.device.is_some() {
            return;
        }
        match self.opened.as_ref().map(|opened| opened.phase) {
            None | Some(OpeningPhase::Opening) => return,
            Some(OpeningPhase::Waiting) => return self.start_opening(),
            Some(OpeningPhase::Open) => {}
        }
        // A generation that begins may change the other surfaces' parts of the budget, so that their generations begin as well.
        while self.begin_generations() {
            self.allot(None);
        }
        self.follow_camera();
        if self.start_describing() {
            return;
        }
        let Some(opened) = &mut self.opened else { return };
        if let Some((surface, job)) = opened.next_job(self.jobs, &self.pace) {
            self.jobs += 1;
            self.device = self.start(surface, job);
        }
    }

    /// Begins the generations of views that have come into force. Returns whether any has begun.
    fn begin_generations(&mut self) -> bool {
        let camera = self.camera_in_force();
        let Some(opened) = &mut self.opened else { return false };
        let volume = opened.volume.clone();
        let engine = self.backend.engine(&volume);
        if opened.engine != engine {
            opened.change_engine(engine, self.backend.mark_open(&volume), self.backend.device(&volume));
        }
        let mut has_begun = false;
        for (number, surface) in opened.surfaces_mut() {
            if surface.edit_pending && surface.generation().is_none() {
                self.last_generation += 1;
                // If the line is full, this member's first step is not sent soon, so further steps of others need not wait for it.
                let group_member = self.member.as_ref().filter(|_| !self.pace.is_line_full());
                let key = SurfaceKey::new(engine, &volume, &surface.view);
                let first_step = group_member.map(Member::first_step);
                surface.begin(number, self.last_generation, key, camera.clone(), self.jobs, first_step);
                has_begun = true;
            }
        }
        has_begun
    }

    /// Queues a job of a surface.
    fn start(&mut self, surface: u8, job: NextJob) -> Option<BoxFuture<DeviceDone>> {
        let opened = self.opened.as_mut()?;
        let (backend, volume) = (self.backend.clone(), opened.volume.clone());
        let session = opened.surface_mut(surface)?;
        let shared = self.common.shared.clone();
        let request = |view, key| SurfaceRequest {
            backend,
            volume,
            view,
            key,
        };
        if let (NextJob::Rest(work), Phase::Resting(rest)) = (job, &mut session.phase) {
            rest.mark_queued();
            let (number, token) = (rest.generation, rest.token.clone());
            let request = request(rest.view.clone(), rest.key.clone());
            let trace = self.id.trace(number);
            return Some(match work {
                RestWork::Improve => Box::pin(
                    trace.follow(async move { DeviceDone::Improved(number, shared.improve(request, &token).await) }),
                ),
                RestWork::Measure => Box::pin(
                    trace.follow(async move { DeviceDone::Measured(number, shared.measure(request, &token).await) }),
                ),
            });
        }
        let generation = session.generation_mut()?;
        generation.making = Making::OnDevice;
        generation.waiting_since_job = self.jobs;
        // Further steps of followers wait for the first steps of all members. The member in control does not wait.
        let has_to_wait = |member: &&Member| job == NextJob::Further && !member.has_control();
        let others_first = self.member.as_ref().filter(has_to_wait).map(Member::others_first);
        let (number, token) = (generation.number, generation.token.clone());
        let request = request(generation.view.clone(), generation.key.clone());
        let trace = self.id.trace(number);
        if job == NextJob::Count {
            let count = async move { DeviceDone::Counted(number, shared.count(request, &token).await) };
            return Some(Box::pin(trace.follow(count)));
        }
        let step = Step {
            shown: generation.shown,
            target: generation.target,
            made_triangles: generation.made_triangles,
            fresh_triangles: self.fresh_triangles(),
            triangles: self.pace.step_triangles(job == NextJob::First),
            bytes: self.meshopt_bytes(self.pace.max_bytes()),
            line_bytes: self.meshopt_bytes(self.line.bytes_within(self.pace.line_time()).max(self.pace.max_bytes())),
        };
        let refine = async move {
            if let Some(others) = others_first {
                token.run_until_cancelled(others.wait()).await;
            }
            DeviceDone::Refined(number, shared.refine(request, step, &token).await)
        };
        Some(Box::pin(trace.follow(refine)))
    }

    /// Returns the coding of the next step: the client's coding for slow lines, if it has requested one and the line is known to be slow.
    fn line_coding(&self, min_fast: u64) -> Coding {
        match self.line.bytes_within(Duration::from_secs(1)) < min_fast {
            true => self.coding,
            false => Coding::Meshopt,
        }
    }

    /// Converts the bytes that the line takes for a step to bytes of chunks in the coding `meshopt`. On a line that uses the coding for
    /// slow lines, the result is larger by half, because that coding takes about two thirds of the bytes. The result is larger also if a
    /// coarse cut is sent in `meshopt` because the line is not very slow.
    fn meshopt_bytes(&self, bytes: u64) -> u64 {
        match self.line_coding(MIN_FAST_LINE) {
            Coding::Meshopt => bytes,
            Coding::Predictive => bytes.saturating_mul(3) / 2,
        }
    }

    /// Returns the triangles of the first step of a new surface. The more followers a group has, the fewer triangles, so that all get the
    /// step soon.
    fn fresh_triangles(&self) -> u64 {
        let followers = self.member.as_ref().map_or(0, Member::follower_count);
        self.pace
            .fresh_triangles()
            .min(FOLLOWED_TRIANGLES / u64::from(followers.max(1)))
    }

    fn start_opening(&mut self) {
        let Some(opened) = &mut self.opened else { return };
        opened.phase = OpeningPhase::Opening;
        let (progress, watched) = watch::channel(OpeningProgress::default());
        opened.progress = Some(watched);
        let (backend, volume) = (self.backend.clone(), opened.volume.clone());
        let (open, token) = (self.opens, opened.token.clone());
        self.device = Some(Box::pin(async move {
            // Opens with the dataset's own opening view: edits may have changed the surface's view meanwhile.
            let result = match opening_view(volume.dataset()) {
                Ok(view) => backend.open(&volume, &view, &token, &progress).await,
                Err(error) => Err(error.into()),
            };
            DeviceDone::Opened(open, result.map(Box::new))
        }));
    }
}
