//! What the device's thread has on its state: the engine, resident volumes, the latest pyramids.

use std::sync::{Arc, Mutex, PoisonError};

use isopeel_kernels::{
    Cancel, Count, CutParams, Engine, Error, Feature, Grid, Histogram, Isovalue, Level, Mesher, Pyramid, Samples,
    Surface, Volume,
};

use super::keys::{HistogramKey, PyramidKey, VolumeKey};
use super::residency::Lru;
use super::{PrefixCount, WorkError};
use crate::view::quality::{Budget, Fitted};
use crate::view::{EditError, FeatureName, View};
use crate::volumes::VolumeStep;

/// Share of the device's memory that resident volumes may take, in percent. The rest is for pyramids, the buffers of the
/// stages and whoever else uses the device.
const VOLUME_PERCENT: u64 = 50;

/// Share of the device's memory that kept pyramids may take, in percent: the latest isovalues of all viewers, so that α, β
/// and the transfer function never build one again. When the device runs out of memory they go first.
const PYRAMID_PERCENT: u64 = 15;

/// Why a job ended without a result.
pub(super) enum JobError {
    /// These fields are not resident; load them and queue again.
    NotResident(Vec<VolumeKey>),
    /// For good.
    Failed(WorkError),
}

impl From<WorkError> for JobError {
    fn from(error: WorkError) -> Self {
        Self::Failed(error)
    }
}

impl From<Error> for JobError {
    fn from(error: Error) -> Self {
        Self::Failed(error.into())
    }
}

impl From<JobError> for WorkError {
    /// For jobs that need no volume.
    fn from(halt: JobError) -> Self {
        match halt {
            JobError::Failed(error) => error,
            JobError::NotResident(_) => Self::Stopped,
        }
    }
}

/// What a job on a view works with.
struct OnDevice<'a> {
    engine: &'a Engine,
    volume: &'a Volume,
    pyramid: &'a Pyramid,
    params: CutParams,
    spacing: [f64; 3],
}

impl OnDevice<'_> {
    /// The parameters once more, where the view has changed since.
    fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.spacing).unwrap_or_else(|| self.params.clone())
    }
}

/// Histograms, shared between the thread and the handles.
pub(super) type Histograms = Arc<Mutex<Lru<HistogramKey, Histogram>>>;

/// A panic elsewhere leaves a cache whole, so a poisoned lock is taken all the same.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The grid of a dataset's samples on the device, padded by one sample on every side or not.
pub(super) fn padded_grid(volume: &VolumeStep, padded: bool) -> Result<Grid, WorkError> {
    let geometry = &volume.dataset().geometry;
    let dims = if padded {
        geometry.dims.map(|n| n + 2)
    } else {
        geometry.dims
    };
    Ok(Grid::new(dims, geometry.spacing.map(|s| s as f32))?)
}

/// The thread's state.
pub(super) struct WorkerState {
    engine: Engine,
    volumes: Lru<VolumeKey, Volume>,
    pyramids: Lru<PyramidKey, Pyramid>,
    histograms: Histograms,
}

impl WorkerState {
    pub(super) fn new(engine: Engine, histograms: Histograms) -> Self {
        let percent = engine.device().memory_bytes / 100;
        Self {
            engine,
            volumes: Lru::new(percent * VOLUME_PERCENT),
            pyramids: Lru::new(percent * PYRAMID_PERCENT),
            histograms,
        }
    }

    pub(super) fn is_resident(&self, key: &VolumeKey) -> bool {
        self.volumes.peek(key).is_some()
    }

    /// Makes a field resident, at the expense of those used longest ago.
    pub(super) fn upload(
        &mut self,
        key: VolumeKey,
        grid: &Grid,
        samples: &Samples,
        missing: Option<f32>,
    ) -> Result<(), JobError> {
        let bytes = self.engine.upload_bytes(grid, samples.sample_type().bytes());
        self.volumes.evict_for(bytes);
        let volume = match self.engine.upload(grid, samples, missing) {
            Err(Error::OutOfDeviceMemory { .. }) if self.free_all_but(&[]) => {
                self.engine.upload(grid, samples, missing)?
            }
            other => other?,
        };
        tracing::info!(
            dataset = key.dataset,
            field = key.field,
            step = key.step,
            bytes,
            "volume resident"
        );
        self.volumes.insert(key, bytes, volume);
        Ok(())
    }

    /// The histogram of a resident field or of its gradient magnitude; kept.
    pub(super) fn histogram(&mut self, key: &HistogramKey) -> Result<Histogram, JobError> {
        if let Some(histogram) = lock(&self.histograms).get(key) {
            return Ok(histogram.clone());
        }
        let feature = if key.gradient {
            Feature::GradientMagnitude
        } else {
            Feature::None
        };
        let Some(volume) = self.volumes.get(&key.volume) else {
            return Err(JobError::NotResident(vec![key.volume.clone()]));
        };
        let histogram = self.engine.histogram(volume, feature)?;
        lock(&self.histograms).insert(key.clone(), 1, histogram.clone());
        Ok(histogram)
    }

    /// Fills in isovalue and feature range. Asks for all the view's volumes at once, so that its job waits once.
    pub(super) fn resolve(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        if view.iso.is_some() && view.feature_range.is_some() {
            return Ok(());
        }
        // Padding belongs to no histogram.
        self.need(volume, view, false)?;
        let field = HistogramKey::new(volume, &view.field, &FeatureName::None);
        let feature = HistogramKey::new(volume, &view.field, &view.feature);
        // Two closures cannot share the state; what they look up is kept, so asking first costs nothing twice.
        let field = if view.iso.is_none() {
            Some(self.histogram(&field)?)
        } else {
            None
        };
        view.resolve(
            || field.ok_or(JobError::Failed(WorkError::Stopped)),
            || self.histogram(&feature),
        )
    }

    /// Peels one prefix, from a kept pyramid where there is one.
    pub(super) fn extract(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface, JobError> {
        self.with_pyramid(volume, view, prefix, cancel, |on, view| {
            let params = CutParams {
                // Coarser prefixes are on screen for a moment, and their error is no one's measure.
                state_error: prefix == Level::FINEST && on.params.mesher == Mesher::Dual,
                ..on.params_of(view)
            };
            on.engine.peel(on.volume, on.pyramid, &params, prefix, cancel)
        })
    }

    /// Fits a budget of triangles, and counts what the prefixes would have. A budget of bytes is not known here: β stays.
    pub(super) fn plan(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        levels: &[Level],
        cancel: &dyn Cancel,
    ) -> Result<(Vec<PrefixCount>, usize), JobError> {
        let coarsest = levels.iter().copied().max().unwrap_or(Level::FINEST);
        self.with_pyramid(volume, view, coarsest, cancel, |on, view| {
            let fitted = match view.budget {
                Some(Budget::Triangles(triangles)) if view.fitted.is_none() => {
                    let source = if view.polish { super::simplification::SOURCE } else { 1 };
                    let most = triangles.saturating_mul(source);
                    let (params, count) = on.engine.fit(on.volume, on.pyramid, &on.params, most, cancel)?;
                    let beta = params.beta;
                    view.fitted = Some(Fitted { beta, triangles });
                    Some(count)
                }
                _ => None,
            };
            let params = on.params_of(view);
            let mut counts = Vec::with_capacity(levels.len());
            for &level in levels {
                let count: Count = match fitted {
                    Some(count) if level == Level::FINEST => count,
                    _ => on.engine.count(on.volume, on.pyramid, &params, level, cancel)?,
                };
                counts.push(PrefixCount { level, count });
            }
            Ok((counts, on.pyramid.active_regions()))
        })
    }

    /// Does something with the volume and the pyramid of a view, for prefixes up to a level, and once more with more room where
    /// memory ran out.
    fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        coarsest: Level,
        cancel: &dyn Cancel,
        work: impl Fn(&OnDevice<'_>, &mut View) -> Result<T, Error>,
    ) -> Result<T, JobError> {
        let keys = self.need(volume, view, view.cap)?;
        self.resolve(volume, view)?;
        match self.at_pyramid(volume, view, coarsest, cancel, &work) {
            Err(JobError::Failed(WorkError::Device(Error::OutOfDeviceMemory { .. }))) if self.free_all_but(&keys) => {
                self.at_pyramid(volume, view, coarsest, cancel, &work)
            }
            outcome => outcome,
        }
    }

    fn at_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        coarsest: Level,
        cancel: &dyn Cancel,
        work: &impl Fn(&OnDevice<'_>, &mut View) -> Result<T, Error>,
    ) -> Result<T, JobError> {
        let unresolved = || {
            WorkError::Edit(EditError {
                field: "iso",
                why: "the field has no finite sample to choose an isovalue from".into(),
            })
        };
        let iso: Isovalue = view.iso.ok_or_else(unresolved)?;
        let spacing = volume.dataset().geometry.spacing;
        let params = view.cut_params(spacing).ok_or_else(unresolved)?;
        let shown = VolumeKey::new(volume, &view.field, view.cap);
        let key = PyramidKey::new(shown.clone(), view.feature.clone(), iso);
        let missing = |key: &VolumeKey| JobError::NotResident(vec![key.clone()]);
        let shown_volume = self.volumes.peek(&shown).ok_or_else(|| missing(&shown))?;
        // A budget of triangles tries many cuts.
        let in_full = params.is_full(coarsest) && view.budget.is_none();
        if !self.pyramids.get(&key).is_some_and(|kept| in_full || kept.is_whole()) {
            let feature = match &view.feature {
                FeatureName::None => Feature::None,
                FeatureName::GradientMagnitude => Feature::GradientMagnitude,
                FeatureName::Field(name) => {
                    let key = VolumeKey::new(volume, name, view.cap);
                    Feature::Field(self.volumes.peek(&key).ok_or_else(|| missing(&key))?)
                }
            };
            let pyramid = if in_full {
                self.engine.build_cells(shown_volume, feature, iso, cancel)?
            } else {
                self.engine.build_pyramid(shown_volume, feature, iso, cancel)?
            };
            self.pyramids.insert(key.clone(), pyramid.device_bytes(), pyramid);
        }
        let pyramid = self.pyramids.peek(&key).ok_or(WorkError::Stopped)?;
        let on = OnDevice {
            engine: &self.engine,
            volume: shown_volume,
            pyramid,
            params,
            spacing,
        };
        Ok(work(&on, view)?)
    }

    /// The fields that a view reads, marked as used.
    fn need(&mut self, volume: &VolumeStep, view: &View, padded: bool) -> Result<Vec<VolumeKey>, JobError> {
        let mut keys = vec![VolumeKey::new(volume, &view.field, padded)];
        if let FeatureName::Field(name) = &view.feature
            && *name != view.field
        {
            keys.push(VolumeKey::new(volume, name, padded));
        }
        let missing: Vec<_> = keys
            .iter()
            .filter(|key| self.volumes.get(key).is_none())
            .cloned()
            .collect();
        if missing.is_empty() {
            return Ok(keys);
        }
        // Say now what can never fit, instead of letting the fields evict each other.
        let grid = padded_grid(volume, padded)?;
        let mut needed_bytes = 0;
        for key in &keys {
            let bytes = key.field_of(volume)?.sample_type.bytes();
            needed_bytes += self.engine.upload_bytes(&grid, bytes);
        }
        let limit_bytes = self.volumes.budget();
        if needed_bytes > limit_bytes {
            return Err(WorkError::TooLarge {
                needed_bytes,
                limit_bytes,
            }
            .into());
        }
        Err(JobError::NotResident(missing))
    }

    /// Gives back all that is only kept for later, but for these volumes. False when there was nothing to give.
    fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let before = self.volumes.len() + self.pyramids.len();
        self.volumes.retain(|key| keys.contains(key));
        self.pyramids.retain(|_| false);
        let freed = before - self.volumes.len() - self.pyramids.len();
        tracing::warn!(freed, "device memory ran out, volumes and pyramids dropped");
        freed > 0
    }
}
