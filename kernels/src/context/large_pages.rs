//! Large pages for large buffers on a CPU. Kernels read a brick's samples from some thirty pages of 4 KiB, and each has to be found
//! in the page tables first; pages of 2 MiB spare most of that. Linux gives them where it is asked, in the usual setting
//! (`/sys/kernel/mm/transparent_hugepage/enabled`: `madvise`).

use super::Context;
use crate::buffer::Buffer;

/// Buffers of fewer bytes are left as they are: what a page of 2 MiB holds beyond their end would be wasted.
#[cfg(target_os = "linux")]
const MIN_BYTES: u64 = 4 << 20;

impl Context {
    /// Asks for large pages for a new buffer. It is as good without: whatever fails is passed over.
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

    /// Other systems choose by themselves.
    #[cfg(not(target_os = "linux"))]
    pub(super) fn ask_for_large_pages<T>(&self, _: &Buffer<T>) {}
}
