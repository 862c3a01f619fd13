//! Device memory: typed buffers from a pool that accounts for them.

use crate::lock::lock;
use crate::{Error, Result};
use opencl3::context::Context;
use opencl3::error_codes::{CL_INVALID_BUFFER_SIZE, CL_MEM_OBJECT_ALLOCATION_FAILURE, CL_OUT_OF_RESOURCES, ClError};
use opencl3::memory::{CL_MEM_READ_WRITE, ClMem};
use opencl3::types::cl_mem;
use std::mem::ManuallyDrop;
use std::sync::{Arc, Mutex};

/// Bytes allocated on a device; on a CPU they are the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
pub(crate) struct Pool(Mutex<Account>);

struct Account {
    now: u64,
    /// Bytes that [`Buffer::lend`] took out and that are not back yet.
    lent: u64,
    peak: u64,
    /// Freed allocations and their bytes, least recently used first.
    idle: Vec<(u64, opencl3::memory::Buffer<u8>)>,
    /// Maximum bytes in `idle`.
    idle_limit: u64,
}

impl Pool {
    /// A pool that keeps at most `idle_limit` freed bytes.
    pub fn new(idle_limit: u64) -> Self {
        Self(Mutex::new(Account {
            now: 0,
            lent: 0,
            peak: 0,
            idle: Vec::new(),
            idle_limit,
        }))
    }

    /// Lowers the limit of idle bytes to `bytes`. A limit that is already lower stays.
    pub fn limit_idle(&self, bytes: u64) {
        let mut account = lock(&self.0);
        account.idle_limit = account.idle_limit.min(bytes);
    }

    /// Releases all that is idle.
    pub fn release_idle(&self) {
        lock(&self.0).idle.clear();
    }

    /// Resets the peak; returns the bytes in use.
    pub fn restart(&self) -> u64 {
        let mut account = lock(&self.0);
        account.peak = account.now;
        account.now
    }

    /// Peak of the bytes in use since [`Pool::restart`].
    pub fn peak(&self) -> u64 {
        lock(&self.0).peak
    }

    /// Bytes in use, idle and lent.
    pub fn memory(&self) -> DeviceMemory {
        let account = lock(&self.0);
        DeviceMemory {
            in_use: account.now,
            idle: account.idle.iter().map(|(bytes, _)| bytes).sum(),
            lent: account.lent,
        }
    }

    /// Takes back lent memory.
    pub fn take_back(&self, bytes: u64, memory: opencl3::memory::Buffer<u8>) {
        let mut account = lock(&self.0);
        account.lent -= bytes;
        account.put_back(bytes, memory);
    }
}

impl Account {
    fn add(&mut self, bytes: u64) {
        self.now += bytes;
        self.peak = self.peak.max(self.now);
    }

    /// The smallest idle allocation of at least `bytes` and at most a quarter more.
    fn take(&mut self, bytes: u64) -> Option<(u64, cl_mem)> {
        let fits = |&(has, _): &(u64, _)| has >= bytes && has - bytes <= (bytes / 4).max(1 << 16);
        let idle = &mut self.idle;
        let tightest = (0..idle.len()).filter(|&i| fits(&idle[i])).min_by_key(|&i| idle[i].0)?;
        let (has, memory) = idle.remove(tightest);
        Some((has, ManuallyDrop::new(memory).get()))
    }

    /// Takes memory that is no longer in use; releases the oldest while the idle memory exceeds the limit.
    fn put_back(&mut self, bytes: u64, memory: opencl3::memory::Buffer<u8>) {
        self.idle.push((bytes, memory));
        let mut total: u64 = self.idle.iter().map(|(bytes, _)| bytes).sum();
        let limit = self.idle_limit;
        self.idle.retain(|(bytes, _)| {
            let keep = total <= limit;
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
    pool: Arc<Pool>,
}

impl<T> Buffer<T> {
    /// Returns a buffer of `len` elements (at least one, as OpenCL has no empty buffers) with undefined contents, and whether its
    /// memory is new instead of reused.
    pub fn new(
        context: &Context,
        pool: &Arc<Pool>,
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
        let earlier = lock(&pool.0).take(bytes);
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
        lock(&pool.0).add(allocated_bytes);
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
        {
            let mut account = lock(&this.pool.0);
            account.now -= this.allocated_bytes;
            account.lent += this.allocated_bytes;
        }
        // SAFETY: not used again, as its owner is never dropped.
        drop(unsafe { std::ptr::read(&this.pool) });
        (this.allocated_bytes, opencl3::memory::Buffer::new(this.handle()))
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        let mut account = lock(&self.pool.0);
        account.now -= self.allocated_bytes;
        // Commands that still use the memory run before those of its next owner: the queue is in order.
        account.put_back(self.allocated_bytes, opencl3::memory::Buffer::new(self.handle()));
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
