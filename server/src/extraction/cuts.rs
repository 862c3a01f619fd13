//! Cache of cuts, by their ids.

use std::rc::Rc;

use isopeel_kernels::Cut;

use super::CutId;
use super::residency::Lru;

/// Number of the latest cuts that are kept whatever their size, so that a large volume's surface changes region by region too: the one that
/// a client shows, its target, and that of the next step.
const MIN_CUTS: usize = 3;

/// Cuts that clients show or are on the way to.
pub(super) struct Cuts {
    kept: Lru<CutId, Rc<Cut>>,
}

impl Cuts {
    /// Keeps cuts of at most `budget` bytes in total, but always the latest [`MIN_CUTS`]. If a client's cut was evicted, its next surface
    /// is made in full.
    pub(super) fn new(budget: u64) -> Self {
        Self {
            kept: Lru::new(budget).keeping(MIN_CUTS),
        }
    }

    /// Bytes of all of them.
    pub(super) fn cost(&self) -> u64 {
        self.kept.cost()
    }

    pub(super) fn clear(&mut self) {
        self.kept.retain(|_| false);
    }

    pub(super) fn get(&mut self, id: CutId) -> Option<Rc<Cut>> {
        self.kept.get(&id).cloned()
    }

    pub(super) fn keep(&mut self, cut: Rc<Cut>) -> CutId {
        let id = CutId::next();
        self.kept.insert(id, cut.device_bytes(), cut);
        id
    }
}
