//! Volumes at a low resolution, made in slices of work.

use isopeel_kernels::{OverviewPart, OverviewValues};
use isopeel_volumes::VolumeStep;

use super::WorkError;
use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

impl Workspace {
    /// Returns the values of a part of an overview.
    ///
    /// # Errors
    /// [`JobError::NotResident`], and the device's errors.
    pub fn overview_values(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        part: &OverviewPart,
    ) -> Result<OverviewValues, JobError> {
        self.use_field(volume, key)?;
        let resident = self.resident(key).ok_or(WorkError::Stopped)?;
        Ok(self.engine().overview_values(resident, part)?)
    }
}
