//! The way of a mesh from the device's memory to the host's.

use crate::buffer::{Buffer, allocation_error};
use crate::context::Context;
use crate::{DeviceKind, Error, Result, SharedSlice};
use bytemuck::Pod;
use opencl3::command_queue::CommandQueue;
use opencl3::event::Event;
use opencl3::memory::{CL_MAP_READ, CL_MAP_WRITE, CL_MEM_ALLOC_HOST_PTR, CL_MEM_READ_WRITE, ClMem};
use opencl3::types::{CL_BLOCKING, CL_NON_BLOCKING};
use rayon::prelude::*;
use std::ffi::c_void;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::mpsc::Sender;

/// Bytes of a room: more than the vertices or the indices of any region but a few of noise, which are read by themselves.
const ROOM_BYTES: usize = 8 << 20;

/// Host memory that a device with its own writes to directly: two rooms, so that one fills while what is in the other
/// moves to where it belongs. Reading to any other memory takes the driver several times as long.
pub(crate) struct Rooms {
    rooms: [Room; 2],
}

struct Room {
    /// Where the driver mapped it, until the memory is released.
    at: *mut u8,
    _memory: opencl3::memory::Buffer<u8>,
}

impl Rooms {
    pub fn new(context: &opencl3::context::Context, queue: &CommandQueue) -> Result<Self> {
        let room = || {
            let failed = |e| allocation_error("read back", ROOM_BYTES as u64, u64::MAX, e);
            let (flags, mut at) = (CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, std::ptr::null_mut());
            // SAFETY: no host pointer is passed; the map is blocking and of the whole memory.
            let memory = unsafe {
                let memory = opencl3::memory::Buffer::<u8>::create(context, flags, ROOM_BYTES, std::ptr::null_mut());
                let memory = memory.map_err(failed)?;
                let how = CL_MAP_READ | CL_MAP_WRITE;
                queue
                    .enqueue_map_buffer(&memory, CL_BLOCKING, how, 0, ROOM_BYTES, &mut at, &[])
                    .map_err(failed)?;
                memory
            };
            Ok(Room {
                at: at.cast(),
                _memory: memory,
            })
        };
        Ok(Self {
            rooms: [room()?, room()?],
        })
    }
}

/// A buffer's memory that the host looks at where it lies, until this is dropped, on whichever thread. Then it goes back to the
/// thread of its context.
struct Lent {
    memory: Option<Returned>,
    to: Sender<Returned>,
}

/// Memory that its context may use again once it is unmapped.
pub(crate) struct Returned {
    allocated_bytes: u64,
    memory: opencl3::memory::Buffer<u8>,
    at: *mut c_void,
}

// SAFETY: OpenCL's objects belong to no thread, and the address is only given back.
unsafe impl Send for Returned {}
// SAFETY: as above; nothing can be done with it but to return it.
unsafe impl Sync for Returned {}

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
            // SAFETY: mapped there by `lend`, and nobody looks at it any more.
            let event = unsafe {
                self.queue
                    .enqueue_unmap_mem_object(returned.memory.get(), returned.at, &[])
            };
            event.map_err(|source| Error::Launch {
                stage: "read back",
                source,
            })?;
            self.pool.put_back(returned.allocated_bytes, returned.memory);
        }
        Ok(())
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
        let returned = Returned {
            allocated_bytes,
            memory,
            at,
        };
        let lent = Arc::new(Lent {
            memory: Some(returned),
            to: self.returned.0.clone(),
        });
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
        let copies = |from: &[T], first: usize, parts: &[Range<usize>]| -> Vec<SharedSlice<T>> {
            let part = |p: &Range<usize>| SharedSlice::share(from[p.start - first..p.end - first].to_vec());
            parts.par_iter().map(part).collect()
        };
        let mut rooms = self.rooms.borrow_mut();
        let rooms = match &mut *rooms {
            Some(rooms) => rooms,
            none => none.insert(Rooms::new(&self.context, &self.queue)?),
        };
        let failed = |source| Error::Launch { stage, source };
        let runs = runs(parts, ROOM_BYTES / size_of::<T>());
        let span = |run: &Range<usize>| parts[run.start].start..parts[run.end - 1].end;
        let fits = |run: &Range<usize>| span(run).len() * size_of::<T>() <= ROOM_BYTES;
        let start = |k: usize| -> Result<Option<Event>> {
            let Some(run) = runs.get(k).filter(|run| fits(run)) else {
                return Ok(None);
            };
            let span = span(run);
            // SAFETY: within the buffer and the room, whose last content was copied before; it is looked at after the event.
            let event = unsafe {
                let room = std::slice::from_raw_parts_mut(rooms.rooms[k % 2].at.cast::<T>(), span.len());
                self.queue
                    .enqueue_read_buffer(buffer.raw(), CL_NON_BLOCKING, span.start * size_of::<T>(), room, &[])
            }
            .map_err(failed)?;
            self.queue.flush().map_err(failed)?;
            Ok(Some(event))
        };
        let mut read = Vec::with_capacity(parts.len());
        let mut coming = start(0)?;
        for (k, run) in runs.iter().enumerate() {
            let here = coming;
            coming = start(k + 1)?;
            let span = span(run);
            match here {
                Some(event) => {
                    event.wait().map_err(failed)?;
                    // SAFETY: the device wrote these elements, any bits are a `T`, and it writes here again only after this.
                    let room = unsafe { std::slice::from_raw_parts(rooms.rooms[k % 2].at.cast::<T>(), span.len()) };
                    read.extend(copies(room, span.start, &parts[run.clone()]));
                    self.record(stage, Ok(event), 0)?;
                }
                None => {
                    let alone = self.read_at(stage, &buffer, span.start, span.len())?;
                    read.push(SharedSlice::share(alone));
                }
            }
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
