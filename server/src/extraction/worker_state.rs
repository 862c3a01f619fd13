//! State of the device's thread: the engine, resident volumes, cached pyramids and histograms.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use isopeel_geometry::IndexSpace;
use isopeel_kernels::{
    Cancel, CutParams, Engine, Error, Histogram, Isovalue, Level, Mesher, Pyramid, RefinementCost, StageTime, Surface,
    Upload, VertexTree, Volume,
};
use isopeel_view::{EditError, FeatureName, OpeningIso, View};
use isopeel_volumes::{Field, VolumeStep};

use super::cuts::Cuts;
use super::decisions::Decided;
use super::feature_fields::FeatureFields;
use super::grids::padded_grid;
use super::host_memory::HostMemory;
use super::identity::{EngineId, PyramidKey};
use super::keys::{HistogramKey, Masking, VolumeKey, view_keys, with_inputs};
use super::lock::lock;
use super::memory::ThreadMemory;
use super::pins::Pins;
use super::residency::Lru;
use super::results::{Making, Refining};
use super::scheduler::{JobContext, JobTimes};
use super::shares::Shares;
use super::{Extraction, Measurement, WorkError};
use crate::dataset_views::view_space;
use crate::device::Proven;
use crate::metrics;

/// Share of the device's memory for resident volumes, in percent. The rest is for pyramids (`shares`), the stages' buffers and other processes.
const VOLUME_PERCENT: u64 = 50;

/// Why a job ended without a result.
pub(super) enum JobError {
    /// Not all fields in `needed` are resident: load them and queue the job again. `needed` has each field's bytes on the device; `budget`
    /// is the maximum for all resident fields together.
    NotResident { needed: Vec<(VolumeKey, u64)>, budget: u64 },
    /// These histograms are not cached: make them and queue the job again.
    NeedsHistograms(Vec<HistogramKey>),
    /// The job is too long to run as a short one: queue it again as a long one.
    TakesLong,
    /// This program is still being checked: wait until it has passed and queue the job again.
    Unproven { program: String, proven: Arc<Proven> },
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
    /// For jobs that use no volume: only `Failed` is expected of them.
    fn from(halt: JobError) -> Self {
        match halt {
            JobError::Failed(error) => error,
            JobError::NotResident { .. }
            | JobError::NeedsHistograms(_)
            | JobError::TakesLong
            | JobError::Unproven { .. } => Self::Stopped,
        }
    }
}

/// Returns the error that a view has no isovalue, and none can be chosen.
pub(super) fn no_finite_sample() -> WorkError {
    WorkError::Edit(EditError {
        field: "iso",
        why: "the field has no finite sample to choose an isovalue from".into(),
    })
}

/// What a job on a view uses on the device: its volume, its pyramid and the caches.
pub(super) struct OnDevice<'a> {
    pub engine: &'a Engine,
    /// `cuts` and `trees` are borrowed only for a moment, because other jobs use them while this job yields.
    pub cuts: &'a RefCell<Cuts>,
    pub trees: &'a RefCell<Trees>,
    /// Key of the pyramid and its tree.
    pub key: PyramidKey,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    /// Whether the pyramid was cached before the job.
    was_cached: bool,
    /// Whether the job yields to waiting jobs. Only such a job may take long.
    pub yields: bool,
    job_times: &'a JobTimes,
    /// Parameters of the view as it was before the job.
    pub params: CutParams,
    /// Smallest spacing: the unit of lengths on the device, world units.
    pub smallest: f64,
    pub index_space: IndexSpace,
}

impl OnDevice<'_> {
    /// Returns the parameters of a view that has been fitted since the job began.
    pub(super) fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.smallest, &self.index_space)
            .unwrap_or_else(|| self.params.clone())
    }

    /// Returns the time since `start`, without the time that other jobs took while this job yielded.
    pub(super) fn own_time(&self, start: Instant) -> Duration {
        self.job_times.own_time(start)
    }

    /// Makes the final surface, and returns the cost of refining it.
    fn final_surface(
        &self,
        view: &mut View,
        making: Making,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, Option<RefinementCost>), JobError> {
        let Making {
            ceiling,
            measures,
            refining,
        } = making;
        let refines = refining != Refining::Never;
        let (params, cut) = if view.is_by_error() {
            // If the surface is to be refined, its error is measured after the refinement.
            match self.decided(view, ceiling, true, measures && !refines, cancel)? {
                Decided::Tree(_) if refines => {
                    let (surface, cost) = self.refined_tree_surface(view, making, cancel)?;
                    return Ok((surface, Some(cost)));
                }
                Decided::Tree(surface) => return Ok((surface, None)),
                Decided::Cubes { params, cut, .. } => (params, cut),
            }
        } else {
            let (params, cut) = self.target_within(view, ceiling, cancel)?;
            (params, Rc::new(cut))
        };
        let params = CutParams {
            state_error: measures && params.mesher == Mesher::Dual,
            ..params
        };
        let surface = self
            .engine
            .surface(self.volume, self.pyramid, &params, &cut, None, cancel)?;
        Ok((self.with_all_stages(surface), None))
    }

    /// Completes the surface's stages with those of the job before its last yield. If the job has built the pyramid, the pyramid's stages
    /// come first.
    pub(super) fn with_all_stages(&self, mut surface: Surface) -> Surface {
        let stages = &mut surface.statistics.stages;
        self.job_times.complete(stages);
        stages.splice(0..0, self.new_pyramid_stages().iter().cloned());
        for stage in stages.iter() {
            metrics::stage(stage.stage, stage.milliseconds);
        }
        surface
    }

    /// Returns the stages of the pyramid if this job has built it, else none.
    pub(super) fn new_pyramid_stages(&self) -> &[StageTime] {
        if self.was_cached { &[] } else { self.pyramid.stages() }
    }
}

/// Which nodes of a pyramid a job needs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Nodes {
    /// Only nodes that can be leaves of the view's cut.
    OfTheView,
    /// All nodes, because the job cuts coarse prefixes too, and the next edit changes the cut.
    All,
}

/// Cache of vertex trees, by the keys of their pyramids.
pub(super) type Trees = Lru<PyramidKey, Rc<VertexTree>>;

/// Histograms, shared between the thread and the handles.
pub(super) type Histograms = Arc<Mutex<Lru<HistogramKey, Histogram>>>;

/// State of the device's thread. Data that a yielding job uses is reference-counted: it lives until the job ends, even if another job
/// evicts it.
pub(super) struct WorkerState {
    engine: Rc<Engine>,
    pub(super) id: EngineId,
    pub(super) volumes: Lru<VolumeKey, Rc<Volume>>,
    /// Volumes that were read ahead and are not used yet, the oldest first.
    pub(super) ahead: Vec<VolumeKey>,
    /// Resident fields that the device has computed from others, by an expression or a mask.
    pub(super) computed: HashSet<VolumeKey>,
    pub(super) pyramids: Lru<PyramidKey, Rc<Pyramid>>,
    pub(super) trees: Rc<RefCell<Trees>>,
    pub(super) cuts: Rc<RefCell<Cuts>>,
    /// Maximum bytes of cached pyramids, trees, cuts and freed buffers together.
    pub(super) surface_bytes: u64,
    /// Maximum device time for computing one field.
    pub(super) request_time: Option<Duration>,
    pub(super) histograms: Histograms,
    pub(super) pins: Pins,
    /// Fields that are being loaded, each with its bytes on the device.
    pub(super) uploads: HashMap<VolumeKey, (u64, Upload)>,
    /// Whether the device no longer answers: all its data is gone.
    pub(super) is_lost: bool,
    /// Set while the device's check is still running: the programs that have passed it so far. The engine builds no others.
    pub(super) proven: Option<Arc<Proven>>,
}

impl WorkerState {
    /// `surface_bytes`: maximum bytes of cached data of earlier edits; `None`: a default that depends on the device. `request_time`: as in
    /// [`super::DeviceOptions`].
    pub(super) fn new(
        engine: Engine,
        histograms: Histograms,
        pins: Pins,
        surface_bytes: Option<u64>,
        request_time: Option<Duration>,
    ) -> Self {
        let device = engine.device();
        let host_bytes = HostMemory::now().total();
        let shares = Shares::of(device.kind, device.memory_bytes, host_bytes, surface_bytes);
        engine.limit_idle(shares.idle);
        Self {
            volumes: Lru::new(device.memory_bytes / 100 * VOLUME_PERCENT),
            engine: Rc::new(engine),
            id: EngineId::new(),
            ahead: Vec::new(),
            computed: HashSet::new(),
            surface_bytes: shares.total(),
            request_time,
            pyramids: Lru::new(shares.pyramids),
            trees: Rc::new(RefCell::new(Lru::new(shares.trees))),
            cuts: Rc::new(RefCell::new(Cuts::new(shares.cuts))),
            histograms,
            pins,
            uploads: HashMap::new(),
            is_lost: false,
            proven: None,
        }
    }

    /// Returns the memory by purpose. `program`: bytes that the process held before it opened a volume.
    pub(super) fn memory(&self, program: u64) -> Result<ThreadMemory, Error> {
        Ok(ThreadMemory {
            device: self.engine.memory()?,
            volumes: self.volumes.cost() + self.upload_bytes(),
            pyramids: self.pyramids.cost(),
            trees: self.trees.borrow().cost(),
            cuts: self.cuts.borrow().cost(),
            program,
        })
    }

    pub(super) fn is_resident(&self, key: &VolumeKey) -> bool {
        self.resident(key).is_some()
    }

    /// Marks a field as used; returns an error if it is not resident.
    pub(super) fn use_field(&mut self, volume: &VolumeStep, key: &VolumeKey) -> Result<(), JobError> {
        self.use_fields(volume, std::slice::from_ref(key))
    }

    /// Returns a field if it is resident, without marking it as used.
    pub(super) fn resident(&self, key: &VolumeKey) -> Option<&Volume> {
        self.volumes.peek(key).map(|volume| &**volume)
    }

    pub(super) const fn engine(&self) -> &Rc<Engine> {
        &self.engine
    }

    /// Evicts the least recently used volumes that no job waits for, until `bytes` fit beside the rest.
    pub(super) fn evict_for(&mut self, bytes: u64) {
        let pins = &self.pins;
        self.volumes.evict_for(bytes, |key| !pins.holds(key));
    }

    pub(super) fn add_volume(&mut self, key: VolumeKey, bytes: u64, volume: Rc<Volume>) {
        self.volumes.add(key, bytes, volume);
        self.forget_evicted();
    }

    /// Forgets computed fields that are no longer resident.
    pub(super) fn forget_evicted(&mut self) {
        let volumes = &self.volumes;
        self.computed.retain(|key| volumes.peek(key).is_some());
    }

    /// Returns the bytes of cached pyramids, trees and cuts, without freed buffers.
    pub(super) fn kept_surface_bytes(&self) -> u64 {
        self.pyramids.cost() + self.trees.borrow().cost() + self.cuts.borrow().cost()
    }

    /// Fills in isovalue and feature range from cached histograms. If any is missing, returns an error that names all missing ones, so that
    /// the caller makes them before the next attempt.
    pub(super) fn resolve(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        if view.iso.is_some() && view.feature_range.is_some() {
            return Ok(());
        }
        let field = HistogramKey::new(volume, &view.field, &FeatureName::None);
        let feature = HistogramKey::new(volume, &view.field, &view.feature);
        let needs_field = view.iso.is_none();
        let needs_feature = view.feature_range.is_none() && view.feature != FeatureName::None;
        let mut missing = Vec::new();
        let mut cached = |key: &HistogramKey, is_needed: bool| {
            let found = is_needed.then(|| lock(&self.histograms).get(key).cloned())?;
            if found.is_none() {
                missing.push(key.clone());
            }
            found
        };
        let (of_field, of_feature) = (cached(&field, needs_field), cached(&feature, needs_feature));
        if !missing.is_empty() {
            return Err(JobError::NeedsHistograms(missing));
        }
        let known = volume.dataset().field(&view.field);
        let (unit, has_labels) = (
            known.and_then(|field| field.unit.as_deref()),
            known.is_some_and(Field::has_labels),
        );
        let opening_iso = of_field.map(|histogram| OpeningIso::of(&histogram, unit, has_labels));
        view.resolve(
            || opening_iso.ok_or(JobError::Failed(WorkError::Stopped)),
            || of_feature.ok_or(JobError::Failed(WorkError::Stopped)),
        )
    }

    /// Makes the final surface as `making` says, from a cached pyramid if there is one. The surface's stages are those of this job alone.
    pub(super) fn extract(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Extraction, JobError> {
        let (start, mut view) = (Instant::now(), view.clone());
        let (surface, refined, wall) =
            self.with_pyramid(volume, &mut view, Nodes::OfTheView, context, |on, view, cancel| {
                let (surface, refined) = on.final_surface(view, making, cancel)?;
                Ok((surface, refined, on.own_time(start)))
            })?;
        Ok(Extraction {
            surface,
            view,
            wall,
            measured: None,
            refined,
        })
    }

    /// Measures the error of a view's final surface, which the dual mesher made: a cut of the vertex tree if `view.fitted` says so and the
    /// tree can be built, else a cut of cubes. `None` if the surface has no triangles.
    pub(super) fn measure(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Option<Measurement>, JobError> {
        self.with_pyramid(volume, view, Nodes::OfTheView, context, |on, view, cancel| {
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
            let in_world = |error| super::MeasuredError::in_world(error, on.smallest);
            let regions = measured.regions.into_iter();
            Ok(in_world(measured.whole).map(|whole| Measurement {
                whole,
                regions: regions
                    .filter_map(|(region, error)| Some((region, in_world(error)?)))
                    .collect(),
            }))
        })
    }

    /// Runs `work` with the volume and the pyramid of a view. If the device runs out of memory, frees caches and retries once. Pins the
    /// volumes of a long job, if there is space for them beside the volumes that are pinned already.
    pub(super) fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        context: &mut JobContext<'_, Self>,
        work: impl Fn(&OnDevice<'_>, &mut View, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let keys = self.require(volume, view)?;
        self.resolve(volume, view)?;
        let _pin = match context.others {
            Some(_) => self.pins.try_pin(&self.bytes_of(volume, &keys)?, self.volumes.budget()),
            None => None,
        };
        match self.try_with_pyramid(volume, view, nodes, context, &work) {
            Err(JobError::Failed(
                WorkError::Device(Error::OutOfDeviceMemory { .. }) | WorkError::NoTree(Error::OutOfDeviceMemory { .. }),
            )) if self.free_all_but(&keys) => self.try_with_pyramid(volume, view, nodes, context, &work),
            outcome => outcome,
        }
    }

    fn try_with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        context: &mut JobContext<'_, Self>,
        work: &impl Fn(&OnDevice<'_>, &mut View, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let iso: Isovalue = view.iso.ok_or_else(no_finite_sample)?;
        let smallest = volume.dataset().smallest_length();
        let (_, index_space) = view_space(volume.dataset(), view);
        let params = view.cut_params(smallest, &index_space).ok_or_else(no_finite_sample)?;
        let key = PyramidKey::new(volume, view);
        let shown_volume = self
            .volumes
            .peek(key.samples())
            .map(Rc::clone)
            .ok_or(WorkError::Stopped)?;
        // Fitting a budget needs the whole pyramid.
        let cells_suffice = nodes == Nodes::OfTheView && params.is_full(Level::FINEST) && view.budget.is_none();
        let is_cached = self
            .pyramids
            .get(&key)
            .is_some_and(|kept| cells_suffice || kept.is_whole());
        metrics::looked_up("pyramid", is_cached);
        let (engine, cuts, trees) = (Rc::clone(&self.engine), Rc::clone(&self.cuts), Rc::clone(&self.trees));
        // An error is ignored here: if the device failed, the job's next launch reports it.
        let take_times = || engine.take_times().unwrap_or_default();
        let job_times = JobTimes::default();
        if !is_cached {
            let feature = self.feature_fields(volume, &view.feature, view.cap)?;
            let pyramid = context.run(self, &take_times, &job_times, |cancel| match cells_suffice {
                true => engine.build_cells(&shown_volume, feature.get(), iso, cancel),
                false => engine.build_pyramid(&shown_volume, feature.get(), iso, cancel),
            })?;
            // While this job yielded, another job may have cached the whole pyramid and a tree of it: keep those.
            if self.pyramids.peek(&key).is_none_or(|kept| !kept.is_whole()) {
                self.pyramids
                    .insert(key.clone(), pyramid.device_bytes(), Rc::new(pyramid));
            }
        }
        let pyramid = self.pyramids.peek(&key).map(Rc::clone).ok_or(WorkError::Stopped)?;
        let on = OnDevice {
            engine: &engine,
            cuts: &cuts,
            trees: &trees,
            key,
            volume: &shown_volume,
            pyramid: &pyramid,
            was_cached: is_cached,
            yields: context.others.is_some(),
            job_times: &job_times,
            params,
            smallest,
            index_space,
        };
        context.run(self, &take_times, &job_times, |cancel| work(&on, view, cancel))
    }

    /// Returns the keys of the fields that a view uses, and marks the fields as used. Returns an error if one is not resident.
    pub(super) fn require(&mut self, volume: &VolumeStep, view: &View) -> Result<Vec<VolumeKey>, JobError> {
        let keys = view_keys(volume, view);
        self.use_fields(volume, &keys)?;
        Ok(keys)
    }

    /// Marks fields as used. If one is not resident, returns an error that names all of them.
    pub(super) fn use_fields(&mut self, volume: &VolumeStep, keys: &[VolumeKey]) -> Result<(), JobError> {
        self.ahead.retain(|key| !keys.contains(key));
        let missing = keys.iter().filter(|key| self.volumes.get(key).is_none()).count();
        metrics::looked_up("volume", missing == 0);
        if missing > 0 {
            return Err(self.not_resident(volume, keys));
        }
        Ok(())
    }

    /// Returns a feature with its fields, which must be resident.
    pub(super) fn feature_fields(
        &self,
        volume: &VolumeStep,
        feature: &FeatureName,
        padded: bool,
    ) -> Result<FeatureFields, WorkError> {
        FeatureFields::new(feature, |name| {
            let field = self.volumes.peek(&VolumeKey::new(volume, name, padded));
            field.map(Rc::clone).ok_or(WorkError::Stopped)
        })
    }

    /// Returns [`JobError::NotResident`] with the fields that a job needs. If they cannot be resident together, returns
    /// [`WorkError::TooLarge`], so that no file is read in vain.
    fn not_resident(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> JobError {
        // Includes the inputs of computed fields: all of them are pinned together until the fields are made.
        let needed = |masking| {
            let needed = self.bytes_of(volume, &with_inputs(volume, keys, masking))?;
            let bytes: u64 = needed.iter().map(|(_, bytes)| bytes).sum();
            Ok::<_, WorkError>((needed, bytes))
        };
        let budget = self.volumes.budget();
        // If fields are masked on the host, only the result is on the device.
        let found = match needed(Masking::OnDevice) {
            Ok((_, bytes)) if bytes > budget => needed(Masking::OnHost),
            found => found,
        };
        match found {
            Ok((_, needed_bytes)) if needed_bytes > budget => JobError::Failed(WorkError::TooLarge {
                needed_bytes,
                limit_bytes: budget,
            }),
            Ok((needed, _)) => JobError::NotResident { needed, budget },
            Err(error) => error.into(),
        }
    }

    /// Returns the fields with their bytes on the device.
    pub(super) fn bytes_of(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> Result<Vec<(VolumeKey, u64)>, WorkError> {
        let bytes = |key: &VolumeKey| {
            let grid = padded_grid(volume, key.padded)?;
            Ok((
                key.clone(),
                self.engine.upload_bytes(grid.grid(), key.sample_bytes(volume)?),
            ))
        };
        keys.iter().map(bytes).collect()
    }

    /// Frees all cached pyramids, trees and cuts, and all volumes except these. Returns false if there was nothing to free.
    pub(super) fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let (mut trees, mut cuts) = (self.trees.borrow_mut(), self.cuts.borrow_mut());
        let (before, cut_bytes) = (self.volumes.len() + self.pyramids.len() + trees.len(), cuts.cost());
        self.volumes.retain(|key| keys.contains(key));
        self.pyramids.retain(|_| false);
        trees.retain(|_| false);
        cuts.clear();
        let freed = before - self.volumes.len() - self.pyramids.len();
        tracing::warn!(
            freed,
            cut_bytes,
            "volumes, pyramids, trees and cuts are dropped from the device"
        );
        freed > 0 || cut_bytes > 0
    }
}
