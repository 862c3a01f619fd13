//! Loads of fields: single-flight for each field, and progress of the work that the opening of a volume waits for.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use isopeel_extraction::{ALWAYS_DESCRIBED, HistogramCache, HistogramKey, VolumeKey, lock};
use isopeel_view::{FeatureName, View};
use isopeel_volumes::{Field, ReadError, ReadProgress, VolumeStep};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::device_thread::Preparation;

/// Maximum number of files that are read at the same time. Each load holds a few pieces of a field in host memory.
const CONCURRENT_LOADS: usize = 2;

/// Number of entries at which unused ones are dropped before another is added. An entry takes some hundred bytes, and each new expression
/// of a client adds one.
const MAX_ENTRIES: usize = 4096;

/// How long a load continues after its last waiting caller has given up: the next edit may need the same field.
const LINGER: Duration = Duration::from_secs(2);

/// The running and earlier loads of all fields.
pub(super) struct Loads {
    /// One entry for each field that was loaded. Entries stay until there are too many.
    fields: Mutex<HashMap<VolumeKey, Arc<FieldLoad>>>,
    /// Permits to read a file: [`CONCURRENT_LOADS`].
    pub permits: Arc<Semaphore>,
}

impl Loads {
    pub(super) fn new() -> Self {
        Self {
            fields: Mutex::default(),
            permits: Arc::new(Semaphore::new(CONCURRENT_LOADS)),
        }
    }

    /// Returns the entry of a field. Adds one if there is none.
    pub(super) fn get_or_insert(&self, key: &VolumeKey) -> Arc<FieldLoad> {
        let mut fields = lock(&self.fields);
        if fields.len() >= MAX_ENTRIES && !fields.contains_key(key) {
            // Keeps the entries of loads that are in use.
            fields.retain(|_, load| Arc::strong_count(load) > 1);
        }
        Arc::clone(fields.entry(key.clone()).or_default())
    }
}

/// The load of one field.
#[derive(Default)]
pub(super) struct FieldLoad {
    /// Held by the caller that loads the field, so that concurrent callers load it once.
    pub lock: Arc<tokio::sync::Mutex<()>>,
    /// Progress of the running load, or of the last one.
    pub progress: Arc<ReadProgress>,
    /// Cancels the computation of the field on the device. Replaced and cancelled together with the cancellation of `progress`.
    token: Mutex<CancellationToken>,
    /// Number of callers that wait for this load.
    waiting: AtomicUsize,
    /// How often the last waiting caller has left.
    departures: AtomicUsize,
    /// When the field was unreadable last, and why.
    failure: Mutex<Option<(Instant, ReadError)>>,
}

/// Guard of a caller that waits for a load. Dropping the guard removes the caller.
pub(super) struct WaitGuard(Arc<FieldLoad>);

impl FieldLoad {
    /// Registers a waiting caller until the returned guard is dropped. The load is cancelled [`LINGER`] after the last guard was dropped.
    pub(super) fn wait(self: &Arc<Self>) -> WaitGuard {
        self.waiting.fetch_add(1, Ordering::Relaxed);
        WaitGuard(Arc::clone(self))
    }

    /// Prepares for a new load or a retry: resets progress and cancellation. Returns false if no caller waits for it any more.
    pub(super) fn restart(&self) -> bool {
        let mut token = lock(&self.token);
        self.progress.restart();
        *token = CancellationToken::new();
        self.is_awaited()
    }

    /// Records that the field is unreadable.
    pub(super) fn fail(&self, error: &ReadError) {
        *lock(&self.failure) = Some((Instant::now(), error.duplicate()));
    }

    /// Returns the error of a load that has failed since `arrived`. So callers that waited for that load do not read the file again, one after
    /// the other.
    pub(super) fn failure_since(&self, arrived: Instant) -> Option<ReadError> {
        let failure = lock(&self.failure);
        let (_, error) = failure.as_ref().filter(|(when, _)| *when >= arrived)?;
        Some(error.duplicate())
    }

    /// Returns the token of the running load.
    pub(super) fn token(&self) -> CancellationToken {
        lock(&self.token).clone()
    }

    fn cancel(&self) {
        let token = lock(&self.token);
        self.progress.cancel();
        token.cancel();
    }

    fn is_awaited(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) > 0
    }
}

impl Drop for WaitGuard {
    fn drop(&mut self) {
        let is_last = self.0.waiting.fetch_sub(1, Ordering::Relaxed) == 1;
        let departure = self.0.departures.fetch_add(usize::from(is_last), Ordering::Relaxed) + 1;
        let is_running = self.0.lock.try_lock().is_err();
        if is_last
            && is_running
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            let load = Arc::clone(&self.0);
            runtime.spawn(async move {
                tokio::time::sleep(LINGER).await;
                // A caller that came and left meanwhile has a timer of its own.
                let is_latest = load.departures.load(Ordering::Relaxed) == departure;
                if is_latest && !load.is_awaited() {
                    load.cancel();
                }
            });
        }
    }
}

/// Progress of the opening of a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpeningProgress {
    /// The device is being prepared; nothing else was done yet.
    pub device: Option<Preparation>,
    /// Bytes that have been processed so far.
    pub bytes: u64,
    /// Bytes to process in all: those of files to read, and those of samples, which count once for each pass of the device over them.
    pub total_bytes: u64,
}

/// Observes the work that a [`super::DeviceWorker`] does, or waits for, on behalf of one caller.
pub struct OpeningWatch {
    fields: Mutex<Vec<FieldWork>>,
}

/// Remaining work on a field.
pub(super) struct FieldWork {
    key: VolumeKey,
    /// Bytes of the field's samples on the device.
    sample_bytes: u64,
    load: Option<LoadWork>,
    /// Histograms that are still to be made.
    histograms: Vec<HistogramKey>,
    /// Number of histograms that were made since the opening began.
    finished_histograms: u64,
}

/// Remaining work to load a field that is not resident.
struct LoadWork {
    /// Bytes of the field in its file.
    stored_bytes: u64,
    /// `None` until the field's load was requested.
    progress: Option<Arc<ReadProgress>>,
    /// Whether the field is resident by now.
    is_finished: bool,
}

impl FieldWork {
    /// Returns the work that opening a volume with this view requires on one of its fields.
    pub(super) fn new(
        volume: &VolumeStep,
        view: &View,
        field: &Field,
        is_resident: bool,
        cache: &HistogramCache,
    ) -> Self {
        let derived = ALWAYS_DESCRIBED.iter().map(|&feature| FeatureName::Derived(feature));
        let histograms: Vec<_> = [FeatureName::None]
            .into_iter()
            .chain(derived)
            .map(|feature| HistogramKey::new(volume, &field.name, &feature))
            .filter(|key| cache.peek(key).is_none())
            .collect();
        let is_resolved = view.iso.is_some() && view.feature_range.is_some();
        let is_in_view = view.field == field.name || view.feature.fields(&view.field).contains(&field.name.as_str());
        let needs_load = !is_resident && (!histograms.is_empty() || (is_in_view && !is_resolved));
        Self {
            key: VolumeKey::new(volume, &field.name, false),
            sample_bytes: volume.dataset().geometry.sample_count() * field.sample_type.bytes() as u64,
            load: needs_load.then(|| LoadWork {
                stored_bytes: field.source.stored_bytes(),
                progress: None,
                is_finished: false,
            }),
            histograms,
            finished_histograms: 0,
        }
    }
}

impl OpeningWatch {
    pub(super) fn new(fields: Vec<FieldWork>) -> Self {
        Self {
            fields: Mutex::new(fields),
        }
    }

    /// Records that a field is being loaded, with the progress of the load.
    pub(super) fn load_requested(&self, key: &VolumeKey, progress: &Arc<ReadProgress>) {
        self.with_load(key, |load| load.progress = Some(Arc::clone(progress)));
    }

    /// Records that a field is resident.
    pub(super) fn field_loaded(&self, key: &VolumeKey) {
        self.with_load(key, |load| load.is_finished = true);
    }

    fn with_load(&self, key: &VolumeKey, change: impl FnOnce(&mut LoadWork)) {
        let mut fields = lock(&self.fields);
        let field = fields.iter_mut().find(|field| field.key == *key);
        // `load` is `None` if the field was resident at first and has been evicted since.
        if let Some(load) = field.and_then(|field| field.load.as_mut()) {
            change(load);
        }
    }

    /// Records that a histogram has been made.
    pub(super) fn histogram_made(&self, key: &HistogramKey) {
        for field in lock(&self.fields).iter_mut() {
            let before = field.histograms.len();
            field.histograms.retain(|histogram| histogram != key);
            field.finished_histograms += (before - field.histograms.len()) as u64;
        }
    }

    /// Returns the current progress over all fields.
    pub fn progress(&self) -> OpeningProgress {
        let mut total = OpeningProgress::default();
        for field in lock(&self.fields).iter() {
            // Each histogram counts as a pass over the samples. A load counts the bytes of the file and those of the uploaded samples.
            total.bytes += field.finished_histograms * field.sample_bytes;
            total.total_bytes += (field.finished_histograms + field.histograms.len() as u64) * field.sample_bytes;
            let Some(load) = &field.load else { continue };
            total.total_bytes += load.stored_bytes + field.sample_bytes;
            total.bytes += match &load.progress {
                _ if load.is_finished => load.stored_bytes + field.sample_bytes,
                // A decoder may read a few bytes twice.
                Some(progress) => progress.bytes().min(load.stored_bytes),
                None => 0,
            };
        }
        total
    }
}
