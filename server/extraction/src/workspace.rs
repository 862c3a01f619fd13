//! A device with its resident volumes, and cached data of earlier edits: pyramids, vertex trees, cuts, histograms.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use isopeel_kernels::{Engine, Error, Pyramid, Upload, VertexTree, Volume, lock};
use isopeel_view::{FeatureName, OpeningIso, View};
use isopeel_volumes::{Field, VolumeStep};
use rayon::ThreadPool;

use super::cuts::Cuts;
use super::feature_fields::FeatureFields;
use super::grids::padded_grid;
use super::histogram_cache::HistogramCache;
use super::host_memory::HostMemory;
use super::identity::{EngineId, PyramidKey};
use super::job_error::JobError;
use super::keys::{HistogramKey, Masking, VolumeKey, view_keys, with_inputs};
use super::memory::WorkspaceMemory;
use super::observer::{Observer, Unobserved};
use super::open_steps::OpenSteps;
use super::pins::Pins;
use super::residency::Lru;
use super::shares::Shares;
use super::user_time::UserTimes;
use super::{WorkError, chain};

/// Share of the device's memory for resident volumes, in percent. The rest is for caches (`shares`), buffers of the stages, and other
/// processes.
const VOLUME_PERCENT: u64 = 50;

/// Cache of vertex trees, by the keys of their pyramids.
pub(crate) type Trees = Lru<PyramidKey, Arc<VertexTree>>;

/// Limits of a workspace, and state that it shares with its owner.
pub struct Options {
    /// Cache of histograms, which outlives the workspace of a lost device.
    pub histograms: HistogramCache,
    /// Pins of volumes that must not be evicted.
    pub pins: Pins,
    /// Time steps that viewers have open.
    pub open_steps: OpenSteps,
    /// Maximum bytes of cached data of earlier edits; `None`: a default that depends on the device.
    pub surface_bytes: Option<u64>,
    /// Maximum device time for computing one field; `None`: no limit.
    pub request_time: Option<Duration>,
    /// Device time that users have taken for computed fields. Outlives the workspace of a lost device.
    pub user_times: Arc<UserTimes>,
    /// Receives events for counters and timers.
    pub observer: Arc<dyn Observer + Send + Sync>,
    /// Pool for long work on the host's processors; `None`: rayon's own.
    pub long_work: Option<Arc<ThreadPool>>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            histograms: HistogramCache::default(),
            pins: Pins::default(),
            open_steps: OpenSteps::default(),
            surface_bytes: None,
            request_time: None,
            user_times: UserTimes::new(None),
            observer: Arc::new(Unobserved),
            long_work: None,
        }
    }
}

/// A device, the fields that are resident on it, and cached data of earlier edits. Data that work uses is reference-counted: it lives until
/// the work ends, even if other work evicts it in a pause.
pub struct Workspace {
    engine: Arc<Engine>,
    pub(crate) id: EngineId,
    pub(crate) volumes: Lru<VolumeKey, Arc<Volume>>,
    /// Volumes that were read ahead and not used yet, the oldest first.
    pub(crate) ahead: Vec<VolumeKey>,
    /// Resident fields that the device has computed from others, by an expression or a mask.
    pub(crate) computed: HashSet<VolumeKey>,
    pub(crate) pyramids: Lru<PyramidKey, Arc<Pyramid>>,
    pub(crate) trees: Arc<Mutex<Trees>>,
    pub(crate) cuts: Arc<Mutex<Cuts>>,
    /// Maximum bytes of cached pyramids, trees, cuts and freed buffers together.
    pub(crate) surface_bytes: u64,
    /// Maximum device time for computing one field.
    pub(crate) request_time: Option<Duration>,
    pub(crate) user_times: Arc<UserTimes>,
    pub(crate) histograms: HistogramCache,
    pub(crate) pins: Pins,
    pub(crate) open_steps: OpenSteps,
    pub(crate) observer: Arc<dyn Observer + Send + Sync>,
    pub(crate) long_work: Option<Arc<ThreadPool>>,
    /// Fields that are being loaded, each with its bytes on the device.
    pub(crate) uploads: HashMap<VolumeKey, (u64, Upload)>,
    /// Whether the device no longer answers, so that all of its data is gone.
    is_lost: bool,
}

impl Workspace {
    /// Creates a workspace on an opened device.
    pub fn new(engine: Engine, options: Options) -> Self {
        let Options {
            histograms,
            pins,
            open_steps,
            surface_bytes,
            request_time,
            user_times,
            observer,
            long_work,
        } = options;
        let device = engine.device();
        let host_bytes = HostMemory::now().total();
        let shares = Shares::of(device.kind, device.memory_bytes, host_bytes, surface_bytes);
        engine.limit_idle(shares.idle);
        Self {
            volumes: Lru::new(device.memory_bytes / 100 * VOLUME_PERCENT),
            engine: Arc::new(engine),
            id: EngineId::new(),
            ahead: Vec::new(),
            computed: HashSet::new(),
            surface_bytes: shares.total(),
            request_time,
            user_times,
            pyramids: Lru::new(shares.pyramids),
            trees: Arc::new(Mutex::new(Lru::new(shares.trees))),
            cuts: Arc::new(Mutex::new(Cuts::new(shares.cuts))),
            histograms,
            pins,
            open_steps,
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

    /// Whether a call has found that the device no longer answers. If so, all of its data is gone.
    pub fn is_lost(&self) -> bool {
        self.is_lost
    }

    /// Checks after a failure whether the device was lost. If the device no longer answers, returns [`WorkError::DeviceLost`] in place of
    /// the driver's error.
    pub fn look_for_loss(&mut self, error: JobError) -> JobError {
        let JobError::Failed(WorkError::Device(cause) | WorkError::NoTree(cause)) = &error else {
            return error;
        };
        let is_driver_error = matches!(cause, Error::Launch { .. } | Error::OutOfDeviceMemory { .. });
        if !is_driver_error || (!self.is_lost && self.engine.answers()) {
            return error;
        }
        if !self.is_lost {
            tracing::error!(error = chain(cause), "the device was lost");
            self.observer.device_lost();
            self.is_lost = true;
        }
        WorkError::DeviceLost.into()
    }

    /// Frees all volumes and cached data on the device, except data that is in use.
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
            trees: lock(&self.trees).cost(),
            cuts: lock(&self.cuts).cost(),
            program,
        })
    }

    /// Whether a field is resident.
    pub fn is_resident(&self, key: &VolumeKey) -> bool {
        self.resident(key).is_some()
    }

    /// Marks a field as used.
    ///
    /// # Errors
    /// [`JobError::NotResident`] if the field is not resident.
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

    /// Returns the engine for work that pauses. Such work must not borrow the workspace, because other work changes it in the pauses.
    pub(crate) fn shared_engine(&self) -> Arc<Engine> {
        Arc::clone(&self.engine)
    }

    /// Evicts the least recently used volumes that are not pinned, until `bytes` fit beside the remaining volumes.
    pub(crate) fn evict_for(&mut self, bytes: u64) {
        let pins = &self.pins;
        self.volumes.evict_for(bytes, |key| !pins.holds(key));
    }

    /// Makes a volume resident. The caller has evicted others to make space for it.
    pub(crate) fn add_volume(&mut self, key: VolumeKey, bytes: u64, volume: Arc<Volume>) {
        self.volumes.add(key, bytes, volume);
        self.forget_evicted();
    }

    /// Removes fields that are no longer resident from the list of computed fields.
    pub(crate) fn forget_evicted(&mut self) {
        let volumes = &self.volumes;
        self.computed.retain(|key| volumes.peek(key).is_some());
    }

    /// Returns the bytes of cached pyramids, trees and cuts, without freed buffers.
    pub(crate) fn cached_surface_bytes(&self) -> u64 {
        self.pyramids.cost() + lock(&self.trees).cost() + lock(&self.cuts).cost()
    }

    /// Fills in isovalue and feature range from cached histograms.
    ///
    /// # Errors
    /// [`JobError::NeedsHistograms`] with all histograms that are not cached; the caller makes them before the next attempt.
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
            let histogram = is_needed.then(|| self.histograms.get(key))?;
            if histogram.is_none() {
                missing.push(key.clone());
            }
            histogram
        };
        let (field_histogram, feature_histogram) = (cached(&field, needs_field), cached(&feature, needs_feature));
        if !missing.is_empty() {
            return Err(JobError::NeedsHistograms(missing));
        }
        let stored_field = volume.dataset().field(&view.field);
        let (unit, has_labels) = (
            stored_field.and_then(|field| field.unit.as_deref()),
            stored_field.is_some_and(Field::has_labels),
        );
        let opening_iso = field_histogram.map(|histogram| OpeningIso::of(&histogram, unit, has_labels));
        view.resolve(
            || opening_iso.ok_or(JobError::Failed(WorkError::Stopped)),
            || feature_histogram.ok_or(JobError::Failed(WorkError::Stopped)),
        )
    }

    /// Resolves a view as [`Workspace::resolve`] does, and marks as used the fields of which its surface is made.
    ///
    /// # Errors
    /// [`JobError`]; [`WorkError::Edit`] if there is no isovalue to choose.
    pub fn prepare(&mut self, volume: &VolumeStep, view: &mut View) -> Result<(), JobError> {
        self.resolve(volume, view)?;
        view.iso.ok_or_else(WorkError::no_finite_sample)?;
        self.require(volume, view)?;
        Ok(())
    }

    /// Marks the fields that a view uses as used, and returns their keys.
    ///
    /// # Errors
    /// [`JobError::NotResident`] if one of them is not resident.
    pub(crate) fn require(&mut self, volume: &VolumeStep, view: &View) -> Result<Vec<VolumeKey>, JobError> {
        let keys = view_keys(volume, view);
        self.use_fields(volume, &keys)?;
        Ok(keys)
    }

    /// Marks fields as used.
    ///
    /// # Errors
    /// [`JobError::NotResident`] with all of the fields if one of them is not resident.
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
            field.map(Arc::clone).ok_or(WorkError::Stopped)
        })
    }

    /// Returns [`JobError::NotResident`] with the fields that a job needs. If they cannot be resident together, returns
    /// [`WorkError::TooLarge`] instead, because it would be useless to read their files.
    fn not_resident(&self, volume: &VolumeStep, keys: &[VolumeKey]) -> JobError {
        // Includes the inputs of computed fields, because all inputs are pinned together until the fields are computed.
        let needed = |masking| {
            let needed = self.bytes_of(volume, &with_inputs(volume, keys, masking))?;
            let bytes: u64 = needed.iter().map(|(_, bytes)| bytes).sum();
            Ok::<_, WorkError>((needed, bytes))
        };
        let budget = self.volumes.budget();
        // If fields are masked on the host, only the result is on the device.
        let fields = match needed(Masking::OnDevice) {
            Ok((_, bytes)) if bytes > budget => needed(Masking::OnHost),
            fields => fields,
        };
        match fields {
            Ok((_, needed_bytes)) if needed_bytes > budget => JobError::Failed(WorkError::TooLarge {
                needed_bytes,
                limit_bytes: budget,
            }),
            Ok((needed, _)) => JobError::NotResident { needed, budget },
            Err(error) => error.into(),
        }
    }

    /// Returns the fields, each with the bytes that it takes on the device.
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

    /// Frees all cached pyramids, trees and cuts, and all volumes except those of `keys`. Returns false if there was nothing to free.
    pub(crate) fn free_all_but(&mut self, keys: &[VolumeKey]) -> bool {
        let (mut trees, mut cuts) = (lock(&self.trees), lock(&self.cuts));
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

/// A workspace may move to another thread.
const _: () = {
    const fn is_send<T: Send>() {}
    is_send::<Workspace>();
};
