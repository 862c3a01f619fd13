//! Samples of a field, as they are on the device.

use std::ops::Range;

use isopeel_kernels::{SampleType, Samples, bulk};
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use super::WorkError;
use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

/// A plane of samples.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Slice {
    /// Type of the samples.
    pub sample_type: SampleType,
    /// Little-endian, the lower of the plane's axes fastest.
    #[serde(with = "bulk")]
    pub bytes: Vec<u8>,
}

impl Workspace {
    /// Returns the samples of these planes across z.
    ///
    /// # Errors
    /// [`JobError::NotResident`], and the device's errors.
    pub fn samples(&mut self, volume: &VolumeStep, key: &VolumeKey, planes: Range<u32>) -> Result<Samples, JobError> {
        self.use_field(volume, key)?;
        let resident = self.resident(key).ok_or(WorkError::Stopped)?;
        Ok(self.engine().download(resident, planes)?)
    }

    /// Returns the plane of a field across an axis (0 to 2).
    ///
    /// # Errors
    /// [`JobError::NotResident`], and the device's errors.
    pub fn slice(&mut self, volume: &VolumeStep, key: &VolumeKey, axis: usize, index: u32) -> Result<Slice, JobError> {
        self.use_field(volume, key)?;
        let resident = self.resident(key).ok_or(WorkError::Stopped)?;
        Ok(Slice {
            sample_type: resident.sample_type(),
            bytes: self.engine().slice(resident, axis, index)?,
        })
    }
}
