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
const SILENCE_LIMIT: Duration = Duration::from_secs(1);

/// Maximum time from the start of the process to its first sign of life: programs start slowly from a slow disk.
const START_LIMIT: Duration = Duration::from_secs(60);

/// Maximum time that one command takes on any device, apart from the samples that it reads.
const COMMAND_LIMIT: Duration = Duration::from_secs(1);

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
        let look = Look {
            now: Instant::now(),
            beats,
            commands: beat.commands,
            is_running: beat.commands.is_none() || lock(&shared.table).is_running(),
            processor_time: processor_time(child.id()),
            command_limit: limit,
        };
        let silent_or_stuck = signs.look(&look, || runnable_threads(child.id()));
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

/// Returns the time for which processors have run a process, in all of its threads; 0 if the system does not say.
fn processor_time(process: u32) -> Duration {
    let (mut clock, mut time) = (0, libc::timespec { tv_sec: 0, tv_nsec: 0 });
    // SAFETY: both calls write to variables of this function.
    let failed = unsafe {
        libc::clock_getcpuclockid(process as libc::pid_t, &mut clock) != 0 || libc::clock_gettime(clock, &mut time) != 0
    };
    if failed {
        return Duration::ZERO;
    }
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Returns the number of threads of a process that run or wait for a processor; 0 if the system does not say.
fn runnable_threads(process: u32) -> usize {
    let threads = std::fs::read_dir(format!("/proc/{process}/task"));
    let states = threads.into_iter().flatten().flatten().filter_map(|thread| {
        let text = std::fs::read_to_string(thread.path().join("stat")).ok()?;
        // The name before the state may have any character.
        text.rsplit_once(") ")?.1.chars().next()
    });
    states.filter(|&state| state == 'R').count()
}

/// What a look at a process finds.
struct Look {
    now: Instant,
    /// Number of signs of life.
    beats: u64,
    /// Number of executed commands; `None` while the device is not open.
    commands: Option<u64>,
    /// Whether a job is running.
    is_running: bool,
    /// As [`processor_time`].
    processor_time: Duration,
    /// Maximum time of a command now.
    command_limit: Duration,
}

/// What was seen of a process.
#[derive(Default)]
struct Watched {
    beats: u64,
    commands: Option<u64>,
    processor_time: Duration,
    last_look: Option<Instant>,
    /// Time without a sign of life.
    silent: Duration,
    /// Time in which a job was running and no command was executed.
    stuck: Duration,
}

impl Watched {
    /// Returns why the process must be killed, if it must. Time in which a thread waited for a processor does not count, because others may
    /// use the processors, or a control group may limit them.
    fn look(&mut self, look: &Look, runnable_threads: impl FnOnce() -> usize) -> Option<Killed> {
        let since_last = self
            .last_look
            .replace(look.now)
            .map_or(Duration::ZERO, |last| look.now - last);
        let ran = look
            .processor_time
            .saturating_sub(std::mem::replace(&mut self.processor_time, look.processor_time));
        let has_spoken = std::mem::replace(&mut self.beats, look.beats) != look.beats;
        let has_worked = std::mem::replace(&mut self.commands, look.commands) != look.commands || !look.is_running;
        let counted = match has_spoken && has_worked || since_last > LATE_LOOK {
            true => Duration::ZERO,
            false => available_time(since_last, ran, runnable_threads()),
        };
        self.silent = if has_spoken {
            Duration::ZERO
        } else {
            self.silent + counted
        };
        self.stuck = if has_worked {
            Duration::ZERO
        } else {
            self.stuck + counted
        };
        let silence_limit = if look.beats == 0 { START_LIMIT } else { SILENCE_LIMIT };
        if self.silent > silence_limit {
            Some(Killed::Silent)
        } else {
            (self.stuck > look.command_limit).then_some(Killed::Stuck)
        }
    }
}

/// Returns the time that a process had since the last look: all of it if no thread wants to run, else what each of these threads ran.
fn available_time(since_last: Duration, ran: Duration, runnable_threads: usize) -> Duration {
    match u32::try_from(runnable_threads) {
        Ok(threads @ 1..) => since_last.min(ran / threads),
        _ => since_last,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks every 100 ms for so long; `signs` returns signs of life and commands at a time in milliseconds, and whether a job is running.
    fn watch(milliseconds: u64, signs: impl Fn(u64) -> (u64, u64, bool)) -> Option<(u64, Killed)> {
        watch_threads(milliseconds, 0, 0, signs)
    }

    /// As [`watch`]. `threads`: number of threads that want to run; `percent`: processor time of all of them, in percent of the time.
    fn watch_threads(
        milliseconds: u64,
        threads: usize,
        percent: u64,
        signs: impl Fn(u64) -> (u64, u64, bool),
    ) -> Option<(u64, Killed)> {
        let (start, mut watched) = (Instant::now(), Watched::default());
        (0..=milliseconds).step_by(100).find_map(|time| {
            let (beats, commands, is_running) = signs(time);
            let look = Look {
                now: start + Duration::from_millis(time),
                beats,
                commands: Some(commands),
                is_running,
                processor_time: Duration::from_micros(time * percent * 10),
                command_limit: command_limit(50_000_000),
            };
            watched.look(&look, || threads).map(|why| (time, why))
        })
    }

    #[test]
    fn a_process_that_speaks_and_works_lives() {
        assert_eq!(watch(60_000, |time| (1 + time / 200, 0, false)), None, "nothing to do");
        assert_eq!(
            watch(60_000, |time| (1 + time / 200, time / 1_500, true)),
            None,
            "slow commands"
        );
    }

    #[test]
    fn a_silent_process_is_killed_soon_and_one_that_starts_late() {
        assert_eq!(watch(60_000, |_| (1, 0, false)), Some((1_100, Killed::Silent)));
        assert_eq!(watch(90_000, |_| (0, 0, false)), Some((60_100, Killed::Silent)));
    }

    #[test]
    fn a_stuck_driver_has_one_second_and_one_more_for_each_50_mb() {
        assert_eq!(
            watch(60_000, |time| (1 + time / 200, 7, true)),
            Some((2_100, Killed::Stuck))
        );
    }

    #[test]
    fn time_in_which_the_process_waits_for_a_processor_does_not_count() {
        let stuck = |time| (1 + time / 200, 7, true);
        assert_eq!(
            watch_threads(60_000, 2, 200, stuck),
            Some((2_100, Killed::Stuck)),
            "both run"
        );
        assert_eq!(
            watch_threads(60_000, 2, 50, stuck),
            Some((8_100, Killed::Stuck)),
            "a quarter of the time"
        );
        assert_eq!(watch_threads(60_000, 1, 0, |_| (1, 7, true)), None, "never");
    }

    #[test]
    fn time_in_which_the_server_did_not_run_does_not_count() {
        let (start, mut watched) = (Instant::now(), Watched::default());
        for minutes in 0..10 {
            let look = Look {
                now: start + Duration::from_secs(60 * minutes),
                beats: 1,
                commands: Some(1),
                is_running: true,
                processor_time: Duration::ZERO,
                command_limit: Duration::from_secs(2),
            };
            assert_eq!(watched.look(&look, || 0), None);
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_system_says_how_long_a_process_ran_and_how_many_threads_want_to() {
        let begun = Instant::now();
        let before = processor_time(std::process::id());
        while processor_time(std::process::id()) < before + Duration::from_millis(20) {
            assert!(begun.elapsed() < Duration::from_secs(60));
            assert!(runnable_threads(std::process::id()) >= 1, "this one");
        }
        assert_eq!(runnable_threads(u32::MAX), 0);
    }
}
