//! The caller's side of work on a workspace: whether the work is cancelled, and other work that uses the workspace in its pauses.

use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, StageTime};

/// Work that waits for a workspace `W`.
pub trait WaitingWork<W> {
    /// Whether any waiting work may run now.
    fn is_waiting(&self) -> bool;

    /// Runs the waiting work that may run now.
    fn run(&mut self, workspace: &mut W);
}

/// The caller of a piece of work on a workspace `W`.
pub struct JobContext<'a, W> {
    cancel: &'a dyn Cancel,
    /// Other work, which runs in the pauses. `None` for short work.
    waiting: Option<&'a mut (dyn WaitingWork<W> + 'a)>,
}

/// Waits for the work that was started on the device, and returns the time of each stage since the last call.
type TakeTimes<'a> = &'a dyn Fn() -> Vec<StageTime>;

impl<'a, W> JobContext<'a, W> {
    /// Returns the context of short work: it does not pause, and fails with [`JobError::TakesLong`](super::JobError::TakesLong) instead of
    /// taking long.
    pub fn short(cancel: &'a dyn Cancel) -> Self {
        Self { cancel, waiting: None }
    }

    /// Returns the context of work that may take long, and that pauses for other work.
    pub fn long(cancel: &'a dyn Cancel, waiting: &'a mut (dyn WaitingWork<W> + 'a)) -> Self {
        Self {
            cancel,
            waiting: Some(waiting),
        }
    }

    /// Whether the work may take long.
    pub(crate) fn may_take_long(&self) -> bool {
        self.waiting.is_some()
    }

    /// Runs `work`. It must not borrow the workspace, because other work changes the workspace in the pauses. Adds the stages before the
    /// last pause, and the time of other work, to `job_times`.
    pub fn run<T>(
        &mut self,
        workspace: &mut W,
        take_times: TakeTimes<'_>,
        job_times: &JobTimes,
        work: impl FnOnce(&dyn Cancel) -> T,
    ) -> T {
        match &mut self.waiting {
            None => work(&NoPause(self.cancel)),
            Some(waiting) => work(&Pausing {
                cancel: self.cancel,
                take_times,
                job_times,
                waiting: RefCell::new((workspace, &mut **waiting)),
            }),
        }
    }
}

/// Cancellation of short work, which does not pause.
struct NoPause<'a>(&'a dyn Cancel);

impl Cancel for NoPause<'_> {
    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
    }
}

/// Cancellation of long work, which pauses for other work.
struct Pausing<'a, 'o, W> {
    cancel: &'a dyn Cancel,
    take_times: TakeTimes<'a>,
    job_times: &'a JobTimes,
    waiting: RefCell<(&'a mut W, &'a mut (dyn WaitingWork<W> + 'o))>,
}

impl<W> Cancel for Pausing<'_, '_, W> {
    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }

    fn pause(&self) {
        let (workspace, waiting) = &mut *self.waiting.borrow_mut();
        if self.cancel.is_cancelled() || !waiting.is_waiting() {
            return;
        }
        // Flush this job's stage times first, or the other work is billed for them.
        self.job_times.add_stages((self.take_times)());
        let start = Instant::now();
        waiting.run(workspace);
        (self.take_times)();
        let other_work = &self.job_times.other_work;
        other_work.set(other_work.get() + start.elapsed());
    }
}

/// Separates the times of a piece of work from those of other work in its pauses.
#[derive(Default)]
pub struct JobTimes {
    /// Stages before the last pause.
    stages: RefCell<Vec<StageTime>>,
    /// Time of other work, in pauses.
    other_work: Cell<Duration>,
}

impl JobTimes {
    /// Returns the time since `start` without the time of other jobs that ran during pauses.
    pub fn time_without_pauses(&self, start: Instant) -> Duration {
        start.elapsed().saturating_sub(self.other_work.get())
    }

    /// Adds the stages before the last pause to those since then.
    pub fn complete(&self, stages: &mut Vec<StageTime>) {
        self.add_stages(std::mem::take(stages));
        *stages = self.stages.take();
    }

    fn add_stages(&self, times: Vec<StageTime>) {
        let mut stages = self.stages.borrow_mut();
        for time in times {
            match stages.iter_mut().find(|sum| sum.stage == time.stage) {
                Some(sum) => sum.milliseconds += time.milliseconds,
                None => stages.push(time),
            }
        }
    }
}
