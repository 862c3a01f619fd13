//! Device memory: typed buffers that count what they take.

use crate::{Error, Result};
use opencl3::context::Context;
use opencl3::error_codes::{CL_INVALID_BUFFER_SIZE, CL_MEM_OBJECT_ALLOCATION_FAILURE, CL_OUT_OF_RESOURCES, ClError};
use opencl3::memory::{CL_MEM_READ_WRITE, ClMem};
use opencl3::types::cl_mem;
use std::cell::Cell;
use std::rc::Rc;

/// Bytes on the device, now and at most.
#[derive(Default)]
pub(crate) struct Meter {
    now: Cell<u64>,
    peak: Cell<u64>,
}

impl Meter {
    fn add(&self, bytes: u64) {
        self.now.set(self.now.get() + bytes);
        self.peak.set(self.peak.get().max(self.now.get()));
    }

    /// Forgets earlier peaks and answers the bytes allocated now.
    pub fn restart(&self) -> u64 {
        self.peak.set(self.now.get());
        self.now.get()
    }

    /// Most bytes allocated since [`Meter::restart`].
    pub fn peak(&self) -> u64 {
        self.peak.get()
    }
}

/// `len` elements of `T` on the device.
pub(crate) struct Buffer<T> {
    inner: opencl3::memory::Buffer<T>,
    len: usize,
    meter: Rc<Meter>,
}

impl<T> Buffer<T> {
    /// Allocates room for `len` elements (at least one, as OpenCL has no empty buffers); contents are undefined.
    pub fn new(
        context: &Context,
        meter: &Rc<Meter>,
        limit_bytes: u64,
        stage: &'static str,
        len: usize,
    ) -> Result<Self> {
        let bytes = len.max(1) as u64 * size_of::<T>() as u64;
        if bytes > limit_bytes {
            return Err(Error::OutOfDeviceMemory {
                stage,
                needed_bytes: bytes,
                limit_bytes,
            });
        }
        // SAFETY: no host pointer is passed, so OpenCL allocates the memory itself.
        let inner =
            unsafe { opencl3::memory::Buffer::create(context, CL_MEM_READ_WRITE, len.max(1), std::ptr::null_mut()) }
                .map_err(|e| allocation_error(stage, bytes, limit_bytes, e))?;
        meter.add(bytes);
        Ok(Self {
            inner,
            len,
            meter: meter.clone(),
        })
    }

    /// Elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.len.max(1) as u64 * size_of::<T>() as u64
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
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.meter.now.set(self.meter.now.get() - self.bytes());
    }
}

/// Out-of-memory has several codes; anything else is a launch failure.
pub(crate) fn allocation_error(stage: &'static str, needed_bytes: u64, limit_bytes: u64, e: ClError) -> Error {
    match e.0 {
        CL_MEM_OBJECT_ALLOCATION_FAILURE | CL_OUT_OF_RESOURCES | CL_INVALID_BUFFER_SIZE => Error::OutOfDeviceMemory {
            stage,
            needed_bytes,
            limit_bytes,
        },
        _ => Error::Launch { stage, source: e },
    }
}
