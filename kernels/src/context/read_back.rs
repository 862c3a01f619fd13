//! Reads meshes back from the device's memory to the host's.

use super::Context;
use crate::buffer::Buffer;
use crate::lock::lock;
use crate::{DeviceKind, Error, Result, SharedSlice};
use bytemuck::Pod;
use bytes::Bytes;
use opencl3::command_queue::CommandQueue;
use opencl3::memory::{CL_MAP_READ, CL_MAP_WRITE, CL_MEM_ALLOC_HOST_PTR, CL_MEM_READ_WRITE, ClMem};
use opencl3::types::{CL_BLOCKING, CL_NON_BLOCKING};
use std::ffi::c_void;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::mpsc::Sender;

/// Bytes of a block: enough for the vertices or the indices of any region, except a few regions of noise, which are read one by one.
const BLOCK_BYTES: usize = 4 << 20;

/// Pinned host memory, in blocks: the device writes to it directly, several times as fast as to pageable memory. The regions of
/// a block share it; the block is free again when the last of them is dropped.
#[derive(Default)]
pub(crate) struct Blocks {
    free: Vec<Block>,
    /// Number of allocated blocks.
    pub allocated: usize,
}

pub(crate) struct Block {
    /// Address at which the driver mapped it, valid until the memory is released.
    address: NonNull<c_void>,
    _memory: opencl3::memory::Buffer<u8>,
}

// SAFETY: OpenCL objects belong to no thread, and a block is exclusively owned or only read.
unsafe impl Send for Block {}
// SAFETY: as above.
unsafe impl Sync for Block {}

impl Blocks {
    /// Maximum number of blocks, which is enough for a surface of ten million triangles. Further reads go to pageable memory, which is
    /// slower.
    pub const MAX_BLOCKS: usize = 64;

    /// Bytes of all blocks.
    pub fn bytes(&self) -> u64 {
        (self.allocated * BLOCK_BYTES) as u64
    }

    /// Returns a free block; `None` if all are in use, or if the host cannot pin more memory.
    fn take(&mut self, context: &opencl3::context::Context, queue: &CommandQueue) -> Option<Block> {
        if let Some(block) = self.free.pop() {
            return Some(block);
        }
        if self.allocated == Self::MAX_BLOCKS {
            return None;
        }
        let (flags, mut address) = (CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, std::ptr::null_mut());
        // SAFETY: no host pointer is passed; the map is blocking and of the whole memory.
        let memory = unsafe {
            let memory = opencl3::memory::Buffer::create(context, flags, BLOCK_BYTES, std::ptr::null_mut()).ok()?;
            let access = CL_MAP_READ | CL_MAP_WRITE;
            let mapped = queue.enqueue_map_buffer(&memory, CL_BLOCKING, access, 0, BLOCK_BYTES, &mut address, &[]);
            mapped.ok()?;
            memory
        };
        self.allocated += 1;
        Some(Block {
            address: NonNull::new(address)?,
            _memory: memory,
        })
    }
}

/// A buffer of a CPU device, mapped for reading.
pub(crate) struct MappedBuffer {
    allocated_bytes: u64,
    memory: opencl3::memory::Buffer<u8>,
    address: *mut c_void,
}

// SAFETY: OpenCL objects belong to no thread, and the address is only given back.
unsafe impl Send for MappedBuffer {}
// SAFETY: as above.
unsafe impl Sync for MappedBuffer {}

/// Memory returned to its context for reuse.
pub(crate) enum Returned {
    Block(Block),
    /// To be unmapped first.
    Buffer(MappedBuffer),
}

/// Memory lent to surfaces: read-only, on any thread. Dropping it sends the memory back to its context.
struct Lent {
    address: NonNull<u8>,
    bytes: usize,
    memory: Option<Returned>,
    to: Sender<Returned>,
}

// SAFETY: the address is that of `memory`, which may be sent, and is only read.
unsafe impl Send for Lent {}

impl AsRef<[u8]> for Lent {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: `memory` has at least `bytes` initialised bytes at this address, and no thread writes to them before it is returned.
        unsafe { std::slice::from_raw_parts(self.address.as_ptr(), self.bytes) }
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        if let Some(memory) = self.memory.take() {
            // Without its context the memory is released here.
            let _ = self.to.send(memory);
        }
    }
}

/// An enqueued read into host memory.
enum Pending {
    /// A read into a block, and its number of bytes.
    Block(Block, usize),
    /// Pageable memory, read completely.
    Pageable(Bytes),
}

/// Elements as bytes.
struct Elements<T>(Vec<T>);

impl<T: Pod> AsRef<[u8]> for Elements<T> {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

impl Context {
    /// Takes back lent memory that was dropped.
    pub fn reclaim(&self) -> Result<()> {
        for returned in lock(&self.returned.1).try_iter() {
            match returned {
                Returned::Block(block) => lock(&self.blocks).free.push(block),
                Returned::Buffer(MappedBuffer {
                    allocated_bytes,
                    memory,
                    address,
                }) => {
                    // SAFETY: mapped there by `lend`, and no slice of it exists any more.
                    let event = unsafe { self.queue.enqueue_unmap_mem_object(memory.get(), address, &[]) };
                    event.map_err(|source| Error::Launch {
                        stage: "read back",
                        source,
                    })?;
                    self.pool.take_back(allocated_bytes, memory);
                }
            }
        }
        Ok(())
    }

    /// Returns a shared view of the first `bytes` of some memory, which is sent back when the last clone is dropped.
    fn lent(&self, address: NonNull<u8>, bytes: usize, memory: Returned) -> Bytes {
        Bytes::from_owner(Lent {
            address,
            bytes,
            memory: Some(memory),
            to: self.returned.0.clone(),
        })
    }

    /// Returns parts of a buffer without a copy, on a device that is the host's own processor.
    fn lend<T: Pod>(
        &self,
        stage: &'static str,
        buffer: Buffer<T>,
        parts: &[Range<usize>],
    ) -> Result<Vec<SharedSlice<T>>> {
        let (bytes, len) = (buffer.bytes(), buffer.len());
        let mut address = std::ptr::null_mut();
        // SAFETY: the map is blocking and of the whole buffer.
        let event = unsafe {
            let raw = buffer.raw();
            self.queue
                .enqueue_map_buffer(raw, CL_BLOCKING, CL_MAP_READ, 0, bytes as usize, &mut address, &[])
        };
        self.record(stage, event, bytes)?;
        let (allocated_bytes, memory) = buffer.lend();
        let first = NonNull::new(address.cast()).expect("the address of mapped memory");
        let mapped = MappedBuffer {
            allocated_bytes,
            memory,
            address,
        };
        let whole = self.lent(first, len * size_of::<T>(), Returned::Buffer(mapped));
        Ok(parts.iter().map(|part| elements(&whole, part.clone())).collect())
    }

    /// Reads parts of a buffer, which are in ascending order and do not overlap.
    pub fn read_parts<T: Pod + Send + Sync>(
        &self,
        stage: &'static str,
        buffer: Buffer<T>,
        parts: &[Range<usize>],
    ) -> Result<Vec<SharedSlice<T>>> {
        if self.found.info.kind == DeviceKind::Cpu {
            return self.lend(stage, buffer, parts);
        }
        self.read_to_blocks(stage, &buffer, parts)
    }

    /// As [`Context::read_parts`], from a device with memory of its own.
    pub fn read_to_blocks<T: Pod + Send + Sync>(
        &self,
        stage: &'static str,
        buffer: &Buffer<T>,
        parts: &[Range<usize>],
    ) -> Result<Vec<SharedSlice<T>>> {
        self.reclaim()?;
        let runs = runs(parts, BLOCK_BYTES / size_of::<T>());
        let mut pending = Vec::with_capacity(runs.len());
        let enqueued = runs
            .iter()
            .try_for_each(|run| self.enqueue_read(stage, buffer, span(parts, run), &mut pending));
        // Also after an error: until then the device writes to the blocks of the reads before it.
        self.finish(stage)?;
        enqueued?;
        let mut read = Vec::with_capacity(parts.len());
        for (run, pending) in runs.iter().zip(pending) {
            let bytes = match pending {
                Pending::Block(block, bytes) => self.lent(block.address.cast(), bytes, Returned::Block(block)),
                Pending::Pageable(bytes) => bytes,
            };
            let first = span(parts, run).start;
            let parts = parts[run.clone()].iter();
            read.extend(parts.map(|part| elements(&bytes, part.start - first..part.end - first)));
        }
        Ok(read)
    }

    /// Enqueues the read of some elements into a block, or reads them into pageable memory if they fit in none. `pending`
    /// holds the block until the queue is finished.
    fn enqueue_read<T: Pod + Send + Sync>(
        &self,
        stage: &'static str,
        buffer: &Buffer<T>,
        span: Range<usize>,
        pending: &mut Vec<Pending>,
    ) -> Result<()> {
        let bytes = span.len() * size_of::<T>();
        let fits = (1..=BLOCK_BYTES).contains(&bytes);
        let block = fits.then(|| lock(&self.blocks).take(&self.context, &self.queue));
        let Some(block) = block.flatten() else {
            let elements = self.read_at(stage, buffer, span.start, span.len())?;
            pending.push(Pending::Pageable(Bytes::from_owner(Elements(elements))));
            return Ok(());
        };
        // SAFETY: within the buffer and the block, of which there is no slice before the queue is finished.
        let event = unsafe {
            let target = std::slice::from_raw_parts_mut(block.address.cast::<T>().as_ptr(), span.len());
            let from = span.start * size_of::<T>();
            self.queue
                .enqueue_read_buffer(buffer.raw(), CL_NON_BLOCKING, from, target, &[])
        };
        pending.push(Pending::Block(block, bytes));
        self.record(stage, event, bytes as u64)
    }
}

/// A range of elements in shared bytes.
fn elements<T: Pod>(bytes: &Bytes, range: Range<usize>) -> SharedSlice<T> {
    // An empty slice of `Bytes` has an address of no alignment.
    if range.is_empty() {
        return SharedSlice::default();
    }
    SharedSlice::new(bytes.slice(range.start * size_of::<T>()..range.end * size_of::<T>()))
}

/// Elements from the first of a run of parts to the last.
fn span(parts: &[Range<usize>], run: &Range<usize>) -> Range<usize> {
    parts[run.start].start..parts[run.end - 1].end
}

/// Runs of parts to be read together: each spans at most `limit` elements, or is a single larger part.
fn runs(parts: &[Range<usize>], limit: usize) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (i, part) in parts.iter().enumerate() {
        match runs.last_mut() {
            Some(run) if part.end - parts[run.start].start <= limit => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::runs;

    #[test]
    fn parts_are_read_together_up_to_the_limit_and_larger_ones_alone() {
        let parts = [0..3, 3..5, 5..20, 20..22, 30..38, 38..38];
        assert_eq!(runs(&parts, 10), [0..2, 2..3, 3..4, 4..6]);
        assert!(runs(&[], 10).is_empty());
    }
}
