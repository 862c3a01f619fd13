//! Frees the data of a time step that nothing will use again.

use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Frees the samples, pyramids and vertex trees of a time step. If the device is lost, they are gone anyway.
    pub async fn release(&self, volume: &VolumeStep) {
        let (never, step) = (CancellationToken::new(), volume.key());
        let freed = self.run(&never, Caller::Cache, Length::Short, move |state, _| {
            state.release(&step);
            Ok(())
        });
        let _ = freed.await;
    }
}
