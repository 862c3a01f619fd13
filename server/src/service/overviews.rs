//! Volumes at a low resolution. The device makes them in slices of work, between other jobs.

use std::sync::Arc;

use isopeel_extraction::{JobContext, VolumeKey, WorkError, Workspace, lock};
use isopeel_kernels::{Overview, OverviewMode};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::attempts::Failures;
use super::overview_cache::{OverviewKey, Unfinished};
use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;
use crate::{metrics, pool};

impl DeviceWorker {
    /// Returns a field, or an expression over fields, at a low resolution. Loads or computes the field if it is not on the device. The
    /// result is cached. Dropping the future ends the work, unless another caller waits for the same overview. `admit` returns the permit
    /// to make an overview; it is called only if the overview is neither cached nor being made.
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
        let _turn = unfinished.turn.lock().await;
        // Another caller may have finished it meanwhile.
        if let Some(overview) = overviews.cached(&key) {
            return Ok(overview);
        }
        self.work_on_overview(volume, &key.volume, &unfinished).await?;
        let finished = Arc::clone(&unfinished);
        let complete = pool::run(move || lock(&finished.work).complete()).await;
        let overview = Arc::new(complete.ok().flatten().ok_or(WorkError::Stopped)?);
        overviews.keep(key, &overview);
        Ok(overview)
    }

    async fn work_on_overview(
        &self,
        volume: &VolumeStep,
        key: &VolumeKey,
        unfinished: &Arc<Unfinished>,
    ) -> Result<(), WorkError> {
        let never = CancellationToken::new();
        let own = key.clone();
        let require = move |state: &mut Workspace, volume: &VolumeStep, _: &mut JobContext<'_, Workspace>| {
            state.use_field(volume, &own)
        };
        self.with_volumes(volume, &never, Caller::Request, Length::Short, require)
            .await?;
        let mut failures = Failures::default();
        loop {
            let (volume_step, key, own) = (volume.clone(), key.clone(), Arc::clone(unfinished));
            let slice = move |state: &mut Workspace| state.continue_overview(&volume_step, &key, &mut lock(&own.work));
            match self.run_slice(Caller::Request, slice).await {
                Ok(true) => return Ok(()),
                Ok(false) => {}
                Err(error) => self.after_failure(volume, error, &mut failures, &never).await?,
            }
        }
    }
}
