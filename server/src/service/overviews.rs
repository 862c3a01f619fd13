//! Volumes at a low resolution. The device makes them in slices of work, between other jobs.

use std::sync::Arc;

use isopeel_extraction::{JobContext, VolumeKey, WorkError, Workspace, lock};
use isopeel_kernels::{Overview, OverviewMode};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::attempts::Retries;
use super::overview_cache::{OverviewKey, UnfinishedOverview};
use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;
use crate::{metrics, pool};

impl DeviceWorker {
    /// Returns a field, or an expression over fields, at a low resolution. Loads or computes the field if it is not on the device. The
    /// result is cached. Dropping the future ends the work, unless another caller waits for the same overview. If the overview is
    /// neither cached nor being made, `admit` is called for a permit to make it.
    ///
    /// # Errors
    /// [`WorkError`], but never `Cancelled`; those of `admit`.
    pub async fn overview<P: Send + Sync + 'static, E: From<WorkError>>(
        &self,
        volume: &VolumeStep,
        field: &str,
        mode: OverviewMode,
        admit: impl FnOnce() -> Result<P, E>,
    ) -> Result<Arc<Overview>, E> {
        let key = OverviewKey {
            volume: VolumeKey::new(volume, field, false),
            mode,
        };
        let overviews = &self.shared.overviews;
        let cached = overviews.cached(&key);
        metrics::looked_up("overview", cached.is_some());
        if let Some(overview) = cached {
            return Ok(overview);
        }
        let unfinished = overviews.unfinished(&key, volume.dataset().geometry.dims, admit)?;
        let _running = unfinished.running.lock().await;
        // Another caller may have finished it meanwhile.
        if let Some(overview) = overviews.cached(&key) {
            return Ok(overview);
        }
        self.run_overview_slices(volume, &key.volume, &unfinished).await?;
        let complete = Arc::clone(&unfinished);
        let overview = pool::run(move || lock(&complete.work).complete()).await;
        let overview = Arc::new(overview.ok().flatten().ok_or(WorkError::Stopped)?);
        overviews.insert(key, &overview);
        Ok(overview)
    }

    /// Runs the device's part of the work on an overview.
    async fn run_overview_slices(
        &self,
        volume: &VolumeStep,
        key: &VolumeKey,
        unfinished: &Arc<UnfinishedOverview>,
    ) -> Result<(), WorkError> {
        let never = CancellationToken::new();
        let field_key = key.clone();
        let require = move |workspace: &mut Workspace, volume: &VolumeStep, _: &mut JobContext<'_, Workspace>| {
            workspace.use_field(volume, &field_key)
        };
        self.run_with_retries(volume, &never, Caller::Request, Length::Short, require)
            .await?;
        let mut retries = Retries::default();
        loop {
            let (step, key, unfinished) = (volume.clone(), key.clone(), Arc::clone(unfinished));
            let slice =
                move |workspace: &mut Workspace| workspace.continue_overview(&step, &key, &mut lock(&unfinished.work));
            match self.run_slice(Caller::Request, slice).await {
                Ok(true) => return Ok(()),
                Ok(false) => {}
                Err(error) => self.prepare_retry(volume, error, &mut retries, &never).await?,
            }
        }
    }
}
