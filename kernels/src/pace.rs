//! Chooses the sizes of launches from the times of earlier ones. Other jobs wait until a launch ends, so launches must be short on any
//! device and for any work.

use std::time::Duration;

/// Target time of a launch. Half of the time that other jobs may wait, because work is uneven and the processors are shared.
const TARGET: Duration = Duration::from_millis(15);

/// Maximum ratio of the size of a launch to that of the previous one.
const GROWTH: u64 = 4;

/// Sizes of the launches of one piece of work, in any unit.
#[derive(Clone, Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub(crate) struct Pace {
    next: u64,
    smallest: u64,
    largest: u64,
}

#[cfg(feature = "serde")]
crate::checked_serde!(Pace, |pace| {
    let is_usable = 1 <= pace.smallest && (pace.smallest..=pace.largest).contains(&pace.next);
    is_usable.then_some(()).ok_or("sizes of launches that are out of order")
});

impl Pace {
    /// Begins with `first` units, and stays between `smallest` and `largest`.
    pub fn new(first: u64, smallest: u64, largest: u64) -> Self {
        Self {
            next: first.clamp(smallest, largest),
            smallest,
            largest,
        }
    }

    /// Units of the next launch.
    pub fn units(&self) -> u64 {
        self.next
    }

    /// Records that a launch of `units` took `time`.
    pub fn took(&mut self, units: u64, time: Duration) {
        let fitting = units as f64 * TARGET.as_secs_f64() / time.as_secs_f64().max(1e-6);
        let largest = units.saturating_mul(GROWTH);
        self.next = (fitting as u64).min(largest).clamp(self.smallest, self.largest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the launch sizes for `work` units that take `each` per unit.
    fn launches(work: u64, each: Duration) -> Vec<u64> {
        let (mut pace, mut done, mut all) = (Pace::new(100, 10, 1_000_000), 0, Vec::new());
        while done < work {
            let units = pace.units().min(work - done);
            pace.took(units, each.mul_f64(units as f64));
            done += units;
            all.push(units);
        }
        all
    }

    #[test]
    fn launches_take_the_target_whatever_a_unit_costs() {
        for nanoseconds in [10, 1_000, 100_000] {
            let each = Duration::from_nanos(nanoseconds);
            let all = launches(30_000_000 / nanoseconds * 100, each);
            let longest = all.iter().max().copied().unwrap_or_default();
            let time = each.mul_f64(longest as f64);
            assert!(time <= TARGET * 2, "{nanoseconds} ns: a launch of {time:?}");
            assert!(
                time >= TARGET / 2 || longest == 1_000_000,
                "{nanoseconds} ns: the longest takes {time:?}"
            );
        }
    }

    #[test]
    fn one_slow_launch_makes_the_next_one_small_within_its_limits() {
        let mut pace = Pace::new(1000, 10, 1_000_000);
        pace.took(1000, Duration::from_secs(1));
        assert_eq!(pace.units(), 15);
        pace.took(15, Duration::from_secs(60));
        assert_eq!(pace.units(), 10);
        pace.took(10, Duration::from_nanos(1));
        assert_eq!(pace.units(), 40);
    }
}
