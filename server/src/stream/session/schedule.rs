//! The scheduler of a session's surfaces: one job at a time is on the device, and one step at a time is sent.

use std::cmp::Reverse;

use tokio::time::Instant;

use super::generation::{Generation, Making, Sending};
use super::open_volume::OpenVolume;
use super::pace::Pace;
use super::rest::RestWork;
use super::sharing::Verdict;

/// Maximum number of other surfaces' jobs that a surface waits for, whatever their ranks.
const MAX_WAIT: u64 = 4;

/// The next job of a surface, in the order of their ranks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum NextJob {
    /// Count the full surface: surfaces share a budget in proportion to the counts.
    Count,
    /// The first step of a generation. It comes before further steps of any surface.
    First,
    /// A further step.
    Further,
    /// Work at rest: the viewer does not wait for it.
    Rest(RestWork),
}

impl OpenVolume {
    /// Returns the next job and its surface. `jobs`: number of jobs that the connection has had.
    pub(super) fn next_job(&self, jobs: u64, pace: &Pace) -> Option<(u8, NextJob)> {
        let last_edited = self.surfaces().max_by_key(|(_, surface)| surface.last_edit)?.0;
        let steps: Vec<_> = self
            .surfaces()
            .filter_map(|(number, surface)| {
                let generation = surface.generation()?;
                Some((
                    number,
                    self.next_job_of(number, generation, pace)?,
                    generation.waiting_since_job,
                ))
            })
            .collect();
        let starving = steps
            .iter()
            .filter(|(.., since)| jobs.saturating_sub(*since) >= MAX_WAIT);
        let next = starving.min_by_key(|(.., since)| *since).or_else(|| {
            steps
                .iter()
                .min_by_key(|(number, job, since)| (*job, *number != last_edited, *since))
        });
        match next {
            Some((number, job, _)) => Some((*number, *job)),
            None => self.next_rest(),
        }
    }

    /// Returns the next job of a generation; `None` if it has to wait.
    fn next_job_of(&self, number: u8, generation: &Generation, pace: &Pace) -> Option<NextJob> {
        let is_ready = matches!(generation.making, Making::Waiting) && generation.failure.is_none();
        if !is_ready || self.encodes_first_step() {
            return None;
        }
        let surface = self.surface(number)?;
        if generation.steps_made == 0 {
            return match self.needs_count(surface) {
                true => Some(NextJob::Count),
                false => (!self.waits_for_counts(surface)).then_some(NextJob::First),
            };
        }
        // The size of a further step depends on the speed of the line, which is known after the pong of the first step.
        let is_measuring_line = !pace.is_line_known() && (self.sending().is_some() || pace.is_line_full());
        let is_waiting = is_measuring_line || generation.is_overtaken || self.draw_pause_until().is_some();
        (!is_waiting).then_some(NextJob::Further)
    }

    /// Whether the first step of a generation is being encoded on processors that the device uses too. Meanwhile no other job starts,
    /// because it would take processors from the pool.
    fn encodes_first_step(&self) -> bool {
        let is_encoding = |generation: &Generation| {
            !generation.has_committed && matches!(generation.sending, Sending::Comparing(_) | Sending::Encoding { .. })
        };
        self.shares_processors
            && self
                .surfaces()
                .any(|(_, surface)| surface.generation().is_some_and(is_encoding))
    }

    /// When the first draw pause ends at the latest; `None` if no generation pauses.
    pub(super) fn draw_pause_until(&self) -> Option<Instant> {
        let pauses = self
            .surfaces()
            .filter_map(|(_, surface)| surface.generation()?.draw_pause.until());
        pauses.min()
    }

    /// Returns work at rest that is due, if no other work is pending.
    fn next_rest(&self) -> Option<(u8, NextJob)> {
        let due = self.rests().filter(|(_, due, _)| *due <= Instant::now());
        let next = due.min_by_key(|(number, _, work)| {
            (
                *work,
                Reverse(self.surface(*number).map_or(0, |surface| surface.last_edit)),
            )
        });
        next.map(|(number, _, work)| (number, NextJob::Rest(work)))
    }

    /// When the next work at rest is due; `None` if there is none.
    pub(super) fn rest_due(&self) -> Option<Instant> {
        let rests = self.rests().map(|(_, due, _)| due);
        rests.chain(self.description_due()).min()
    }

    /// Returns each surface whose work at rest is not queued yet, with the due time and the work. Empty while other work is pending.
    fn rests(&self) -> impl Iterator<Item = (u8, Instant, RestWork)> {
        let is_busy = self.is_awaited();
        self.surfaces().filter_map(move |(number, surface)| {
            let (due, work) = surface.rest()?.due()?;
            (!is_busy).then_some((number, due, work))
        })
    }

    /// Returns the surface whose finished step is sent or given up next, with the verdict. Among the surfaces whose verdict is not
    /// [`Verdict::Wait`], the surface whose generation has waited longest is next.
    pub(super) fn next_made_step(&self) -> Option<(u8, Verdict)> {
        let candidates = self.surfaces().filter_map(|(number, surface)| {
            let generation = surface.generation()?;
            let verdict = self.verdict(number);
            let is_next = matches!(generation.making, Making::Made(_)) && verdict != Verdict::Wait;
            is_next.then_some((generation.waiting_since_job, number, verdict))
        });
        candidates
            .min_by_key(|(since, ..)| *since)
            .map(|(_, number, verdict)| (number, verdict))
    }
}
