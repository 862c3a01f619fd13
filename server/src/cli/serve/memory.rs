//! Options of `isopeel serve` about memory.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
use std::time::Duration;

use isopeel_extraction::PROCESSOR_BYTES;

use crate::cli::control_group::limit_memory;
use crate::stream::SHARED_BYTES;

/// Default of `--read-ahead`: space for sixteen time steps of 256³ 32-bit floats.
const READ_AHEAD_MIB: u64 = 1024;

const MIB: u64 = 1 << 20;

/// An allocation of at least this many bytes has its own mapping, which returns to the system as soon as it is freed.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MIN_MAPPED_BYTES: i32 = 1 << 20;

/// Interval at which free pages between smaller allocations are returned to the system.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const TRIM_INTERVAL: Duration = Duration::from_secs(30);

/// Options of `isopeel serve` that limit memory on the host and on the device.
#[derive(Debug, clap::Args)]
pub struct MemoryArgs {
    /// Memory of this machine for volumes and surfaces with all else that the process holds, in MiB: what would take more is refused before
    /// it is read or made [default: what the machine has, or a control group allows]
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..))]
    host_memory: Option<u64>,

    #[arg(long, value_name = "MIB", help = surface_memory_help())]
    surface_memory: Option<u64>,

    /// Device memory for time steps that are read before a viewer asks for them, as it goes from one to the next, in MiB; 0: none are
    #[arg(long, value_name = "MIB", default_value_t = READ_AHEAD_MIB)]
    read_ahead: u64,

    /// Memory for surfaces that were encoded, which viewers who ask for the same are sent again, in MiB; 0: each is encoded anew
    #[arg(long, value_name = "MIB", default_value_t = SHARED_BYTES / MIB)]
    shared_memory: u64,
}

fn surface_memory_help() -> String {
    format!(
        "Device memory for what makes the next edit of a surface quick, the pyramids, vertex trees and cuts of the latest isovalues and buffers \
         that are free, in MiB, of which a third of the device's memory is the maximum; 0: those used last alone [default: {} where the device \
         is this machine's processors, else that third]",
        PROCESSOR_BYTES / MIB
    )
}

impl MemoryArgs {
    /// Sets the limit of host memory, and makes the allocator return freed memory. Call this once, before any other work.
    pub(super) fn limit_process(&self) {
        return_freed_memory();
        limit_memory(self.host_memory.map(|mebibytes| mebibytes.saturating_mul(MIB)));
    }

    /// Returns the maximum device bytes of pyramids, vertex trees, cuts and free buffers, if `--surface-memory` is given.
    pub(super) fn surface_bytes(&self) -> Option<u64> {
        self.surface_memory.map(|mebibytes| mebibytes.saturating_mul(MIB))
    }

    /// Returns the maximum device bytes of time steps that are read ahead.
    pub(super) fn ahead_bytes(&self) -> u64 {
        self.read_ahead.saturating_mul(MIB)
    }

    /// Returns the maximum host bytes of the cache of encoded surfaces.
    pub(super) fn shared_bytes(&self) -> u64 {
        self.shared_memory.saturating_mul(MIB)
    }
}

/// Makes glibc return freed memory to the system. Call this once, before any other work.
///
/// Each allocation of at least [`MIN_MAPPED_BYTES`] gets its own mapping, and is unmapped when it is freed. By default glibc begins with a
/// threshold of 128 KiB, but raises it up to 32 MiB when such allocations are freed. Then the buffers of a CPU driver are in glibc's heaps,
/// where glibc cannot return freed memory between live allocations.
///
/// A thread returns free pages between smaller allocations. Without it, they grew to 0.1 GB within ten minutes with many viewers.
pub(in crate::cli) fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: the call only sets a parameter of the allocator.
        unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, MIN_MAPPED_BYTES) };
        let trim = || {
            loop {
                std::thread::sleep(TRIM_INTERVAL);
                isopeel_extraction::trim_heaps();
            }
        };
        // An error is not fatal: without this thread, the process only uses more memory.
        if let Err(error) = std::thread::Builder::new().name("isopeel-trim".into()).spawn(trim) {
            tracing::warn!(%error, "freed memory is kept");
        }
    }
}
