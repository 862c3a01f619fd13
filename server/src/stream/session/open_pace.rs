//! Rate limit for opening volumes, by the generic cell rate algorithm (GCRA): an opening costs other viewers more than any other message.

use std::time::Duration;

use tokio::time::Instant;

/// Number of openings that are read without a pause: as many as a user needs to look through the volumes of a study.
const BURST_OPENINGS: u32 = 8;
/// Minimum interval between openings once the burst is used up. An opening with its first step takes about 50 ms of the device, so a client
/// that opens one volume after the other takes a tenth of the device's time.
const OPEN_INTERVAL: Duration = Duration::from_millis(500);

/// Decides when the session pauses reading after an opening. Unread messages stay in order, and TCP gives back-pressure to the client.
#[derive(Default)]
pub(super) struct OpenPace {
    /// Theoretical arrival time of GCRA: the time at which the openings so far would be used up, at one per [`OPEN_INTERVAL`].
    arrival: Option<Instant>,
}

impl OpenPace {
    /// Records that a volume is opened now.
    pub fn record_opening(&mut self, now: Instant) {
        self.arrival = Some(self.arrival.map_or(now, |arrival| arrival.max(now)) + OPEN_INTERVAL);
    }

    /// Returns the time until which the session must not read messages of the client; `None` if it may read now.
    pub fn held_until(&self, now: Instant) -> Option<Instant> {
        let ahead = self.arrival?.saturating_duration_since(now);
        let wait = ahead.checked_sub(OPEN_INTERVAL * (BURST_OPENINGS - 1))?;
        (!wait.is_zero()).then(|| now + wait)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn openings_are_read_at_once_until_there_are_many() {
        let (mut pace, mut now) = (OpenPace::default(), Instant::now());
        assert_eq!(pace.held_until(now), None);
        for _ in 1..BURST_OPENINGS {
            pace.record_opening(now);
            assert_eq!(pace.held_until(now), None);
        }
        pace.record_opening(now);
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
        now += OPEN_INTERVAL;
        assert_eq!(pace.held_until(now), None);
        pace.record_opening(now);
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
        // After a while a full burst is read at once again, and not more.
        now += 100 * OPEN_INTERVAL;
        for _ in 0..BURST_OPENINGS {
            assert_eq!(pace.held_until(now), None);
            pace.record_opening(now);
        }
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
    }
}
