//! Heartbeats in both directions, for clients that request them: both ends notice within seconds if the line is cut silently.

use std::time::Duration;

use tokio::time::Instant;

/// Interval between two `heartbeat` messages.
const BEAT: Duration = Duration::from_millis(1500);
/// Bytes that may be sent before a beat. A slow line may need more than [`BEAT`] for them.
pub(super) const BEFORE_BEAT: u64 = 128 << 10;
/// Heartbeats without an answer after which the line counts as dead.
const MISSED: u32 = 3;

/// The heartbeat of one connection.
pub(super) struct Heartbeat {
    next: Option<Instant>,
    heard: Instant,
    answers_pings: bool,
}

impl Heartbeat {
    pub(super) fn new() -> Self {
        Self {
            next: None,
            heard: Instant::now(),
            answers_pings: false,
        }
    }

    /// Starts the heartbeat at the client's request. The first beat is due now.
    pub(super) fn begin(&mut self) {
        self.next.get_or_insert_with(Instant::now);
    }

    /// Records that a frame of the client was read.
    pub(super) fn heard(&mut self, is_pong: bool) {
        self.heard = Instant::now();
        self.answers_pings |= is_pong;
    }

    /// When the next beat is due.
    pub(super) fn due(&self) -> Option<Instant> {
        self.next
    }

    /// Called when a beat is due; `line` is the time that the line needs for [`BEFORE_BEAT`]. Returns the longest time until the next beat,
    /// or `None` if the client was silent for too long. A client that has never answered a ping may be silent, because a proxy may drop its
    /// pings.
    pub(super) fn beat(&mut self, is_listening: bool, line: Duration) -> Option<Duration> {
        self.next = Some(Instant::now() + BEAT);
        let longest = BEAT.max(line);
        if !is_listening {
            // The server itself does not read now, so the client's frames wait in the queue: count them as heard.
            self.heard = Instant::now();
        }
        // The next check is one beat later.
        let is_dead = self.answers_pings && self.heard.elapsed() + BEAT > MISSED * longest;
        (!is_dead).then_some(longest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds until the line counts as dead, after the last pong.
    async fn dead_after(line: Duration) -> f64 {
        let mut heartbeat = Heartbeat::new();
        heartbeat.begin();
        heartbeat.heard(true);
        let last = Instant::now();
        loop {
            tokio::time::sleep_until(heartbeat.due().expect("it has begun")).await;
            if heartbeat.beat(true, line).is_none() {
                return last.elapsed().as_secs_f64();
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_silent_client_is_noticed_within_five_seconds() {
        let seconds = dead_after(Duration::ZERO).await;
        assert!((3.0..5.0).contains(&seconds), "{seconds} s");
        let slow = dead_after(Duration::from_secs(10)).await;
        assert!((28.0..31.0).contains(&slow), "a slow line: {slow} s");
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_never_answered_a_ping_or_is_not_read_is_not_dead() {
        let mut heartbeat = Heartbeat::new();
        heartbeat.begin();
        tokio::time::sleep(Duration::from_secs(60)).await;
        assert_eq!(heartbeat.beat(true, Duration::ZERO), Some(BEAT));
        heartbeat.heard(true);
        tokio::time::sleep(Duration::from_secs(60)).await;
        assert_eq!(heartbeat.beat(false, Duration::ZERO), Some(BEAT));
    }
}
