//! Jobs on views: counts, steps, final surfaces, errors.

use isopeel_extraction::{
    Extraction, FullCount, JobContext, JobError, Making, Measurement, Refinement, Step, WorkError, Workspace,
};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Counts the triangles of the full surface of a view. This builds the view's pyramid, which the first step then uses. `token` as in
    /// [`DeviceWorker::extract`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn count(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<FullCount, WorkError> {
        let caller = (Caller::Viewer, Length::Short);
        self.with_view(volume, view, token, caller, |workspace, volume, view, context| {
            workspace.count(volume, view, context)
        })
        .await
    }

    /// Fills in values that depend on the data: the default isovalue and the feature's own range.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn resolve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let caller = (Caller::Viewer, Length::Short);
        self.with_view(volume, view, token, caller, |workspace, volume, view, _| {
            workspace.resolve(volume, view)?;
            Ok(view.clone())
        })
        .await
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
        let caller = (Caller::Viewer, Length::Short);
        self.with_view(volume, view, token, caller, |workspace, volume, view, _| {
            workspace.prepare(volume, view)?;
            Ok(view.clone())
        })
        .await
    }

    /// Makes the final surface of a view with its measured error, unless it has more than `ceiling_triangles`. Cancelling `token` or
    /// dropping the future cancels the job before its next stage.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        ceiling_triangles: u64,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let making = Making {
            ceiling: ceiling_triangles,
            ..Making::default()
        };
        self.extract_for(Caller::Request, volume, view, making, token).await
    }

    /// As [`DeviceWorker::extract`], for this caller and as `making` says.
    ///
    /// # Errors
    /// [`WorkError`].
    pub(super) async fn extract_for(
        &self,
        caller: Caller,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let view = view.clone();
        self.run_with_retries(
            volume,
            token,
            caller,
            caller.long(),
            move |workspace, volume, context| workspace.extract(volume, &view, making, context),
        )
        .await
    }

    /// Measures how far the final surface of a view, whose budget is fitted, is from the undecimated one. `None` if the surface has no
    /// triangles. `token` as in [`DeviceWorker::extract`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub(super) async fn measure_for(
        &self,
        caller: (Caller, Length),
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        self.with_view(volume, view, token, caller, |workspace, volume, view, context| {
            workspace.measure(volume, view, context)
        })
        .await
    }

    /// Makes a step from the surface that a client shows to the surface of a view. `token` and `ceiling_triangles` as in
    /// [`DeviceWorker::extract`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        ceiling_triangles: u64,
        token: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        let caller = (Caller::Viewer, Length::Short);
        self.with_view(volume, view, token, caller, move |workspace, volume, view, context| {
            workspace.refine(volume, view, step, ceiling_triangles, context)
        })
        .await
    }

    /// Makes the final surface of a view as a cut of the vertex tree; `None` if there is no better one. `token` and `ceiling_triangles` as
    /// in [`DeviceWorker::extract`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        ceiling_triangles: u64,
        token: &CancellationToken,
    ) -> Result<Option<Refinement>, WorkError> {
        let caller = (Caller::Viewer, Length::Rest);
        self.with_view(volume, view, token, caller, move |workspace, volume, view, context| {
            workspace.improve(volume, view, ceiling_triangles, context)
        })
        .await
    }

    /// As [`DeviceWorker::run_with_retries`], for a job on a view, which it fills in: each attempt begins with the view as it was given.
    async fn with_view<T, F>(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
        (caller, length): (Caller, Length),
        job: F,
    ) -> Result<T, WorkError>
    where
        T: Send + 'static,
        F: Fn(&mut Workspace, &VolumeStep, &mut View, &mut JobContext<'_, Workspace>) -> Result<T, JobError>
            + Clone
            + Send
            + 'static,
    {
        let view = view.clone();
        self.run_with_retries(volume, token, caller, length, move |workspace, volume, context| {
            job(workspace, volume, &mut view.clone(), context)
        })
        .await
    }
}
