//! Chooses the size of a step so that the step arrives within [`StepTimes`]. The size follows from two measured speeds: the speed at which
//! device and pool make triangles, and the speed of the line.
//!
//! Every step ends with a ping. The client's pong confirms that the whole step has arrived. The time at which the socket accepts the bytes
//! does not: on a slow line, buffers of the operating system hold them for seconds.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

/// Target times of a step: for device and pool together, and then for the line.
#[derive(Clone, Copy, Debug)]
pub struct StepTimes {
    /// The first step of a new surface, without the time for its pyramid. A surface that takes hardly longer than this is made in one step.
    pub fresh: Duration,
    /// The first step of a surface that changes.
    pub first: Duration,
    /// A further step. Each remakes regions at the border of the step before, so fewer and longer steps finish sooner.
    pub next: Duration,
    /// Sending the new regions of a step. The regions at its border, which are sent again, take additional time.
    pub line: Duration,
}

impl Default for StepTimes {
    fn default() -> Self {
        Self {
            fresh: Duration::from_millis(5),
            first: Duration::from_millis(60),
            next: Duration::from_millis(150),
            line: Duration::from_millis(400),
        }
    }
}

/// Assumed speed of meshing and encoding until it is measured, in triangles per millisecond: the speed of two processors.
const TRIANGLES_PER_MS: f64 = 3000.0;

/// Minimum triangles of a step whose time is measured: smaller steps spend most of their time on launches.
const MEASURED_TRIANGLES: u64 = 20_000;
/// Minimum bytes of a step whose time on the line is measured: the time of smaller ones is mostly latency.
const MEASURED_BYTES: u64 = 16 << 10;
/// A step that took at least this many milliseconds on the line is measured whatever its size.
const MEASURED_MS: f64 = 5.0;

/// Weight of the latest measurement in the exponential moving average of a speed.
const LATEST_WEIGHT: f64 = 0.5;

/// Minimum triangles of a step: a prefix of the coarsest level has hardly more.
const MIN_TRIANGLES: f64 = 1000.0;

/// Maximum number of steps on the line: one that is arriving and one behind it, so that the line is never idle.
const MAX_ON_LINE: usize = 2;
/// Maximum number of steps on the line before the first pong, when the speed of the line is unknown.
const MAX_ON_UNKNOWN_LINE: usize = 1;
/// Longest wait for a pong. A client must answer pings, but if a proxy does not forward them, the client still gets its surface after this
/// wait.
const MAX_PONG_WAIT: Duration = Duration::from_secs(2);

/// A step that was sent, and whose pong has not come.
struct StepOnLine {
    number: u32,
    bytes: u64,
    /// When the writer took the first and the last frame of the step.
    first: Instant,
    last: Instant,
}

/// Bytes of a measurement of the line, and when the line began to carry them.
struct Measured {
    bytes: u64,
    began: Instant,
}

/// Speeds of one connection.
pub(super) struct Pace {
    times: StepTimes,
    triangles_per_ms: f64,
    bytes_per_ms: f64,
    /// Steps whose pong is awaited, the oldest first.
    on_line: VecDeque<StepOnLine>,
    /// Number of the last step that was sent.
    last_number: u32,
    last_pong: Option<Instant>,
    last_measured: Option<Measured>,
}

impl Pace {
    pub(super) fn new(times: StepTimes) -> Self {
        Self {
            times,
            triangles_per_ms: TRIANGLES_PER_MS,
            bytes_per_ms: f64::INFINITY,
            on_line: VecDeque::new(),
            last_number: 0,
            last_pong: None,
            last_measured: None,
        }
    }

    /// Returns the number of triangles that suits the first step of a new surface.
    pub(super) fn fresh_triangles(&self) -> u64 {
        self.triangles_within(self.times.fresh)
    }

    /// Returns the number of triangles that suits a step of a surface that changes. `is_first`: the first step after the edit.
    pub(super) fn step_triangles(&self, is_first: bool) -> u64 {
        self.triangles_within(if is_first { self.times.first } else { self.times.next })
    }

    /// Returns how many triangles can be meshed and encoded in this time, at least [`MIN_TRIANGLES`].
    fn triangles_within(&self, time: Duration) -> u64 {
        (self.triangles_per_ms * time.as_secs_f64() * 1e3).max(MIN_TRIANGLES) as u64
    }

    /// Returns the time that the line may take for a step.
    pub(super) fn line_time(&self) -> Duration {
        self.times.line
    }

    /// Returns the maximum bytes of a step, by the measured speed of the line; `u64::MAX` before the first measurement.
    pub(super) fn max_bytes(&self) -> u64 {
        (self.bytes_per_ms * self.times.line.as_secs_f64() * 1e3) as u64
    }

    /// Records the time in which a step of this number of triangles was meshed and encoded.
    pub(super) fn record_made(&mut self, triangles: u64, time: Duration) {
        if triangles >= MEASURED_TRIANGLES {
            let ms = (time.as_secs_f64() * 1e3).max(0.1);
            self.triangles_per_ms = average(self.triangles_per_ms, triangles as f64 / ms);
        }
    }

    /// Records that the writer has taken the last frame of a step of `bytes` bytes; `first`: when it took the first one. Returns the number
    /// of the ping to send after the step.
    pub(super) fn record_sent(&mut self, bytes: u64, first: Instant) -> u32 {
        self.last_number = self.last_number.wrapping_add(1);
        let (number, last) = (self.last_number, Instant::now());
        // Drop steps whose pong is overdue.
        self.on_line.retain(|step| step.last.elapsed() < MAX_PONG_WAIT);
        self.on_line.push_back(StepOnLine {
            number,
            bytes,
            first,
            last,
        });
        number
    }

    /// Returns the steps whose pong may still come.
    fn awaited(&self) -> impl Iterator<Item = &StepOnLine> {
        self.on_line.iter().filter(|step| step.last.elapsed() < MAX_PONG_WAIT)
    }

    /// Whether a further step has to wait for a pong.
    pub(super) fn is_line_full(&self) -> bool {
        let max = if self.is_line_known() {
            MAX_ON_LINE
        } else {
            MAX_ON_UNKNOWN_LINE
        };
        self.awaited().count() >= max
    }

    /// Whether the client has answered a ping. Until then the size of a further step cannot be fitted to the line.
    pub(super) fn is_line_known(&self) -> bool {
        self.last_pong.is_some()
    }

    /// Resolves when the oldest step has waited long enough for its pong; never if no step waits.
    pub(super) async fn pong_wait_elapsed(&self) {
        match self.awaited().next() {
            Some(step) => tokio::time::sleep_until(step.last + MAX_PONG_WAIT).await,
            None => std::future::pending().await,
        }
    }

    /// Handles a pong: measures the line with all steps up to this one. Ignores a pong whose number belongs to no step.
    pub(super) fn on_pong(&mut self, number: u32) {
        let Some(index) = self.on_line.iter().position(|step| step.number == number) else {
            return;
        };
        let now = Instant::now();
        let steps: Vec<StepOnLine> = self.on_line.drain(..=index).collect();
        let bytes: u64 = steps.iter().map(|step| step.bytes).sum();
        let first = steps.first().map_or(now, |step| step.first);
        let began = self.last_pong.map_or(first, |last| last.max(first));
        self.last_pong = Some(now);
        let ms = |began: Instant| ((now - began).as_secs_f64() * 1e3).max(0.1);
        let mut speed = bytes as f64 / ms(began);
        // If the client was busy, the pong of the steps before was late, and this one seems early. Both together have the right time.
        if began > first
            && let Some(before) = &self.last_measured
        {
            speed = speed.min((bytes + before.bytes) as f64 / ms(before.began));
        }
        self.last_measured = Some(Measured { bytes, began });
        if bytes >= MEASURED_BYTES || ms(began) >= MEASURED_MS {
            self.bytes_per_ms = average(self.bytes_per_ms, speed);
        }
    }
}

/// Returns the moving average after a further measurement. Before the first one `before` is infinite; then the measurement itself is
/// returned.
fn average(before: f64, latest: f64) -> f64 {
    if before.is_finite() {
        before + LATEST_WEIGHT * (latest - before)
    } else {
        latest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_line_makes_steps_small_and_a_fast_one_lets_them_grow() {
        let mut pace = Pace::new(StepTimes::default());
        assert_eq!(pace.max_bytes(), u64::MAX, "not known yet");
        let ping = pace.record_sent(100_000, Instant::now());
        std::thread::sleep(Duration::from_millis(50));
        pace.on_pong(ping + 1);
        assert_eq!(pace.max_bytes(), u64::MAX, "a pong of no ping");
        pace.on_pong(ping);
        let slow = pace.max_bytes();
        assert!(slow <= 800_000, "2 MB/s at most: {slow}");
        for _ in 0..20 {
            let ping = pace.record_sent(10_000_000, Instant::now());
            pace.on_pong(ping);
        }
        assert!(pace.max_bytes() > slow);
    }

    #[test]
    fn two_pongs_at_once_make_no_line_fast() {
        let mut pace = Pace::new(StepTimes::default());
        for _ in 0..4 {
            let began = Instant::now();
            let pings = [pace.record_sent(100_000, began), pace.record_sent(100_000, began)];
            std::thread::sleep(Duration::from_millis(50));
            for ping in pings {
                pace.on_pong(ping);
            }
            // 400 ms of 4 MB/s.
            assert!(pace.max_bytes() <= 1_700_000, "{} bytes", pace.max_bytes());
        }
    }

    #[test]
    fn two_steps_may_be_on_a_line_whose_speed_is_known() {
        let mut pace = Pace::new(StepTimes::default());
        let first = pace.record_sent(1, Instant::now());
        assert!(pace.is_line_full() && !pace.is_line_known());
        pace.on_pong(first);
        assert!(pace.is_line_known());
        let second = pace.record_sent(1, Instant::now());
        assert!(!pace.is_line_full());
        pace.record_sent(1, Instant::now());
        assert!(pace.is_line_full());
        pace.on_pong(second);
        assert!(!pace.is_line_full());
    }

    #[test]
    fn steps_follow_the_speed_at_which_they_are_made() {
        let mut pace = Pace::new(StepTimes::default());
        for _ in 0..10 {
            pace.record_made(1_000_000, Duration::from_millis(10));
        }
        assert!(
            pace.step_triangles(false) > 10_000_000,
            "{}",
            pace.step_triangles(false)
        );
        assert!(
            pace.fresh_triangles() < pace.step_triangles(true)
                && pace.step_triangles(true) < pace.step_triangles(false)
        );
        pace.record_made(500, Duration::from_secs(1));
        assert!(
            pace.step_triangles(false) > 10_000_000,
            "a small step says nothing of the speed"
        );
    }
}
