//! Divides the connection's budget between surfaces. Each surface with a budget gets a part in proportion to the triangles of its full
//! surface. So the parts depend only on the full surfaces, and an edit that changes no full surface affects no other surface's part.
//!
//! Failures do not change the parts either. A surface whose generation failed keeps its part, and is retried when the part changes. If
//! others share the budget and the client holds more of the failed surface than that part, the client's regions of the surface are removed.
//! A surface whose generation was cancelled stays as it was, and its size at the client is reserved.

use isopeel_codec::chunk::MAX_SURFACES;
use isopeel_view::quality::Budget;

use super::generation::Making;
use super::open_volume::OpenVolume;
use super::surface::SurfaceSession;

/// Decision about a step that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Send,
    /// Other surfaces are sent first.
    Wait,
    /// The surface's part has become smaller: drop this step and make another.
    GiveUp,
}

/// Returns the sum, saturated at [`u64::MAX`].
fn saturating_sum(numbers: impl Iterator<Item = u64>) -> u64 {
    numbers.fold(0, u64::saturating_add)
}

/// The part of the budget of each surface, by its number.
pub(super) type Allotments = [Option<Budget>; MAX_SURFACES as usize];

impl SurfaceSession {
    /// Whether the surface has a part of the budget. It has none if β or an error decides alone, or if it was cancelled.
    fn shares(&self) -> bool {
        self.view.budget.is_some() && (self.is_busy() || self.is_counted())
    }

    /// Whether the triangles of the full surface of the current view are known.
    fn is_counted(&self) -> bool {
        let key = match self.generation() {
            Some(generation) => Some(generation.key.surface()),
            None => self.key.as_ref().filter(|_| !self.edit_pending),
        };
        match (&self.full, key) {
            (Some((full, _)), Some(key)) => full.has_triangles_of(key),
            _ => false,
        }
    }

    pub(super) fn full_triangles(&self) -> u64 {
        self.full.as_ref().map_or(0, |(_, triangles)| *triangles)
    }

    /// Returns the surface's size at the client, in the budget's unit, if the surface has no part of the budget; otherwise 0. The other
    /// surfaces share the budget less this size.
    fn reserved(&self) -> u64 {
        if self.shares() { 0 } else { self.held_size() }
    }

    /// Whether the surface has failed, so that its regions are being removed from the client.
    fn is_leaving(&self) -> bool {
        self.generation().is_some_and(|generation| generation.failure.is_some())
    }

    /// Returns the size of the surface that the client holds, in the budget's unit.
    fn held_size(&self) -> u64 {
        match (self.view.budget, self.held_budget) {
            (Some(Budget::Triangles(_)), _) => self.held_triangles,
            (Some(Budget::Bytes(_)), Some(Budget::Bytes(bytes))) if !self.held.is_empty() => bytes,
            _ => 0,
        }
    }

    /// Whether the surface failed before its triangles were counted, and may be retried to get a part of the budget. If so, clears the
    /// permission to retry.
    fn take_retry_for_part(&mut self) -> bool {
        let is_uncounted = self.view.budget.is_some() && !self.is_busy() && !self.is_counted();
        let failed = self.failed.as_mut().filter(|_| is_uncounted);
        failed.is_some_and(|failed| std::mem::take(&mut failed.may_retry))
    }

    /// Whether the surface that the client holds exceeds its part of the budget.
    fn holds_more(&self) -> bool {
        let part = self.allotted.map(|part| part.as_number(self.full_triangles()));
        match part {
            Some(Budget::Triangles(part)) => self.held_size() > part.of(self.full_triangles()),
            Some(Budget::Bytes(part)) => self.held_size() > part,
            None => false,
        }
    }

    /// Whether the budget `one` allows more of this surface than `other`. False if one limits triangles and the other bytes.
    fn exceeds(&self, one: Option<Budget>, other: Option<Budget>) -> bool {
        let full = self.full_triangles();
        let as_number = |budget: Option<Budget>| match budget?.as_number(full) {
            Budget::Triangles(triangles) => Some((false, triangles.of(full))),
            Budget::Bytes(bytes) => Some((true, bytes)),
        };
        match (as_number(one), as_number(other)) {
            (Some((in_bytes, one)), Some((other_in_bytes, other))) => in_bytes == other_in_bytes && one > other,
            (one, None) => one.is_some(),
            (None, Some(_)) => false,
        }
    }

    /// Whether the client may get a smaller surface than the one that it holds or that is being made.
    fn shrinks(&self) -> bool {
        let made_with = self.generation().and_then(|generation| generation.view.budget);
        let gets_less = || self.exceeds(self.held_budget, self.allotted) || self.exceeds(made_with, self.allotted);
        self.is_leaving() || self.shares() && self.is_busy() && gets_less()
    }
}

impl OpenVolume {
    /// Whether two or more surfaces have a part of the budget, so that their triangles must be counted first.
    fn is_budget_shared(&self) -> bool {
        self.surfaces().filter(|(_, surface)| surface.shares()).count() > 1
    }

    /// Whether the triangles of a surface are to be counted before anything of its generation is made.
    pub(super) fn needs_count(&self, surface: &SurfaceSession) -> bool {
        self.is_budget_shared() && surface.shares() && !surface.is_counted()
    }

    /// Whether a surface has to wait until others are counted.
    pub(super) fn waits_for_counts(&self, surface: &SurfaceSession) -> bool {
        surface.shares() && self.allotments().is_none()
    }

    /// Returns the triangles of all surfaces that share the budget; `None` if fewer than two share it, or if not all are counted.
    pub(super) fn shared_triangles(&self) -> Option<u64> {
        let sharing = || self.surfaces().filter(|(_, surface)| surface.shares());
        let is_known = self.is_budget_shared() && sharing().all(|(_, surface)| surface.is_counted());
        is_known.then(|| saturating_sum(sharing().map(|(_, surface)| surface.full_triangles())))
    }

    /// Returns the size at the client of all surfaces without a part of the budget.
    fn reserved(&self) -> u64 {
        saturating_sum(self.surfaces().map(|(_, surface)| surface.reserved()))
    }

    /// Returns the part of each surface; `None` until all surfaces that share the budget are counted.
    pub(super) fn allotments(&self) -> Option<Allotments> {
        let shared_triangles = self.shared_triangles();
        if self.is_budget_shared() && shared_triangles.is_none() {
            return None;
        }
        let reserved = self.reserved();
        let mut allotments = Allotments::default();
        for (number, surface) in self.surfaces().filter(|(_, surface)| surface.shares()) {
            let part_of = |budget: Budget| {
                let available = budget.without(reserved);
                shared_triangles.map_or(available, |all| available.part(surface.full_triangles(), all))
            };
            allotments[usize::from(number)] = surface.view.budget.map(part_of);
        }
        Some(allotments)
    }

    /// Returns the failed surfaces that are retried although their parts are unchanged, because the client may no longer keep their
    /// regions or because the budget to suggest has changed.
    pub(super) fn failed_to_retry(&self) -> Vec<u8> {
        let shared_triangles = self.shared_triangles();
        let is_outdated = |number: u8, surface: &SurfaceSession| {
            let failed = surface.failed.filter(|_| surface.shares() && !surface.is_busy());
            failed.is_some_and(|failed| failed.shared_triangles != shared_triangles || !self.may_stay(number))
        };
        let outdated = self
            .surfaces()
            .filter(|&(number, surface)| is_outdated(number, surface));
        outdated.map(|(number, _)| number).collect()
    }

    /// Returns the budget of all surfaces together of which this surface's part is `part` triangles.
    pub(super) fn whole_of(&self, number: u8, part: u64) -> u64 {
        let whole = match (self.surface(number), self.shared_triangles()) {
            (Some(surface), Some(all)) => Budget::whole_of(part, surface.full_triangles(), all),
            _ => part,
        };
        whole.saturating_add(self.reserved())
    }

    /// Whether the client may keep the regions of a failed surface. It may not if they are of another time step, or exceed the surface's
    /// part of a budget that others share.
    pub(super) fn may_stay(&self, number: u8) -> bool {
        let held = self.surface(number).filter(|surface| !surface.held.is_empty());
        let exceeds_part =
            |surface: &SurfaceSession| self.is_budget_shared() && surface.shares() && surface.holds_more();
        held.is_none_or(|surface| !surface.holds_another_step && !exceeds_part(surface))
    }

    /// Allows failed surfaces to be retried. Called when something other than their views has changed.
    pub(super) fn offer_retries(&mut self) {
        let failed = self.surfaces_mut().filter_map(|(_, surface)| surface.failed.as_mut());
        failed.for_each(|failed| failed.may_retry = true);
    }

    /// Returns the surfaces that failed before they were counted, and are to be counted now because others share the budget.
    pub(super) fn uncounted_to_retry(&mut self) -> Vec<u8> {
        if !self.surfaces().any(|(_, surface)| surface.shares()) {
            return Vec::new();
        }
        let surfaces = self.surfaces_mut();
        surfaces
            .filter_map(|(number, surface)| surface.take_retry_for_part().then_some(number))
            .collect()
    }

    /// Decides whether a step that was made is sent. A final surface that takes more of the budget than the one before waits until the
    /// surfaces that take less are committed, so that all surfaces together never exceed the budget.
    pub(super) fn verdict(&self, number: u8) -> Verdict {
        let surface = self.surface(number);
        let Some((surface, generation)) = surface.and_then(|surface| Some((surface, surface.generation()?))) else {
            return Verdict::Send;
        };
        let is_final = matches!(&generation.making, Making::Made(offered) if offered.step.refinement.is_final);
        let made_with = generation.view.budget;
        let is_superseded = is_final && surface.shares() && surface.edit_pending;
        // Other surfaces may have got this surface's former part meanwhile, so the step is dropped. If there is only one surface, the step
        // is sent, so that the viewer sees changes while they reduce the budget by dragging.
        if is_superseded && self.surfaces().count() > 1 && surface.exceeds(made_with, surface.allotted) {
            return Verdict::GiveUp;
        }
        let grows = is_final && surface.shares() && surface.exceeds(made_with, surface.held_budget);
        let others_shrink = || {
            self.surfaces()
                .any(|(other, surface)| other != number && surface.shrinks())
        };
        if !grows || !others_shrink() {
            return Verdict::Send;
        }
        // A surface that has to shrink itself drops its step instead of waiting: two surfaces that waited for each other would deadlock.
        match surface.exceeds(made_with, surface.allotted) {
            true => Verdict::GiveUp,
            false => Verdict::Wait,
        }
    }
}
