//! Read-ahead: while a viewer goes through the time steps one by one, the server loads the next step before the viewer reaches it.
//! Read-ahead never evicts data in use: neither volumes that jobs work on (`pins`), nor time steps that viewers have open
//! ([`OpenStepGuard`]).

use isopeel_extraction::{MakeSpaceAhead, Masking, OpenStepGuard, VolumeKey, WorkError, view_keys, with_inputs};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Marks a time step as open in a viewer until the returned guard is dropped.
    pub fn mark_open(&self, volume: &VolumeStep) -> OpenStepGuard {
        self.shared.open_steps.mark(&volume.key())
    }

    /// Loads the fields that views use onto the device, one after the other. Skips fields that are resident or do not fit. A field
    /// fits if there is space beside all volumes in use, and if it does not raise the bytes of fields that were read ahead but not
    /// used yet above `budget`. A load that has begun is finished unless `token` is cancelled, even if the future is dropped.
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
            // Reads only fields that come from files. The device computes the other fields from these when they are needed.
            let inputs = with_inputs(volume, &view_keys(volume, view), Masking::OnDevice);
            for key in inputs.into_iter().filter(|key| !key.is_computed(volume)) {
                if !keys.contains(&key) {
                    keys.push(key);
                }
            }
        }
        for key in keys {
            let permit = tokio::select! {
                permit = self.shared.ahead_permits.acquire() => permit.map_err(|_| WorkError::Stopped)?,
                () = token.cancelled() => return Ok(()),
            };
            if token.is_cancelled() {
                return Ok(());
            }
            if self.make_space_ahead(volume, &key, budget).await? {
                self.load_ahead(volume, key, budget, token).await?;
            }
            drop(permit);
        }
        Ok(())
    }

    /// Makes space on the device for a field that is not resident. Returns false if the field is not to be loaded, because it is resident,
    /// or because space for it would exceed the budget or take memory from data in use.
    async fn make_space_ahead(&self, volume: &VolumeStep, key: &VolumeKey, budget: u64) -> Result<bool, WorkError> {
        let request = MakeSpaceAhead {
            volume: volume.clone(),
            key: key.clone(),
            budget,
        };
        self.run_for_cache(request).await
    }
}
