//! A device with its resident volumes, and what earlier edits have made: pyramids, vertex trees, cuts, histograms.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_geometry::IndexSpace;
use isopeel_kernels::{
    Cancel, CutParams, Engine, Error, Isovalue, Level, Mesher, Pyramid, RefinementCost, StageTime, Surface, Upload,
    VertexTree, Volume,
};
use isopeel_view::{EditError, FeatureName, OpeningIso, View};
use isopeel_volumes::{Field, VolumeStep};
use rayon::ThreadPool;

use super::context::{JobContext, JobTimes};
use super::cuts::Cuts;
use super::dataset_views::view_space;
use super::decisions::Decided;
use super::feature_fields::FeatureFields;
use super::grids::padded_grid;
use super::histogram_cache::HistogramCache;
use super::host_memory::HostMemory;
use super::identity::{EngineId, PyramidKey};
use super::keys::{HistogramKey, Masking, VolumeKey, view_keys, with_inputs};
use super::memory::WorkspaceMemory;
use super::observer::{Observer, Unobserved};
use super::pins::Pins;
use super::residency::Lru;
use super::results::{Making, Refining};
use super::shares::Shares;
use super::{Extraction, Measurement, WorkError, chain};

/// Share of the device's memory for resident volumes, in percent. The rest is for pyramids (`shares`), the stages' buffers and other processes.
const VOLUME_PERCENT: u64 = 50;

/// Why a piece of work ended without a result.
#[derive(Debug)]
pub enum JobError {
    /// Not all fields that it needs are resident: load them and try again.
    NotResident {
        /// The fields, each with its bytes on the device.
        needed: Vec<(VolumeKey, u64)>,
        /// Maximum bytes of all resident fields together.
        budget: u64,
    },
    /// These histograms are not cached: make them and try again.
    NeedsHistograms(Vec<HistogramKey>),
    /// It is too long for short work: try again as long work.
    TakesLong,
    /// Trying again would not help.
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
    /// For work that uses no volume: only `Failed` is expected of them.
    fn from(halt: JobError) -> Self {
        match halt {
            JobError::Failed(error) => error,
            JobError::NotResident { .. } | JobError::NeedsHistograms(_) | JobError::TakesLong => Self::Stopped,
        }
    }
}

/// Returns the error that a view has no isovalue, and none can be chosen.
pub(crate) fn no_finite_sample() -> WorkError {
    WorkError::Edit(EditError {
        field: "iso",
        why: "the field has no finite sample to choose an isovalue from".into(),
    })
}

/// What a job on a view uses on the device: its volume, its pyramid and the caches.
pub(crate) struct OnDevice<'a> {
    pub engine: &'a Engine,
    /// `cuts` and `trees` are borrowed only for a moment, because other jobs use them in a pause.
    pub cuts: &'a RefCell<Cuts>,
    pub trees: &'a RefCell<Trees>,
    /// Key of the pyramid and its tree.
    pub key: PyramidKey,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    /// Whether the pyramid was cached before the job.
    was_cached: bool,
    /// Whether the work may take long. Only such work pauses.
    pub may_take_long: bool,
    job_times: &'a JobTimes,
    pub observer: &'a dyn Observer,
    /// Pool for long work on the host's processors; `None`: rayon's own.
    pub long_work: Option<&'a ThreadPool>,
    /// Parameters of the view as it was before the job.
    pub params: CutParams,
    /// Smallest spacing: the unit of lengths on the device, world units.
    pub smallest: f64,
    pub index_space: IndexSpace,
}

impl OnDevice<'_> {
    /// Returns the parameters of a view that has been fitted since the job began.
    pub(crate) fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.smallest, &self.index_space)
            .unwrap_or_else(|| self.params.clone())
    }

    /// Returns the time since `start`, without the time of other jobs in its pauses.
    pub(crate) fn own_time(&self, start: Instant) -> Duration {
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

    /// Completes the surface's stages with those of the job before its last pause. If the job has built the pyramid, the pyramid's stages
    /// come first.
    pub(crate) fn with_all_stages(&self, mut surface: Surface) -> Surface {
        let stages = &mut surface.statistics.stages;
        self.job_times.complete(stages);
        stages.splice(0..0, self.new_pyramid_stages().iter().cloned());
        for stage in stages.iter() {
            self.observer.stage(stage.stage, stage.milliseconds);
        }
        surface
    }

    /// Returns the stages of the pyramid if this job has built it, else none.
    pub(crate) fn new_pyramid_stages(&self) -> &[StageTime] {
        if self.was_cached { &[] } else { self.pyramid.stages() }
    }
}

/// Which nodes of a pyramid a job needs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Nodes {
    /// Only nodes that can be leaves of the view's cut.
    OfTheView,
    /// All nodes, because the job cuts coarse prefixes too, and the next edit changes the cut.
    All,
}

/// Cache of vertex trees, by the keys of their pyramids.
pub(crate) type Trees = Lru<PyramidKey, Rc<VertexTree>>;

/// What a workspace shares with its owner, and its limits.
pub struct Options {
    /// Histograms that were made; kept when the workspace is made again.
    pub histograms: HistogramCache,
    /// Volumes that are not evicted.
    pub pins: Pins,
    /// Maximum bytes of cached data of earlier edits; `None`: a default that depends on the device.
    pub surface_bytes: Option<u64>,
    /// Maximum device time for computing one field; `None`: no limit.
    pub request_time: Option<Duration>,
    /// Counters and timers.
    pub observer: Arc<dyn Observer + Send + Sync>,
    /// Pool for long work on the host's processors; `None`: rayon's own.
    pub long_work: Option<Arc<ThreadPool>>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            histograms: HistogramCache::default(),
            pins: Pins::default(),
            surface_bytes: None,
            request_time: None,
            observer: Arc::new(Unobserved),
            long_work: None,
        }
    }
}

/// A device, the fields that are resident on it, and what earlier edits have made. Data that work uses is reference-counted: it lives until
/// the work ends, even if other work in a pause evicts it.
pub struct Workspace {
    engine: Rc<Engine>,
    pub(crate) id: EngineId,
    pub(crate) volumes: Lru<VolumeKey, Rc<Volume>>,
    /// Volumes that were read ahead and are not used yet, the oldest first.
    pub(crate) ahead: Vec<VolumeKey>,
    /// Resident fields that the device has computed from others, by an expression or a mask.
    pub(crate) computed: HashSet<VolumeKey>,
    pub(crate) pyramids: Lru<PyramidKey, Rc<Pyramid>>,
    pub(crate) trees: Rc<RefCell<Trees>>,
    pub(crate) cuts: Rc<RefCell<Cuts>>,
    /// Maximum bytes of cached pyramids, trees, cuts and freed buffers together.
    pub(crate) surface_bytes: u64,
    /// Maximum device time for computing one field.
    pub(crate) request_time: Option<Duration>,
    pub(crate) histograms: HistogramCache,
    pub(crate) pins: Pins,
    pub(crate) observer: Arc<dyn Observer + Send + Sync>,
    long_work: Option<Arc<ThreadPool>>,
    /// Fields that are being loaded, each with its bytes on the device.
    pub(crate) uploads: HashMap<VolumeKey, (u64, Upload)>,
    /// Whether the device no longer answers: all its data is gone.
    is_lost: bool,
}

impl Workspace {
    /// Creates a workspace on an opened device.
    pub fn new(engine: Engine, options: Options) -> Self {
        let Options {
            histograms,
            pins,
            surface_bytes,
            request_time,
            observer,
            long_work,
        } = options;
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
            observer,
            long_work,
            uploads: HashMap::new(),
            is_lost: false,
        }
    }

    /// Returns the id of the engine.
    pub fn id(&self) -> EngineId {
        self.id
    }

    /// Whether the device was found not to answer any more: all its data is gone.
    pub fn is_lost(&self) -> bool {
        self.is_lost
    }

    /// Classifies a failure: if the device no longer answers, it is lost, whatever error the driver has reported.
    pub fn look_for_loss(&mut self, error: JobError) -> JobError {
        let JobError::Failed(WorkError::Device(cause) | WorkError::NoTree(cause)) = &error else {
            return error;
        };
        let is_of_the_driver = matches!(cause, Error::Launch { .. } | Error::OutOfDeviceMemory { .. });
        if !is_of_the_driver || (!self.is_lost && self.engine.answers()) {
            return error;
        }
        if !self.is_lost {
            tracing::error!(error = chain(cause), "the device was lost");
            self.observer.device_lost();
            self.is_lost = true;
        }
        WorkError::DeviceLost.into()
    }

    /// Frees all that it can of what the device holds.
    pub fn clear(&mut self) {
        self.uploads.clear();
        self.free_all_but(&[]);
    }

    /// Returns the memory by purpose. `program`: bytes that the process held before it opened a volume.
    ///
    /// # Errors
    /// The device's errors.
    pub fn memory(&self, program: u64) -> Result<WorkspaceMemory, Error> {
        Ok(WorkspaceMemory {
            device: self.engine.memory()?,
            volumes: self.volumes.cost() + self.upload_bytes(),
            pyramids: self.pyramids.cost(),
            trees: self.trees.borrow().cost(),
            cuts: self.cuts.borrow().cost(),
            program,
        })
    }

    /// Whether a field is resident.
    pub fn is_resident(&self, key: &VolumeKey) -> bool {
        self.resident(key).is_some()
    }

    /// Marks a field as used; returns an error if it is not resident.
    ///
    /// # Errors
    /// [`JobError::NotResident`].
    pub fn use_field(&mut self, volume: &VolumeStep, key: &VolumeKey) -> Result<(), JobError> {
        self.use_fields(volume, std::slice::from_ref(key))
    }

    /// Returns a field if it is resident, without marking it as used.
    pub(crate) fn resident(&self, key: &VolumeKey) -> Option<&Volume> {
        self.volumes.peek(key).map(|volume| &**volume)
    }

    /// Returns the engine.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// Returns the engine for work that pauses, during which nothing of the workspace is borrowed.
    pub(crate) fn shared_engine(&self) -> Rc<Engine> {
        Rc::clone(&self.engine)
    }

    /// Evicts the least recently used volumes that are not pinned, until `bytes` fit beside the rest.
    pub(crate) fn evict_for(&mut self, bytes: u64) {
        let pins = &self.pins;
        self.volumes.evict_for(bytes, |key| !pins.holds(key));
    }

    pub(crate) fn add_volume(&mut self, key: VolumeKey, bytes: u64, volume: Rc<Volume>) {
        self.volumes.add(key, bytes, volume);
        self.forget_evicted();
    }

    /// Forgets computed fields that are no longer resident.
    pub(crate) fn forget_evicted(&mut self) {
        let volumes = &self.volumes;
        self.computed.retain(|key| volumes.peek(key).is_some());
    }

    /// Returns the bytes of cached pyramids, trees and cuts, without freed buffers.
    pub(crate) fn kept_surface_bytes(&self) -> u64 {
        self.pyramids.cost() + self.trees.borrow().cost() + self.cuts.borrow().cost()
    }

    /// Fills in isovalue and feature range from cached histograms. If any is missing, returns an error that names all missing ones, so that
    /// the caller makes them before the next attempt.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn resolve(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        if view.iso.is_some() && view.feature_range.is_some() {
            return Ok(());
        }
        let field = HistogramKey::new(volume, &view.field, &FeatureName::None);
        let feature = HistogramKey::new(volume, &view.field, &view.feature);
        let needs_field = view.iso.is_none();
        let needs_feature = view.feature_range.is_none() && view.feature != FeatureName::None;
        let mut missing = Vec::new();
        let mut cached = |key: &HistogramKey, is_needed: bool| {
            let found = is_needed.then(|| self.histograms.get(key))?;
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

    /// Resolves a view as [`Workspace::resolve`] does, and marks the fields as used that its surface is made of.
    ///
    /// # Errors
    /// [`JobError`]; [`WorkError::Edit`] if there is no isovalue to choose.
    pub fn prepare(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        self.resolve(volume, view)?;
        view.iso.ok_or_else(no_finite_sample)?;
        self.require(volume, view)?;
        Ok(())
    }

    /// Makes the final surface as `making` says, from a cached pyramid if there is one. The surface's stages are those of this job alone.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn extract(
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
    ///
    /// # Errors
    /// [`JobError`].
    pub fn measure(
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
    pub(crate) fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        context: &mut JobContext<'_, Self>,
        work: impl Fn(&OnDevice<'_>, &mut View, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let keys = self.require(volume, view)?;
        self.resolve(volume, view)?;
        let _pin = match context.may_take_long() {
            true => self.pins.try_pin(&self.bytes_of(volume, &keys)?, self.volumes.budget()),
            false => None,
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
        self.observer.looked_up("pyramid", is_cached);
        let (engine, cuts, trees) = (Rc::clone(&self.engine), Rc::clone(&self.cuts), Rc::clone(&self.trees));
        let (observer, long_work) = (Arc::clone(&self.observer), self.long_work.clone());
        // An error is ignored here: if the device failed, the job's next launch reports it.
        let take_times = || engine.take_times().unwrap_or_default();
        let job_times = JobTimes::default();
        if !is_cached {
            let feature = self.feature_fields(volume, &view.feature, view.cap)?;
            let pyramid = context.run(self, &take_times, &job_times, |cancel| match cells_suffice {
                true => engine.build_cells(&shown_volume, feature.get(), iso, cancel),
                false => engine.build_pyramid(&shown_volume, feature.get(), iso, cancel),
            })?;
            // In a pause, another job may have cached the whole pyramid and a tree of it: keep those.
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
            may_take_long: context.may_take_long(),
            job_times: &job_times,
            observer: &*observer,
            long_work: long_work.as_deref(),
            params,
            smallest,
            index_space,
        };
        context.run(self, &take_times, &job_times, |cancel| work(&on, view, cancel))
    }

    /// Returns the keys of the fields that a view uses, and marks the fields as used. Returns an error if one is not resident.
    ///
    /// # Errors
    /// [`JobError`].
    pub(crate) fn require(&mut self, volume: &VolumeStep, view: &View) -> Result<Vec<VolumeKey>, JobError> {
        let keys = view_keys(volume, view);
        self.use_fields(volume, &keys)?;
        Ok(keys)
    }

    /// Marks fields as used. If one is not resident, returns an error that names all of them.
    pub(crate) fn use_fields(&mut self, volume: &VolumeStep, keys: &[VolumeKey]) -> Result<(), JobError> {
        self.ahead.retain(|key| !keys.contains(key));
        let missing = keys.iter().filter(|key| self.volumes.get(key).is_none()).count();
        self.observer.looked_up("volume", missing == 0);
        if missing > 0 {
            return Err(self.not_resident(volume, keys));
        }
        Ok(())
    }

    /// Returns a feature with its fields, which must be resident.
    pub(crate) fn feature_fields(
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
    pub(crate) fn bytes_of(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> Result<Vec<(VolumeKey, u64)>, WorkError> {
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
    pub(crate) fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let (mut trees, mut cuts) = (self.trees.borrow_mut(), self.cuts.borrow_mut());
        let (before, cut_bytes) = (
            self.volumes.entries() + self.pyramids.entries() + trees.entries(),
            cuts.cost(),
        );
        self.volumes.retain(|key| keys.contains(key));
        self.pyramids.retain(|_| false);
        trees.retain(|_| false);
        cuts.clear();
        let freed = before - self.volumes.entries() - self.pyramids.entries();
        tracing::warn!(
            freed,
            cut_bytes,
            "volumes, pyramids, trees and cuts are dropped from the device"
        );
        freed > 0 || cut_bytes > 0
    }
}
