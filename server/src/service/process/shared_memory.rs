//! Memory that both processes have mapped, in slots.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use isopeel_extraction::HostMemory;
use memmap2::{MmapOptions, MmapRaw};
use rustix::fs::{MemfdFlags, SealFlags};

/// Number of slots for each direction: while one is read, the next message is written.
pub(super) const SLOTS: usize = 2;

/// One in this many bytes of the memory that the process may hold stays allocated in each slot after its message was read, so that the next message finds its
/// pages.
const RESIDENT_SHARE: u64 = 512;

/// Size of a slot, which is the maximum size of a message. Pages are allocated when they are used. If the limits of the process allow less,
/// slots are smaller.
const SLOT_BYTES: usize = 8 << 30;

/// All slots together take one in this many bytes of the address space at most, if that is limited.
const ADDRESS_SPACE_SHARE: u64 = 8;

/// Minimum size of a slot.
const MIN_SLOT_BYTES: usize = 8 << 20;

/// Bytes before the first slot, for the flags: a page of any machine.
const FLAG_BYTES: usize = 64 << 10;

/// Offset of the numbers behind the flags.
const NUMBER_OFFSET: usize = 64;

/// A sign of life of the device's process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Beat {
    /// As [`isopeel_kernels::Activity::commands`]; `None` while the device is not open.
    pub commands: Option<u64>,
    /// As [`isopeel_kernels::Activity::may_compile`].
    pub may_compile: bool,
}

/// One of the two processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The server.
    Server,
    /// The process of the device.
    Device,
}

impl End {
    pub(super) fn other(self) -> Self {
        match self {
            Self::Server => Self::Device,
            Self::Device => Self::Server,
        }
    }
}

/// Memory that both processes have mapped. The flag of each slot is 1 while the slot holds a message that is not read yet.
pub(super) struct SharedMemory {
    map: MmapRaw,
    pub slot_bytes: usize,
}

impl SharedMemory {
    /// Allocates shared memory, and returns it with its file, which the other process maps.
    ///
    /// # Errors
    /// The system refuses even small slots.
    pub(super) fn create() -> io::Result<(Self, OwnedFd)> {
        let (file_limit, _) = rlimit::Resource::FSIZE.get()?;
        // Drivers need most of a limited address space.
        let (space_limit, _) = rlimit::Resource::AS.get()?;
        Self::create_below(file_limit.min(space_limit / ADDRESS_SPACE_SHARE))
    }

    /// As [`SharedMemory::create`]. `limit`: maximum bytes of all slots.
    ///
    /// # Errors
    /// As [`SharedMemory::create`].
    pub(super) fn create_below(limit: u64) -> io::Result<(Self, OwnedFd)> {
        let file = rustix::fs::memfd_create("isopeel-device", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
        let mut slot_bytes = SLOT_BYTES;
        loop {
            let bytes = FLAG_BYTES + 2 * SLOTS * slot_bytes;
            // A file beyond its limit would end the process.
            let mapped = if bytes as u64 <= limit {
                rustix::fs::ftruncate(&file, bytes as u64)?;
                Self::map(&file)
            } else {
                Err(io::ErrorKind::FileTooLarge.into())
            };
            match mapped {
                Ok(memory) => {
                    // Access beyond the end of a file that the other process has cut off would end this one.
                    rustix::fs::fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
                    return Ok((memory, file));
                }
                Err(_) if slot_bytes > MIN_SLOT_BYTES => slot_bytes /= 2,
                Err(error) => return Err(error),
            }
        }
    }

    /// Maps the shared memory of the other process.
    ///
    /// # Errors
    /// The system refuses, or the file is too short.
    pub(super) fn map(file: &OwnedFd) -> io::Result<Self> {
        let bytes = usize::try_from(rustix::fs::fstat(file)?.st_size).unwrap_or(0);
        let slot_bytes = bytes.saturating_sub(FLAG_BYTES) / (2 * SLOTS);
        if slot_bytes < MIN_SLOT_BYTES {
            return Err(io::Error::other("the shared memory is too small"));
        }
        let map = MmapOptions::new().len(bytes).no_reserve_swap().map_raw(file)?;
        // Writing a core would allocate all of its pages. An error is ignored: nothing depends on it.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::DontDump);
        Ok(Self { map, slot_bytes })
    }

    /// Index of a slot of one direction among all slots.
    pub(super) fn index(sender: End, slot: usize) -> usize {
        match sender {
            End::Server => slot,
            End::Device => SLOTS + slot,
        }
    }

    pub(super) fn flag(&self, index: usize) -> &AtomicU32 {
        // SAFETY: the flags are at the start of the map, aligned, and only ever accessed as atomics.
        unsafe { AtomicU32::from_ptr(self.map.as_mut_ptr().cast::<u32>().add(index)) }
    }

    /// Numbers behind the flags.
    fn number(&self, index: usize) -> &AtomicU64 {
        // SAFETY: as the flags, behind them.
        unsafe { AtomicU64::from_ptr(self.map.as_mut_ptr().add(NUMBER_OFFSET).cast::<u64>().add(index)) }
    }

    /// Numbers of the last sign of life: how many there were, commands and one, whether the driver may compile.
    fn beat_numbers(&self) -> [&AtomicU64; 3] {
        [0, 1, 2].map(|index| self.number(index))
    }

    /// Bytes of the processes of the server that the process of the device cannot count.
    pub(super) fn further_bytes(&self) -> &AtomicU64 {
        self.number(3)
    }

    /// Gives a sign of life.
    pub(super) fn beat(&self, beat: Beat) {
        let [count, commands, may_compile] = self.beat_numbers();
        commands.store(beat.commands.map_or(0, |commands| commands + 1), Ordering::Relaxed);
        may_compile.store(beat.may_compile.into(), Ordering::Relaxed);
        count.fetch_add(1, Ordering::Release);
    }

    /// Returns the number of signs of life so far, and the last one.
    pub(super) fn beats(&self) -> (u64, Beat) {
        let [count, commands, may_compile] = self.beat_numbers();
        let count = count.load(Ordering::Acquire);
        let beat = Beat {
            commands: commands.load(Ordering::Relaxed).checked_sub(1),
            may_compile: may_compile.load(Ordering::Relaxed) != 0,
        };
        (count, beat)
    }

    pub(super) fn slot(&self, index: usize) -> *mut u8 {
        assert!(index < 2 * SLOTS);
        // SAFETY: the slot is within the map.
        unsafe { self.map.as_mut_ptr().add(FLAG_BYTES + index * self.slot_bytes) }
    }

    /// Frees the pages of a slot beyond those that stay allocated.
    pub(super) fn trim(&self, index: usize, used: usize) {
        let resident = resident_slot_bytes();
        if used > resident {
            // SAFETY: the range is within the slot, whose message was read, and begins at a page.
            unsafe {
                let start = self.slot(index).add(resident);
                libc::madvise(start.cast(), used - resident, libc::MADV_REMOVE)
            };
        }
    }
}

/// Returns the bytes of a slot that stay allocated.
pub(super) fn resident_slot_bytes() -> usize {
    static BYTES: OnceLock<usize> = OnceLock::new();
    *BYTES.get_or_init(|| match HostMemory::now().total() {
        // Not known.
        u64::MAX => 0,
        // Whole pages.
        total => (total / RESIDENT_SHARE) as usize / FLAG_BYTES * FLAG_BYTES,
    })
}
