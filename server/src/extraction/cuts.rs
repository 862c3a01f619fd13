//! Cuts that are kept, by their ids.

use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};

use isopeel_kernels::Cut;

use super::CutId;
use super::residency::Lru;

/// Cuts that stay whatever they take, so that a large volume's surface changes region by region too: the one that a client shows, the one
/// that it is on the way to, and that of the next step.
const MIN_CUTS: usize = 3;

/// The last id of a cut. Ids are unique in the process: sessions name cuts of a device that was lost after another one has taken its place.
static LAST_ID: AtomicU64 = AtomicU64::new(0);

/// Cuts that clients show or are on the way to.
pub(super) struct Cuts {
    kept: Lru<CutId, Rc<Cut>>,
}

impl Cuts {
    /// Keeps cuts of at most `budget` bytes, and the latest ones anyway: where one was let go, a client's next surface is made as a whole.
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

    /// An id that no other cut has.
    pub(super) fn new_id() -> CutId {
        CutId::new(LAST_ID.fetch_add(1, Ordering::Relaxed) + 1)
    }

    pub(super) fn keep(&mut self, cut: Rc<Cut>) -> CutId {
        let id = Self::new_id();
        self.kept.insert(id, cut.device_bytes(), cut);
        id
    }
}

#[cfg(test)]
mod tests {
    use super::Cuts;

    #[test]
    fn no_two_cuts_of_a_process_have_one_id() {
        let ids = [Cuts::new_id(), Cuts::new_id(), Cuts::new_id()];
        assert!(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], "{ids:?}");
    }
}
