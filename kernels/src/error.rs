//! Errors of the crate.

use crate::interned::StaticText;
use opencl3::error_codes::{CL_DEVICE_NOT_AVAILABLE, CL_DEVICE_NOT_FOUND};

/// The stage that opens a device.
pub(crate) const OPEN: &str = "open";

/// Result of everything in this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, with the stage it happened in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Error {
    /// No OpenCL loader (`libOpenCL.so.1`) on this machine.
    #[error("no OpenCL loader found: install it, on Debian with `apt-get install ocl-icd-libopencl1`")]
    NoLoader,
    /// A loader, but no driver registered with it.
    #[error(
        "the OpenCL loader found no driver: install one, for a CPU on Debian with `apt-get install pocl-opencl-icd`, \
         for a GPU its vendor's driver"
    )]
    NoDriver,
    /// Drivers are installed, but none of them offers a matching device.
    #[error("{}", no_device(wanted.as_deref(), found))]
    NoDevice {
        /// The given selector, if any.
        wanted: Option<String>,
        /// Names of the available devices.
        found: Vec<String>,
    },
    /// A program did not compile.
    #[error("stage {stage} did not build with options {options:?}:\n{log}")]
    Build {
        /// Stage whose program failed.
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::interned::deserialize"))]
        stage: StaticText,
        /// Build options.
        options: String,
        /// Log of the compiler.
        log: String,
    },
    /// A kernel could not be started or failed while running.
    #[error("stage {stage} failed on the device")]
    Launch {
        /// Stage that failed.
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::interned::deserialize"))]
        stage: StaticText,
        /// The driver's error.
        #[source]
        #[cfg_attr(feature = "serde", serde(with = "code"))]
        source: opencl3::error_codes::ClError,
    },
    /// A buffer could not be allocated.
    #[error("{}", out_of_memory(stage, *needed_bytes, *limit_bytes))]
    OutOfDeviceMemory {
        /// Stage that requested the buffer.
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::interned::deserialize"))]
        stage: StaticText,
        /// Requested bytes; 0 if no buffer was requested.
        needed_bytes: u64,
        /// Bytes the device allows for one allocation; `None` if it has less memory left than it allows.
        limit_bytes: Option<u64>,
    },
    /// A parameter or input is invalid; the text says what was expected.
    #[error("{what}: {why}")]
    Invalid {
        /// The parameter.
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::interned::deserialize"))]
        what: StaticText,
        /// The value found and the value expected.
        why: String,
    },
    /// No more programs are built for the device; the text gives the reason.
    #[error("the device is not used any more: {0}")]
    Refused(String),
    /// The gate does not allow this program to be built yet.
    #[error("the program {0} is still being checked on this device")]
    ProgramUnchecked(String),
    /// The caller's [`crate::Cancel`] cancelled the call between two stages.
    #[error("cancelled")]
    Cancelled,
}

impl Error {
    /// Whether the device exists but its driver no longer works in this process, so that only a new process can open it. NVIDIA's
    /// documentation states this for a fault of a kernel: "any further CUDA work will return the same error. To continue using CUDA, the
    /// process must be terminated and relaunched" (CUDA driver API, `CUDA_ERROR_ILLEGAL_ADDRESS`).
    pub fn needs_new_process(&self) -> bool {
        matches!(self, Self::Launch { stage: OPEN, source }
            if ![CL_DEVICE_NOT_FOUND, CL_DEVICE_NOT_AVAILABLE].contains(&source.0))
    }
}

fn out_of_memory(stage: &str, needed_bytes: u64, limit_bytes: Option<u64>) -> String {
    match (needed_bytes, limit_bytes) {
        (_, Some(limit)) => format!("stage {stage} needs {needed_bytes} bytes of device memory, the limit is {limit}"),
        // Not of a buffer.
        (0, None) => format!("the driver ran out of memory in stage {stage}"),
        (_, None) => format!("the driver ran out of memory in stage {stage}, for {needed_bytes} bytes"),
    }
}

fn no_device(wanted: Option<&str>, found: &[String]) -> String {
    match wanted {
        _ if found.is_empty() => "the OpenCL drivers offer no device: PoCL needs a folder that it can write (POCL_CACHE_DIR, else below HOME), a GPU \
             access to its device files in /dev"
            .to_owned(),
        Some(wanted) => format!("no OpenCL device matches {wanted:?}: found {found:?}"),
        None => format!("no OpenCL device: found {found:?}"),
    }
}

/// An error of OpenCL as its code.
#[cfg(feature = "serde")]
mod code {
    use opencl3::error_codes::ClError;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(error: &ClError, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_i32(error.0)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<ClError, D::Error> {
        i32::deserialize(deserializer).map(ClError)
    }
}
