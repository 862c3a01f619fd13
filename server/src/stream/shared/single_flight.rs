//! Single-flight jobs: if a job for the same result is in flight, a request waits for that job instead of starting another.

use std::collections::HashMap;
use std::hash::Hash;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};

use futures_util::FutureExt;
use futures_util::future;
use tokio_util::sync::CancellationToken;

use isopeel_extraction::{WorkError, lock};

/// A job's result, for all of its waiters.
pub(in crate::stream) type Outcome<T> = Result<T, Arc<WorkError>>;

type Job<T> = future::Shared<Pin<Box<dyn Future<Output = Outcome<T>> + Send>>>;

/// Jobs in flight, by the key of their result. Each job has at least one waiter, and is cancelled when its last waiter leaves. So there are
/// at most as many jobs as waiters.
pub(super) struct SingleFlight<K, T: Clone>(Mutex<Jobs<K, T>>);

struct Jobs<K, T: Clone> {
    running: HashMap<K, Running<T>>,
    /// Number of the last job. Numbers distinguish a job from an earlier one of the same key.
    last_number: u64,
}

/// A job in flight.
struct Running<T: Clone> {
    number: u64,
    job: Job<T>,
    /// Cancels the job.
    token: CancellationToken,
    /// Number of waiters.
    waiting: usize,
}

impl<K, T: Clone> Default for SingleFlight<K, T> {
    fn default() -> Self {
        Self(Mutex::new(Jobs {
            running: HashMap::new(),
            last_number: 0,
        }))
    }
}

impl<K, T: Clone> SingleFlight<K, T> {
    fn jobs(&self) -> MutexGuard<'_, Jobs<K, T>> {
        lock(&self.0)
    }
}

impl<K: Clone + Eq + Hash, T: Clone + Send + Sync + 'static> SingleFlight<K, T> {
    /// Waits for the job of this key; if no such job is in flight, calls `start` to begin one. Returns the result, and whether the job was
    /// in flight already.
    ///
    /// If `token` is cancelled, this waiter leaves and the others continue to wait. The last waiter cancels the job, and returns only when
    /// the job has ended, so that a caller never has two jobs at once.
    pub(super) async fn join_or_start<F>(
        &self,
        key: &K,
        token: &CancellationToken,
        start: impl FnOnce(CancellationToken) -> F,
    ) -> (Outcome<T>, bool)
    where
        F: Future<Output = Outcome<T>> + Send + 'static,
    {
        let (mut waiter, mut job) = self.enter(key, start);
        let was_joined = waiter.has_joined;
        let outcome = tokio::select! {
            outcome = &mut job => outcome,
            () = token.cancelled() => match waiter.leave() {
                true => job.await,
                false => return (Err(Arc::new(WorkError::Cancelled)), was_joined),
            }
        };
        waiter.end();
        (outcome, was_joined)
    }

    /// Adds a waiter to the job of this key; starts the job if it is not in flight.
    fn enter<F>(&self, key: &K, start: impl FnOnce(CancellationToken) -> F) -> (Waiter<'_, K, T>, Job<T>)
    where
        F: Future<Output = Outcome<T>> + Send + 'static,
    {
        let mut jobs = self.jobs();
        let waiter = |number, has_joined| Waiter {
            flight: self,
            key: key.clone(),
            number,
            has_joined,
            is_waiting: true,
        };
        if let Some(running) = jobs.running.get_mut(key) {
            running.waiting += 1;
            return (waiter(running.number, true), running.job.clone());
        }
        let token = CancellationToken::new();
        let job: Pin<Box<dyn Future<Output = _> + Send>> = Box::pin(start(token.clone()));
        let job = job.shared();
        jobs.last_number += 1;
        let running = Running {
            number: jobs.last_number,
            job: job.clone(),
            token,
            waiting: 1,
        };
        let number = running.number;
        jobs.running.insert(key.clone(), running);
        (waiter(number, false), job)
    }
}

/// A waiter of a job. Dropping it leaves the job.
struct Waiter<'a, K: Eq + Hash, T: Clone> {
    flight: &'a SingleFlight<K, T>,
    key: K,
    /// Number of the job.
    number: u64,
    /// Whether the job was in flight before this waiter came.
    has_joined: bool,
    /// Whether the waiter still counts as waiting. False after it has left, or the job has ended.
    is_waiting: bool,
}

impl<K: Eq + Hash, T: Clone> Waiter<'_, K, T> {
    /// Leaves the job. Returns true if this was the last waiter. If so, the job was cancelled, and later requests do not join the job.
    fn leave(&mut self) -> bool {
        if !std::mem::replace(&mut self.is_waiting, false) {
            return false;
        }
        let mut jobs = self.flight.jobs();
        let Some(running) = jobs.running.get_mut(&self.key) else {
            return false;
        };
        if running.number != self.number {
            return false;
        }
        running.waiting -= 1;
        if running.waiting > 0 {
            return false;
        }
        running.token.cancel();
        jobs.running.remove(&self.key);
        true
    }

    /// Removes a job that has ended, so that the next request begins another.
    fn end(mut self) {
        self.is_waiting = false;
        let mut jobs = self.flight.jobs();
        if jobs
            .running
            .get(&self.key)
            .is_some_and(|running| running.number == self.number)
        {
            jobs.running.remove(&self.key);
        }
    }
}

impl<K: Eq + Hash, T: Clone> Drop for Waiter<'_, K, T> {
    fn drop(&mut self) {
        self.leave();
    }
}
