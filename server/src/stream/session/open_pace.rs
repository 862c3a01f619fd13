//! Rate limit for opening volumes: an opening costs other viewers more than any other message.

use std::time::Duration;

use tokio::time::Instant;

/// Burst: number of openings that are read without a pause, for a user who looks through the volumes of a study.
const OPENS_AT_ONCE: u32 = 8;
/// Interval between openings once the burst is used up. An opening with its first step takes some 50 ms of the device, so a client that
/// opens volumes without end takes a tenth of it.
const OPEN_INTERVAL: Duration = Duration::from_millis(500);

/// Decides until when the session reads no message. Unread messages stay in order, and TCP gives back-pressure to the client.
#[derive(Default)]
pub(super) struct OpenPace {
    /// When all openings so far would be done if they were read at one per interval.
    even: Option<Instant>,
}

impl OpenPace {
    /// Records that a volume is opened now.
    pub fn opened(&mut self, now: Instant) {
        self.even = Some(self.even.map_or(now, |even| even.max(now)) + OPEN_INTERVAL);
    }

    /// Returns until when the client's messages have to wait; `None`: they are read now.
    pub fn held_until(&self, now: Instant) -> Option<Instant> {
        let ahead = self.even?.saturating_duration_since(now);
        let wait = ahead.checked_sub(OPEN_INTERVAL * (OPENS_AT_ONCE - 1))?;
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
        for _ in 1..OPENS_AT_ONCE {
            pace.opened(now);
            assert_eq!(pace.held_until(now), None);
        }
        pace.opened(now);
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
        now += OPEN_INTERVAL;
        assert_eq!(pace.held_until(now), None);
        pace.opened(now);
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
        // After a while a full burst is read at once again, and not more.
        now += 100 * OPEN_INTERVAL;
        for _ in 0..OPENS_AT_ONCE {
            assert_eq!(pace.held_until(now), None);
            pace.opened(now);
        }
        assert_eq!(pace.held_until(now), Some(now + OPEN_INTERVAL));
    }
}
