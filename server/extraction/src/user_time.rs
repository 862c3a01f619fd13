//! Recent device time that each user's computed fields have taken.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use isopeel_kernels::lock;

/// Period in which a user may take device time up to the limit.
pub const USER_TIME_PERIOD: Duration = Duration::from_secs(600);

/// Number of entries at which the entries of users who have their whole limit available are dropped.
const MANY_USERS: usize = 1024;

/// Device time that users have taken.
pub struct UserTimes {
    /// `None`: there is no limit.
    limit: Option<Duration>,
    taken: Mutex<HashMap<Arc<str>, Taken>>,
}

/// Device time that a user had taken at a given moment. It decreases evenly, by the whole limit in one period.
#[derive(Clone, Copy)]
struct Taken {
    time: Duration,
    since: Instant,
}

impl Taken {
    /// Returns the part of the taken time that still counts.
    fn remaining(self, limit: Duration, now: Instant) -> Duration {
        let periods = now.saturating_duration_since(self.since).as_secs_f64() / USER_TIME_PERIOD.as_secs_f64();
        self.time.saturating_sub(limit.mul_f64(periods))
    }
}

impl UserTimes {
    /// Creates the state in which no user has taken time. `limit`: maximum time of a user; `None`: there is no limit.
    pub fn new(limit: Option<Duration>) -> Arc<Self> {
        Arc::new(Self {
            limit,
            taken: Mutex::default(),
        })
    }
}

/// The user who is charged for a piece of work.
#[derive(Clone)]
pub struct Payer {
    times: Arc<UserTimes>,
    user: Arc<str>,
}

/// Time that is available to a user now, and how long to wait until it is a tenth of the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TimeLeft {
    pub limit: Duration,
    pub available: Duration,
    pub wait: Duration,
}

impl Payer {
    /// Returns the user of this name as payer.
    pub fn new(times: &Arc<UserTimes>, user: &str) -> Self {
        Self {
            times: Arc::clone(times),
            user: user.into(),
        }
    }

    /// Returns the time that the user may take; `None`: there is no limit.
    pub(crate) fn left(&self, now: Instant) -> Option<TimeLeft> {
        let limit = self.times.limit?;
        let taken = lock(&self.times.taken).get(&self.user).copied();
        let used = taken.map_or(Duration::ZERO, |taken| taken.remaining(limit, now));
        let excess = used.saturating_sub(limit.mul_f64(0.9)).as_secs_f64() / limit.as_secs_f64();
        Some(TimeLeft {
            limit,
            available: limit.saturating_sub(used),
            wait: USER_TIME_PERIOD.mul_f64(excess),
        })
    }

    /// Charges the user for device time.
    pub(crate) fn charge(&self, time: Duration, now: Instant) {
        let Some(limit) = self.times.limit else {
            return;
        };
        let mut taken = lock(&self.times.taken);
        if taken.len() >= MANY_USERS {
            taken.retain(|_, taken| !taken.remaining(limit, now).is_zero());
        }
        let before = taken.get(&self.user).copied();
        let before = before.map_or(Duration::ZERO, |taken| taken.remaining(limit, now));
        let time = before + time;
        taken.insert(Arc::clone(&self.user), Taken { time, since: now });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_each_users_and_comes_back() {
        let times = UserTimes::new(Some(Duration::from_secs(100)));
        let (ann, bob) = (Payer::new(&times, "ann"), Payer::new(&times, "bob"));
        let start = Instant::now();
        let left = |payer: &Payer, seconds| {
            let left = payer.left(start + Duration::from_secs(seconds)).unwrap();
            (left.available.as_secs_f64().round(), left.wait.as_secs_f64().round())
        };
        assert_eq!(left(&ann, 0), (100.0, 0.0));
        ann.charge(Duration::from_secs(60), start);
        ann.charge(Duration::from_secs(50), start);
        assert_eq!(left(&ann, 0), (0.0, 120.0), "a tenth is there again after 20 s of 100");
        assert_eq!(left(&bob, 0), (100.0, 0.0), "another user's");
        assert_eq!(left(&ann, 120), (10.0, 0.0));
        assert_eq!(left(&ann, 660), (100.0, 0.0));
        let unlimited = Payer::new(&UserTimes::new(None), "ann");
        unlimited.charge(Duration::from_secs(9000), start);
        assert!(unlimited.left(start).is_none());
    }

    #[test]
    fn users_who_have_all_their_time_are_forgotten() {
        let times = UserTimes::new(Some(Duration::from_secs(100)));
        let start = Instant::now();
        let payers = (0..2 * MANY_USERS).map(|user| Payer::new(&times, &user.to_string()));
        for (second, payer) in payers.enumerate() {
            payer.charge(Duration::from_secs(1), start + Duration::from_secs(second as u64));
        }
        assert!(lock(&times.taken).len() <= MANY_USERS);
    }
}
