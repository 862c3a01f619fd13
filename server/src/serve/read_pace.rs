//! Rate limit for reads of a stream, by the generic cell rate algorithm (GCRA).
//!
//! The session limits complete messages. But a client can send fragments of one message without end, and parsing them takes processor time
//! from other clients.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::{Instant, Sleep, sleep_until};

/// Sustained rate of reads: sixteen messages of maximum length in a second. Back-pressure of TCP slows down a client that sends more.
const BYTES_PER_SECOND: u32 = 1 << 20;
/// Maximum number of bytes that are read without a pause after an idle time.
const BURST_BYTES: u32 = 1 << 20;

/// Rate limiter of one connection.
#[derive(Default)]
pub(super) struct ReadPace {
    /// Theoretical arrival time (TAT) of GCRA: when reads at [`BYTES_PER_SECOND`] would have reached the current number of bytes.
    arrival: Option<Instant>,
    sleep: Option<Pin<Box<Sleep>>>,
}

impl ReadPace {
    /// Returns `Ready` when the next read is allowed.
    pub(super) fn poll(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let Some(until) = self.blocked_until(Instant::now()) else {
            self.sleep = None;
            return Poll::Ready(());
        };
        let sleep = self.sleep.get_or_insert_with(|| Box::pin(sleep_until(until)));
        std::task::ready!(sleep.as_mut().poll(context));
        self.sleep = None;
        Poll::Ready(())
    }

    /// Records that `bytes` were read at `now`.
    pub(super) fn record_read(&mut self, bytes: usize, now: Instant) {
        let time = Duration::from_secs_f64(bytes as f64 / f64::from(BYTES_PER_SECOND));
        self.arrival = Some(self.arrival.map_or(now, |arrival| arrival.max(now)) + time);
    }

    /// Returns the time of the next allowed read; `None` if a read is allowed now.
    fn blocked_until(&self, now: Instant) -> Option<Instant> {
        let burst = Duration::from_secs_f64(f64::from(BURST_BYTES) / f64::from(BYTES_PER_SECOND));
        let until = self.arrival?.checked_sub(burst)?;
        (until > now).then_some(until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_read_at_once_until_there_are_many() {
        let (mut pace, mut now) = (ReadPace::default(), Instant::now());
        let second = Duration::from_secs(1);
        assert_eq!(pace.blocked_until(now), None);
        pace.record_read(BURST_BYTES as usize, now);
        assert_eq!(pace.blocked_until(now), None);
        pace.record_read(BYTES_PER_SECOND as usize / 2, now);
        assert_eq!(pace.blocked_until(now), Some(now + second / 2));
        now += second / 2;
        assert_eq!(pace.blocked_until(now), None);
        pace.record_read(BYTES_PER_SECOND as usize / 4, now);
        assert_eq!(pace.blocked_until(now), Some(now + second / 4));
        // After a while as many are read at once again, and no more than that.
        now += 100 * second;
        pace.record_read(BURST_BYTES as usize, now);
        assert_eq!(pace.blocked_until(now), None);
        pace.record_read(BYTES_PER_SECOND as usize, now);
        assert_eq!(pace.blocked_until(now), Some(now + second));
    }

    #[tokio::test]
    async fn who_waits_is_woken() {
        let mut pace = ReadPace::default();
        pace.record_read(BURST_BYTES as usize + BYTES_PER_SECOND as usize / 20, Instant::now());
        let start = Instant::now();
        std::future::poll_fn(|context| pace.poll(context)).await;
        let waited = start.elapsed();
        assert!(waited >= Duration::from_millis(45), "{waited:?}");
    }
}
