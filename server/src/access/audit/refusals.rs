//! Counts repeated refusals, so that a refused client cannot fill the disk with lines.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Event;

/// Maximum number of kinds that are counted separately. Beyond that, refusals are counted without their users and peers.
pub(super) const MAX_KINDS: usize = 1_024;

/// A kind of refusals. The lines of two refusals of the same kind differ only in time and id.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Kind {
    pub(super) event: Event,
    pub(super) status: Option<u16>,
    pub(super) code: Option<&'static str>,
    /// User and id of the token.
    pub(super) who: Option<(Arc<str>, Arc<str>)>,
    pub(super) peer: Option<IpAddr>,
}

/// Refusals that were counted instead of written.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    /// For each kind, the time of the first refusal, and the number of refusals after it.
    kinds: HashMap<Kind, (Instant, u64)>,
}

impl Refusals {
    /// Counts a refusal. Returns true if it is the first of its kind, whose line must be written.
    pub(super) fn count(&mut self, mut kind: Kind, now: Instant) -> bool {
        if self.kinds.len() >= MAX_KINDS && !self.kinds.contains_key(&kind) {
            (kind.who, kind.peer) = (None, None);
        }
        match self.kinds.entry(kind) {
            Entry::Occupied(mut count) => {
                count.get_mut().1 += 1;
                false
            }
            Entry::Vacant(entry) => {
                entry.insert((now, 0));
                true
            }
        }
    }

    /// Removes the kinds whose first refusal was at least `age` ago, and returns their counts if these are above 0.
    pub(super) fn take_due(&mut self, now: Instant, age: Duration) -> Vec<(Kind, u64)> {
        let due = self.kinds.extract_if(|_, (since, _)| now.duration_since(*since) >= age);
        due.map(|(kind, (_, count))| (kind, count))
            .filter(|(_, count)| *count > 0)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{COUNTING_PERIOD, WRITE_INTERVAL};
    use super::*;

    #[test]
    fn counts_are_those_of_a_minute() {
        let (mut refusals, start) = (Refusals::default(), Instant::now());
        let kind = Kind {
            event: Event::Request,
            status: Some(429),
            code: None,
            who: None,
            peer: None,
        };
        let minute = start + COUNTING_PERIOD;
        assert!(refusals.count(kind.clone(), start) && !refusals.count(kind.clone(), start));
        assert!(refusals.take_due(minute - WRITE_INTERVAL, COUNTING_PERIOD).is_empty());
        assert_eq!(refusals.take_due(minute, COUNTING_PERIOD), [(kind.clone(), 1)]);
        assert!(
            refusals.count(kind, minute) && refusals.take_due(minute + COUNTING_PERIOD, COUNTING_PERIOD).is_empty()
        );
    }
}
