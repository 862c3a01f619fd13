//! Jobs that several wait for: who asks for what is being made joins those who wait for it.

use std::collections::HashMap;
use std::hash::Hash;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use futures_util::FutureExt;
use futures_util::future;
use tokio_util::sync::CancellationToken;

use crate::extraction::WorkError;

/// A result for all who wait for it.
pub(in crate::stream) type Outcome<T> = Result<T, Arc<WorkError>>;

type Job<T> = future::Shared<Pin<Box<dyn Future<Output = Outcome<T>> + Send>>>;

/// The jobs that run, by what they make. There are no more than those who wait for them: each has one or more, and ends where it has none.
pub(super) struct Joint<K, T: Clone>(Mutex<Jobs<K, T>>);

struct Jobs<K, T: Clone> {
    running: HashMap<K, Running<T>>,
    /// Counts them, so that one is not taken for another that made the same.
    last: u64,
}

struct Running<T: Clone> {
    number: u64,
    job: Job<T>,
    token: CancellationToken,
    waiting: usize,
}

impl<K, T: Clone> Default for Joint<K, T> {
    fn default() -> Self {
        Self(Mutex::new(Jobs {
            running: HashMap::new(),
            last: 0,
        }))
    }
}

impl<K, T: Clone> Joint<K, T> {
    /// A poisoned one too: a panic leaves nothing half updated.
    fn jobs(&self) -> MutexGuard<'_, Jobs<K, T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: Clone + Eq + Hash, T: Clone + Send + Sync + 'static> Joint<K, T> {
    /// Waits for the job of this key, which `start` begins where it does not run; and whether it ran already. Where `token` is cancelled,
    /// others go on; the last who waits ends the job, and returns when it has ended, so that it has never two of them.
    pub(super) async fn make<F>(
        &self,
        key: &K,
        token: &CancellationToken,
        start: impl FnOnce(CancellationToken) -> F,
    ) -> (Outcome<T>, bool)
    where
        F: Future<Output = Outcome<T>> + Send + 'static,
    {
        let (mut waiter, mut job, joined) = self.enter(key, start);
        let outcome = tokio::select! {
            outcome = &mut job => outcome,
            () = token.cancelled() => match waiter.leave() {
                true => job.await,
                false => return (Err(Arc::new(WorkError::Cancelled)), joined),
            }
        };
        waiter.end();
        (outcome, joined)
    }

    fn enter<F>(&self, key: &K, start: impl FnOnce(CancellationToken) -> F) -> (Waiter<'_, K, T>, Job<T>, bool)
    where
        F: Future<Output = Outcome<T>> + Send + 'static,
    {
        let mut jobs = self.jobs();
        let waiter = |number| Waiter {
            joint: self,
            key: key.clone(),
            number,
            waits: true,
        };
        if let Some(running) = jobs.running.get_mut(key) {
            running.waiting += 1;
            return (waiter(running.number), running.job.clone(), true);
        }
        let token = CancellationToken::new();
        let job: Pin<Box<dyn Future<Output = _> + Send>> = Box::pin(start(token.clone()));
        let job = job.shared();
        jobs.last += 1;
        let running = Running {
            number: jobs.last,
            job: job.clone(),
            token,
            waiting: 1,
        };
        let number = running.number;
        jobs.running.insert(key.clone(), running);
        (waiter(number), job, false)
    }
}

/// One who waits for a job; dropped, it waits no longer.
struct Waiter<'a, K: Eq + Hash, T: Clone> {
    joint: &'a Joint<K, T>,
    key: K,
    number: u64,
    waits: bool,
}

impl<K: Eq + Hash, T: Clone> Waiter<'_, K, T> {
    /// Waits no longer; true where nobody does, so that the job was told to end, and nobody joins it any more.
    fn leave(&mut self) -> bool {
        if !std::mem::replace(&mut self.waits, false) {
            return false;
        }
        let mut jobs = self.joint.jobs();
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

    /// The job has ended: who asks from now on begins another.
    fn end(mut self) {
        self.waits = false;
        let mut jobs = self.joint.jobs();
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
