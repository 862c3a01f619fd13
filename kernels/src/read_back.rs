//! The way of a mesh from the device's memory to the host's.

use crate::buffer::Buffer;
use crate::context::Context;
use crate::{DeviceKind, Error, Result, SharedSlice};
use bytemuck::Pod;
use opencl3::command_queue::CommandQueue;
use opencl3::memory::{CL_MAP_READ, CL_MAP_WRITE, CL_MEM_ALLOC_HOST_PTR, CL_MEM_READ_WRITE, ClMem};
use opencl3::types::{CL_BLOCKING, CL_NON_BLOCKING};
use std::any::Any;
use std::ffi::c_void;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::mpsc::Sender;

/// Bytes of a block: more than the vertices or the indices of any region but a few of noise, which are read by themselves.
const BLOCK_BYTES: usize = 4 << 20;

/// Host memory that a device with its own writes to directly, in blocks; reading to any other takes the driver several times as
/// long. Regions share a block, which comes back when the last of them is dropped.
#[derive(Default)]
pub(crate) struct Blocks {
    free: Vec<Block>,
    /// How many there are.
    pub made: usize,
}

pub(crate) struct Block {
    /// Where the driver mapped it, until the memory is released.
    at: NonNull<c_void>,
    _memory: opencl3::memory::Buffer<u8>,
}

// SAFETY: OpenCL's objects belong to no thread, and a block is in one hand, or only read.
unsafe impl Send for Block {}
// SAFETY: as above.
unsafe impl Sync for Block {}

impl Blocks {
    /// As many as a surface of ten million triangles takes. What finds none is read all the same, slower.
    pub const MOST: usize = 64;

    /// A block of which nobody holds a part; `None`: all are in use, or the host gives no more memory of this kind.
    fn take(&mut self, context: &opencl3::context::Context, queue: &CommandQueue) -> Option<Block> {
        if let Some(block) = self.free.pop() {
            return Some(block);
        }
        if self.made == Self::MOST {
            return None;
        }
        let (flags, mut at) = (CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, std::ptr::null_mut());
        // SAFETY: no host pointer is passed; the map is blocking and of the whole memory.
        let memory = unsafe {
            let memory = opencl3::memory::Buffer::create(context, flags, BLOCK_BYTES, std::ptr::null_mut()).ok()?;
            let how = CL_MAP_READ | CL_MAP_WRITE;
            let mapped = queue.enqueue_map_buffer(&memory, CL_BLOCKING, how, 0, BLOCK_BYTES, &mut at, &[]);
            mapped.ok()?;
            memory
        };
        self.made += 1;
        Some(Block {
            at: NonNull::new(at)?,
            _memory: memory,
        })
    }
}

/// Memory that the host looks at where it lies, until this is dropped, on whichever thread. Then it goes back to the thread of its
/// context.
struct Lent {
    memory: Option<Returned>,
    to: Sender<Returned>,
}

/// Memory that its context may use again.
pub(crate) enum Returned {
    Block(Block),
    /// To be unmapped first.
    Buffer(Mapped),
}

pub(crate) struct Mapped {
    allocated_bytes: u64,
    memory: opencl3::memory::Buffer<u8>,
    at: *mut c_void,
}

// SAFETY: OpenCL's objects belong to no thread, and the address is only given back.
unsafe impl Send for Mapped {}
// SAFETY: as above; nothing can be done with it but to return it.
unsafe impl Sync for Mapped {}

impl Drop for Lent {
    fn drop(&mut self) {
        if let Some(memory) = self.memory.take() {
            // Where the context is gone, so is the memory: it is released here.
            let _ = self.to.send(memory);
        }
    }
}

impl Context {
    /// Takes back what was lent and is no longer looked at.
    pub fn reclaim(&self) -> Result<()> {
        for returned in self.returned.1.try_iter() {
            match returned {
                Returned::Block(block) => self.blocks.borrow_mut().free.push(block),
                Returned::Buffer(Mapped {
                    allocated_bytes,
                    memory,
                    at,
                }) => {
                    // SAFETY: mapped there by `lend`, and nobody looks at it any more.
                    let event = unsafe { self.queue.enqueue_unmap_mem_object(memory.get(), at, &[]) };
                    event.map_err(|source| Error::Launch {
                        stage: "read back",
                        source,
                    })?;
                    self.pool.put_back(allocated_bytes, memory);
                }
            }
        }
        Ok(())
    }

    fn lent(&self, memory: Returned) -> Arc<Lent> {
        Arc::new(Lent {
            memory: Some(memory),
            to: self.returned.0.clone(),
        })
    }

    /// Parts of a buffer without a copy, where the device is the host's own processor.
    fn lend<T: Pod>(
        &self,
        stage: &'static str,
        buffer: Buffer<T>,
        parts: &[Range<usize>],
    ) -> Result<Vec<SharedSlice<T>>> {
        let (bytes, len) = (buffer.bytes(), buffer.len());
        let mut at = std::ptr::null_mut();
        // SAFETY: the map is blocking and of the whole buffer.
        let event = unsafe {
            self.queue
                .enqueue_map_buffer(buffer.raw(), CL_BLOCKING, CL_MAP_READ, 0, bytes as usize, &mut at, &[])
        };
        self.record(stage, event, bytes)?;
        let (allocated_bytes, memory) = buffer.lend();
        let lent = self.lent(Returned::Buffer(Mapped {
            allocated_bytes,
            memory,
            at,
        }));
        let part = |part: &Range<usize>| {
            assert!(part.start <= part.end && part.end <= len);
            // SAFETY: within the buffer, whose elements lie at `at`, any bits of which are a `T`, until it is unmapped: not before
            // `lent` is dropped. Until then nothing writes there, as the buffer is in nobody's hands.
            unsafe {
                let first = NonNull::new(at.cast::<T>().add(part.start)).expect("where memory is mapped");
                SharedSlice::new(first, part.len(), lent.clone())
            }
        };
        Ok(parts.iter().map(part).collect())
    }

    /// Parts of a buffer, which follow one another without overlap.
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
        let read = self.start_reading(stage, buffer, parts);
        // Also when one of them could not be started: until then the device writes to the blocks of the others.
        self.finish(stage)?;
        read
    }

    /// The parts, which may be looked at when the queue is empty; not before may their blocks be dropped.
    fn start_reading<T: Pod + Send + Sync>(
        &self,
        stage: &'static str,
        buffer: &Buffer<T>,
        parts: &[Range<usize>],
    ) -> Result<Vec<SharedSlice<T>>> {
        let mut read = Vec::with_capacity(parts.len());
        for run in runs(parts, BLOCK_BYTES / size_of::<T>()) {
            let span = parts[run.start].start..parts[run.end - 1].end;
            let bytes = span.len() * size_of::<T>();
            let fits = (1..=BLOCK_BYTES).contains(&bytes);
            let block = fits.then(|| self.blocks.borrow_mut().take(&self.context, &self.queue));
            let (first, owner): (NonNull<T>, Arc<dyn Any + Send + Sync>) = match block.flatten() {
                Some(block) => {
                    let first = block.at.cast::<T>();
                    let lent = self.lent(Returned::Block(block));
                    // SAFETY: within the buffer and the block, which nobody looks at before the queue is empty.
                    let event = unsafe {
                        let room = std::slice::from_raw_parts_mut(first.as_ptr(), span.len());
                        let from = span.start * size_of::<T>();
                        self.queue
                            .enqueue_read_buffer(buffer.raw(), CL_NON_BLOCKING, from, room, &[])
                    };
                    self.record(stage, event, bytes as u64)?;
                    (first, lent)
                }
                None => {
                    let vec = Arc::new(self.read_at(stage, buffer, span.start, span.len())?);
                    (NonNull::from(vec.as_slice()).cast(), vec)
                }
            };
            let part = |part: &Range<usize>| {
                assert!(span.start <= part.start && part.start <= part.end && part.end <= span.end);
                // SAFETY: within what was read, any bits of which are a `T`, and to which nobody writes while the owner lives.
                unsafe { SharedSlice::new(first.add(part.start - span.start), part.len(), owner.clone()) }
            };
            read.extend(parts[run].iter().map(part));
        }
        Ok(read)
    }
}

/// Parts that are read at once: as many as span at most `limit` elements, or a single one that is larger.
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
