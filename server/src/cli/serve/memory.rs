//! Options of `isopeel serve` about memory.

use isopeel_extraction::{PROCESSOR_BYTES, limit_host_memory, return_freed_memory};

use crate::stream::SHARED_BYTES;

/// A few steps of 256³ floats.
const READ_AHEAD_MIB: u64 = 1024;

const MIB: u64 = 1 << 20;

/// These options.
#[derive(Debug, clap::Args)]
pub struct MemoryArgs {
    /// Memory of this machine for volumes and surfaces with all else that the process holds, in MiB: what would take more is refused before
    /// it is read or made [default: what the machine or the container has]
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
    /// Holds this process to its limit, and has it give back what it frees. Once, before any work.
    pub(super) fn limit_process(&self) {
        return_freed_memory();
        if let Some(mebibytes) = self.host_memory {
            limit_host_memory(mebibytes.saturating_mul(MIB));
        }
    }

    /// Bytes that earlier edits may occupy, if `--surface-memory` is given.
    pub(super) fn surface_bytes(&self) -> Option<u64> {
        self.surface_memory.map(|mebibytes| mebibytes.saturating_mul(MIB))
    }

    /// Bytes of time steps that are read ahead.
    pub(super) fn ahead_bytes(&self) -> u64 {
        self.read_ahead.saturating_mul(MIB)
    }

    /// Bytes of surfaces that were encoded.
    pub(super) fn shared_bytes(&self) -> u64 {
        self.shared_memory.saturating_mul(MIB)
    }
}
