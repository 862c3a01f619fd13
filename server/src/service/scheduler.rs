//! Cooperative scheduler of the device's thread. Jobs run in the order in which they were queued. About every 50 ms a long job pauses and
//! runs the waiting jobs of higher priority.

use std::sync::Arc;

use isopeel_extraction::WaitingWork;
use isopeel_kernels::{Activity, Cancel};
use serde::{Deserialize, Serialize};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::metrics::{DeviceNumber, JobLabels};

/// Kind of caller of a job.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Caller {
    /// A viewer. Its job waits if the queue is full, and stops before its next stage when the viewer is gone. Viewers have one job each, so
    /// that each has its turn.
    Viewer,
    /// A REST request, a command or a batch job. Its job is refused if the queue is full, and stops before its next stage when this caller
    /// is gone.
    Request,
    /// A cache, which stores the result for other callers. The job waits if the queue is full, and does not end with its
    /// caller. Only a load or a computed field is cancelled, some time after the last caller that waits for it is gone.
    Cache,
}

impl Caller {
    /// Returns the length with which a job of this caller is queued if it takes long.
    pub(super) fn length_if_long(self) -> Length {
        match self {
            Self::Request => Length::Export,
            Self::Viewer | Self::Cache => Length::Long,
        }
    }
}

/// How a job shares the device, from the highest priority to the lowest. When a long job pauses, the waiting jobs of higher priority run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) enum Length {
    /// Ends soon, so other jobs wait for its end.
    Short,
    /// Takes long, and a viewer waits for it.
    Long,
    /// Computes a field: its time depends on the expression, and many callers may wait for it.
    Field,
    /// Takes long, and a program waits for it: an export.
    Export,
    /// Takes long, for a viewer at rest.
    Rest,
}

/// Returns the names of caller and length in metrics.
pub(super) fn job_labels(device: DeviceNumber, caller: Caller, length: Length) -> JobLabels {
    JobLabels {
        device,
        caller: match caller {
            Caller::Viewer => "viewer",
            Caller::Request => "request",
            Caller::Cache => "cache",
        },
        length: match length {
            Length::Short => "short",
            Length::Long => "long",
            Length::Field => "field",
            Length::Export => "export",
            Length::Rest => "rest",
        },
    }
}

/// Permits limit the number of viewers' short jobs in the queue. Of each other length they allow one job at a time, because such a job
/// holds the memory of its result.
pub(super) struct Permits {
    viewers: Arc<Semaphore>,
    long: Arc<Semaphore>,
    field: Arc<Semaphore>,
    export: Arc<Semaphore>,
    rest: Arc<Semaphore>,
}

impl Permits {
    /// Allows `viewers` short jobs of viewers in the queue; further ones wait in order, so that requests find space.
    pub(super) fn new(viewers: usize) -> Self {
        Self {
            viewers: Arc::new(Semaphore::new(viewers)),
            long: Arc::new(Semaphore::new(1)),
            field: Arc::new(Semaphore::new(1)),
            export: Arc::new(Semaphore::new(1)),
            rest: Arc::new(Semaphore::new(1)),
        }
    }

    /// Waits until a job of this length may be queued. The returned permit is kept with the job.
    pub(super) async fn wait(&self, caller: Caller, length: Length) -> Option<OwnedSemaphorePermit> {
        let permits = match (length, caller) {
            (Length::Short, Caller::Viewer) => &self.viewers,
            (Length::Short, Caller::Request | Caller::Cache) => return None,
            (Length::Long, _) => &self.long,
            (Length::Field, _) => &self.field,
            (Length::Export, _) => &self.export,
            (Length::Rest, _) => &self.rest,
        };
        // The semaphores are never closed.
        Arc::clone(permits).acquire_owned().await.ok()
    }
}

/// A job in the queue.
pub(super) trait Job: Sized {
    /// The state that jobs change.
    type State;

    /// Returns the name of the job in the log.
    fn name(&self) -> &'static str;

    fn length(&self) -> Length;

    /// Whether the job was cancelled, so that it ends as soon as it runs.
    fn is_cancelled(&self) -> bool;

    fn run(self, state: &mut Self::State, queue: &mut Queue<Self>);

    /// Whether the job may run while one of this length pauses. A cancelled job may too: it ends at once, and
    /// releases the permit for which its viewer's next job waits.
    fn may_run(&self, length: Length) -> bool {
        self.length() < length || self.is_cancelled()
    }
}

/// Called with the state after a job.
type AfterJob<S> = Box<dyn Fn(&S)>;

/// The waiting jobs.
pub(super) struct Queue<J: Job> {
    waiting: mpsc::Receiver<J>,
    /// Jobs that were received in a pause of a job but have no higher priority than that job: a computation of a field, an
    /// export, or a job of a viewer at rest.
    /// There are few, because [`Permits`] admits one such job of each length.
    deferred: Vec<J>,
    /// Called after each job, also after one that runs in a pause.
    after_job: AfterJob<J::State>,
}

impl<J: Job> Queue<J> {
    pub(super) fn new(waiting: mpsc::Receiver<J>, after_job: impl Fn(&J::State) + 'static) -> Self {
        Self {
            waiting,
            deferred: Vec::new(),
            after_job: Box::new(after_job),
        }
    }

    /// Runs jobs until all senders are dropped. Calls `between` after each, except for jobs that run in a pause of another one.
    pub(super) fn run(&mut self, state: &mut J::State, mut between: impl FnMut(&mut J::State, &mut Self)) {
        while let Some(job) = self.take_deferred(None).or_else(|| self.waiting.blocking_recv()) {
            self.run_job(state, job);
            between(state, self);
        }
    }

    /// Drops the waiting jobs. Their callers then read the reason from the device's state. Returns false if all senders are dropped.
    pub(super) fn drop_waiting(&mut self) -> bool {
        self.deferred.clear();
        while self.waiting.try_recv().is_ok() {}
        !self.waiting.is_closed()
    }

    /// Takes the deferred job with the shortest length. If a job of length `pausing` pauses, only jobs that may run then are taken.
    fn take_deferred(&mut self, pausing: Option<Length>) -> Option<J> {
        let jobs = self.deferred.iter().enumerate();
        let ready = jobs.filter(|(_, job)| pausing.is_none_or(|length| job.may_run(length)));
        let (index, _) = ready.min_by_key(|(_, job)| job.length())?;
        Some(self.deferred.swap_remove(index))
    }

    /// Whether a job of this length has to pause: new jobs are queued, or a deferred one may run.
    fn has_waiting(&self, length: Length) -> bool {
        !self.waiting.is_empty() || self.deferred.iter().any(|job| job.may_run(length))
    }

    /// Runs the waiting jobs that may run while a job of this length pauses, and defers the others. Receives only jobs that are queued now,
    /// so that the pause ends. Viewers have one job each, so each viewer gets a turn.
    fn run_waiting(&mut self, state: &mut J::State, length: Length) {
        for _ in 0..self.waiting.len() {
            match self.waiting.try_recv() {
                Ok(job) if job.may_run(length) => self.run_job(state, job),
                Ok(job) => self.deferred.push(job),
                Err(_) => break,
            }
        }
        while let Some(job) = self.take_deferred(Some(length)) {
            self.run_job(state, job);
        }
    }

    fn run_job(&mut self, state: &mut J::State, job: J) {
        let name = job.name();
        // A panic ends the job, not the thread: the workspace has no partial updates.
        let run = std::panic::AssertUnwindSafe(|| job.run(state, self));
        if std::panic::catch_unwind(run).is_err() {
            tracing::error!(job = name, "a job panicked on the device thread");
        }
        (self.after_job)(state);
    }
}

/// The queue while a job of length `length` pauses. Runs the jobs of higher priority.
pub(super) struct PausedQueue<'a, J: Job> {
    pub queue: &'a mut Queue<J>,
    pub length: Length,
}

impl<J: Job> WaitingWork<J::State> for PausedQueue<'_, J> {
    fn is_waiting(&self) -> bool {
        self.queue.has_waiting(self.length)
    }

    fn run(&mut self, state: &mut J::State) {
        self.queue.run_waiting(state, self.length);
    }
}

/// Adapts a token to the kernels' interface of cancellation. Each question is a sign of progress.
pub(super) struct Token<'a>(pub &'a CancellationToken, pub Arc<Activity>);

impl Cancel for Token<'_> {
    fn is_cancelled(&self) -> bool {
        self.1.progress();
        self.0.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::time::{Duration, Instant};

    use isopeel_extraction::{JobContext, JobTimes};
    use isopeel_kernels::{Never, StageTime, check_cancelled};

    use super::*;

    /// Log of the jobs that ran, in order.
    type Log = Vec<String>;

    type Script = Box<dyn FnOnce(&mut Log, &mut Queue<Scripted>) + Send>;

    /// A job that runs a closure.
    struct Scripted {
        length: Length,
        token: CancellationToken,
        run: Script,
    }

    impl Job for Scripted {
        type State = Log;

        fn name(&self) -> &'static str {
            "scripted"
        }

        fn length(&self) -> Length {
            self.length
        }

        fn is_cancelled(&self) -> bool {
            self.token.is_cancelled()
        }

        fn run(self, log: &mut Log, queue: &mut Queue<Self>) {
            (self.run)(log, queue);
        }
    }

    /// A queue that ends when these jobs, and those that they queue, are done.
    fn run(jobs: impl FnOnce(&mpsc::Sender<Scripted>)) -> Log {
        let (sender, waiting) = mpsc::channel(8);
        jobs(&sender);
        drop(sender);
        let mut log = Log::new();
        Queue::new(waiting, |_| {}).run(&mut log, |_, _| {});
        log
    }

    fn queue(
        to: &mpsc::Sender<Scripted>,
        length: Length,
        run: impl FnOnce(&mut Log, &mut Queue<Scripted>) + Send + 'static,
    ) {
        queue_with(to, length, CancellationToken::new(), run);
    }

    fn queue_with(
        to: &mpsc::Sender<Scripted>,
        length: Length,
        token: CancellationToken,
        run: impl FnOnce(&mut Log, &mut Queue<Scripted>) + Send + 'static,
    ) {
        let run = Box::new(run);
        let job = Scripted { length, token, run };
        assert!(to.try_send(job).is_ok(), "space in the queue");
    }

    fn say(to: &mpsc::Sender<Scripted>, length: Length, what: &'static str) {
        queue(to, length, move |log, _| log.push(what.into()));
    }

    /// A job that pauses twice, unless it is cancelled, and then says what it found.
    fn pausing(log: &mut Log, queue: &mut Queue<Scripted>, token: CancellationToken, length: Length) {
        let (cancel, mut waiting) = (Token(&token, Arc::default()), PausedQueue { queue, length });
        let mut context = JobContext::long(&cancel, &mut waiting);
        let ended = context.run(log, &Vec::new, &JobTimes::default(), |cancel| {
            (1..=2)
                .find(|_| check_cancelled(cancel).is_err())
                .map_or("done".to_owned(), |pause| format!("given up at {pause}"))
        });
        log.push(format!("{length:?} {ended}").to_lowercase());
    }

    #[test]
    fn each_that_waits_gets_one_turn_a_pause() {
        let log = run(|to| {
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Rest)
            });
            let again = to.clone();
            queue(to, Length::Short, move |log, _| {
                log.push("a 1".into());
                // The next edit of the same viewer.
                say(&again, Length::Short, "a 2");
            });
            say(to, Length::Short, "b 1");
        });
        assert_eq!(log, ["a 1", "b 1", "a 2", "rest done"]);
    }

    #[test]
    fn a_cancelled_job_runs_in_the_pause_of_a_job_of_higher_priority() {
        let log = run(|to| {
            let token = CancellationToken::new();
            let rest = token.clone();
            queue(to, Length::Export, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Export)
            });
            // Deferred at the export's first pause, and given up before its second.
            queue_with(to, Length::Rest, rest.clone(), move |log, _| {
                log.push(format!("rest, cancelled: {}", rest.is_cancelled()));
            });
            queue(to, Length::Short, move |log, _| {
                log.push("an edit".into());
                token.cancel();
            });
        });
        assert_eq!(log, ["an edit", "rest, cancelled: true", "export done"]);
    }

    #[test]
    fn jobs_at_rest_wait_for_long_jobs() {
        let log = run(|to| {
            queue(to, Length::Long, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Long)
            });
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Rest)
            });
            say(to, Length::Short, "a");
        });
        assert_eq!(log, ["a", "long done", "rest done"]);
        let log = run(|to| {
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Rest)
            });
            queue(to, Length::Long, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Long)
            });
            say(to, Length::Short, "a");
        });
        assert_eq!(log, ["a", "long done", "rest done"]);
    }

    /// All lengths wait in this order, and each says when it is done.
    fn order_of(lengths: [Length; 3]) -> Log {
        run(|to| {
            for length in lengths {
                queue(to, length, move |log, waiting| {
                    pausing(log, waiting, CancellationToken::new(), length)
                });
            }
            say(to, Length::Short, "a");
        })
    }

    #[test]
    fn viewers_come_before_exports_and_exports_before_who_rests() {
        use Length::{Export, Long, Rest};
        for lengths in [
            [Export, Long, Rest],
            [Rest, Export, Long],
            [Long, Rest, Export],
            [Rest, Long, Export],
        ] {
            let log = order_of(lengths);
            let at = |what: &str| log.iter().position(|said| said == what).unwrap_or(usize::MAX);
            assert!(
                at("long done") < at("export done") && at("export done") < at("rest done"),
                "{lengths:?}: {log:?}"
            );
            assert!(at("a") < at("rest done"), "{lengths:?}: {log:?}");
        }
        assert_eq!(order_of([Export, Long, Rest])[..2], ["a", "long done"]);
    }

    #[test]
    fn what_runs_in_a_pause_may_end_the_job() {
        let log = run(|to| {
            let token = CancellationToken::new();
            let given_up = token.clone();
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, token, Length::Rest)
            });
            queue(to, Length::Short, move |log, _| {
                log.push("edit".into());
                given_up.cancel();
            });
        });
        assert_eq!(log, ["edit", "rest given up at 1"]);
    }

    #[test]
    fn a_panic_ends_one_job() {
        let log = run(|to| {
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), Length::Rest)
            });
            queue(to, Length::Short, |_, _| panic!("for the test"));
            say(to, Length::Short, "a");
        });
        assert_eq!(log, ["a", "rest done"]);
    }

    #[test]
    fn times_are_those_of_the_job_itself() {
        let time = |stage, milliseconds| StageTime { stage, milliseconds };
        let log = run(|to| {
            queue(to, Length::Rest, move |log, waiting| {
                let (job_times, start) = (JobTimes::default(), Instant::now());
                let device = RefCell::new(vec![time("tree", 1.0)]);
                let mut below = PausedQueue {
                    queue: waiting,
                    length: Length::Rest,
                };
                let mut context = JobContext::long(&Never, &mut below);
                context.run(log, &|| device.take(), &job_times, |cancel| cancel.pause());
                let mut stages = vec![time("tree", 2.0), time("tree_cut", 4.0)];
                job_times.complete(&mut stages);
                assert_eq!(stages, [time("tree", 3.0), time("tree_cut", 4.0)]);
                assert!(start.elapsed() >= Duration::from_millis(20));
                assert!(job_times.time_without_pauses(start) < Duration::from_millis(20));
                log.push("checked".into());
            });
            queue(to, Length::Short, |_, _| std::thread::sleep(Duration::from_millis(20)));
        });
        assert_eq!(log, ["checked"], "the assertions hold");
    }
}
