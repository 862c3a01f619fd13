//! Volumes at a low resolution. The device makes them in slices of work, between other jobs.

use std::sync::Arc;

use isopeel_extraction::{ContinueOverview, UseField, VolumeKey, WorkError, lock};
use isopeel_kernels::{Overview, OverviewMode};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::attempts::Retries;
use super::overview_cache::{OverviewKey, UnfinishedOverview};
use super::scheduler::Caller;
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
        metrics::looked_up(self.shared.number, "overview", cached.is_some());
        if let Some(overview) = cached {
            return Ok(overview);
        }
        let unfinished = overviews.unfinished(&key, volume.dataset().geometry.dims, admit)?;
        let _running = unfinished.running.lock().await;
        // Another caller may have finished the overview meanwhile.
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
        let require = UseField {
            volume: volume.clone(),
            key: key.clone(),
        };
        self.perform(Caller::Request, require, &CancellationToken::new())
            .await?;
        let mut retries = Retries::default();
        loop {
            let Some(part) = lock(&unfinished.work).next().cloned() else {
                return Ok(());
            };
            let slice = ContinueOverview {
                volume: volume.clone(),
                key: key.clone(),
                part,
            };
            let values = self.perform_slice(Caller::Request, slice, &mut retries).await?;
            // Added here, not on the pool: if this caller left before the pool had added the values, the next caller would request the same
            // part again.
            lock(&unfinished.work).add(values);
        }
    }
}
