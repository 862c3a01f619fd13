//! Counts refusals of one kind, so that clients who are refused repeatedly do not fill the disk with lines.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Event;

/// Maximum kinds of refusals that are counted separately. Further kinds are counted together, without user and peer.
pub(super) const MAX_KINDS: usize = 1_024;

/// A kind of refusals: their lines differ only in time and id.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Kind {
    pub(super) event: Event,
    pub(super) status: Option<u16>,
    pub(super) code: Option<&'static str>,
    /// User and token.
    pub(super) who: Option<(Arc<str>, Arc<str>)>,
    pub(super) peer: Option<IpAddr>,
}

/// Refusals that were counted instead of written.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    /// For each kind, when counting began, and the number of refusals after the first.
    kinds: HashMap<Kind, (Instant, u64)>,
}

impl Refusals {
    /// Counts a refusal. Returns true if it must be written, because it is the first of its kind for a while.
    pub(super) fn count(&mut self, mut kind: Kind, now: Instant) -> bool {
        if self.kinds.len() >= MAX_KINDS && !self.kinds.contains_key(&kind) {
            (kind.who, kind.peer) = (None, None);
        }
        match self.kinds.entry(kind) {
            Entry::Occupied(mut found) => {
                found.get_mut().1 += 1;
                false
            }
            Entry::Vacant(space) => {
                space.insert((now, 0));
                true
            }
        }
    }

    /// Removes and returns the counts that must be written: those of kinds that were first seen at least `age` ago.
    pub(super) fn take_due(&mut self, now: Instant, age: Duration) -> Vec<(Kind, u64)> {
        let due = self.kinds.extract_if(|_, (since, _)| now.duration_since(*since) >= age);
        due.map(|(kind, (_, more))| (kind, more))
            .filter(|(_, more)| *more > 0)
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
