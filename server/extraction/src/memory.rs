//! Memory by purpose.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use isopeel_kernels::{DeviceKind, DeviceMemory, lock};
use serde::{Deserialize, Serialize};

/// Use of memory, in bytes. If the device is this machine's processors, all of it is the process's own memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "camelCase")]
pub struct MemoryUse {
    /// Volumes on the device.
    pub volume_bytes: u64,
    /// Pyramids of the latest isovalues, on the device.
    pub pyramid_bytes: u64,
    /// Vertex trees of the latest isovalues, on the device.
    pub tree_bytes: u64,
    /// Cuts that clients show, on the device.
    pub cut_bytes: u64,
    /// Other bytes of the device's buffers: what they were allocated larger than needed, and the buffers of the running job.
    pub other_device_bytes: u64,
    /// Buffers on the device that are not in use and are kept for the next edits.
    pub idle_bytes: u64,
    /// Meshes that are being encoded, on the host.
    pub surface_bytes: u64,
    /// Memory of the process before it opened a volume: code, the device's driver and compiled kernels.
    pub program_bytes: u64,
    /// Memory that the process holds, as the operating system reports it; 0 if it does not.
    pub resident_bytes: u64,
    /// Whether the memory of all devices is part of the process's.
    pub is_host_memory: bool,
}

impl MemoryUse {
    /// Returns the use of two devices of one server. What the process holds counts once.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            volume_bytes: self.volume_bytes + other.volume_bytes,
            pyramid_bytes: self.pyramid_bytes + other.pyramid_bytes,
            tree_bytes: self.tree_bytes + other.tree_bytes,
            cut_bytes: self.cut_bytes + other.cut_bytes,
            other_device_bytes: self.other_device_bytes + other.other_device_bytes,
            idle_bytes: self.idle_bytes + other.idle_bytes,
            surface_bytes: self.surface_bytes + other.surface_bytes,
            program_bytes: self.program_bytes.max(other.program_bytes),
            resident_bytes: self.resident_bytes.max(other.resident_bytes),
            is_host_memory: self.is_host_memory && other.is_host_memory,
        }
    }
}

/// Memory that a workspace accounts for, in bytes.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct WorkspaceMemory {
    /// Memory that the engine has allocated.
    pub device: DeviceMemory,
    /// Volumes, including those that are being uploaded.
    pub volumes: u64,
    /// Pyramids.
    pub pyramids: u64,
    /// Vertex trees.
    pub trees: u64,
    /// Cuts.
    pub cuts: u64,
    /// Memory of the process when the device was ready.
    pub program: u64,
}

/// Other processes of the same program, whose memory counts with that of this one: the process that owns the device, checks of devices, or
/// the server that has started this one.
static COUNTED: Mutex<Vec<u32>> = Mutex::new(Vec::new());

/// Bytes of processes that only another process can count.
static FURTHER_BYTES: AtomicU64 = AtomicU64::new(0);

/// Counts the memory of another process of the same program with that of this one, until it is dropped.
pub struct CountedProcess(u32);

impl CountedProcess {
    /// Begins to count the process with this id.
    pub fn new(id: u32) -> Self {
        lock(&COUNTED).push(id);
        Self(id)
    }
}

impl Drop for CountedProcess {
    fn drop(&mut self) {
        lock(&COUNTED).retain(|&id| id != self.0);
    }
}

/// Returns the private bytes of all processes of [`CountedProcess`] but one; 0: of all.
pub fn counted_bytes(except: u32) -> u64 {
    let ids = lock(&COUNTED).clone();
    ids.into_iter().filter(|&id| id != except).map(private_bytes).sum()
}

/// Sets the bytes of processes that only another process can count, and has reported.
pub fn count_further_bytes(bytes: u64) {
    FURTHER_BYTES.store(bytes, Ordering::Relaxed);
}

/// Returns the bytes of physical memory that the process holds, with those of the processes of [`CountedProcess`] and of
/// [`count_further_bytes`]; without its own if the operating system does not report them.
pub fn resident_bytes() -> u64 {
    let own = memory_stats::memory_stats().map_or(0, |memory| memory.physical_mem as u64);
    own + counted_bytes(0) + FURTHER_BYTES.load(Ordering::Relaxed)
}

/// Returns the bytes of physical memory that a process does not share with others; 0 if the process has ended, or if the operating system
/// does not report them.
pub fn private_bytes(process: u32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"));
    let kibibytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kibibytes.unwrap_or(0) << 10
}

impl WorkspaceMemory {
    /// Returns the memory by purpose, with the resident memory of the process as it is now.
    pub fn stated(self, kind: DeviceKind) -> MemoryUse {
        let accounted = self.volumes + self.pyramids + self.trees + self.cuts;
        MemoryUse {
            other_device_bytes: self.device.in_use.saturating_sub(accounted),
            volume_bytes: self.volumes,
            pyramid_bytes: self.pyramids,
            tree_bytes: self.trees,
            cut_bytes: self.cuts,
            idle_bytes: self.device.idle,
            surface_bytes: self.device.lent,
            program_bytes: self.program,
            resident_bytes: resident_bytes(),
            is_host_memory: kind == DeviceKind::Cpu,
        }
    }
}

#[cfg(test)]
mod tests {
    #[cfg(target_os = "linux")]
    #[test]
    fn another_process_counts_until_it_is_dropped() {
        use super::{CountedProcess, counted_bytes};
        use std::process::Command;
        use std::time::{Duration, Instant};

        let mut other = Command::new("sleep").arg("60").spawn().expect("a process");
        let counted = CountedProcess::new(other.id());
        let begun = Instant::now();
        while counted_bytes(0) == 0 {
            assert!(begun.elapsed() < Duration::from_secs(10), "the process has no memory");
        }
        assert_eq!(counted_bytes(other.id()), 0, "without this one");
        drop(counted);
        assert_eq!(counted_bytes(0), 0);
        other.kill().and_then(|()| other.wait()).expect("killed");
    }
}
