//! Histograms, made a slice at a time. Other work waits for at most one slice, which takes some milliseconds however large the volume is.

use isopeel_kernels::{Histogram, HistogramWork};
use isopeel_volumes::VolumeStep;

use super::WorkError;
use super::job_error::JobError;
use super::keys::{HistogramKey, feature_keys};
use super::workspace::Workspace;

impl Workspace {
    /// Marks the fields of which a histogram is made as used.
    ///
    /// # Errors
    /// [`JobError::NotResident`] if one of them is not resident.
    pub fn use_histogram_fields(&mut self, volume: &VolumeStep, key: &HistogramKey) -> Result<(), JobError> {
        let keys = feature_keys(volume, &key.volume.field, &key.computed, false);
        match keys.as_slice() {
            [] => self.use_field(volume, &key.volume),
            keys => self.use_fields(volume, keys),
        }
    }

    /// Runs the next slice of the work on a histogram of a resident field, or of a feature derived from the field. If the histogram is
    /// complete then, caches and returns it.
    ///
    /// # Errors
    /// [`JobError::NotResident`], and the device's errors.
    pub fn continue_histogram(
        &mut self,
        volume: &VolumeStep,
        key: &HistogramKey,
        work: &mut HistogramWork,
    ) -> Result<Option<Histogram>, JobError> {
        if let Some(histogram) = self.histograms.get(key) {
            return Ok(Some(histogram));
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
        self.histograms.insert(key.clone(), histogram.clone());
        Ok(Some(histogram))
    }
}
