//! Surfaces of views, and questions on them.

use isopeel_extraction::{
    Answer, Ask, Extract, Extraction, Making, Prepare, Question, Resolve, ShownSurface, WorkError,
};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::Caller;
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Fills in values that depend on the data: the default isovalue and the feature's own range. Cancelling `token` or dropping the future
    /// cancels the job before its next stage.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn resolve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(Caller::Viewer, Resolve { volume, view }, token).await
    }

    /// As [`DeviceWorker::resolve`], and loads the fields that the view's surface is made of.
    ///
    /// # Errors
    /// [`WorkError`]; [`WorkError::Edit`] if there is no isovalue to choose, or a computed field has no values.
    pub async fn prepare(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(Caller::Viewer, Prepare { volume, view }, token).await
    }

    /// Makes the final surface of a view with its measured error, unless it has more than `ceiling` triangles. `token` as in
    /// [`DeviceWorker::resolve`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        ceiling: u64,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let request = Extract {
            volume: volume.clone(),
            view: view.clone(),
            making: Making {
                ceiling,
                ..Making::default()
            },
        };
        self.perform(Caller::Request, request, token).await
    }

    /// Answers a question about the surface that a viewer is shown; if none is shown, a probe is answered for the volume alone. `token` as
    /// in [`DeviceWorker::resolve`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn answer(
        &self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        token: &CancellationToken,
    ) -> Result<Answer, WorkError> {
        let request = Ask {
            volume: volume.clone(),
            shown: shown.cloned(),
            question,
        };
        self.perform(Caller::Viewer, request, token).await
    }
}
