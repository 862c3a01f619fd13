//! Makes space for allocations on the host if the device is this machine's processors. All data that can be loaded or computed again is
//! evicted before an allocation is refused.

use isopeel_kernels::{DeviceKind, lock};

use super::WorkError;
use super::host_memory::{HostMemory, trim_heaps};
use super::workspace::Workspace;

/// Maximum bytes that fields leave free for the next surfaces, within the limit of the caches of surfaces.
const SURFACE_RESERVE_BYTES: u64 = 128 << 20;

/// The bytes to leave free beyond those that are needed, and a function that evicts a number of bytes, or as many as it can.
type Eviction = (u64, fn(&mut Workspace, u64));

impl Workspace {
    /// Makes sure that this machine has memory for `needed_bytes`. Until it has, evicts in this order: freed buffers, computed fields,
    /// other fields, and caches of earlier edits. Fields are evicted until they leave some memory for the next surfaces too, so that edits
    /// need not wait for an eviction.
    ///
    /// # Errors
    /// As [`HostMemory::admit`]. In that case the memory in use is pinned by running jobs, or is not part of a cache.
    pub fn make_host_space(&mut self, needed_bytes: u64) -> Result<(), WorkError> {
        let mut memory = HostMemory::now();
        let admitted = memory.admit(needed_bytes);
        let never_fits = matches!(admitted, Err(WorkError::TooLargeForHost { .. }));
        if never_fits || self.engine().device().kind != DeviceKind::Cpu {
            return admitted;
        }
        let unused = self.surface_bytes.saturating_sub(self.cached_surface_bytes());
        let surface_reserve = unused.min(SURFACE_RESERVE_BYTES);
        let evictions: [Eviction; 6] = [
            // Evicts nothing, because freed buffers are released after each entry of this list anyway.
            (surface_reserve, |_, _| ()),
            (surface_reserve, Self::evict_computed),
            (surface_reserve, Self::evict_fields),
            (0, Self::evict_trees),
            (0, Self::evict_pyramids),
            (0, |workspace, _| lock(&workspace.cuts).clear()),
        ];
        if memory.missing(needed_bytes.saturating_add(surface_reserve)) == 0 {
            return admitted;
        }
        for (reserve, evict) in evictions {
            let missing = memory.missing(needed_bytes.saturating_add(reserve));
            if missing > 0 {
                evict(self, missing);
                // The engine pools freed buffers: they are the host's memory again only once the pool has released them.
                self.engine().release_idle();
                memory = HostMemory::now();
            }
        }
        if memory.missing(needed_bytes) > 0 {
            trim_heaps();
            memory = HostMemory::now();
        }
        tracing::debug!(needed_bytes, ?memory, "caches made space on the host");
        memory.admit(needed_bytes)
    }

    fn evict_computed(&mut self, bytes: u64) {
        let (pins, computed) = (&self.pins, &self.computed);
        self.volumes
            .free(bytes, |key| computed.contains(key) && !pins.holds(key));
        self.forget_evicted();
    }

    fn evict_fields(&mut self, bytes: u64) {
        let pins = &self.pins;
        self.volumes.free(bytes, |key| !pins.holds(key));
        self.forget_evicted();
    }

    fn evict_trees(&mut self, bytes: u64) {
        lock(&self.trees).free(bytes, |_| true);
    }

    fn evict_pyramids(&mut self, bytes: u64) {
        self.pyramids.free(bytes, |_| true);
    }
}
