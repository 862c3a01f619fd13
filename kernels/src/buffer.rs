//! Device memory: typed buffers from a pool that accounts for them.

use crate::{Error, Result};
use opencl3::context::Context;
use opencl3::error_codes::{CL_INVALID_BUFFER_SIZE, CL_MEM_OBJECT_ALLOCATION_FAILURE, CL_OUT_OF_RESOURCES, ClError};
use opencl3::memory::{CL_MEM_READ_WRITE, ClMem};
use opencl3::types::cl_mem;
use std::cell::{Cell, RefCell};
use std::mem::ManuallyDrop;
use std::rc::Rc;

/// Bytes allocated on a device; on a CPU they are the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Bytes of volumes, pyramids, cuts and stages.
    pub in_use: u64,
    /// Bytes that were freed and are cached for the next allocations.
    pub idle: u64,
    /// Bytes of surfaces that share the device's memory, or pinned memory of the host, until they are sent.
    pub lent: u64,
}

/// Accounts for a device's allocations and caches freed ones for later allocations of about the same size: drivers allocate
/// slowly, and on a CPU the operating system maps fresh pages slowly.
pub(crate) struct Pool {
    now: Cell<u64>,
    /// Bytes that [`Buffer::lend`] took out and that are not back yet.
    lent: Cell<u64>,
    peak: Cell<u64>,
    /// Freed allocations and their bytes, least recently used first.
    idle: RefCell<Vec<(u64, opencl3::memory::Buffer<u8>)>>,
    /// Maximum bytes in `idle`.
    idle_limit: Cell<u64>,
}

impl Pool {
    /// A pool that keeps at most `idle_limit` freed bytes.
    pub fn new(idle_limit: u64) -> Self {
        Self {
            now: Cell::default(),
            lent: Cell::default(),
            peak: Cell::default(),
            idle: RefCell::default(),
            idle_limit: Cell::new(idle_limit),
        }
    }

    /// Lowers the limit of idle bytes to `bytes`. A limit that is already lower stays.
    pub fn limit_idle(&self, bytes: u64) {
        self.idle_limit.set(self.idle_limit.get().min(bytes));
    }

    /// Releases all that is idle.
    pub fn release_idle(&self) {
        self.idle.borrow_mut().clear();
    }

    /// Resets the peak; returns the bytes in use.
    pub fn restart(&self) -> u64 {
        self.peak.set(self.now.get());
        self.now.get()
    }

    /// Peak of the bytes in use since [`Pool::restart`].
    pub fn peak(&self) -> u64 {
        self.peak.get()
    }

    /// Bytes in use, idle and lent.
    pub fn memory(&self) -> DeviceMemory {
        DeviceMemory {
            in_use: self.now.get(),
            idle: self.idle.borrow().iter().map(|(bytes, _)| bytes).sum(),
            lent: self.lent.get(),
        }
    }

    /// Takes back lent memory.
    pub fn take_back(&self, bytes: u64, memory: opencl3::memory::Buffer<u8>) {
        self.lent.set(self.lent.get() - bytes);
        self.put_back(bytes, memory);
    }

    fn add(&self, bytes: u64) {
        self.now.set(self.now.get() + bytes);
        self.peak.set(self.peak.get().max(self.now.get()));
    }

    fn subtract(&self, bytes: u64) {
        self.now.set(self.now.get() - bytes);
    }

    /// The smallest idle allocation of at least `bytes` and at most a quarter more.
    fn take(&self, bytes: u64) -> Option<(u64, cl_mem)> {
        let mut idle = self.idle.borrow_mut();
        let fits = |&(has, _): &(u64, _)| has >= bytes && has - bytes <= (bytes / 4).max(1 << 16);
        let tightest = (0..idle.len()).filter(|&i| fits(&idle[i])).min_by_key(|&i| idle[i].0)?;
        let (has, memory) = idle.remove(tightest);
        Some((has, ManuallyDrop::new(memory).get()))
    }

    /// Takes memory that is no longer in use; releases the oldest while the idle memory exceeds the limit.
    pub fn put_back(&self, bytes: u64, memory: opencl3::memory::Buffer<u8>) {
        let mut idle = self.idle.borrow_mut();
        idle.push((bytes, memory));
        let mut total: u64 = idle.iter().map(|(bytes, _)| bytes).sum();
        idle.retain(|(bytes, _)| {
            let keep = total <= self.idle_limit.get();
            total -= if keep { 0 } else { *bytes };
            keep
        });
    }
}

/// `len` elements of `T` on the device.
pub(crate) struct Buffer<T> {
    /// Released by the pool.
    inner: ManuallyDrop<opencl3::memory::Buffer<T>>,
    len: usize,
    /// Size of the allocation: that of `len` elements or a little more.
    allocated_bytes: u64,
    pool: Rc<Pool>,
}

impl<T> Buffer<T> {
    /// Returns a buffer of `len` elements (at least one, as OpenCL has no empty buffers) with undefined contents, and whether its
    /// memory is new instead of reused.
    pub fn new(
        context: &Context,
        pool: &Rc<Pool>,
        limit_bytes: u64,
        stage: &'static str,
        len: usize,
    ) -> Result<(Self, bool)> {
        let bytes = len.max(1) as u64 * size_of::<T>() as u64;
        if bytes > limit_bytes {
            return Err(Error::OutOfDeviceMemory {
                stage,
                needed_bytes: bytes,
                limit_bytes: Some(limit_bytes),
            });
        }
        // SAFETY: no host pointer is passed, so OpenCL allocates the memory itself.
        let create =
            || unsafe { opencl3::memory::Buffer::create(context, CL_MEM_READ_WRITE, len.max(1), std::ptr::null_mut()) };
        let earlier = pool.take(bytes);
        let is_new = earlier.is_none();
        let (allocated_bytes, inner) = match earlier {
            Some((allocated, memory)) => (allocated, opencl3::memory::Buffer::new(memory)),
            None => {
                let made = create().or_else(|_| {
                    pool.release_idle();
                    create()
                });
                (bytes, made.map_err(|e| allocation_error(stage, bytes, e))?)
            }
        };
        pool.add(allocated_bytes);
        let buffer = Self {
            inner: ManuallyDrop::new(inner),
            len,
            allocated_bytes,
            pool: pool.clone(),
        };
        Ok((buffer, is_new))
    }

    /// Elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.len.max(1) as u64 * size_of::<T>() as u64
    }

    /// Bytes that the pool holds for it: a reused allocation may be larger than the buffer.
    pub fn allocated_bytes(&self) -> u64 {
        self.allocated_bytes
    }

    pub(crate) fn raw(&self) -> &opencl3::memory::Buffer<T> {
        &self.inner
    }

    pub(crate) fn raw_mut(&mut self) -> &mut opencl3::memory::Buffer<T> {
        &mut self.inner
    }

    pub(crate) fn handle(&self) -> cl_mem {
        self.inner.get()
    }

    /// Takes the memory out of the pool; returns the bytes allocated and the memory. [`Pool::take_back`] takes it back.
    pub fn lend(self) -> (u64, opencl3::memory::Buffer<u8>) {
        let this = ManuallyDrop::new(self);
        this.pool.subtract(this.allocated_bytes);
        this.pool.lent.set(this.pool.lent.get() + this.allocated_bytes);
        // SAFETY: not used again, as its owner is never dropped.
        drop(unsafe { std::ptr::read(&this.pool) });
        (this.allocated_bytes, opencl3::memory::Buffer::new(this.handle()))
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.pool.subtract(self.allocated_bytes);
        // Commands that still use the memory run before those of its next owner: the queue is in order.
        self.pool
            .put_back(self.allocated_bytes, opencl3::memory::Buffer::new(self.handle()));
    }
}

/// Out-of-memory has several codes; anything else is a launch failure.
pub(crate) fn allocation_error(stage: &'static str, needed_bytes: u64, e: ClError) -> Error {
    match e.0 {
        CL_MEM_OBJECT_ALLOCATION_FAILURE | CL_OUT_OF_RESOURCES | CL_INVALID_BUFFER_SIZE => Error::OutOfDeviceMemory {
            stage,
            needed_bytes,
            limit_bytes: None,
        },
        _ => Error::Launch { stage, source: e },
    }
}
