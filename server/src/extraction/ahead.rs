//! Read-ahead: while a viewer goes through the time steps one by one, loads the next steps before the viewer reaches them. Read-ahead takes
//! no memory from data in use: neither from volumes that jobs work on (`pins`), nor from time steps that viewers have open ([`Held`]).

use isopeel_kernels::{Error, RectilinearGrid, SampleType};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::grids::padded_grid;
use super::keys::{Masking, VolumeKey, view_keys, with_inputs};
use super::open_steps::Held;
use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;
use super::worker_state::{JobError, WorkerState};

impl DeviceWorker {
    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub fn hold(&self, volume: &VolumeStep) -> Held {
        self.shared.ahead.hold(&volume.key())
    }

    /// Loads the fields that views use onto the device, if they fit into the `budget` bytes of fields that were read ahead and are not used
    /// yet, and beside all volumes in use. A load that has begun is finished unless `token` is cancelled, even if the future is dropped.
    ///
    /// # Errors
    /// Errors of the file or of the device.
    pub async fn read_ahead(
        &self,
        volume: &VolumeStep,
        views: &[View],
        budget: u64,
        token: &CancellationToken,
    ) -> Result<(), WorkError> {
        if budget == 0 {
            return Ok(());
        }
        let mut keys: Vec<VolumeKey> = Vec::new();
        for view in views {
            // Reads only fields that come from files: the device computes the others from them when they are needed.
            let all = with_inputs(volume, &view_keys(volume, view), Masking::OnDevice);
            for key in all.into_iter().filter(|key| key.recipe(volume).is_none()) {
                if !keys.contains(&key) {
                    keys.push(key);
                }
            }
        }
        let turn = &self.shared.ahead.turn;
        for key in keys {
            let permit = tokio::select! {
                permit = turn.acquire() => permit.map_err(|_| WorkError::Stopped)?,
                () = token.cancelled() => return Ok(()),
            };
            if token.is_cancelled() || !self.has_space_ahead(volume, &key, budget).await? {
                return Ok(());
            }
            self.load_ahead(volume, key, budget, token).await?;
            drop(permit);
        }
        Ok(())
    }

    /// Whether a viewer has the time step of a field open.
    pub(super) fn is_open(&self) -> impl Fn(&VolumeKey) -> bool + Send + use<> {
        self.shared.ahead.is_open()
    }

    /// Makes space for a field that is not resident. Returns false if it is resident already, or if space would have to come from data in
    /// use or from beyond the budget.
    async fn has_space_ahead(&self, volume: &VolumeStep, key: &VolumeKey, budget: u64) -> Result<bool, WorkError> {
        let (never, key, is_used) = (CancellationToken::new(), key.clone(), self.is_open());
        let grid = padded_grid(volume, key.padded)?;
        let sample_bytes = key.sample_bytes(volume)?;
        let job = self.run(&never, Caller::Cache, Length::Short, move |state, _| {
            let bytes = state.engine().upload_bytes(grid.grid(), sample_bytes);
            Ok::<_, JobError>(!state.is_resident(&key) && state.make_space_ahead(bytes, budget, &is_used))
        });
        Ok(job.await?)
    }
}

impl WorkerState {
    /// Starts the upload of a field that is read ahead, if there is space for it; returns false if there is none.
    pub(super) fn begin_upload_ahead(
        &mut self,
        key: &VolumeKey,
        grid: &RectilinearGrid,
        sample_type: SampleType,
        missing: Option<f32>,
        budget: u64,
        is_used: &dyn Fn(&VolumeKey) -> bool,
    ) -> Result<bool, JobError> {
        let bytes = self.engine().upload_bytes(grid.grid(), sample_type.bytes());
        if !self.make_space_ahead(bytes, budget, is_used) {
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
    pub(super) fn make_space_ahead(&mut self, bytes: u64, budget: u64, is_used: &dyn Fn(&VolumeKey) -> bool) -> bool {
        let pins = &self.pins;
        let stays = |key: &VolumeKey| pins.holds(key) || is_used(key);
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
