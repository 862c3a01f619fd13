//! Counts the triangles of the full surface of a view. This builds the view's pyramid, which the first step then uses.

use isopeel_extraction::{FullCount, WorkError};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::DeviceWorker;
use super::scheduler::{Caller, Length};

impl DeviceWorker {
    /// Counts the full surface of a view. `token` as in [`DeviceWorker::extract`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn count(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<FullCount, WorkError> {
        let view = view.clone();
        self.with_volumes(
            volume,
            token,
            Caller::Viewer,
            Length::Short,
            move |state, volume, context| state.count(volume, &mut view.clone(), context),
        )
        .await
    }
}
