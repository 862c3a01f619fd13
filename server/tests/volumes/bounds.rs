//! Bounds of the memory and the time that reading may take on a thread.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;

use isopeel_kernels::SampleType;
use isopeel_volumes::{Field, OpenedFile, ReadError, Samples};
use rustix::time::{ClockId, clock_gettime};

/// Counts the current and the maximum memory of the thread.
struct Counting;

thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn count(bytes: isize) {
    let held = HELD.get() + bytes;
    HELD.set(held);
    PEAK.set(PEAK.get().max(held));
}

// SAFETY: every call goes to the system's allocator unchanged; the counters are plain cells without destructors.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's contract is the system's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's contract is the system's.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: the caller's contract is the system's.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Old and new exist together while the system copies.
        count(size as isize);
        count(-(layout.size() as isize));
        // SAFETY: the caller's contract is the system's.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Buffers of fixed size: header, decoder, one decoded piece.
const FIXED: isize = 16 << 20;

thread_local! {
    /// All that a test's thread decodes in parallel is decoded by itself, so that its memory is counted.
    static ON_THIS_THREAD: rayon::ThreadPool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build()
        .unwrap();
}

/// A time step of a field, with at most twice the memory that the header declares for all of the array. Floats may be stored as doubles.
pub fn load_within(file: &OpenedFile, field: &Field, step: u32) -> Result<Samples, ReadError> {
    let width = match field.sample_type {
        SampleType::F32 => 8,
        other => other.bytes() as u64,
    };
    let arrays = u64::from(file.steps) * file.fields.len() as u64;
    let declared = file.geometry.sample_count() * arrays * width;
    let before = HELD.get();
    let outer = PEAK.replace(before);
    let samples = field.source.load(step);
    let used = PEAK.get() - before;
    assert!(
        used <= FIXED + 2 * declared as isize,
        "{used} bytes for {declared} that are declared"
    );
    PEAK.set(outer.max(PEAK.get()));
    samples
}

/// Runs `work` and returns its result. Panics if it takes a second, or holds more than `limit` bytes beyond the fixed buffers.
pub fn within<R>(limit: usize, work: impl FnOnce() -> R) -> R {
    ON_THIS_THREAD.with(|_| ());
    let start = own_time();
    let before = HELD.get();
    PEAK.set(before);
    let result = work();
    let used = PEAK.get() - before;
    assert!(used <= FIXED + limit as isize, "{used} bytes");
    let took = own_time().saturating_sub(start);
    assert!(took < Duration::from_secs(1), "took {took:?}");
    result
}

/// Time that the thread has run, whatever else the machine does.
fn own_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}
