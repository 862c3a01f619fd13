//! Histograms, made a slice at a time between other jobs: an edit waits for one slice at most, some milliseconds, however large the volume
//! is. Callers of the same histogram share the work. It pauses when all of them are gone, and the next caller continues it.

use isopeel_kernels::{Histogram, HistogramWork};
use isopeel_view::FeatureName;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::attempts::Failures;
use super::keys::{HistogramKey, feature_keys};
use super::lock::lock;
use super::scheduler::{Caller, JobContext, Length};
use super::worker::DeviceWorker;
use super::worker_state::{JobError, WorkerState};
use crate::metrics;

impl DeviceWorker {
    /// Returns the range and the 256-bin histogram of a feature of `field`, or with [`FeatureName::None`] of the field itself. The result
    /// is cached. Dropping the future pauses the work.
    ///
    /// # Errors
    /// [`WorkError`], but never `Cancelled`.
    pub async fn histogram(
        &self,
        volume: &VolumeStep,
        field: &str,
        feature: &FeatureName,
    ) -> Result<Histogram, WorkError> {
        self.histogram_of(volume, &HistogramKey::new(volume, field, feature))
            .await
    }

    pub(super) async fn histogram_of(&self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, WorkError> {
        let cached = lock(&self.shared.histograms).get(key).cloned();
        metrics::looked_up("histogram", cached.is_some());
        let histogram = match cached {
            Some(histogram) => histogram,
            None => self.make_histogram(volume, key).await?,
        };
        if let Some(watch) = &self.watch {
            watch.made(key);
        }
        Ok(histogram)
    }

    /// As [`DeviceWorker::histogram`], if it is cached.
    pub(super) fn known_histogram(&self, volume: &VolumeStep, field: &str, feature: &FeatureName) -> Option<Histogram> {
        let key = HistogramKey::new(volume, field, feature);
        lock(&self.shared.histograms).peek(&key).cloned()
    }

    async fn make_histogram(&self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, WorkError> {
        let never = CancellationToken::new();
        // Loads the histogram's fields first, so that each caller sees the progress of the loads.
        let own = key.clone();
        let require = move |state: &mut WorkerState, volume: &VolumeStep, _: &mut JobContext<'_, WorkerState>| {
            state.use_histogram_fields(volume, &own)
        };
        self.with_volumes(volume, &never, Caller::Viewer, Length::Short, require)
            .await?;
        let shared_work = self.shared.unfinished.of(key);
        let mut work = shared_work.lock().await;
        let mut failures = Failures::default();
        loop {
            match self.histogram_slice(volume, key, &work).await {
                Ok((more, None)) => *work = more,
                Ok((_, Some(histogram))) => {
                    self.shared.unfinished.forget(key);
                    return Ok(histogram);
                }
                Err(error) => self.after_failure(volume, error, &mut failures, &never).await?,
            }
        }
    }

    /// Runs the next slice; returns the remaining work, and the histogram if it is complete.
    async fn histogram_slice(
        &self,
        volume: &VolumeStep,
        key: &HistogramKey,
        work: &HistogramWork,
    ) -> Result<(HistogramWork, Option<Histogram>), JobError> {
        let (volume, key, mut work) = (volume.clone(), key.clone(), work.clone());
        self.run_slice(Caller::Viewer, move |state| {
            let histogram = state.continue_histogram(&volume, &key, &mut work)?;
            Ok((work, histogram))
        })
        .await
    }
}

impl WorkerState {
    /// Marks the fields that a histogram is made of as used. Returns an error if one is not resident.
    fn use_histogram_fields(&mut self, volume: &VolumeStep, key: &HistogramKey) -> Result<(), JobError> {
        let keys = feature_keys(volume, &key.volume.field, &key.computed, false);
        match keys.as_slice() {
            [] => self.use_field(volume, &key.volume),
            keys => self.use_fields(volume, keys),
        }
    }

    /// Runs the next slice of a histogram of a resident field, or of a feature derived from it. Returns the histogram, which is then
    /// cached, if it is complete.
    fn continue_histogram(
        &mut self,
        volume: &VolumeStep,
        key: &HistogramKey,
        work: &mut HistogramWork,
    ) -> Result<Option<Histogram>, JobError> {
        if let Some(histogram) = lock(&self.histograms).get(key) {
            return Ok(Some(histogram.clone()));
        }
        self.use_histogram_fields(volume, key)?;
        let feature = self.feature_fields(volume, &key.computed, false)?;
        let resident = self.resident(&key.volume).ok_or(WorkError::Stopped)?;
        self.engine().continue_histogram(resident, feature.get(), work)?;
        let Some(mut histogram) = work.complete() else {
            return Ok(None);
        };
        let smallest = volume.dataset().smallest_length();
        histogram.range = key.computed.range_in_world(histogram.range, smallest);
        lock(&self.histograms).insert(key.clone(), 1, histogram.clone());
        Ok(Some(histogram))
    }
}
