//! How surfaces share the connection's budget: in proportion to the triangles of their full surfaces, as far as a budget is in force for
//! them. So a surface's part depends on isovalues alone, and an edit of anything else changes no other surface.

use super::generation::Making;
use super::open_volume::OpenVolume;
use super::surface::SurfaceSession;
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

/// What each surface gets of the budget.
pub(super) type Allotments = [Option<Budget>; MAX_SURFACES as usize];

impl SurfaceSession {
    /// Whether it has a part of the budget: not where β or an error decides alone, nor where nothing was ever made.
    fn shares(&self) -> bool {
        self.view.budget.is_some() && (self.is_busy() || self.full.is_some())
    }

    /// Whether its full surface is that of its generation, and known.
    fn is_counted(&self) -> bool {
        match self.generation() {
            Some(generation) => self.full_of(&generation.view).is_some(),
            None => self.full.is_some(),
        }
    }

    pub(super) fn full_triangles(&self) -> u64 {
        self.full.as_ref().map_or(0, |(_, triangles)| *triangles)
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
        is_known.then(|| {
            sharing()
                .map(|(_, surface)| surface.full_triangles())
                .fold(0, u64::saturating_add)
        })
    }

    /// What each surface gets; `None` while not all that share are counted.
    pub(super) fn allotments(&self) -> Option<Allotments> {
        let all = self.shared_triangles();
        if self.is_budget_shared() && all.is_none() {
            return None;
        }
        let mut allotments = Allotments::default();
        for (number, surface) in self.surfaces().filter(|(_, surface)| surface.shares()) {
            let part = |budget: Budget| all.map_or(budget, |all| budget.part(surface.full_triangles(), all));
            allotments[usize::from(number)] = surface.view.budget.map(part);
        }
        Some(allotments)
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
