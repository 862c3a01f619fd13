//! Cache of cuts, by their ids: of those of cubes the cuts themselves, of those of vertex trees what tells in which regions another cut
//! differs.

use std::sync::Arc;

use isopeel_kernels::{Cut, TreeRegions};

use super::CutId;
use super::residency::Lru;

/// Number of most recently used cuts that stay even above the budget: the cut that a client shows, its target, and the cut of the next
/// step. With these three, even the surface of a large volume can change region by region.
const MIN_CUTS: usize = 3;

/// Host memory for the regions of cuts of vertex trees: 24 to 32 bytes a region, so that some 50 clients can show different surfaces of 20,000
/// regions.
const TREE_REGION_BYTES: u64 = 32 << 20;

/// Cuts that clients show, and the cuts that their surfaces are refined to.
pub(crate) struct Cuts {
    by_id: Lru<CutId, Arc<Cut>>,
    trees: Lru<CutId, Arc<TreeRegions>>,
}

impl Cuts {
    /// Creates a cache of at most `budget` bytes on the device, in which the latest [`MIN_CUTS`] always stay. If the cut of a client was evicted, the
    /// client's next surface is made in full.
    pub(crate) fn new(budget: u64) -> Self {
        Self {
            by_id: Lru::new(budget).keeping(MIN_CUTS),
            trees: Lru::new(TREE_REGION_BYTES),
        }
    }

    /// Returns the bytes of all cuts on the device.
    pub(crate) fn cost(&self) -> u64 {
        self.by_id.cost()
    }

    pub(crate) fn clear(&mut self) {
        self.by_id.retain(|_| false);
    }

    pub(crate) fn get(&mut self, id: CutId) -> Option<Arc<Cut>> {
        self.by_id.get(&id).cloned()
    }

    /// Caches a cut under a new id.
    pub(crate) fn insert(&mut self, cut: Arc<Cut>) -> CutId {
        let id = CutId::next();
        self.by_id.insert(id, cut.device_bytes(), cut);
        id
    }

    /// Returns the regions of a cut of a vertex tree.
    pub(crate) fn get_tree(&mut self, id: CutId) -> Option<Arc<TreeRegions>> {
        self.trees.get(&id).cloned()
    }

    /// Caches the regions of a cut of a vertex tree under a new id.
    pub(crate) fn insert_tree(&mut self, regions: TreeRegions) -> CutId {
        let id = CutId::next();
        self.trees.insert(id, regions.bytes(), Arc::new(regions));
        id
    }
}
