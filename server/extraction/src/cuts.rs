//! Cache of cuts, by their ids.

use std::sync::Arc;

use isopeel_kernels::Cut;

use super::CutId;
use super::residency::Lru;

/// Number of most recently used cuts that are kept even above the budget: the cut that a client shows, its target, and the cut of the next
/// step. With these three, the surface of a large volume can change region by region too.
const MIN_CUTS: usize = 3;

/// Cuts that clients show, and the cuts that their surfaces are refined to.
pub(crate) struct Cuts {
    kept: Lru<CutId, Arc<Cut>>,
}

impl Cuts {
    /// Keeps cuts of at most `budget` bytes in total, but always the latest [`MIN_CUTS`]. If a client's cut was evicted, its next surface
    /// is made in full.
    pub(crate) fn new(budget: u64) -> Self {
        Self {
            kept: Lru::new(budget).keeping(MIN_CUTS),
        }
    }

    /// Returns the device bytes of all cuts.
    pub(crate) fn cost(&self) -> u64 {
        self.kept.cost()
    }

    pub(crate) fn clear(&mut self) {
        self.kept.retain(|_| false);
    }

    pub(crate) fn get(&mut self, id: CutId) -> Option<Arc<Cut>> {
        self.kept.get(&id).cloned()
    }

    pub(crate) fn keep(&mut self, cut: Arc<Cut>) -> CutId {
        let id = CutId::next();
        self.kept.insert(id, cut.device_bytes(), cut);
        id
    }
}
