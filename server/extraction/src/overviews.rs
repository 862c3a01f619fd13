//! Volumes at a low resolution, made in slices of work.

use isopeel_kernels::OverviewWork;
use isopeel_volumes::VolumeStep;

use super::WorkError;
use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

impl Workspace {
    /// Runs the next slice of work; returns whether it was the last one.
    ///
    /// # Errors
    /// [`JobError::NotResident`], and the device's errors.
    pub fn continue_overview(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        work: &mut OverviewWork,
    ) -> Result<bool, JobError> {
        if work.is_done() {
            return Ok(true);
        }
        self.use_field(volume, key)?;
        let resident = self.resident(key).ok_or(WorkError::Stopped)?;
        self.engine().continue_overview(resident, work)?;
        Ok(work.is_done())
    }
}
