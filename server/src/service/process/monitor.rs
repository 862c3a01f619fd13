//! Kills a process that gives no sign of life, whose driver is stuck, or that takes too much memory. Tells it what other processes of the
//! server take.

use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_extraction::{WorkspaceMemory, counted_bytes, host_memory_limit, lock, private_bytes};
use tokio::sync::watch;

use super::child::{Child, Killed};
use super::link::Shared;

/// Interval of looks at the process.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// A look that comes later than this after the one before does not count: this process did not run either.
const LATE_LOOK: Duration = Duration::from_millis(300);

/// Maximum time without a sign of life. The process sends one five times a second.
const SILENCE_LIMIT: Duration = Duration::from_millis(1500);

/// Maximum time from the start of the process to its first sign of life: programs start slowly from a slow disk.
const START_LIMIT: Duration = Duration::from_secs(60);

/// Maximum time that one command takes on any device, apart from the samples that it reads.
const COMMAND_LIMIT: Duration = Duration::from_secs(2);

/// Minimum bytes of samples that a command processes in a second.
const COMMAND_BYTES_A_SECOND: u64 = 50_000_000;

/// Maximum time of a command while the driver may be compiling. Some compilers take minutes for a large kernel.
const COMPILE_LIMIT: Duration = Duration::from_secs(600);

/// As [`COMPILE_LIMIT`], in a process that has replaced another one: the driver has cached what was compiled for that one.
const LATER_COMPILE_LIMIT: Duration = Duration::from_secs(30);

/// Memory above the limit of the host, in percent of it, at which the process is killed. Work is refused before it takes that much, if it
/// is known before how much it takes.
const EXCESS_PERCENT: u64 = 10;

/// Looks at the process until the server ends.
pub(super) fn run(shared: &Shared, memory: &watch::Receiver<WorkspaceMemory>) {
    let mut watched: Option<(Arc<Child>, Watched)> = None;
    let mut compile_limit = COMPILE_LIMIT;
    while !shared.is_stopping() {
        std::thread::sleep(LOOK_INTERVAL);
        let Some(child) = lock(&shared.child).clone() else {
            if watched.take().is_some() {
                compile_limit = LATER_COMPILE_LIMIT;
            }
            continue;
        };
        let same = watched.take().filter(|(watched, _)| Arc::ptr_eq(watched, &child));
        let (child, mut signs) = same.unwrap_or_else(|| (child, Watched::default()));
        child.count_further_bytes(counted_bytes(child.id()));
        let (beats, beat) = child.beats();
        // A device that is being opened may take as long as a compiler.
        let limit = if beat.commands.is_none() {
            COMPILE_LIMIT
        } else if beat.may_compile {
            compile_limit
        } else {
            command_limit(memory.borrow().volumes)
        };
        let is_running = beat.commands.is_none() || lock(&shared.table).is_running();
        let silent_or_stuck = signs.look(Instant::now(), beats, beat.commands, is_running, limit);
        if let Some(why) = silent_or_stuck.or_else(|| takes_too_much(&child).then_some(Killed::Memory))
            && child.kill_for(why)
        {
            tracing::error!(?why, "the process of the device is killed");
        }
        watched = Some((child, signs));
    }
}

/// Returns the maximum time of one command if these bytes of samples are on the device.
fn command_limit(sample_bytes: u64) -> Duration {
    COMMAND_LIMIT + Duration::from_secs_f64(sample_bytes as f64 / COMMAND_BYTES_A_SECOND as f64)
}

fn takes_too_much(child: &Child) -> bool {
    host_memory_limit().is_some_and(|limit| private_bytes(child.id()) > limit / 100 * (100 + EXCESS_PERCENT))
}

/// What was seen of a process.
#[derive(Default)]
struct Watched {
    beats: u64,
    commands: Option<u64>,
    last_look: Option<Instant>,
    /// Time without a sign of life.
    silent: Duration,
    /// Time in which a job was running and no command was executed.
    stuck: Duration,
}

impl Watched {
    /// Looks at the numbers of signs of life and of executed commands; returns why the process must be killed, if it must.
    /// `command_limit`: maximum time of a command now.
    fn look(
        &mut self,
        now: Instant,
        beats: u64,
        commands: Option<u64>,
        is_running: bool,
        command_limit: Duration,
    ) -> Option<Killed> {
        let since_last = self.last_look.replace(now).map_or(Duration::ZERO, |last| now - last);
        if since_last > LATE_LOOK {
            return None;
        }
        let has_spoken = std::mem::replace(&mut self.beats, beats) != beats;
        let has_worked = std::mem::replace(&mut self.commands, commands) != commands;
        self.silent = if has_spoken {
            Duration::ZERO
        } else {
            self.silent + since_last
        };
        self.stuck = if has_worked || !is_running {
            Duration::ZERO
        } else {
            self.stuck + since_last
        };
        let silence_limit = if beats == 0 { START_LIMIT } else { SILENCE_LIMIT };
        if self.silent > silence_limit {
            Some(Killed::Silent)
        } else {
            (self.stuck > command_limit).then_some(Killed::Stuck)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks every 100 ms for so long; `signs` returns signs of life and commands at a time in milliseconds, and whether a job is running.
    fn watch(milliseconds: u64, signs: impl Fn(u64) -> (u64, u64, bool)) -> Option<(u64, Killed)> {
        let (start, mut watched) = (Instant::now(), Watched::default());
        (0..=milliseconds).step_by(100).find_map(|time| {
            let (beats, commands, is_running) = signs(time);
            let now = start + Duration::from_millis(time);
            let killed = watched.look(now, beats, Some(commands), is_running, command_limit(50_000_000));
            killed.map(|why| (time, why))
        })
    }

    #[test]
    fn a_process_that_speaks_and_works_lives() {
        assert_eq!(watch(60_000, |time| (1 + time / 200, 0, false)), None, "nothing to do");
        assert_eq!(
            watch(60_000, |time| (1 + time / 200, time / 2_500, true)),
            None,
            "slow commands"
        );
    }

    #[test]
    fn a_silent_process_is_killed_soon_and_one_that_starts_late() {
        assert_eq!(watch(60_000, |_| (1, 0, false)), Some((1_600, Killed::Silent)));
        assert_eq!(watch(90_000, |_| (0, 0, false)), Some((60_100, Killed::Silent)));
    }

    #[test]
    fn a_stuck_driver_has_two_seconds_and_one_for_each_50_mb() {
        assert_eq!(
            watch(60_000, |time| (1 + time / 200, 7, true)),
            Some((3_100, Killed::Stuck))
        );
    }

    #[test]
    fn time_in_which_the_server_did_not_run_does_not_count() {
        let (start, mut watched) = (Instant::now(), Watched::default());
        for minutes in 0..10 {
            let now = start + Duration::from_secs(60 * minutes);
            assert_eq!(watched.look(now, 1, Some(1), true, Duration::from_secs(2)), None);
        }
    }
}
