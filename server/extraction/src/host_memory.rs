//! Checks whether this machine has memory for a volume or a surface before the memory is allocated. Otherwise the system could kill a
//! process that takes too much, and all viewers would lose their connections.

use std::sync::OnceLock;

use super::WorkError;
use super::memory::resident_bytes;

/// Memory that is left for allocations without a check: sockets, frames in queues, the driver, other programs.
const RESERVE_BYTES: u64 = 256 << 20;

/// Maximum bytes on the host for each triangle of a surface. Measured: 80 to 100, for the region meshes and the chunks or the mesh of an
/// export that are made of them. A region mesh takes 24 bytes a vertex and 12 bytes a triangle.
const BYTES_PER_TRIANGLE: u64 = 100;

/// The limit of [`limit_host_memory`], in bytes.
static LIMIT: OnceLock<u64> = OnceLock::new();

/// Sets the maximum bytes of this machine's memory that volumes and surfaces may take in this process. Call this once, before any work.
pub fn limit_host_memory(bytes: u64) {
    // Only the first call counts: a second server in the same process cannot change the limit.
    let _ = LIMIT.set(bytes);
}

/// Returns the limit of [`limit_host_memory`], if there is one.
pub fn host_memory_limit() -> Option<u64> {
    LIMIT.get().copied()
}

/// Gives unused pages of the allocator's heaps back to the system. Takes 10 to 15 ms for a hundred megabytes, during which allocations
/// wait.
pub fn trim_heaps() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call returns unused pages of the allocator's heaps, and no pointer refers to them.
    unsafe {
        libc::malloc_trim(0)
    };
}

/// Memory of the host, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostMemory {
    /// Bytes that the process can allocate in addition to those that it holds.
    available: u64,
    /// Bytes that the process could hold if no other memory were in use.
    total: u64,
}

impl HostMemory {
    /// Returns the current state: the minimum over the system, the control group and `--host-memory`.
    pub fn now() -> Self {
        let limit = LIMIT.get().map(|&limit| Self::within(limit, resident_bytes()));
        let limits = [system(), control_group(), limit];
        limits.into_iter().flatten().fold(Self::UNKNOWN, Self::minimum)
    }

    /// Returns the maximum bytes that the process may hold; `u64::MAX` if no limit is known.
    pub fn total(self) -> u64 {
        self.total
    }

    /// No limit is known, so everything is admitted.
    const UNKNOWN: Self = Self {
        available: u64::MAX,
        total: u64::MAX,
    };

    /// Returns the memory below a limit, of which `used` bytes are in use.
    fn within(limit: u64, used: u64) -> Self {
        Self {
            available: limit.saturating_sub(used),
            total: limit,
        }
    }

    /// Returns the stricter of two states.
    fn minimum(self, other: Self) -> Self {
        Self {
            available: self.available.min(other.available),
            total: self.total.min(other.total),
        }
    }

    /// Returns the bytes that have to be freed before `needed_bytes` may be allocated.
    pub(crate) fn missing(self, needed_bytes: u64) -> u64 {
        needed_bytes
            .saturating_add(RESERVE_BYTES)
            .saturating_sub(self.available)
    }

    /// Checks whether `needed_bytes` may be allocated.
    ///
    /// # Errors
    /// [`WorkError::HostBusy`] if there may be enough memory later, [`WorkError::TooLargeForHost`] if there will never be.
    pub fn admit(self, needed_bytes: u64) -> Result<(), WorkError> {
        if needed_bytes <= self.available.saturating_sub(RESERVE_BYTES) {
            return Ok(());
        }
        let limit_bytes = self.total.saturating_sub(RESERVE_BYTES);
        Err(if needed_bytes <= limit_bytes {
            WorkError::HostBusy { needed_bytes }
        } else {
            WorkError::TooLargeForHost {
                needed_bytes,
                limit_bytes,
            }
        })
    }

    /// Returns the maximum triangles of a surface that may be made now.
    pub fn triangles(self) -> u64 {
        self.available.saturating_sub(RESERVE_BYTES) / BYTES_PER_TRIANGLE
    }

    /// Replaces the error that a surface has too many triangles by an error about memory, if the ceiling in that error is due to the
    /// memory. `ceiling_triangles`: the ceiling if there were enough memory.
    pub fn explain(self, error: WorkError, ceiling_triangles: u64) -> WorkError {
        match error {
            WorkError::TooManyTriangles { triangles, ceiling } if ceiling < ceiling_triangles => {
                match self.admit(triangles.saturating_mul(BYTES_PER_TRIANGLE)) {
                    Err(no_memory) => no_memory,
                    // Memory was freed meanwhile, so the surface might fit now.
                    Ok(()) => error,
                }
            }
            other => other,
        }
    }
}

/// Returns the memory of the machine as Linux reports it.
fn system() -> Option<HostMemory> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let bytes = |name: &str| -> Option<u64> {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        Some(line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok()? << 10)
    };
    Some(HostMemory {
        available: bytes("MemAvailable:")?,
        total: bytes("MemTotal:")?,
    })
}

/// Returns the memory that the control group of a container allows. Inactive caches of files count as free: the system drops them when
/// memory is needed.
fn control_group() -> Option<HostMemory> {
    let read = |name: &str| std::fs::read_to_string(format!("/sys/fs/cgroup/memory.{name}")).ok();
    let limit = read("max")?.trim().parse().ok()?;
    let used: u64 = read("current")?.trim().parse().ok()?;
    let caches = read("stat").and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("inactive_file "))?;
        line.trim().parse::<u64>().ok()
    });
    Some(HostMemory::within(limit, used.saturating_sub(caches.unwrap_or(0))))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEMORY: HostMemory = HostMemory {
        available: RESERVE_BYTES + 1000,
        total: RESERVE_BYTES + 5000,
    };

    #[test]
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    fn free_pages_between_used_ones_go_back() {
        // Pieces of this size lie in a heap, whatever was freed before.
        let mut pieces: Vec<_> = (0..2000)
            .map(|_| Some(std::hint::black_box(vec![1u8; 100_000])))
            .collect();
        pieces.iter_mut().step_by(2).for_each(|piece| drop(piece.take()));
        let before = resident_bytes();
        trim_heaps();
        let given_back = before.saturating_sub(resident_bytes());
        assert!(given_back > 50_000_000, "{given_back} of 100,000,000 bytes");
    }

    #[test]
    fn what_fits_later_may_wait_and_what_never_fits_is_too_large() {
        assert!(MEMORY.admit(1000).is_ok());
        assert!(matches!(
            MEMORY.admit(1001),
            Err(WorkError::HostBusy { needed_bytes: 1001 })
        ));
        assert!(matches!(MEMORY.admit(5000), Err(WorkError::HostBusy { .. })));
        let never = MEMORY.admit(5001).unwrap_err();
        assert!(matches!(
            never,
            WorkError::TooLargeForHost {
                needed_bytes: 5001,
                limit_bytes: 5000
            }
        ));
        assert!(HostMemory::UNKNOWN.admit(u64::MAX - RESERVE_BYTES).is_ok());
        assert_eq!((MEMORY.missing(1000), MEMORY.missing(1200)), (0, 200));
    }

    #[test]
    fn memory_is_a_limit_of_triangles_too() {
        assert_eq!(MEMORY.triangles(), 1000 / BYTES_PER_TRIANGLE);
        let refused = |triangles, ceiling| MEMORY.explain(WorkError::TooManyTriangles { triangles, ceiling }, 20);
        assert!(matches!(refused(11, 10), WorkError::HostBusy { .. }));
        assert!(matches!(refused(1000, 10), WorkError::TooLargeForHost { .. }));
        // The server's own limit.
        assert!(matches!(refused(1000, 20), WorkError::TooManyTriangles { .. }));
    }

    #[test]
    fn the_smallest_limit_counts() {
        let limit = HostMemory::within(RESERVE_BYTES + 3000, 2500);
        let minimum = MEMORY.minimum(limit);
        assert_eq!(
            (minimum.available, minimum.total),
            (RESERVE_BYTES + 500, RESERVE_BYTES + 3000)
        );
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn linux_says_how_much_there_is() {
        let now = HostMemory::now();
        assert!(
            now.available > 0 && now.available <= now.total && now.total < u64::MAX,
            "{now:?}"
        );
    }
}
