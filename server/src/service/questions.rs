//! Questions on the current surface of a viewer.

use isopeel_extraction::{Answer, JobContext, Question, ShownSurface, WorkError, Workspace};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Answers a question about the surface that a viewer is shown; if none is shown, a probe is answered for the volume alone. `token` as
    /// in [`DeviceWorker::extract`].
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
        let shown = shown.cloned();
        let job = move |state: &mut Workspace, volume: &VolumeStep, context: &mut JobContext<'_, Workspace>| {
            state.answer(volume, shown.as_ref(), question, context)
        };
        let length = match question {
            Question::VertexErrors(_) => Length::Rest,
            Question::Probe(_) | Question::Distribution(_) | Question::Curve => Length::Short,
        };
        self.run_with_retries(volume, token, Caller::Viewer, length, job).await
    }
}
