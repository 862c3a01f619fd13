//! Which OpenCL devices there are, and which one is taken.

use crate::{Error, Result};
use opencl3::device::{CL_DEVICE_TYPE_ALL, CL_DEVICE_TYPE_CPU, CL_DEVICE_TYPE_GPU, Device, cl_device_id};
use opencl3::error_codes::ClError;
use opencl3::platform::get_platforms;
use std::sync::{Mutex, PoisonError};

/// `clGetPlatformIDs` could not load the OpenCL library (a code of the `cl3` crate).
const LIBRARY_NOT_LOADED: i32 = -2000;

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

/// A listed device and the driver's handle of it.
pub(crate) struct Found {
    pub info: DeviceInfo,
    pub handle: cl_device_id,
}

fn describe(platform: &str, handle: cl_device_id) -> std::result::Result<DeviceInfo, ClError> {
    let device = Device::new(handle);
    let kind = match device.dev_type()? {
        t if t & CL_DEVICE_TYPE_GPU != 0 => DeviceKind::Gpu,
        t if t & CL_DEVICE_TYPE_CPU != 0 => DeviceKind::Cpu,
        _ => DeviceKind::Other,
    };
    Ok(DeviceInfo {
        index: 0,
        platform: platform.trim().to_owned(),
        name: device.name()?.trim().to_owned(),
        kind,
        memory_bytes: device.global_mem_size()?,
        max_allocation_bytes: device.max_mem_alloc_size()?,
        compute_units: device.max_compute_units()?,
        version: device.version()?.trim().to_owned(),
        driver: device.driver_version()?.trim().to_owned(),
    })
}

/// Held while devices are looked for: drivers initialise themselves on first use, and PoCL 3.1 crashes or finds nothing when
/// two threads make it do so at once.
static LOOKING: Mutex<()> = Mutex::new(());

/// All devices, preferred first: a GPU before anything else, then more memory before less.
pub(crate) fn find() -> Result<Vec<Found>> {
    let _looking = LOOKING.lock().unwrap_or_else(PoisonError::into_inner);
    let platforms = get_platforms().map_err(|e| {
        if e.0 == LIBRARY_NOT_LOADED {
            Error::NoLoader
        } else {
            Error::NoDriver
        }
    })?;
    if platforms.is_empty() {
        return Err(Error::NoDriver);
    }
    let mut found = Vec::new();
    for platform in platforms {
        let name = platform.name().unwrap_or_else(|_| "unnamed platform".to_owned());
        // A platform without devices answers with an error; the others may still have some.
        for handle in platform.get_devices(CL_DEVICE_TYPE_ALL).unwrap_or_default() {
            match describe(&name, handle) {
                Ok(info) => found.push(Found { info, handle }),
                Err(e) => tracing::warn!("a device of {name:?} does not answer and is left out: {e}"),
            }
        }
    }
    found.sort_by_key(|f| (f.info.kind != DeviceKind::Gpu, std::cmp::Reverse(f.info.memory_bytes)));
    for (index, f) in found.iter_mut().enumerate() {
        f.info.index = index;
    }
    if found.is_empty() {
        return Err(Error::NoDevice {
            wanted: None,
            found: Vec::new(),
        });
    }
    Ok(found)
}

/// The preferred device, or the one that `selector` names by index or by a part of its name or platform.
pub(crate) fn select(selector: Option<&str>) -> Result<Found> {
    let mut found = find()?;
    let Some(wanted) = selector else {
        return Ok(found.remove(0));
    };
    let at = match wanted.parse::<usize>() {
        Ok(index) => (index < found.len()).then_some(index),
        Err(_) => {
            let wanted = wanted.to_lowercase();
            found.iter().position(|f| {
                f.info.name.to_lowercase().contains(&wanted) || f.info.platform.to_lowercase().contains(&wanted)
            })
        }
    };
    match at {
        Some(at) => Ok(found.remove(at)),
        None => Err(Error::NoDevice {
            wanted: Some(wanted.to_owned()),
            found: found.into_iter().map(|f| f.info.name).collect(),
        }),
    }
}

/// Lists the devices of every platform, preferred first.
///
/// # Errors
/// [`Error::NoLoader`], [`Error::NoDriver`] or [`Error::NoDevice`].
pub fn list() -> Result<Vec<DeviceInfo>> {
    Ok(find()?.into_iter().map(|f| f.info).collect())
}
