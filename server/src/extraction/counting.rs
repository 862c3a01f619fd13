//! Counts the triangles of the full surface of a view. This builds the view's pyramid, which the first step then uses.

use std::time::Instant;

use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, JobContext, Length};
use super::worker_state::{JobError, Nodes, WorkerState};
use super::{DeviceWorker, FullCount, WorkError};

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

impl WorkerState {
    fn count(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        context: &mut JobContext<'_, Self>,
    ) -> Result<FullCount, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, context, |on, _, _| {
            Ok(FullCount {
                triangles: on.pyramid.full_triangles(),
                stages: on.new_pyramid_stages().to_vec(),
                wall: on.own_time(start),
            })
        })
    }
}
