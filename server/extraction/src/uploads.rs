//! Uploads of fields to the device, piece by piece between other jobs.

use std::sync::Arc;

use isopeel_kernels::{Error, RectilinearGrid, SampleType, Samples};

use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

impl Workspace {
    /// Allocates a field on the device. Evicts the least recently used fields to make space for it.
    ///
    /// # Errors
    /// The device's errors.
    pub fn begin_upload(
        &mut self,
        key: VolumeKey,
        grid: &RectilinearGrid,
        sample_type: SampleType,
        missing: Option<f32>,
    ) -> Result<(), JobError> {
        let bytes = self.engine().upload_bytes(grid.grid(), sample_type.bytes());
        self.uploads.remove(&key);
        self.evict_for(bytes + self.upload_bytes());
        let upload =
            self.or_after_clearing_caches(|workspace| workspace.engine().begin_upload(grid, sample_type, missing))?;
        self.uploads.insert(key, (bytes, upload));
        Ok(())
    }

    /// Sends the next samples of a field to the device. Does nothing if its upload was dropped.
    ///
    /// # Errors
    /// The device's errors.
    pub fn continue_upload(&mut self, key: &VolumeKey, samples: &Samples) -> Result<(), JobError> {
        let Some((bytes, mut upload)) = self.uploads.remove(key) else {
            return Ok(());
        };
        self.or_after_clearing_caches(|workspace| workspace.engine().continue_upload(&mut upload, samples))?;
        self.uploads.insert(key.clone(), (bytes, upload));
        Ok(())
    }

    /// Makes the next part of a field's min/max table; returns true once it is complete, or if the upload was dropped.
    ///
    /// # Errors
    /// The device's errors.
    pub fn continue_table(&mut self, key: &VolumeKey) -> Result<bool, JobError> {
        let Some((bytes, mut upload)) = self.uploads.remove(key) else {
            return Ok(true);
        };
        let is_complete = self.or_after_clearing_caches(|workspace| workspace.engine().continue_table(&mut upload));
        self.uploads.insert(key.clone(), (bytes, upload));
        is_complete
    }

    /// Makes a field resident once all of its samples are on the device, unless its upload was dropped. `is_ahead`: whether the field was
    /// read ahead, before a viewer needed it.
    ///
    /// # Errors
    /// The device's errors.
    pub fn finish_upload(&mut self, key: VolumeKey, is_ahead: bool) -> Result<(), JobError> {
        let Some((bytes, upload)) = self.uploads.remove(&key) else {
            return Ok(());
        };
        let volume = self.engine().finish_upload(upload)?;
        tracing::info!(
            dataset = key.step.dataset.id,
            field = key.field,
            step = key.step.step,
            bytes,
            ahead = is_ahead,
            "volume resident"
        );
        if is_ahead {
            self.ahead.push(key.clone());
        }
        self.add_volume(key, bytes, Arc::new(volume));
        Ok(())
    }

    /// Frees the partial upload of a field that will not be completed.
    pub fn drop_upload(&mut self, key: &VolumeKey) {
        self.uploads.remove(key);
    }

    /// Returns the bytes of the fields that are being uploaded.
    pub(crate) fn upload_bytes(&self) -> u64 {
        self.uploads.values().map(|(bytes, _)| bytes).sum()
    }

    /// Runs an allocation on the device. If the device is out of memory, drops all caches and retries once.
    fn or_after_clearing_caches<T>(&mut self, mut work: impl FnMut(&Self) -> Result<T, Error>) -> Result<T, JobError> {
        match work(self) {
            Err(Error::OutOfDeviceMemory { .. }) if self.free_all_but(&[]) => Ok(work(self)?),
            other => Ok(other?),
        }
    }
}
