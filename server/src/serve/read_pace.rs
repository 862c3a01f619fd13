//! Rate limit for reading a stream. Clients send little, and messages are limited elsewhere. But a message in endless pieces does not count
//! as a message while it lasts, and parsing it takes a processor that others wait for.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::{Instant, Sleep, sleep_until};

/// Bytes that are read in a second: sixteen times the longest messages. Back-pressure of TCP slows down a client that sends more.
const BYTES_A_SECOND: u32 = 1 << 20;
/// Burst: bytes that are read at once, after less was sent for a while.
const BYTES_AT_ONCE: u32 = 1 << 20;

/// Decides when the next bytes may be read.
#[derive(Default)]
pub(super) struct ReadPace {
    /// Time at which all bytes so far would have been read at an even rate.
    even: Option<Instant>,
    sleep: Option<Pin<Box<Sleep>>>,
}

impl ReadPace {
    /// Ready when the next bytes may be read.
    pub(super) fn poll(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let Some(until) = self.held_until(Instant::now()) else {
            self.sleep = None;
            return Poll::Ready(());
        };
        let sleep = self.sleep.get_or_insert_with(|| Box::pin(sleep_until(until)));
        std::task::ready!(sleep.as_mut().poll(context));
        self.sleep = None;
        Poll::Ready(())
    }

    /// Records that `bytes` were read at `now`.
    pub(super) fn read(&mut self, bytes: usize, now: Instant) {
        let time = Duration::from_secs_f64(bytes as f64 / f64::from(BYTES_A_SECOND));
        self.even = Some(self.even.map_or(now, |even| even.max(now)) + time);
    }

    /// Returns until when reads have to wait; `None` if they need not.
    fn held_until(&self, now: Instant) -> Option<Instant> {
        let at_once = Duration::from_secs_f64(f64::from(BYTES_AT_ONCE) / f64::from(BYTES_A_SECOND));
        let until = self.even?.checked_sub(at_once)?;
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
        assert_eq!(pace.held_until(now), None);
        pace.read(BYTES_AT_ONCE as usize, now);
        assert_eq!(pace.held_until(now), None);
        pace.read(BYTES_A_SECOND as usize / 2, now);
        assert_eq!(pace.held_until(now), Some(now + second / 2));
        now += second / 2;
        assert_eq!(pace.held_until(now), None);
        pace.read(BYTES_A_SECOND as usize / 4, now);
        assert_eq!(pace.held_until(now), Some(now + second / 4));
        // After a while as many are read at once again, and no more than that.
        now += 100 * second;
        pace.read(BYTES_AT_ONCE as usize, now);
        assert_eq!(pace.held_until(now), None);
        pace.read(BYTES_A_SECOND as usize, now);
        assert_eq!(pace.held_until(now), Some(now + second));
    }

    #[tokio::test]
    async fn who_waits_is_woken() {
        let mut pace = ReadPace::default();
        pace.read(BYTES_AT_ONCE as usize + BYTES_A_SECOND as usize / 20, Instant::now());
        let start = Instant::now();
        std::future::poll_fn(|context| pace.poll(context)).await;
        let waited = start.elapsed();
        assert!(waited >= Duration::from_millis(45), "{waited:?}");
    }
}
