//! Whose turn it is on the device's thread. Jobs run in the order in which they were queued; one that takes long lets those that wait
//! run wherever it could be cancelled, which is every 50 ms or so.

use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, StageTime};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

/// How a job shares the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Length {
    /// Soon over: others wait for its end.
    Short,
    /// Takes long, and somebody waits for it: short ones run where it pauses.
    Long,
    /// For a viewer that rests: all others run where it pauses.
    Rest,
}

/// A permit for the one long job, and for the one of a viewer that rests: each holds the memory of what it makes.
pub(super) struct LongTurns {
    long: Arc<Semaphore>,
    rest: Arc<Semaphore>,
}

impl LongTurns {
    pub(super) fn new() -> Self {
        Self {
            long: Arc::new(Semaphore::new(1)),
            rest: Arc::new(Semaphore::new(1)),
        }
    }

    /// Waits until a job of this length may be queued. What is returned goes with the job.
    pub(super) async fn wait(&self, length: Length) -> Option<OwnedSemaphorePermit> {
        let turns = match length {
            Length::Short => return None,
            Length::Long => &self.long,
            Length::Rest => &self.rest,
        };
        // They are never closed.
        Arc::clone(turns).acquire_owned().await.ok()
    }
}

/// What is run on the thread's state `S`.
pub(super) struct Job<S> {
    pub length: Length,
    pub run: Run<S>,
}

pub(super) type Run<S> = Box<dyn FnOnce(&mut S, &mut Queue<S>) + Send>;

/// The jobs that wait.
pub(super) struct Queue<S> {
    waiting: mpsc::Receiver<Job<S>>,
    /// A job of a viewer that rests, whose turn came while a long one paused. [`LongTurns`] lets no second one in.
    deferred: Option<Job<S>>,
    /// Called after each job.
    after: Box<dyn Fn(&S)>,
}

impl<S> Queue<S> {
    pub(super) fn new(waiting: mpsc::Receiver<Job<S>>, after: impl Fn(&S) + 'static) -> Self {
        Self {
            waiting,
            deferred: None,
            after: Box::new(after),
        }
    }

    /// Runs jobs until nobody can queue one any more.
    pub(super) fn run(&mut self, state: &mut S) {
        while let Some(job) = self.deferred.take().or_else(|| self.waiting.blocking_recv()) {
            self.run_job(state, job);
        }
    }

    /// Runs the jobs that wait now: viewers have one each, so each gets a turn.
    fn run_waiting(&mut self, state: &mut S) {
        for _ in 0..self.waiting.len() {
            match self.waiting.try_recv() {
                Ok(job) if job.length == Length::Rest => self.deferred = Some(job),
                Ok(job) => self.run_job(state, job),
                Err(_) => return,
            }
        }
    }

    fn run_job(&mut self, state: &mut S, job: Job<S>) {
        // A panic ends the job, not the thread: the worker's state has no partial updates.
        let run = std::panic::AssertUnwindSafe(|| (job.run)(state, self));
        if std::panic::catch_unwind(run).is_err() {
            tracing::error!("a job panicked on the device thread");
        }
        (self.after)(state);
    }
}

/// Ends what was started on the device, and says how long each stage took since the last call.
type TakeTimes<'a> = &'a dyn Fn() -> Vec<StageTime>;

/// A job's turn.
pub(super) struct Turn<'a, S> {
    pub token: CancellationToken,
    /// Of a job that takes long, those that run where it pauses.
    pub others: Option<&'a mut Queue<S>>,
}

impl<S> Turn<'_, S> {
    /// Runs `work`, which holds nothing of `state`; others change it where `work` asks whether it is cancelled. Their times go to
    /// `aside`.
    pub(super) fn run<T>(
        &mut self,
        state: &mut S,
        take_times: TakeTimes<'_>,
        aside: &Aside,
        work: impl FnOnce(&dyn Cancel) -> T,
    ) -> T {
        match &mut self.others {
            None => work(&self.token()),
            Some(queue) => work(&Pauses {
                token: &self.token,
                take_times,
                aside,
                others: RefCell::new((state, queue)),
            }),
        }
    }

    /// Cancellation alone: nobody else runs.
    pub(super) fn token(&self) -> Token<'_> {
        Token(&self.token)
    }
}

/// A token as the kernels' cancellation.
pub(super) struct Token<'a>(&'a CancellationToken);

impl Cancel for Token<'_> {
    fn cancelled(&self) -> bool {
        self.0.is_cancelled()
    }
}

/// The same of a job that takes long.
struct Pauses<'a, S> {
    token: &'a CancellationToken,
    take_times: TakeTimes<'a>,
    aside: &'a Aside,
    others: RefCell<(&'a mut S, &'a mut Queue<S>)>,
}

impl<S> Cancel for Pauses<'_, S> {
    fn cancelled(&self) -> bool {
        let (state, queue) = &mut *self.others.borrow_mut();
        if !self.token.is_cancelled() && !queue.waiting.is_empty() {
            // Times are of whoever asks next.
            self.aside.add_stages((self.take_times)());
            let start = Instant::now();
            queue.run_waiting(state);
            (self.take_times)();
            self.aside.elsewhere.set(self.aside.elsewhere.get() + start.elapsed());
        }
        self.token.is_cancelled()
    }
}

/// What is to be known of a job's time where others ran meanwhile.
#[derive(Default)]
pub(super) struct Aside {
    /// Its stages before the last pause.
    stages: RefCell<Vec<StageTime>>,
    /// Time of others.
    elsewhere: Cell<Duration>,
}

impl Aside {
    /// Time of the job itself since `start`.
    pub(super) fn own_time(&self, start: Instant) -> Duration {
        start.elapsed().saturating_sub(self.elsewhere.get())
    }

    /// Adds the stages before the last pause to those since then.
    pub(super) fn complete(&self, stages: &mut Vec<StageTime>) {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// What was done, in order.
    type Log = Vec<String>;

    /// A queue that ends when these jobs, and those that they queue, are done.
    fn run(jobs: impl FnOnce(&mpsc::Sender<Job<Log>>)) -> Log {
        let (sender, waiting) = mpsc::channel(8);
        jobs(&sender);
        drop(sender);
        let mut log = Log::new();
        Queue::new(waiting, |_| {}).run(&mut log);
        log
    }

    fn queue(
        to: &mpsc::Sender<Job<Log>>,
        length: Length,
        run: impl FnOnce(&mut Log, &mut Queue<Log>) + Send + 'static,
    ) {
        let run = Box::new(run);
        assert!(to.try_send(Job { length, run }).is_ok(), "space in the queue");
    }

    fn say(to: &mpsc::Sender<Job<Log>>, length: Length, what: &'static str) {
        queue(to, length, move |log, _| log.push(what.into()));
    }

    /// A job that pauses twice, unless it is cancelled, and then says what it found.
    fn pausing(log: &mut Log, waiting: &mut Queue<Log>, token: CancellationToken, name: &str) {
        let (others, aside) = (Some(waiting), Aside::default());
        let mut turn = Turn { token, others };
        let ended = turn.run(log, &Vec::new, &aside, |cancel| {
            (1..=2)
                .find(|_| cancel.cancelled())
                .map_or("done".to_owned(), |pause| format!("given up at {pause}"))
        });
        log.push(format!("{name} {ended}"));
    }

    #[test]
    fn each_that_waits_gets_one_turn_a_pause() {
        let log = run(|to| {
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), "rest")
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
    fn who_rests_waits_for_who_does_not() {
        let log = run(|to| {
            queue(to, Length::Long, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), "long")
            });
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), "rest")
            });
            say(to, Length::Short, "a");
        });
        assert_eq!(log, ["a", "long done", "rest done"]);
        let log = run(|to| {
            queue(to, Length::Rest, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), "rest")
            });
            queue(to, Length::Long, |log, waiting| {
                pausing(log, waiting, CancellationToken::new(), "long")
            });
            say(to, Length::Short, "a");
        });
        assert_eq!(log, ["a", "long done", "rest done"]);
    }

    #[test]
    fn what_runs_in_a_pause_may_end_the_job() {
        let log = run(|to| {
            let token = CancellationToken::new();
            let given_up = token.clone();
            queue(to, Length::Rest, |log, waiting| pausing(log, waiting, token, "rest"));
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
                pausing(log, waiting, CancellationToken::new(), "rest")
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
                let (aside, start) = (Aside::default(), Instant::now());
                let device = RefCell::new(vec![time("tree", 1.0)]);
                let mut turn = Turn {
                    token: CancellationToken::new(),
                    others: Some(waiting),
                };
                turn.run(log, &|| device.take(), &aside, |cancel| cancel.cancelled());
                let mut stages = vec![time("tree", 2.0), time("tree_cut", 4.0)];
                aside.complete(&mut stages);
                assert_eq!(stages, [time("tree", 3.0), time("tree_cut", 4.0)]);
                assert!(start.elapsed() >= Duration::from_millis(20));
                assert!(aside.own_time(start) < Duration::from_millis(20));
                log.push("checked".into());
            });
            queue(to, Length::Short, |_, _| std::thread::sleep(Duration::from_millis(20)));
        });
        assert_eq!(log, ["checked"], "the assertions hold");
    }
}
