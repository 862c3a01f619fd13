//! Read-ahead of fields of time steps that a viewer may reach next. Read-ahead takes no memory from data in use: neither from pinned
//! volumes, nor from time steps that viewers have open.

use isopeel_kernels::{Error, RectilinearGrid, SampleType};

use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

impl Workspace {
    /// Starts the upload of a field that is read ahead. Returns false if there is no space for the field.
    ///
    /// # Errors
    /// The device's errors.
    pub fn begin_upload_ahead(
        &mut self,
        key: &VolumeKey,
        grid: &RectilinearGrid,
        sample_type: SampleType,
        missing: Option<f32>,
        budget: u64,
    ) -> Result<bool, JobError> {
        let bytes = self.engine().upload_bytes(grid.grid(), sample_type.bytes());
        if !self.make_space_ahead(bytes, budget) {
            return Ok(false);
        }
        match self.engine().begin_upload(grid, sample_type, missing) {
            Err(Error::OutOfDeviceMemory { .. }) => Ok(false),
            upload => {
                self.uploads.insert(key.clone(), (bytes, upload?));
                Ok(true)
            }
        }
    }

    /// Evicts volumes that are not in use until `bytes` fit. First evicts volumes that were read ahead and never used, the oldest first,
    /// until those that remain and the new one are within `budget` bytes. Then evicts others. If this cannot free enough, evicts nothing
    /// and returns false.
    pub fn make_space_ahead(&mut self, bytes: u64, budget: u64) -> bool {
        let (pins, open_steps) = (&self.pins, &self.open_steps);
        let is_in_use = |key: &VolumeKey| pins.holds(key) || open_steps.contains(&key.step);
        let bytes_in_use: u64 = self
            .volumes
            .costs()
            .filter(|(key, _)| is_in_use(key))
            .map(|(_, bytes)| bytes)
            .sum();
        let uploads = self.upload_bytes();
        if bytes > budget || bytes_in_use.saturating_add(bytes + uploads) > self.volumes.budget() {
            return false;
        }
        let volumes = &self.volumes;
        self.ahead.retain(|key| volumes.peek(key).is_some() && !is_in_use(key));
        let cost = |key: &VolumeKey| {
            volumes
                .costs()
                .find(|(other, _)| *other == key)
                .map_or(0, |(_, bytes)| bytes)
        };
        let mut ahead_bytes: u64 = self.ahead.iter().map(cost).sum();
        let mut evicted = 0;
        while ahead_bytes.saturating_add(bytes) > budget && evicted < self.ahead.len() {
            ahead_bytes -= cost(&self.ahead[evicted]);
            evicted += 1;
        }
        let evicted: Vec<VolumeKey> = self.ahead.drain(..evicted).collect();
        self.volumes.retain(|key| !evicted.contains(key));
        self.volumes.evict_for(bytes + uploads, |key| !is_in_use(key));
        true
    }
}
