//! State of the device's thread: the engine, resident volumes, cached pyramids and histograms.

use std::rc::Rc;
use std::sync::{Arc, Mutex};

use isopeel_kernels::{
    Cancel, Cut, CutParams, Engine, Error, Feature, Grid, Histogram, Isovalue, Level, Mesher, Pyramid, Samples,
    Surface, VertexTree, Volume,
};

use super::keys::{HistogramKey, PyramidKey, VolumeKey};
use super::lock::lock;
use super::memory::ThreadMemory;
use super::pins::Pins;
use super::residency::Lru;
use super::{CutId, Measurement, WorkError};
use crate::math::DAffine3;
use crate::view::{EditError, FeatureName, OpeningIso, View};
use crate::volumes::VolumeStep;

/// Share of the device's memory for resident volumes, in percent. The rest is for pyramids, the stages' buffers and other processes.
const VOLUME_PERCENT: u64 = 50;

/// Share of the device's memory for cached pyramids, in percent: those of the latest isovalues of all viewers, which edits of α, β and
/// the transfer function use again.
const PYRAMID_PERCENT: u64 = 15;

/// Share of the device's memory for vertex trees, in percent: one takes about as much as its pyramid.
const TREE_PERCENT: u64 = 10;

/// Share of the device's memory for cuts, in percent: a byte a node, where a pyramid takes 40.
const CUT_PERCENT: u64 = 2;

/// Why a job ended without a result.
pub(super) enum JobError {
    /// Not all of these fields are resident: load them and queue the job again. With their bytes on the device, and the maximum of
    /// all resident ones.
    NotResident { needed: Vec<(VolumeKey, u64)>, budget: u64 },
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
            JobError::NotResident { .. } => Self::Stopped,
        }
    }
}

/// What a job on a view uses.
pub(super) struct OnDevice<'a> {
    pub engine: &'a Engine,
    pub cuts: &'a mut Cuts,
    pub trees: &'a mut Lru<PyramidKey, Rc<VertexTree>>,
    /// Of the pyramid and its tree.
    pub key: PyramidKey,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    /// Whether the pyramid was there before the job.
    was_cached: bool,
    /// Of the view as it was before the job.
    pub params: CutParams,
    pub spacing: [f64; 3],
    pub world_from_index: DAffine3,
}

impl OnDevice<'_> {
    /// The parameters of a view that was fitted meanwhile.
    pub(super) fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.spacing, self.world_from_index)
            .unwrap_or_else(|| self.params.clone())
    }

    /// With the stages of the pyramid before the surface's own, where this job has built it.
    pub(super) fn with_pyramid_stages(&self, mut surface: Surface) -> Surface {
        if !self.was_cached {
            let stages = &mut surface.statistics.stages;
            stages.splice(0..0, self.pyramid.stages().iter().cloned());
        }
        surface
    }
}

/// Which nodes of a pyramid a job needs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Nodes {
    /// Those that the view's cut may have as leaves.
    OfTheView,
    /// All: coarse prefixes are made, and the next edit changes the cut.
    All,
}

/// Cuts that clients show or are on the way to.
pub(super) struct Cuts {
    kept: Lru<CutId, Rc<Cut>>,
    last: u64,
}

impl Cuts {
    /// Keeps cuts of at most `budget` bytes: where one was let go, a client's next surface is made as a whole.
    fn new(budget: u64) -> Self {
        Self {
            kept: Lru::new(budget),
            last: 0,
        }
    }

    pub(super) fn get(&mut self, id: CutId) -> Option<Rc<Cut>> {
        self.kept.get(&id).cloned()
    }

    /// An id of no cut.
    pub(super) fn new_id(&mut self) -> CutId {
        self.last += 1;
        CutId::new(self.last)
    }

    pub(super) fn keep(&mut self, cut: Rc<Cut>) -> CutId {
        let id = self.new_id();
        self.kept.insert(id, cut.device_bytes(), cut);
        id
    }
}

/// Histograms, shared between the thread and the handles.
pub(super) type Histograms = Arc<Mutex<Lru<HistogramKey, Histogram>>>;

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
    trees: Lru<PyramidKey, Rc<VertexTree>>,
    cuts: Cuts,
    histograms: Histograms,
    pins: Pins,
}

impl WorkerState {
    pub(super) fn new(engine: Engine, histograms: Histograms, pins: Pins) -> Self {
        let percent = engine.device().memory_bytes / 100;
        Self {
            engine,
            volumes: Lru::new(percent * VOLUME_PERCENT),
            pyramids: Lru::new(percent * PYRAMID_PERCENT),
            trees: Lru::new(percent * TREE_PERCENT),
            cuts: Cuts::new(percent * CUT_PERCENT),
            histograms,
            pins,
        }
    }

    /// What holds memory. `program`: the process's before it opened a volume.
    pub(super) fn memory(&self, program: u64) -> Result<ThreadMemory, Error> {
        Ok(ThreadMemory {
            device: self.engine.memory()?,
            volumes: self.volumes.cost(),
            pyramids: self.pyramids.cost(),
            trees: self.trees.cost(),
            cuts: self.cuts.kept.cost(),
            program,
        })
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
        let pins = &self.pins;
        self.volumes.evict_for(bytes, |key| !pins.holds(key));
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
        self.volumes.add(key, bytes, volume);
        Ok(())
    }

    /// The histogram of a resident field or of a feature derived from it; cached.
    pub(super) fn histogram(&mut self, volume: &VolumeStep, key: &HistogramKey) -> Result<Histogram, JobError> {
        if let Some(histogram) = lock(&self.histograms).get(key) {
            return Ok(histogram.clone());
        }
        let feature = key.derived.map_or(Feature::None, Feature::Derived);
        let Some(resident) = self.volumes.get(&key.volume) else {
            return Err(self.not_resident(volume, std::slice::from_ref(&key.volume)));
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
        let opening_iso = if view.iso.is_none() {
            let unit = volume
                .dataset()
                .field(&view.field)
                .and_then(|field| field.unit.as_deref());
            Some(OpeningIso::of(&self.histogram(volume, &field)?, unit))
        } else {
            None
        };
        view.resolve(
            || opening_iso.ok_or(JobError::Failed(WorkError::Stopped)),
            || self.histogram(volume, &feature),
        )
    }

    /// Makes the final surface with its measured error, from a cached pyramid where there is one. Its stages are those of this job.
    pub(super) fn extract(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        ceiling_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<Surface, JobError> {
        self.with_pyramid(volume, view, Nodes::OfTheView, cancel, |on, view| {
            if view.is_by_error()
                && let Some(surface) = on.tree_surface(view, ceiling_triangles, true, cancel)?
            {
                return Ok(surface);
            }
            let (params, cut) = on.target(view, cancel)?;
            on.check_ceiling(&cut, ceiling_triangles, cancel)?;
            let params = CutParams {
                state_error: params.mesher == Mesher::Dual,
                ..params
            };
            let surface = on.engine.surface(on.volume, on.pyramid, &params, &cut, None, cancel)?;
            Ok(on.with_pyramid_stages(surface))
        })
    }

    /// Measures the final surface of a view of the dual mesher, which is a cut of the vertex tree where that is built.
    pub(super) fn measure(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        cancel: &dyn Cancel,
    ) -> Result<Measurement, JobError> {
        self.with_pyramid(volume, view, Nodes::OfTheView, cancel, |on, view| {
            let is_tree_cut = view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
            let of_tree = if is_tree_cut {
                on.measure_tree(view, cancel)?
            } else {
                None
            };
            let measured = match of_tree {
                Some(measured) => measured,
                None => {
                    let params = on.params_of(view);
                    on.engine.measure_error(on.volume, on.pyramid, &params, cancel)?
                }
            };
            Ok(Measurement {
                whole: measured.whole,
                regions: measured.regions,
            })
        })
    }

    /// Runs `work` with the volume and the pyramid of a view. Where the device runs out of memory, caches are freed and it runs once
    /// more.
    pub(super) fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        cancel: &dyn Cancel,
        work: impl Fn(&mut OnDevice<'_>, &mut View) -> Result<T, WorkError>,
    ) -> Result<T, JobError> {
        let keys = self.require(volume, view, view.cap)?;
        self.resolve(volume, view)?;
        match self.try_with_pyramid(volume, view, nodes, cancel, &work) {
            Err(JobError::Failed(
                WorkError::Device(Error::OutOfDeviceMemory { .. }) | WorkError::NoTree(Error::OutOfDeviceMemory { .. }),
            )) if self.free_all_but(&keys) => self.try_with_pyramid(volume, view, nodes, cancel, &work),
            outcome => outcome,
        }
    }

    fn try_with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        cancel: &dyn Cancel,
        work: &impl Fn(&mut OnDevice<'_>, &mut View) -> Result<T, WorkError>,
    ) -> Result<T, JobError> {
        let unresolved = || {
            WorkError::Edit(EditError {
                field: "iso",
                why: "the field has no finite sample to choose an isovalue from".into(),
            })
        };
        let iso: Isovalue = view.iso.ok_or_else(unresolved)?;
        let spacing = volume.dataset().geometry.spacing;
        let world_from_index = volume.dataset().geometry.of_view(view).world_from_index();
        let params = view.cut_params(spacing, world_from_index).ok_or_else(unresolved)?;
        let shown = VolumeKey::new(volume, &view.field, view.cap);
        let key = PyramidKey::new(shown.clone(), view.feature.clone(), iso);
        let shown_volume = self.volumes.peek(&shown).ok_or(WorkError::Stopped)?;
        // Fitting a budget needs the whole pyramid.
        let cells_suffice = nodes == Nodes::OfTheView && params.is_full(Level::FINEST) && view.budget.is_none();
        let is_cached = self
            .pyramids
            .get(&key)
            .is_some_and(|kept| cells_suffice || kept.is_whole());
        if !is_cached {
            let feature = match &view.feature {
                FeatureName::None => Feature::None,
                FeatureName::Derived(derived) => Feature::Derived(*derived),
                FeatureName::Field(name) => {
                    let key = VolumeKey::new(volume, name, view.cap);
                    Feature::Field(self.volumes.peek(&key).ok_or(WorkError::Stopped)?)
                }
            };
            let pyramid = if cells_suffice {
                self.engine.build_cells(shown_volume, feature, iso, cancel)?
            } else {
                self.engine.build_pyramid(shown_volume, feature, iso, cancel)?
            };
            self.pyramids.insert(key.clone(), pyramid.device_bytes(), pyramid);
        }
        let pyramid = self.pyramids.peek(&key).ok_or(WorkError::Stopped)?;
        let mut on = OnDevice {
            engine: &self.engine,
            cuts: &mut self.cuts,
            trees: &mut self.trees,
            key,
            volume: shown_volume,
            pyramid,
            was_cached: is_cached,
            params,
            spacing,
            world_from_index,
        };
        Ok(work(&mut on, view)?)
    }

    /// Keys of the fields that a view uses, marked as used; an error if one is not resident.
    fn require(&mut self, volume: &VolumeStep, view: &View, padded: bool) -> Result<Vec<VolumeKey>, JobError> {
        let mut keys = vec![VolumeKey::new(volume, &view.field, padded)];
        if let FeatureName::Field(name) = &view.feature
            && *name != view.field
        {
            keys.push(VolumeKey::new(volume, name, padded));
        }
        // All are marked as used.
        let missing = keys.iter().filter(|key| self.volumes.get(key).is_none()).count();
        if missing > 0 {
            return Err(self.not_resident(volume, &keys));
        }
        Ok(keys)
    }

    /// Says which fields a job needs; or before any file is read, that they cannot be resident together.
    fn not_resident(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> JobError {
        let bytes = |key: &VolumeKey| {
            let grid = padded_grid(volume, key.padded)?;
            let sample_bytes = key.field_of(volume)?.sample_type.bytes();
            Ok::<_, WorkError>((key.clone(), self.engine.upload_bytes(&grid, sample_bytes)))
        };
        let needed: Vec<_> = match keys.iter().map(bytes).collect() {
            Ok(needed) => needed,
            Err(error) => return error.into(),
        };
        let needed_bytes = needed.iter().map(|(_, bytes)| bytes).sum();
        let budget = self.volumes.budget();
        if needed_bytes > budget {
            return JobError::Failed(WorkError::TooLarge {
                needed_bytes,
                limit_bytes: budget,
            });
        }
        JobError::NotResident { needed, budget }
    }

    /// Frees all cached volumes and pyramids but these volumes. False where there were none.
    fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let before = self.volumes.len() + self.pyramids.len() + self.trees.len();
        self.volumes.retain(|key| keys.contains(key));
        self.pyramids.retain(|_| false);
        self.trees.retain(|_| false);
        self.cuts.kept.retain(|_| false);
        let freed = before - self.volumes.len() - self.pyramids.len();
        tracing::warn!(freed, "device memory ran out, volumes, pyramids and trees dropped");
        freed > 0
    }
}
