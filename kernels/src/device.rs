//! Which OpenCL devices there are, and which one is taken.

use crate::{Error, Result};

/// What kind of processor a device is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceKind {
    /// A graphics processor.
    Gpu,
    /// The host's own processor.
    Cpu,
    /// Anything else (accelerators, custom devices).
    Other,
}

/// A device as `isopeel devices` lists it.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceInfo {
    /// Position in the list, in order of preference: GPUs first, then by memory.
    pub index: usize,
    /// Name of its platform.
    pub platform: String,
    /// Name of the device.
    pub name: String,
    /// What kind of processor.
    pub kind: DeviceKind,
    /// Global memory in bytes.
    pub memory_bytes: u64,
    /// Largest single allocation in bytes.
    pub max_allocation_bytes: u64,
    /// Compute units.
    pub compute_units: u32,
    /// Version string of the device, e.g. `OpenCL 3.0 CUDA`.
    pub version: String,
    /// Version string of its driver.
    pub driver: String,
}

/// Lists the devices of every platform, preferred first.
///
/// # Errors
/// [`Error::NoLoader`], [`Error::NoDriver`] or [`Error::NoDevice`].
pub fn list() -> Result<Vec<DeviceInfo>> {
    Err(Error::NoDriver)
}
