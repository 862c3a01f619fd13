//! Histograms, made in slices of some milliseconds between other jobs: an edit waits for one slice at most, however large the volume is.
//! Callers of the same histogram share the work. The work pauses when all of these callers are gone, and the next caller continues it.

use isopeel_extraction::{ContinueHistogram, HistogramKey, UseHistogramFields, WorkError};
use isopeel_kernels::Histogram;
use isopeel_view::FeatureName;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::attempts::Retries;
use super::scheduler::Caller;
use super::worker::DeviceWorker;
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

    /// As [`DeviceWorker::histogram`], for a key.
    pub(super) async fn histogram_of(&self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, WorkError> {
        let cached = self.shared.histograms.get(key);
        metrics::looked_up(self.shared.number, "histogram", cached.is_some());
        let histogram = match cached {
            Some(histogram) => histogram,
            None => self.make_histogram(volume, key).await?,
        };
        if let Some(watch) = &self.watch {
            watch.histogram_made(key);
        }
        Ok(histogram)
    }

    /// Returns the result of [`DeviceWorker::histogram`] if it is cached.
    pub(super) fn peek_histogram(&self, volume: &VolumeStep, field: &str, feature: &FeatureName) -> Option<Histogram> {
        let key = HistogramKey::new(volume, field, feature);
        self.shared.histograms.peek(&key)
    }

    async fn make_histogram(&self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, WorkError> {
        // Loads the histogram's fields first, so that each caller sees the progress of the loads.
        let require = UseHistogramFields {
            volume: volume.clone(),
            key: key.clone(),
        };
        self.perform(Caller::Viewer, require, &CancellationToken::new()).await?;
        let shared_work = self.shared.unfinished_histograms.get_or_begin(key);
        let mut work = shared_work.lock().await;
        let mut retries = Retries::default();
        loop {
            let slice = ContinueHistogram {
                volume: volume.clone(),
                key: key.clone(),
                work: work.clone(),
            };
            let (remaining, histogram) = self.perform_slice(Caller::Viewer, slice, &mut retries).await?;
            *work = remaining;
            if let Some(histogram) = histogram {
                // A device in a process of its own has a cache of its own.
                self.shared.histograms.insert(key.clone(), histogram.clone());
                self.shared.unfinished_histograms.remove(key);
                return Ok(histogram);
            }
        }
    }
}
