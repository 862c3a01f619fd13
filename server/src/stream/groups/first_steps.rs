//! Orders the steps of a group's members: a follower's further steps wait until no member waits for the first step of a surface.
//!
//! Copying a cached surface to the sockets of a thousand followers takes a tenth of a second. Without this order the first followers would
//! have the whole surface before the last ones have anything.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::yield_now;
use tokio::time::timeout;

use super::{Group, Member};

/// Longest wait for the first steps of others: about the time that the first steps of the largest group take.
pub(in crate::stream) const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// Number of members that wait for a first step.
pub(super) struct FirstSteps(watch::Sender<usize>);

impl Default for FirstSteps {
    fn default() -> Self {
        Self(watch::Sender::new(0))
    }
}

/// Guard of a member that waits for a first step. Dropped when the step is ready to be sent, or is no longer needed.
pub(in crate::stream) struct FirstStep(Arc<Group>);

impl Drop for FirstStep {
    fn drop(&mut self) {
        self.0.first_steps.0.send_if_modified(|waiting| {
            *waiting -= 1;
            *waiting == 0
        });
    }
}

/// Waits for the first steps of other members.
pub(in crate::stream) struct OthersFirst(watch::Receiver<usize>);

impl OthersFirst {
    /// Returns when no member waits for a first step any more, but no later than after [`LONGEST_WAIT`].
    pub(in crate::stream) async fn wait(mut self) {
        // The event that woke this member wakes others as well. Yield, so that they are counted as waiting first.
        yield_now().await;
        // A time-out or the end of the group is harmless: only the order of steps is lost.
        let _ = timeout(LONGEST_WAIT, self.0.wait_for(|waiting| *waiting == 0)).await;
    }
}

impl Member {
    /// Marks this member as waiting for a first step.
    pub(in crate::stream) fn first_step(&self) -> FirstStep {
        self.group.first_steps.0.send_if_modified(|waiting| {
            *waiting += 1;
            false
        });
        FirstStep(Arc::clone(&self.group))
    }

    /// Returns a wait for the first steps of all members.
    pub(in crate::stream) fn others_first(&self) -> OthersFirst {
        OthersFirst(self.group.first_steps.0.subscribe())
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::pin;
    use std::time::Duration;

    use futures_util::FutureExt;
    use tokio::task::yield_now;
    use tokio::time::advance;

    use super::super::{Groups, Leader};
    use super::LONGEST_WAIT;
    use crate::access::Occupant;

    /// Polls a few times.
    async fn is_ready(waiting: &mut (impl Future<Output = ()> + Unpin)) -> bool {
        for _ in 0..4 {
            if waiting.now_or_never().is_some() {
                return true;
            }
            yield_now().await;
        }
        false
    }

    #[tokio::test(start_paused = true)]
    async fn further_steps_come_after_all_first_ones_but_wait_no_longer_than_they_may() {
        let groups = Groups::default();
        let who = Leader {
            who: Occupant {
                user: "ann".into(),
                address: None,
                is_admin: false,
            },
            key: "1".into(),
        };
        let leader = groups.lead("1".into(), who).expect("a group");
        let follower = groups.join("1", None, false).expect("space");
        assert!(
            is_ready(&mut pin!(leader.others_first().wait())).await,
            "no member waits"
        );

        let (one, other) = (leader.first_step(), follower.first_step());
        let mut wait = pin!(leader.others_first().wait());
        assert!(!is_ready(&mut wait).await);
        drop(one);
        assert!(!is_ready(&mut wait).await);
        drop(other);
        assert!(is_ready(&mut wait).await);

        let _stalls = follower.first_step();
        let mut wait = pin!(leader.others_first().wait());
        advance(LONGEST_WAIT - Duration::from_millis(2)).await;
        assert!(!is_ready(&mut wait).await);
        advance(LONGEST_WAIT).await;
        assert!(is_ready(&mut wait).await);
    }
}
