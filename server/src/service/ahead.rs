//! Read-ahead: while a viewer goes through the time steps one by one, loads the next steps before the viewer reaches them. Read-ahead takes
//! no memory from data in use: neither from volumes that jobs work on (`pins`), nor from time steps that viewers have open
//! ([`OpenStepGuard`]).

use isopeel_extraction::{JobError, Masking, VolumeKey, WorkError, padded_grid, view_keys, with_inputs};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::open_steps::OpenStepGuard;
use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub fn hold(&self, volume: &VolumeStep) -> OpenStepGuard {
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
            for key in all.into_iter().filter(|key| !key.is_computed(volume)) {
                if !keys.contains(&key) {
                    keys.push(key);
                }
            }
        }
        for key in keys {
            let permit = tokio::select! {
                permit = self.shared.ahead.permits.acquire() => permit.map_err(|_| WorkError::Stopped)?,
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

    /// Returns a predicate: whether a viewer has the time step of a field open.
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
