//! Fields of time steps that a viewer may reach next. They take no memory from data in use: neither from pinned volumes, nor from time steps
//! that viewers have open.

use isopeel_kernels::{Error, RectilinearGrid, SampleType};

use super::job_error::JobError;
use super::keys::VolumeKey;
use super::workspace::Workspace;

impl Workspace {
    /// Starts the upload of a field that is read ahead, if there is space for it; returns false if there is none.
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

    /// Evicts volumes that are not in use until `bytes` fit: first those that were read ahead and never used, oldest first, until they and
    /// the new one keep the budget; then others. Returns false, and evicts nothing, if that cannot free enough.
    pub fn make_space_ahead(&mut self, bytes: u64, budget: u64) -> bool {
        let (pins, open_steps) = (&self.pins, &self.open_steps);
        let stays = |key: &VolumeKey| pins.holds(key) || open_steps.contains(&key.step);
        let kept: u64 = self
            .volumes
            .costs()
            .filter(|(key, _)| stays(key))
            .map(|(_, bytes)| bytes)
            .sum();
        let uploads = self.upload_bytes();
        if bytes > budget || kept.saturating_add(bytes + uploads) > self.volumes.budget() {
            return false;
        }
        let volumes = &self.volumes;
        self.ahead.retain(|key| volumes.peek(key).is_some() && !stays(key));
        let cost = |key: &VolumeKey| {
            volumes
                .costs()
                .find(|(other, _)| *other == key)
                .map_or(0, |(_, bytes)| bytes)
        };
        let mut held: u64 = self.ahead.iter().map(cost).sum();
        let mut gone = 0;
        while held.saturating_add(bytes) > budget && gone < self.ahead.len() {
            held -= cost(&self.ahead[gone]);
            gone += 1;
        }
        let gone: Vec<VolumeKey> = self.ahead.drain(..gone).collect();
        self.volumes.retain(|key| !gone.contains(key));
        self.volumes.evict_for(bytes + uploads, |key| !stays(key));
        true
    }
}
