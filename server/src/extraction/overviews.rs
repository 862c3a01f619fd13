//! Volumes at a low resolution, made a slice of work at a time between other jobs.

use std::sync::{Arc, Mutex};

use isopeel_kernels::{Overview, OverviewMode, OverviewWork};
use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::attempts::FailedSlices;
use super::keys::VolumeKey;
use super::lock::lock;
use super::overview_cache::OverviewKey;
use super::turns::{Caller, Length, Turn};
use super::worker::DeviceWorker;
use super::worker_state::{JobError, WorkerState};
use crate::volumes::VolumeStep;
use crate::{metrics, pool};

impl DeviceWorker {
    /// Returns a field, or an expression over fields, at a low resolution. Loads or computes it if it is not on the device. Cached. Dropping
    /// the future ends the work.
    ///
    /// # Errors
    /// [`WorkError`], but never `Cancelled`.
    pub async fn overview(
        &self,
        volume: &VolumeStep,
        field: &str,
        mode: OverviewMode,
    ) -> Result<Arc<Overview>, WorkError> {
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
        let work = overviews.work(&key, volume.dataset().geometry.dims);
        self.work_on_overview(volume, &key.volume, &work).await?;
        let complete = pool::run(move || lock(&work).complete()).await;
        let overview = Arc::new(complete.ok().flatten().ok_or(WorkError::Stopped)?);
        overviews.keep(key, &overview);
        Ok(overview)
    }

    async fn work_on_overview(
        &self,
        volume: &VolumeStep,
        key: &VolumeKey,
        work: &Arc<Mutex<OverviewWork>>,
    ) -> Result<(), WorkError> {
        let never = CancellationToken::new();
        let own = key.clone();
        let require = move |state: &mut WorkerState, volume: &VolumeStep, _: &mut Turn<'_, WorkerState>| {
            state.use_field(volume, &own)
        };
        self.with_volumes(volume, &never, Caller::Request, Length::Short, require)
            .await?;
        let mut failed = FailedSlices::default();
        loop {
            let (volume_step, key, work) = (volume.clone(), key.clone(), Arc::clone(work));
            let slice = move |state: &mut WorkerState| state.continue_overview(&volume_step, &key, &mut lock(&work));
            match self.run_slice(Caller::Request, slice).await {
                Ok(true) => return Ok(()),
                Ok(false) => {}
                Err(error) => self.after_failed_slice(volume, error, &mut failed).await?,
            }
        }
    }
}

impl WorkerState {
    /// Runs the next slice of work; returns whether it was the last one.
    fn continue_overview(
        &mut self,
        volume: &VolumeStep,
        key: &VolumeKey,
        work: &mut OverviewWork,
    ) -> Result<bool, JobError> {
        if work.is_done() {
            return Ok(true);
        }
        self.use_field(volume, key)?;
        let resident = self.resident(key).ok_or(WorkError::Stopped)?;
        self.engine().continue_overview(resident, work)?;
        Ok(work.is_done())
    }
}
