//! Large pages for large buffers on a CPU. Kernels read a brick's samples from some thirty pages of 4 KiB, each of which needs a
//! look-up in the page tables; pages of 2 MiB avoid most look-ups. In its usual setting, Linux provides them only on request
//! (`/sys/kernel/mm/transparent_hugepage/enabled`: `madvise`).

use super::Context;
use crate::buffer::Buffer;

/// Minimum size of a buffer with large pages: for smaller ones, the unused rest of the last page of 2 MiB would be too much waste.
#[cfg(target_os = "linux")]
const MIN_BYTES: u64 = 4 << 20;

impl Context {
    /// Requests large pages for a new buffer. They are optional, so errors are ignored.
    #[cfg(target_os = "linux")]
    pub(super) fn ask_for_large_pages<T>(&self, buffer: &Buffer<T>) {
        use opencl3::memory::{CL_MAP_WRITE_INVALIDATE_REGION, ClMem};
        use opencl3::types::CL_BLOCKING;
        use rustix::mm::{Advice, madvise};

        let bytes = buffer.bytes();
        if self.found.info.kind != crate::DeviceKind::Cpu || bytes < MIN_BYTES {
            return;
        }
        let page = rustix::param::page_size();
        let mut address = std::ptr::null_mut();
        // SAFETY: the map is blocking and of the whole buffer, which is unmapped before anything uses it. The advice is on whole pages
        // inside, and changes no content.
        unsafe {
            let access = CL_MAP_WRITE_INVALIDATE_REGION;
            let size = bytes as usize;
            let mapped = self
                .queue
                .enqueue_map_buffer(buffer.raw(), CL_BLOCKING, access, 0, size, &mut address, &[]);
            if mapped.is_err() || address.is_null() {
                return;
            }
            let skipped = address.align_offset(page);
            let whole = size.saturating_sub(skipped) / page * page;
            let _ = madvise(address.byte_add(skipped), whole, Advice::LinuxHugepage);
            let _ = self.queue.enqueue_unmap_mem_object(buffer.raw().get(), address, &[]);
        }
    }

    /// Does nothing: other systems choose page sizes by themselves.
    #[cfg(not(target_os = "linux"))]
    pub(super) fn ask_for_large_pages<T>(&self, _: &Buffer<T>) {}
}
