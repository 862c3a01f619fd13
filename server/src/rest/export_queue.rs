//! Admission of exports. Limits how many exports run and wait, and lets users take turns.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;

use crate::problem::ApiError;

/// Limits of a queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct QueueLimits {
    /// Maximum number of running exports.
    pub max_running: usize,
    /// Maximum number of running exports of one user. Lower than `max_running`, so that long exports of one user do not block others.
    pub max_running_of_user: usize,
    /// Maximum number of waiting exports.
    pub max_waiting: usize,
    /// Maximum number of waiting exports of one user.
    pub max_waiting_of_user: usize,
    /// Maximum waiting time of an export.
    pub max_wait: Duration,
}

/// A queue of exports. Clones share it.
#[derive(Clone, Debug)]
pub(super) struct ExportQueue(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    limits: QueueLimits,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Number of running exports of each user.
    running_by_user: HashMap<Arc<str>, usize>,
    /// Waiting exports, in the order in which they arrived.
    waiting: Vec<Waiter>,
}

/// A waiting export.
#[derive(Debug)]
struct Waiter {
    user: Arc<str>,
    admit: oneshot::Sender<ExportPermit>,
}

/// Guard of a running export. Dropping the guard admits the next export.
#[derive(Debug)]
pub(super) struct ExportPermit {
    queue: ExportQueue,
    user: Arc<str>,
}

impl ExportQueue {
    pub(super) fn new(limits: QueueLimits) -> Self {
        let state = Mutex::default();
        Self(Arc::new(Shared { limits, state }))
    }

    /// Returns the number of running exports.
    pub(super) fn running_count(&self) -> usize {
        self.state().running_by_user.values().sum()
    }

    /// Waits until an export of a user may run.
    ///
    /// # Errors
    /// `busy` if too many exports wait, or if the wait takes too long.
    pub(super) async fn admit(&self, user: &str) -> Result<ExportPermit, ApiError> {
        let limits = self.0.limits;
        let admitted = match self.enter(user)? {
            Entry::Admitted(permit) => return Ok(permit),
            Entry::Queued(admitted) => admitted,
        };
        // If the client disconnects, this future is dropped with its receiver. The queue then skips the waiter.
        match tokio::time::timeout(limits.max_wait, admitted).await {
            Ok(Ok(permit)) => Ok(permit),
            _ => Err(ApiError::busy(format!(
                "up to {} exports are made at a time, up to {} of one user, and none ended within {} s: try again in a few seconds",
                limits.max_running,
                limits.max_running_of_user,
                limits.max_wait.as_secs()
            ))),
        }
    }

    /// Admits an export at once, or adds it to the waiting ones.
    fn enter(&self, user: &str) -> Result<Entry, ApiError> {
        let (limits, user) = (self.0.limits, Arc::<str>::from(user));
        let mut state = self.state();
        // Removes waiters whose clients have disconnected.
        state.waiting.retain(|waiter| !waiter.admit.is_closed());
        if state.has_capacity(&limits) && state.may_run(&user, &limits) && state.next_index(&limits).is_none() {
            *state.running_by_user.entry(Arc::clone(&user)).or_default() += 1;
            let queue = self.clone();
            return Ok(Entry::Admitted(ExportPermit { queue, user }));
        }
        let of_user = state.waiting.iter().filter(|waiter| waiter.user == user).count();
        if state.waiting.len() >= limits.max_waiting || of_user >= limits.max_waiting_of_user {
            return Err(ApiError::busy(format!(
                "{} exports are under way and {} wait, {of_user} of them yours, expected up to {} that wait and up to {} of a user: try again \
                 in a few seconds",
                limits.max_running,
                state.waiting.len(),
                limits.max_waiting,
                limits.max_waiting_of_user
            )));
        }
        let (admit, admitted) = oneshot::channel();
        state.waiting.push(Waiter { user, admit });
        Ok(Entry::Queued(admitted))
    }

    /// Ends an export of a user, and admits the next one.
    fn release(&self, user: &Arc<str>) {
        let next = {
            let mut state = self.state();
            state.end_running(user);
            let next = state.next(&self.0.limits);
            if let Some(waiter) = &next {
                *state.running_by_user.entry(Arc::clone(&waiter.user)).or_default() += 1;
            }
            next
        };
        if let Some(Waiter { user, admit }) = next {
            let queue = self.clone();
            // If the client has disconnected, `send` returns the permit in its error. Dropping that permit admits another export.
            let _ = admit.send(ExportPermit { queue, user });
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// State of an export that has entered the queue.
enum Entry {
    Admitted(ExportPermit),
    /// The export waits for its permit.
    Queued(oneshot::Receiver<ExportPermit>),
}

impl State {
    /// Whether fewer than the maximum number of exports are running.
    fn has_capacity(&self, limits: &QueueLimits) -> bool {
        self.running_by_user.values().sum::<usize>() < limits.max_running
    }

    fn running_of(&self, user: &str) -> usize {
        self.running_by_user.get(user).copied().unwrap_or_default()
    }

    fn may_run(&self, user: &str, limits: &QueueLimits) -> bool {
        self.running_of(user) < limits.max_running_of_user
    }

    /// Returns the index of the waiter that is admitted next: the oldest one among the users with the fewest running exports. Returns
    /// `None` if no waiter's user may run another export.
    fn next_index(&self, limits: &QueueLimits) -> Option<usize> {
        let numbered = self.waiting.iter().enumerate();
        let admissible = numbered.filter(|(_, waiter)| self.may_run(&waiter.user, limits));
        let next = admissible.min_by_key(|(index, waiter)| (self.running_of(&waiter.user), *index));
        next.map(|(index, _)| index)
    }

    /// Removes and returns the waiter that is admitted next, if the queue has capacity.
    fn next(&mut self, limits: &QueueLimits) -> Option<Waiter> {
        let index = self.next_index(limits).filter(|_| self.has_capacity(limits))?;
        Some(self.waiting.remove(index))
    }

    fn end_running(&mut self, user: &Arc<str>) {
        if let Some(count) = self.running_by_user.get_mut(user) {
            *count -= 1;
            if *count == 0 {
                self.running_by_user.remove(user);
            }
        }
    }
}

impl Drop for ExportPermit {
    fn drop(&mut self) {
        self.queue.release(&self.user);
    }
}

#[cfg(test)]
mod tests {
    use std::pin::pin;
    use std::task::Poll;

    use futures_util::poll;

    use super::*;

    fn queue(max_running: usize) -> ExportQueue {
        ExportQueue::new(QueueLimits {
            max_running,
            max_running_of_user: max_running,
            max_waiting: 4,
            max_waiting_of_user: 3,
            max_wait: Duration::from_secs(600),
        })
    }

    #[tokio::test]
    async fn users_take_turns_and_each_ones_exports_come_in_their_order() {
        let queue = queue(1);
        let first = queue.admit("a").await.unwrap();
        let order = Arc::new(Mutex::new(Vec::new()));
        let waiting: Vec<_> = ["a 1", "a 2", "a 3", "b 1"]
            .map(|name| {
                let (queue, order) = (queue.clone(), Arc::clone(&order));
                tokio::spawn(async move {
                    let _permit = queue.admit(&name[..1]).await.unwrap();
                    order.lock().unwrap().push(name);
                    tokio::task::yield_now().await;
                })
            })
            .into();
        while queue.state().waiting.len() < 4 {
            tokio::task::yield_now().await;
        }
        let own = queue.admit("a").await.unwrap_err().to_string();
        assert!(own.contains("3 of them yours"), "{own}");
        let full = queue.admit("c").await.unwrap_err().to_string();
        assert!(
            full.starts_with("1 exports are under way and 4 wait, 0 of them yours"),
            "{full}"
        );
        drop(first);
        for one in waiting {
            one.await.unwrap();
        }
        assert_eq!(
            *order.lock().unwrap(),
            ["a 1", "a 2", "a 3", "b 1"],
            "nothing of either runs when one ends"
        );
        assert_eq!(queue.running_count(), 0);
    }

    #[tokio::test]
    async fn a_user_with_fewer_exports_comes_first() {
        let queue = queue(2);
        let of_a = [queue.admit("a").await.unwrap(), queue.admit("a").await.unwrap()];
        let (mut next_of_a, mut next_of_b) = (pin!(queue.admit("a")), pin!(queue.admit("b")));
        assert!(poll!(&mut next_of_a).is_pending() && poll!(&mut next_of_b).is_pending());
        let [one, other] = of_a;
        drop(one);
        assert!(poll!(&mut next_of_a).is_pending());
        let Poll::Ready(Ok(_of_b)) = poll!(&mut next_of_b) else {
            panic!("b is admitted before a second one of a");
        };
        drop(other);
        assert!(poll!(&mut next_of_a).is_ready());
    }

    #[tokio::test]
    async fn one_user_leaves_a_place_for_others() {
        let queue = ExportQueue::new(QueueLimits {
            max_running_of_user: 2,
            ..queue(3).0.limits
        });
        let mut of_a = vec![queue.admit("a").await.unwrap(), queue.admit("a").await.unwrap()];
        let mut next_of_a = pin!(queue.admit("a"));
        assert!(poll!(&mut next_of_a).is_pending(), "a third one of a");
        let of_b = queue.admit("b").await.unwrap();
        drop(of_b);
        assert!(poll!(&mut next_of_a).is_pending(), "b has left a place, not to a");
        drop(of_a.pop());
        assert!(poll!(&mut next_of_a).is_ready());
    }

    #[tokio::test]
    async fn who_leaves_is_passed_over() {
        let queue = queue(1);
        let first = queue.admit("a").await.unwrap();
        let mut left = Box::pin(queue.admit("a"));
        assert!(poll!(&mut left).is_pending());
        let mut stays = pin!(queue.admit("b"));
        assert!(poll!(&mut stays).is_pending());
        drop(left);
        drop(first);
        let Poll::Ready(Ok(permit)) = poll!(&mut stays) else {
            panic!("the client that still waits is admitted");
        };
        drop(permit);
        assert_eq!(queue.running_count(), 0);
    }

    #[tokio::test(start_paused = true)]
    async fn a_wait_ends() {
        let queue = queue(1);
        let _first = queue.admit("a").await.unwrap();
        let late = queue.admit("b").await.unwrap_err().to_string();
        assert!(late.contains("none ended within 600 s"), "{late}");
    }
}
