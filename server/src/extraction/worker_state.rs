//! State of the device's thread: the engine, resident volumes, cached pyramids and histograms.

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

/// Share of the device's memory for resident volumes, in percent. The rest is for pyramids, the stages' buffers and other processes.
const VOLUME_PERCENT: u64 = 50;

/// Share of the device's memory for cached pyramids, in percent: those of the latest isovalues of all viewers, which edits of α, β and
/// the transfer function use again.
const PYRAMID_PERCENT: u64 = 15;

/// Why a job ended without a result.
pub(super) enum JobError {
    /// These fields are not resident: load them and queue the job again.
    NotResident(Vec<VolumeKey>),
    /// Queuing again would not help.
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
    /// For jobs that use no volume.
    fn from(halt: JobError) -> Self {
        match halt {
            JobError::Failed(error) => error,
            JobError::NotResident(_) => Self::Stopped,
        }
    }
}

/// What a job on a view uses.
struct OnDevice<'a> {
    engine: &'a Engine,
    volume: &'a Volume,
    pyramid: &'a Pyramid,
    params: CutParams,
    spacing: [f64; 3],
}

impl OnDevice<'_> {
    /// The parameters of a view that was fitted meanwhile.
    fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.spacing).unwrap_or_else(|| self.params.clone())
    }
}

/// Histograms, shared between the thread and the handles.
pub(super) type Histograms = Arc<Mutex<Lru<HistogramKey, Histogram>>>;

/// Locks a mutex, a poisoned one too: a panic leaves no cache half updated.
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

    /// Makes a field resident; evicts those used longest ago.
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

    /// The histogram of a resident field or of a feature derived from it; cached.
    pub(super) fn histogram(&mut self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, JobError> {
        if let Some(histogram) = lock(&self.histograms).get(key) {
            return Ok(histogram.clone());
        }
        let feature = key.derived.map_or(Feature::None, Feature::Derived);
        if self.volumes.get(&key.volume).is_none() {
            self.check_fit(volume, std::slice::from_ref(&key.volume))?;
        }
        let Some(resident) = self.volumes.peek(&key.volume) else {
            return Err(JobError::NotResident(vec![key.volume.clone()]));
        };
        let histogram = self.engine.histogram(resident, feature)?;
        lock(&self.histograms).insert(key.clone(), 1, histogram.clone());
        Ok(histogram)
    }

    /// Fills in isovalue and feature range. All of the view's volumes are required at once, so that they are loaded at once.
    pub(super) fn resolve(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        if view.iso.is_some() && view.feature_range.is_some() {
            return Ok(());
        }
        // Histograms are made of unpadded volumes.
        self.require(volume, view, false)?;
        let field = HistogramKey::new(volume, &view.field, &FeatureName::None);
        let feature = HistogramKey::new(volume, &view.field, &view.feature);
        // Before the other one, because two closures cannot borrow the state.
        let field = if view.iso.is_none() {
            Some(self.histogram(volume, &field)?)
        } else {
            None
        };
        view.resolve(
            || field.ok_or(JobError::Failed(WorkError::Stopped)),
            || self.histogram(volume, &feature),
        )
    }

    /// Makes one prefix, from a cached pyramid where there is one.
    pub(super) fn extract(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface, JobError> {
        self.with_pyramid(volume, view, prefix, cancel, |on, view| {
            let params = CutParams {
                // Coarser prefixes are shown for a moment only, so their error is not measured.
                state_error: prefix == Level::FINEST && on.params.mesher == Mesher::Dual,
                ..on.params_of(view)
            };
            on.engine.peel(on.volume, on.pyramid, &params, prefix, cancel)
        })
    }

    /// Fits a budget of triangles, and counts the prefixes. Ignores a budget of bytes.
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
                    let max_triangles = triangles.saturating_mul(source);
                    let (params, count) = on
                        .engine
                        .fit(on.volume, on.pyramid, &on.params, max_triangles, cancel)?;
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

    /// Runs `work` with the volume and the pyramid of a view, for prefixes up to a level. Where the device runs out of memory, caches
    /// are freed and it runs once more.
    fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        coarsest: Level,
        cancel: &dyn Cancel,
        work: impl Fn(&OnDevice<'_>, &mut View) -> Result<T, Error>,
    ) -> Result<T, JobError> {
        let keys = self.require(volume, view, view.cap)?;
        self.resolve(volume, view)?;
        match self.try_with_pyramid(volume, view, coarsest, cancel, &work) {
            Err(JobError::Failed(WorkError::Device(Error::OutOfDeviceMemory { .. }))) if self.free_all_but(&keys) => {
                self.try_with_pyramid(volume, view, coarsest, cancel, &work)
            }
            outcome => outcome,
        }
    }

    fn try_with_pyramid<T>(
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
        // Fitting a budget tries many cuts, which need the whole pyramid.
        let in_full = params.is_full(coarsest) && view.budget.is_none();
        if !self.pyramids.get(&key).is_some_and(|kept| in_full || kept.is_whole()) {
            let feature = match &view.feature {
                FeatureName::None => Feature::None,
                FeatureName::Derived(derived) => Feature::Derived(*derived),
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

    /// Keys of the fields that a view uses, marked as used; an error if one is not resident.
    fn require(&mut self, volume: &VolumeStep, view: &View, padded: bool) -> Result<Vec<VolumeKey>, JobError> {
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
        // Fields that do not fit together would evict each other.
        self.check_fit(volume, &keys)?;
        Err(JobError::NotResident(missing))
    }

    /// Checks before files are read that these fields can be resident together.
    fn check_fit(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> Result<(), WorkError> {
        let mut needed_bytes = 0;
        for key in keys {
            let grid = padded_grid(volume, key.padded)?;
            needed_bytes += self
                .engine
                .upload_bytes(&grid, key.field_of(volume)?.sample_type.bytes());
        }
        let limit_bytes = self.volumes.budget();
        if needed_bytes > limit_bytes {
            return Err(WorkError::TooLarge {
                needed_bytes,
                limit_bytes,
            });
        }
        Ok(())
    }

    /// Frees all cached volumes and pyramids but these volumes. False where there were none.
    fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let before = self.volumes.len() + self.pyramids.len();
        self.volumes.retain(|key| keys.contains(key));
        self.pyramids.retain(|_| false);
        let freed = before - self.volumes.len() - self.pyramids.len();
        tracing::warn!(freed, "device memory ran out, volumes and pyramids dropped");
        freed > 0
    }
}
