//! Time steps. A client that goes to another step of the open volume keeps its surfaces, and regions that are equal in both steps are not
//! sent again. A step comes into force when all surfaces can be made of it (`resolving`). If the client goes on in equal strides, the
//! session prefetches the next step. When the viewer rests, the session describes the values of the step.

use std::sync::Arc;

use isopeel_codec::chunk::MAX_SURFACES;
use isopeel_extraction::{OpenStepGuard, WorkError};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use serde_json::value::RawValue;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::super::backend::Backend;
use super::Session;
use super::jobs::{BoxFuture, DeviceDone};
use super::open_volume::{OpenVolume, OpeningPhase};
use super::pending::PendingStep;
use super::rest::REST_AFTER;
use crate::wire::messages::ServerMessage;

/// Maximum stride, in time steps, for which the next step is predicted. A longer one is more likely a jump than playback.
const MAX_STRIDE: u32 = 4;

/// A time step that is being prefetched. Dropping it cancels the prefetch.
pub(super) struct Ahead {
    step: u32,
    pub job: Option<BoxFuture<()>>,
    _cancel: DropGuard,
}

/// Resolves when the prefetch of a time step has ended; never if there is none.
pub(super) async fn read_ahead(ahead: &mut Option<Ahead>) {
    match ahead.as_mut().and_then(|ahead| ahead.job.as_mut()) {
        Some(job) => job.await,
        None => std::future::pending().await,
    }
    if let Some(ahead) = ahead {
        ahead.job = None;
    }
}

/// Predicts the step that follows after the client went from `from` to `to`: the same stride further, or the first step after the last
/// one.
fn expected(from: u32, to: u32, steps: u32) -> Option<u32> {
    if to == 0 && from > 1 && from == steps - 1 {
        return Some(1);
    }
    let stride = i64::from(to) - i64::from(from);
    let next = i64::from(to) + stride;
    let is_near = stride != 0 && stride.unsigned_abs() <= u64::from(MAX_STRIDE);
    match u32::try_from(next) {
        _ if !is_near => None,
        Ok(next) if next < steps => Some(next),
        // At the end a player starts over at step 0.
        _ => (stride > 0 && to == steps - 1).then_some(0),
    }
}

impl<B: Backend> Session<B> {
    /// Handles the client's request for another time step of the open volume.
    pub(super) fn on_step(&mut self, step: u32) {
        let opened = self.opened.as_ref().filter(|opened| opened.phase == OpeningPhase::Open);
        let Some(opened) = opened else {
            return self.send_error(
                "not-open",
                "no volume is open, expected `open` and its answer first",
                true,
            );
        };
        let before = Arc::clone(opened.volume.dataset());
        // The dataset may have got new steps since it was opened.
        let newest = self.backend.find(&before.id, &self.who);
        let newest = newest.filter(|newest| newest.continues(&before));
        let volume = match VolumeStep::new(newest.unwrap_or(before), step) {
            Ok(volume) => volume,
            Err(error) => return self.send_error("unknown-step", error.to_string(), true),
        };
        self.ahead.take_if(|ahead| ahead.step != step);
        self.go_to(volume);
    }

    /// Begins to go to another step of the open volume, which comes into force as soon as all surfaces can be made of it. A later request
    /// replaces this one.
    fn go_to(&mut self, volume: VolumeStep) {
        if let Some(opened) = &mut self.opened {
            opened.postpone_rest();
            let had_pending_step = opened.stepping.is_some();
            opened.stepping = Some(PendingStep {
                volume,
                cancelled_after: None,
            });
            if had_pending_step {
                self.resolving = None;
            }
        }
    }

    /// Puts another step of the open volume into force.
    pub(super) fn bring_step_into_force(&mut self, step: PendingStep) {
        let PendingStep {
            volume,
            cancelled_after,
        } = step;
        for surface in 0..MAX_SURFACES {
            self.end_generation(surface);
        }
        self.questions.cancel_for_edit();
        self.outbox.drop_annotations();
        let step = volume.step();
        let times = volume.dataset().times.as_ref();
        self.send(&ServerMessage::Stepped {
            step,
            label: times.map(|times| times.label(step)),
        });
        let guard = self.backend.mark_open(&volume);
        if let Some(opened) = &mut self.opened {
            opened.expected = expected(opened.volume.step(), step, volume.dataset().steps);
            opened.step_to(volume, guard);
            for (_, surface) in opened.surfaces_mut() {
                surface.edit_pending &= cancelled_after.is_none_or(|edits| surface.last_edit > edits);
            }
        }
        if let Some(opened) = &mut self.opened {
            opened.offer_retries();
        }
        self.allot(None);
    }

    /// Starts to prefetch the step that the client is expected to request next, once all surfaces of the current step are made.
    pub(super) fn advance_ahead(&mut self) {
        let Some(opened) = &mut self.opened else { return };
        if self.ahead.as_ref().is_some_and(|ahead| ahead.job.is_some()) || opened.is_awaited() {
            return;
        }
        let Some(step) = opened.expected.take() else { return };
        let Ok(volume) = VolumeStep::new(Arc::clone(opened.volume.dataset()), step) else {
            return;
        };
        let views: Vec<View> = opened.surfaces().map(|(_, surface)| surface.view.clone()).collect();
        let (token, backend) = (CancellationToken::new(), self.backend.clone());
        self.ahead = Some(Ahead {
            step,
            _cancel: token.clone().drop_guard(),
            job: Some(Box::pin(
                async move { backend.read_ahead(&volume, &views, &token).await },
            )),
        });
    }

    /// Starts to describe the current step, if no other work is pending. Returns whether the description was started.
    pub(super) fn start_describing(&mut self) -> bool {
        let Some(opened) = &mut self.opened else { return false };
        if opened.description_due().is_none_or(|due| due > Instant::now()) {
            return false;
        }
        opened.undescribed_since = None;
        let (backend, volume, token) = (self.backend.clone(), opened.volume.clone(), opened.step_token.clone());
        let (open, step) = (self.opens, volume.step());
        self.device = Some(Box::pin(async move {
            DeviceDone::Described(open, step, backend.describe(&volume, &token).await)
        }));
        true
    }

    /// Sends the description of a step's values, unless that step is no longer open.
    pub(super) fn on_described(&mut self, open: u32, step: u32, result: Result<Box<RawValue>, WorkError>) {
        let opened = self.opened.as_mut().filter(|opened| opened.volume.step() == step);
        let (Some(opened), true) = (opened, open == self.opens) else {
            return;
        };
        match result {
            Ok(volume) => self.send(&ServerMessage::Described { volume, step }),
            // An edit has cancelled the description, which is made later.
            Err(WorkError::Cancelled) => opened.undescribed_since = Some(Instant::now()),
            Err(error) => self.send_work_error(&error),
        }
    }
}

impl OpenVolume {
    /// Switches to another step of the same volume. The surfaces are made again of that step with unchanged views. Each surface changes in
    /// one commit.
    fn step_to(&mut self, volume: VolumeStep, step_guard: OpenStepGuard) {
        self.volume = volume;
        self.step_guard = step_guard;
        self.step_token = CancellationToken::new();
        self._cancel_step = self.step_token.clone().drop_guard();
        self.undescribed_since = Some(Instant::now());
        for (_, surface) in self.surfaces_mut() {
            surface.switch_step();
        }
    }

    /// Whether work for any surface is pending.
    pub(super) fn is_awaited(&self) -> bool {
        self.stepping.is_some() || self.surfaces().any(|(_, surface)| surface.is_awaited())
    }

    /// Returns when the time step is to be described; `None` if that is done, or while work for a surface is pending.
    pub(super) fn description_due(&self) -> Option<Instant> {
        let since = self.undescribed_since.filter(|_| !self.is_awaited())?;
        Some(since + REST_AFTER)
    }
}

#[cfg(test)]
mod tests {
    use super::expected;

    #[test]
    fn steps_that_are_expected() {
        for (from, to, next) in [
            (3, 4, Some(5)),
            (4, 3, Some(2)),
            (2, 4, Some(6)),
            (8, 9, Some(0)),
            (9, 0, Some(1)),
            (1, 0, None),
            (5, 5, None),
            (0, 7, None),
            (6, 8, None),
        ] {
            assert_eq!(expected(from, to, 10), next, "{from} {to}");
        }
        assert_eq!(expected(0, 1, 2), Some(0));
        assert_eq!(expected(1, 0, 2), None);
    }
}
