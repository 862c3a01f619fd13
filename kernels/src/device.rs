//! Lists OpenCL devices and selects one.

use crate::lock::lock;
use crate::{Error, Result};
use opencl3::device::{CL_DEVICE_TYPE_ALL, CL_DEVICE_TYPE_CPU, CL_DEVICE_TYPE_GPU, Device};
use opencl3::error_codes::ClError;
use opencl3::platform::{Platform, get_platforms};
use std::sync::Mutex;

/// `clGetPlatformIDs` could not load the OpenCL library (a code of the `cl3` crate).
const LIBRARY_NOT_LOADED: i32 = -2000;

/// Platform of PoCL.
pub const POCL: &str = "Portable Computing Language";

/// What kind of processor a device is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DeviceInfo {
    /// Position in the list, in order of preference: GPUs first, then by driver and memory.
    pub index: usize,
    /// Name of its platform.
    pub platform: String,
    /// Version string of its platform, in which some drivers name their compiler, e.g. `OpenCL 3.0 PoCL 6.0 … LLVM 18.1.8`.
    pub platform_version: String,
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
    /// Largest number of work-items in a work-group.
    pub max_work_group: usize,
    /// Version string of the device, e.g. `OpenCL 3.0 CUDA`.
    pub version: String,
    /// Version string of its driver.
    pub driver: String,
}

impl DeviceInfo {
    /// Orders devices, preferred first: GPUs; then by driver, as several may offer the same processor: PoCL, Intel's, others, Mesa's, which
    /// compiles longest; then more memory before less.
    pub fn preference(&self) -> impl Ord + use<> {
        let driver = match self.platform.as_str() {
            _ if self.kind == DeviceKind::Gpu => 0,
            POCL => 0,
            _ if self.is_intel_runtime() => 1,
            "rusticl" => 3,
            _ => 2,
        };
        (
            self.kind != DeviceKind::Gpu,
            driver,
            std::cmp::Reverse(self.memory_bytes),
        )
    }

    /// Whether the driver is Intel's.
    pub fn is_intel_runtime(&self) -> bool {
        self.platform.starts_with("Intel(R) OpenCL")
    }

    /// Major version of PoCL, if that is the device's driver.
    pub fn pocl_version(&self) -> Option<u32> {
        let digits = self.driver.split(['.', '-', '+', ' ']).next()?;
        (self.platform == POCL).then_some(())?;
        digits.parse().ok()
    }
}

/// A listed device.
pub(crate) struct Found {
    pub info: DeviceInfo,
    pub device: Device,
}

fn name_of(platform: &Platform) -> String {
    let name = platform.name();
    name.map_or_else(|_| "unnamed platform".to_owned(), |name| name.trim().to_owned())
}

fn describe(platform: &Platform, device: &Device) -> std::result::Result<DeviceInfo, ClError> {
    let kind = match device.dev_type()? {
        t if t & CL_DEVICE_TYPE_GPU != 0 => DeviceKind::Gpu,
        t if t & CL_DEVICE_TYPE_CPU != 0 => DeviceKind::Cpu,
        _ => DeviceKind::Other,
    };
    Ok(DeviceInfo {
        index: 0,
        platform: name_of(platform),
        platform_version: platform.version().unwrap_or_default().trim().to_owned(),
        name: device.name()?.trim().to_owned(),
        kind,
        memory_bytes: device.global_mem_size()?,
        max_allocation_bytes: device.max_mem_alloc_size()?,
        compute_units: device.max_compute_units()?,
        max_work_group: device.max_work_group_size()?,
        version: device.version()?.trim().to_owned(),
        driver: device.driver_version()?.trim().to_owned(),
    })
}

/// Held while devices are listed: drivers initialise themselves on first use, and PoCL 3.1 crashes or finds no device if two
/// threads initialise it at once.
static LOOKING: Mutex<()> = Mutex::new(());

/// All devices, preferred first, by [`DeviceInfo::preference`].
pub(crate) fn find() -> Result<Vec<Found>> {
    let _looking = lock(&LOOKING);
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
        // A platform without devices returns an error; other platforms may still have devices.
        for handle in platform.get_devices(CL_DEVICE_TYPE_ALL).unwrap_or_default() {
            let device = Device::new(handle);
            match describe(&platform, &device) {
                Ok(info) => found.push(Found { info, device }),
                Err(e) => {
                    let name = name_of(&platform);
                    tracing::warn!("a device of {name:?} does not answer and is left out: {e}");
                }
            }
        }
    }
    found.sort_by_key(|f| f.info.preference());
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

/// Returns the index of the device that `selector` names by index or by a part of its name or platform.
pub fn position(devices: &[DeviceInfo], selector: &str) -> Option<usize> {
    if let Ok(index) = selector.parse::<usize>() {
        return (index < devices.len()).then_some(index);
    }
    let wanted = selector.to_lowercase();
    let has = |text: &str| text.to_lowercase().contains(&wanted);
    devices
        .iter()
        .position(|device| has(&device.name) || has(&device.platform))
}

/// The preferred device, or the one that `selector` names by index or by a part of its name or platform.
pub(crate) fn select(selector: Option<&str>) -> Result<Found> {
    let mut found = find()?;
    let Some(wanted) = selector else {
        return Ok(found.remove(0));
    };
    let infos: Vec<_> = found.iter().map(|f| f.info.clone()).collect();
    let at = position(&infos, wanted);
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
