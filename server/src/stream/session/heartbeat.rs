//! Heartbeats in both directions, for clients that request them. With heartbeats both ends notice within seconds if the line is cut without
//! an error.

use std::time::Duration;

use tokio::time::Instant;

/// Interval between two `heartbeat` messages.
const BEAT: Duration = Duration::from_millis(1500);
/// Maximum bytes that may be sent before a beat. A slow line may take longer than [`BEAT`] to send these bytes.
pub(super) const BEFORE_BEAT: u64 = 128 << 10;
/// Number of beats without an answer after which the line counts as dead.
const MAX_MISSED: u32 = 3;

/// The heartbeat of one connection.
pub(super) struct Heartbeat {
    /// When the next beat is due; `None` until the client requests heartbeats.
    next: Option<Instant>,
    /// When the last frame of the client was read.
    last_heard: Instant,
    /// Whether the client has answered any ping.
    answers_pings: bool,
}

impl Heartbeat {
    pub(super) fn new() -> Self {
        Self {
            next: None,
            last_heard: Instant::now(),
            answers_pings: false,
        }
    }

    /// Starts the heartbeat at the client's request. The first beat is due now.
    pub(super) fn begin(&mut self) {
        self.next.get_or_insert_with(Instant::now);
    }

    /// Records that a frame of the client was read.
    pub(super) fn record_frame(&mut self, is_pong: bool) {
        self.last_heard = Instant::now();
        self.answers_pings |= is_pong;
    }

    /// Returns when the next beat is due.
    pub(super) fn due(&self) -> Option<Instant> {
        self.next
    }

    /// Handles a beat that is due. `is_listening`: whether the session reads the client's frames. `line_time`: the time that the line needs
    /// for [`BEFORE_BEAT`]. Returns the maximum time until the client gets the next beat, or `None` if the client was silent for too long.
    /// A client that has never answered a ping may be silent, because a proxy may drop the pings.
    pub(super) fn beat(&mut self, is_listening: bool, line_time: Duration) -> Option<Duration> {
        self.next = Some(Instant::now() + BEAT);
        let longest = BEAT.max(line_time);
        if !is_listening {
            // The session does not read frames now, so frames of the client may wait in the queue. Count the client as heard.
            self.last_heard = Instant::now();
        }
        // The next check is one beat later, so a client that would be silent for too long by then counts as dead now.
        let is_dead = self.answers_pings && self.last_heard.elapsed() + BEAT > MAX_MISSED * longest;
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
        heartbeat.record_frame(true);
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
        heartbeat.record_frame(true);
        tokio::time::sleep(Duration::from_secs(60)).await;
        assert_eq!(heartbeat.beat(false, Duration::ZERO), Some(BEAT));
    }
}
