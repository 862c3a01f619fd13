//! Flow control: bounds the bytes in flight, which the client has not confirmed yet. So a newer edit does not wait until much of an older
//! surface is sent.
//!
//! A ping follows each eighth of the window. The ping's pong confirms that all bytes before the ping have arrived. The window is the number
//! of bytes that the line takes in a round trip plus [`QUEUE`]. Without a window, buffers of the operating system and the network would
//! take several megabytes, for which a slow line needs seconds.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

/// Time that bytes may wait for the line, beyond a round trip. A newer edit waits about as long for the bytes of an older surface.
const QUEUE: Duration = Duration::from_millis(120);

/// Bytes of the window before the first pong.
const FIRST_WINDOW: u64 = 64 << 10;
/// Minimum bytes of the window, for slow lines.
const MIN_WINDOW: u64 = 24 << 10;

/// Maximum number of pings in a window. There must be few, because the server limits how many messages it reads, and pongs count too.
const PINGS_PER_WINDOW: u64 = 8;
/// Minimum bytes between two pings, so that a small window has fewer of them.
const MIN_BYTES_PER_PING: u64 = 8 << 10;

/// Number of latest rates that are kept. The highest one is used, because a pause of the sender or the network makes some of them too low.
const RATES: usize = 10;

/// Time without a pong after which the window is ignored: the client may be behind a proxy that answers no pings. A client that does not
/// read is closed by the writer's deadline.
const MAX_PONG_WAIT: Duration = Duration::from_secs(2);

/// Bit that is set in the numbers of this module's pings, but not in those of [`super::pace`].
const MARK: u32 = 1 << 31;

/// A ping whose pong is awaited.
struct Ping {
    number: u32,
    /// Bytes of the connection that were sent before the ping.
    sent: u64,
    /// Bytes that had been confirmed when the ping was sent.
    confirmed: u64,
    /// The line's `progress` when the ping was sent.
    since: Instant,
    /// The line's `confirmed_sent_at` when the ping was sent.
    first_sent_at: Instant,
    sent_at: Instant,
    /// Whether the line had capacity when the ping was sent. If so, the sender rather than the line may have limited the measured rate.
    had_capacity: bool,
}

/// Bytes in flight and measured rates of one connection.
pub(super) struct Line {
    sent: u64,
    confirmed: u64,
    /// Pings whose pongs are awaited, the oldest first.
    pings: VecDeque<Ping>,
    /// Number of the last ping, without [`MARK`].
    last_number: u32,
    /// The latest rates in bytes a second, the newest last.
    rates: VecDeque<f64>,
    round_trip: Option<Duration>,
    /// When bytes were last confirmed, or when sending began again with nothing in flight.
    progress: Instant,
    /// When the last confirmed bytes were sent, or when sending began again with nothing in flight.
    confirmed_sent_at: Instant,
}

impl Line {
    pub(super) fn new() -> Self {
        Self {
            sent: 0,
            confirmed: 0,
            pings: VecDeque::new(),
            last_number: 0,
            rates: VecDeque::with_capacity(RATES),
            round_trip: None,
            progress: Instant::now(),
            confirmed_sent_at: Instant::now(),
        }
    }

    /// Whether this module, and not [`super::pace`], has sent the ping of this number.
    pub(super) fn is_own(number: u32) -> bool {
        number & MARK != 0
    }

    /// Returns the highest of the latest rates, in bytes a second; 0 while none is known.
    fn highest_rate(&self) -> f64 {
        self.rates.iter().copied().fold(0.0, f64::max)
    }

    /// Returns the maximum bytes in flight.
    fn window(&self) -> u64 {
        let highest = self.highest_rate();
        match self.round_trip {
            Some(round_trip) if highest > 0.0 => {
                ((highest * (round_trip + QUEUE).as_secs_f64()) as u64).max(MIN_WINDOW)
            }
            _ => FIRST_WINDOW,
        }
    }

    /// Returns the time that the line needs for `bytes`; zero while its rate is not known.
    pub(super) fn time_of(&self, bytes: u64) -> Duration {
        let highest = self.highest_rate();
        if highest > 0.0 {
            Duration::from_secs_f64(bytes as f64 / highest)
        } else {
            Duration::ZERO
        }
    }

    /// Returns the bytes that the line takes in this time; `u64::MAX` while its rate is not known.
    pub(super) fn bytes_within(&self, time: Duration) -> u64 {
        match self.highest_rate() {
            rate if rate > 0.0 => (rate * time.as_secs_f64()) as u64,
            _ => u64::MAX,
        }
    }

    /// Whether a further frame may be handed to the writer.
    pub(super) fn has_capacity(&self) -> bool {
        self.sent - self.confirmed < self.window() || self.progress.elapsed() >= MAX_PONG_WAIT
    }

    /// Returns when a full line counts as having capacity although no pong has come; `None` if it is not full.
    pub(super) fn capacity_at(&self) -> Option<Instant> {
        (!self.has_capacity()).then(|| self.progress + MAX_PONG_WAIT)
    }

    /// Records that the writer takes a frame of this many bytes. Returns the number of the ping to send behind it, if one is due.
    pub(super) fn record_frame(&mut self, bytes: usize) -> Option<u32> {
        let now = Instant::now();
        if self.sent == self.confirmed {
            self.progress = now;
            self.confirmed_sent_at = now;
        }
        self.sent += bytes as u64;
        let bytes_since_ping = self.sent - self.pings.back().map_or(self.confirmed, |ping| ping.sent);
        if bytes_since_ping < (self.window() / PINGS_PER_WINDOW).max(MIN_BYTES_PER_PING) {
            return None;
        }
        self.last_number = self.last_number.wrapping_add(1);
        let number = self.last_number | MARK;
        self.pings.push_back(Ping {
            number,
            sent: self.sent,
            confirmed: self.confirmed,
            since: self.progress,
            first_sent_at: self.confirmed_sent_at,
            sent_at: now,
            had_capacity: self.sent - self.confirmed < self.window(),
        });
        Some(number)
    }

    /// Handles a pong. Ignores one that belongs to no ping.
    pub(super) fn on_pong(&mut self, number: u32) {
        let Some(index) = self.pings.iter().position(|ping| ping.number == number) else {
            return;
        };
        let Some(ping) = self.pings.drain(..=index).next_back() else {
            return;
        };
        let now = Instant::now();
        let elapsed = |since: Instant| (now - since).max(Duration::from_micros(100));
        let round_trip = elapsed(ping.sent_at);
        self.round_trip = Some(self.round_trip.map_or(round_trip, |minimum| minimum.min(round_trip)));
        // A busy client answers several pings at once, so bytes had arrived before `since`. They were not sent faster than they arrived.
        let time = elapsed(ping.since).max(ping.sent_at - ping.first_sent_at);
        let rate = (ping.sent - ping.confirmed) as f64 / time.as_secs_f64();
        if !ping.had_capacity || rate > self.highest_rate() {
            self.rates.push_back(rate);
        }
        if self.rates.len() > RATES {
            self.rates.pop_front();
        }
        self.confirmed = ping.sent;
        self.confirmed_sent_at = ping.sent_at;
        self.progress = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends as much as there is capacity for over a line of a rate and a round trip, in frames of 4 KiB. Returns the longest time that the
    /// line needs for what is on it, after a second, and the bytes that arrived in all.
    async fn send_over(bytes_per_second: f64, round_trip: Duration, seconds: u64) -> (Duration, u64) {
        let (mut line, began) = (Line::new(), Instant::now());
        let mut free = began;
        let mut pongs: VecDeque<(Instant, Option<u32>)> = VecDeque::new();
        let (mut longest, mut arrived) = (Duration::ZERO, 0);
        while began.elapsed() < Duration::from_secs(seconds) {
            while line.has_capacity() {
                free = free.max(Instant::now()) + Duration::from_secs_f64(4096.0 / bytes_per_second);
                pongs.push_back((free + round_trip, line.record_frame(4096)));
            }
            if began.elapsed() > Duration::from_secs(1) {
                longest = longest.max(free.saturating_duration_since(Instant::now()));
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
            while let Some((_, number)) = pongs.pop_front_if(|(at, _)| *at <= Instant::now()) {
                arrived += 4096;
                number.into_iter().for_each(|number| line.on_pong(number));
            }
        }
        (longest, arrived)
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_line_is_kept_busy_and_short() {
        for (mbit, round_trip) in [(5.0, 80), (20.0, 40), (1.0, 200), (1000.0, 2)] {
            let rate = mbit * 125_000.0;
            let (longest, arrived) = send_over(rate, Duration::from_millis(round_trip), 6).await;
            assert!(
                longest <= Duration::from_millis(250),
                "{mbit} Mbit/s: {longest:?} of it"
            );
            assert!(
                arrived as f64 > 0.8 * 6.0 * rate,
                "{mbit} Mbit/s: {arrived} bytes arrived"
            );
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_sender_makes_no_line_fast_or_slow() {
        let (rate, round_trip) = (625_000.0, Duration::from_millis(20));
        let frame_time = Duration::from_secs_f64(3072.0 / rate);
        let mut line = Line::new();
        // Frames that come one by one, then as many as the line takes, then one by one again.
        for pause in [Duration::from_millis(20), Duration::ZERO, Duration::from_millis(20)] {
            for _ in 0..200 {
                let number = line.record_frame(3072);
                tokio::time::sleep(frame_time.max(pause)).await;
                if let Some(number) = number {
                    tokio::time::sleep(round_trip).await;
                    line.on_pong(number);
                }
            }
            let found = line.highest_rate();
            assert!(found <= 1.05 * rate, "{found} bytes a second");
            assert!(pause > Duration::ZERO || found > 0.2 * rate, "{found} bytes a second");
        }
        let found = line.highest_rate();
        assert!(found > 0.2 * rate, "{found} bytes a second after a pause of the sender");
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_answers_several_pings_at_once_makes_no_line_fast() {
        let (rate, round_trip) = (2_500_000.0, Duration::from_millis(40));
        let (mut line, began) = (Line::new(), Instant::now());
        let (mut free, mut last_answer) = (began, began);
        let mut pongs: VecDeque<(Instant, u32)> = VecDeque::new();
        while began.elapsed() < Duration::from_secs(6) {
            while line.has_capacity() {
                free = free.max(Instant::now()) + Duration::from_secs_f64(4096.0 / rate);
                pongs.extend(line.record_frame(4096).map(|number| (free + round_trip, number)));
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
            // Drawing keeps the client busy for a while, now and then.
            let pause = Duration::from_millis(if began.elapsed().as_secs() % 2 == 0 { 1 } else { 90 });
            if last_answer.elapsed() >= pause {
                last_answer = Instant::now();
                while let Some((_, number)) = pongs.pop_front_if(|(at, _)| *at <= Instant::now()) {
                    line.on_pong(number);
                    // What the window allows is sent between two pongs.
                    while line.has_capacity() {
                        free = free.max(Instant::now()) + Duration::from_secs_f64(4096.0 / rate);
                        pongs.extend(line.record_frame(4096).map(|number| (free + round_trip, number)));
                    }
                }
            }
            let found = line.highest_rate();
            assert!(
                found <= 1.25 * rate,
                "{found} bytes a second after {:?}",
                began.elapsed()
            );
        }
    }

    #[tokio::test(start_paused = true)]
    async fn without_pongs_the_window_does_not_count_after_a_while() {
        let mut line = Line::new();
        while line.has_capacity() {
            line.record_frame(1 << 10);
        }
        assert_eq!(line.sent, FIRST_WINDOW);
        assert_eq!(line.bytes_within(QUEUE), u64::MAX, "not known yet");
        let capacity_at = line.capacity_at().expect("a full line");
        tokio::time::sleep_until(capacity_at).await;
        assert!(line.has_capacity());
        line.on_pong(7);
        line.on_pong(MARK | 1 << 20);
        assert_eq!(line.confirmed, 0, "pongs of no ping");
    }
}
