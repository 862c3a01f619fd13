//! How surfaces share the connection's budget: in proportion to the triangles of their full surfaces, as far as a budget is in force for
//! them. So a surface's part depends on what decides full surfaces alone, and an edit of anything else changes no other surface.
//!
//! A surface whose generation failed or was cancelled stays as it was. It has no part then, but what the client holds of it is reserved: the
//! others share what is left. It is tried again when an edit, a removed surface or another time step gives it another part.

use super::generation::Making;
use super::open_volume::OpenVolume;
use super::surface::{Failed, SurfaceSession};
use crate::view::quality::Budget;
use crate::wire::chunk::MAX_SURFACES;

/// What becomes of a step that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Send,
    /// Other surfaces are sent first.
    Wait,
    /// Its part has become smaller: another one is made.
    GiveUp,
}

/// The sum, or the largest number where it is larger.
fn total(numbers: impl Iterator<Item = u64>) -> u64 {
    numbers.fold(0, u64::saturating_add)
}

/// What each surface gets of the budget.
pub(super) type Allotments = [Option<Budget>; MAX_SURFACES as usize];

impl SurfaceSession {
    /// Whether it has a part of the budget: not where β or an error decides alone, nor where it is not made as its view says.
    fn shares(&self) -> bool {
        self.view.budget.is_some() && self.failed.is_none() && (self.is_busy() || self.is_counted())
    }

    /// Whether the triangles of the full surface of its view are known.
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

    /// What the client holds and others cannot have, as it has no part of the budget: in the budget's unit.
    fn reserved(&self) -> u64 {
        if self.shares() {
            return 0;
        }
        match (self.view.budget, self.kept) {
            (Some(Budget::Triangles(_)), _) => self.held_triangles,
            (Some(Budget::Bytes(_)), Some(Budget::Bytes(kept))) if !self.held.is_empty() => kept,
            _ => 0,
        }
    }

    /// The generation of its view has failed.
    pub(super) fn fail(&mut self) {
        self.failed = Some(Failed {
            budget: self.view.budget,
            part: self.allotted,
            may_retry: false,
        });
    }

    /// Something else has changed than its view. Whether it is to be tried again in any case: the budget is another one.
    fn offer_retry(&mut self) -> bool {
        let Some(failed) = &mut self.failed else { return false };
        failed.may_retry = true;
        failed.budget != self.view.budget
    }

    /// Whether a budget of this surface allows more than another one. Triangles and bytes are not compared.
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

    /// Whether the client may get a smaller surface than it has, or is about to get.
    fn shrinks(&self) -> bool {
        let made_with = self.generation().and_then(|generation| generation.view.budget);
        self.shares()
            && self.is_busy()
            && (self.exceeds(self.kept, self.allotted) || self.exceeds(made_with, self.allotted))
    }
}

impl OpenVolume {
    /// Whether two surfaces or more have a part of the budget, so that their triangles must be known first.
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

    /// The triangles of all surfaces that share the budget; `None` where there is only one, or not all are counted.
    pub(super) fn shared_triangles(&self) -> Option<u64> {
        let sharing = || self.surfaces().filter(|(_, surface)| surface.shares());
        let is_known = self.is_budget_shared() && sharing().all(|(_, surface)| surface.is_counted());
        is_known.then(|| total(sharing().map(|(_, surface)| surface.full_triangles())))
    }

    /// What surfaces hold that have no part of the budget.
    pub(super) fn reserved(&self) -> u64 {
        total(self.surfaces().map(|(_, surface)| surface.reserved()))
    }

    /// What each surface gets; `None` while not all that share are counted.
    pub(super) fn allotments(&self) -> Option<Allotments> {
        let all = self.shared_triangles();
        if self.is_budget_shared() && all.is_none() {
            return None;
        }
        let reserved = self.reserved();
        let mut allotments = Allotments::default();
        for (number, surface) in self.surfaces().filter(|(_, surface)| surface.shares()) {
            let part = |budget: Budget| {
                let left = budget.without(reserved);
                all.map_or(left, |all| left.part(surface.full_triangles(), all))
            };
            allotments[usize::from(number)] = surface.view.budget.map(part);
        }
        Some(allotments)
    }

    /// Surfaces that failed and are to be tried again, after an edit, a step or the end of another surface. Those whose part has to be known
    /// first follow by [`OpenVolume::retried`].
    pub(super) fn offer_retries(&mut self) -> Vec<u8> {
        let surfaces = self.surfaces_mut();
        surfaces
            .filter_map(|(number, surface)| surface.offer_retry().then_some(number))
            .collect()
    }

    /// Failed surfaces that would get another part of the budget than they failed with, if all that failed were tried again.
    pub(super) fn retried(&mut self) -> Vec<u8> {
        // Until all are counted, nobody's part is known.
        if self
            .surfaces()
            .any(|(_, surface)| surface.shares() && !surface.is_counted())
        {
            return Vec::new();
        }
        let counted = |surface: &SurfaceSession| surface.view.budget.is_some() && surface.is_counted();
        let all = total(
            self.surfaces()
                .filter(|(_, s)| counted(s))
                .map(|(_, s)| s.full_triangles()),
        );
        let mut retried = Vec::new();
        for (number, surface) in self.surfaces_mut() {
            let (full, is_counted, budget) = (surface.full_triangles(), counted(surface), surface.view.budget);
            let Some(failed) = surface.failed.as_mut().filter(|failed| failed.may_retry) else {
                continue;
            };
            failed.may_retry = false;
            let number_of = |budget: Budget| budget.as_number(full);
            let part = budget.map(|budget| number_of(budget.part(full, all)));
            if is_counted && part != failed.part.map(number_of) {
                retried.push(number);
            }
        }
        retried
    }

    /// What becomes of a step that was made. A final surface that has more of the budget than the one before waits until those that get less
    /// are committed, so that all together are never above it.
    pub(super) fn verdict(&self, number: u8) -> Verdict {
        let surface = self.surface(number);
        let Some((surface, generation)) = surface.and_then(|surface| Some((surface, surface.generation()?))) else {
            return Verdict::Send;
        };
        let is_final = matches!(&generation.making, Making::Made(made) if made.step.made.is_final);
        let made_with = generation.view.budget;
        if is_final && surface.shares() && surface.edit_pending && surface.exceeds(made_with, surface.allotted) {
            // What others got meanwhile is not left for it.
            return Verdict::GiveUp;
        }
        let grows = is_final && surface.shares() && surface.exceeds(made_with, surface.kept);
        let others_shrink = || {
            self.surfaces()
                .any(|(other, surface)| other != number && surface.shrinks())
        };
        if !grows || !others_shrink() {
            return Verdict::Send;
        }
        // Two that wait for each other would wait forever.
        match surface.exceeds(made_with, surface.allotted) {
            true => Verdict::GiveUp,
            false => Verdict::Wait,
        }
    }
}
