//! The interface of a session to catalog and device: a trait, so that tests can script a device.

use std::sync::Arc;
use std::time::Duration;

use isopeel_extraction::{
    Answer, EngineId, FullCount, Measurement, OpenStepGuard, Question, Refinement, ShownSurface, Step, WorkError,
};
use isopeel_kernels::{DeviceInfo, DeviceKind};
use isopeel_view::View;
use isopeel_volumes::{Dataset, Lease, SharedCatalog, VolumeStep};
use serde_json::value::RawValue;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::access::Identity;
use crate::error::chain;
use crate::service::{DevicePool, DeviceState, DeviceWorker, OpeningProgress, OpeningWatch, Seat, describe};

/// Default capacity, in bytes, of the cache of chunks for viewers of equal views: some dozen surfaces of a million triangles.
pub const SHARED_BYTES: u64 = 256 << 20;

/// Interval at which the progress of opening a volume is polled. It is also the minimum interval between two reports.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Catalog and device of a session.
pub trait Backend: Clone + Send + Sync + 'static {
    /// Returns the dataset with the id `volume`, if there is one that the user may see.
    fn find(&self, volume: &str, who: &Identity) -> Option<Arc<Dataset>>;

    /// Returns a backend for a viewer, which charges its work to this user, for the limits per user.
    #[must_use]
    fn charged_to(self, _who: &Identity) -> Self {
        self
    }

    /// Marks a volume as in use until the returned lease is dropped.
    fn lease(&self, _volume: &str) -> Lease {
        Lease::default()
    }

    /// Describes a volume, and resolves the values of its opening view that depend on the data. Publishes the progress on `progress`.
    fn open(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
        progress: &watch::Sender<OpeningProgress>,
    ) -> impl Future<Output = Result<Opening, WorkError>> + Send;

    /// Returns the description of a volume: the same JSON as `GET /api/v1/volumes/{id}` returns.
    fn describe(
        &self,
        volume: &VolumeStep,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Box<RawValue>, WorkError>> + Send;

    /// Reads ahead the samples of a time step that these views use, if there is memory for the samples.
    fn read_ahead(
        &self,
        volume: &VolumeStep,
        views: &[View],
        token: &CancellationToken,
    ) -> impl Future<Output = ()> + Send;

    /// Marks a time step as open until the returned guard is dropped. Read-ahead of other steps does not evict the samples of an open step.
    fn mark_open(&self, _volume: &VolumeStep) -> OpenStepGuard {
        OpenStepGuard::default()
    }

    /// Whether volumes and time steps may appear while the server runs.
    fn watches(&self) -> bool {
        false
    }

    /// Returns the id of the engine that works on a volume now. A device that was lost and opened again has another id, as has another device.
    fn engine(&self, _volume: &VolumeStep) -> EngineId {
        EngineId::default()
    }

    /// Returns the device that works on a volume now, if it may be another one than that on which the volume was opened.
    fn device(&self, _volume: &VolumeStep) -> Option<DeviceInfo> {
        None
    }

    /// Loads the samples of all fields that a view of a time step uses, and returns the view with every value resolved.
    fn resolve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<View, WorkError>> + Send;

    /// Counts the triangles of the full surface of a view. The next step of the view reuses this work.
    fn count(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<FullCount, WorkError>> + Send;

    /// Makes a step from the surface that the client shows to the surface of a view.
    fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Refinement, WorkError>> + Send;

    /// Makes a better surface of the same view, for a viewer that rests. `None` if there is no better surface.
    fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Option<Refinement>, WorkError>> + Send;

    /// Measures how far the final surface of a view is from the undecimated one. `None` for surfaces of the marching-cubes mesher, and if
    /// the surface has no triangles.
    fn measure(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Option<Measurement>, WorkError>> + Send;

    /// Answers a question about the surface that the viewer is shown. If none is shown, a probe is answered for the volume alone.
    fn answer(
        &self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Answer, WorkError>> + Send;
}

/// Result of opening a volume.
#[derive(Clone, Debug)]
pub struct Opening {
    /// Description of the volume: the same JSON as `GET /api/v1/volumes/{id}` returns.
    pub volume: Box<RawValue>,
    /// The opening view, with every value resolved.
    pub view: View,
    /// Name of the device.
    pub device: String,
    /// Whether the device is this machine's processors, which the CPU pool needs too.
    pub shares_processors: bool,
}

/// The backend of a server: its catalog and its devices.
#[derive(Clone)]
pub struct LiveBackend {
    catalog: SharedCatalog,
    devices: DevicePool,
    /// The device of the viewer's volume.
    seat: Seat,
    options: LiveOptions,
}

/// Options of the [`LiveBackend`].
#[derive(Clone, Copy, Debug)]
pub struct LiveOptions {
    /// Maximum bytes that time steps that are read ahead may take on each device; 0 turns read-ahead off.
    pub ahead_bytes: u64,
    /// Maximum bytes of chunks that are cached for viewers of equal views; 0 disables the cache.
    pub shared_bytes: u64,
    /// Whether volumes and time steps may appear while the server runs.
    pub watches: bool,
}

impl Default for LiveOptions {
    /// Returns options without read-ahead.
    fn default() -> Self {
        Self {
            ahead_bytes: 0,
            shared_bytes: SHARED_BYTES,
            watches: false,
        }
    }
}

impl LiveBackend {
    /// Creates a backend that offers the volumes of a catalog.
    pub fn new(catalog: SharedCatalog, devices: DevicePool, options: LiveOptions) -> Self {
        Self {
            catalog,
            devices,
            seat: Seat::default(),
            options,
        }
    }

    /// Does work on a volume, on the device of this viewer's seat.
    async fn perform<T, F>(&self, volume: &VolumeStep, work: impl Fn(DeviceWorker) -> F + Send) -> Result<T, WorkError>
    where
        F: Future<Output = Result<T, WorkError>> + Send,
    {
        self.devices.perform(&self.seat, volume, work).await
    }
}

impl Backend for LiveBackend {
    fn find(&self, volume: &str, who: &Identity) -> Option<Arc<Dataset>> {
        self.catalog.find(volume, who.reader())
    }

    fn charged_to(self, who: &Identity) -> Self {
        Self {
            devices: self.devices.charged_to(who.limited_user()),
            seat: Seat::default(),
            ..self
        }
    }

    fn lease(&self, volume: &str) -> Lease {
        self.catalog.private().lease(volume)
    }

    async fn open(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
        progress: &watch::Sender<OpeningProgress>,
    ) -> Result<Opening, WorkError> {
        let open = self.perform(volume, |worker| async move {
            let device = tokio::select! {
                ready = worker.ready() => ready?,
                never = report_device(worker.states(), progress) => never,
            };
            let (worker, watch) = worker.with_watch(volume, view).await?;
            let (view, volume) = tokio::select! {
                resolved = describe_and_resolve(&worker, volume, view, token) => resolved?,
                never = report_progress(&watch, progress) => never,
            };
            Ok(Opening {
                volume,
                view,
                shares_processors: device.kind == DeviceKind::Cpu,
                device: device.name,
            })
        });
        // Stop waiting if the viewer is gone. The histogram in progress is still finished for the cache.
        tokio::select! {
            opening = open => opening,
            () = token.cancelled() => Err(WorkError::Cancelled),
        }
    }

    async fn describe(&self, volume: &VolumeStep, token: &CancellationToken) -> Result<Box<RawValue>, WorkError> {
        tokio::select! {
            description = self.perform(volume, |worker| async move { describe_json(&worker, volume).await }) => description,
            () = token.cancelled() => Err(WorkError::Cancelled),
        }
    }

    async fn read_ahead(&self, volume: &VolumeStep, views: &[View], token: &CancellationToken) {
        let bytes = self.options.ahead_bytes;
        let read = self.perform(volume, |worker| async move {
            worker.read_ahead(volume, views, bytes, token).await
        });
        if let Err(error) = read.await {
            tracing::debug!(error = chain(&error), "a time step could not be read ahead");
        }
    }

    fn mark_open(&self, volume: &VolumeStep) -> OpenStepGuard {
        self.devices.mark_open(&self.seat, volume)
    }

    fn watches(&self) -> bool {
        self.options.watches
    }

    fn engine(&self, volume: &VolumeStep) -> EngineId {
        self.devices.engine(&self.seat, volume)
    }

    fn device(&self, volume: &VolumeStep) -> Option<DeviceInfo> {
        self.devices.device(&self.seat, volume)
    }

    async fn resolve(&self, volume: &VolumeStep, view: &View, token: &CancellationToken) -> Result<View, WorkError> {
        self.perform(
            volume,
            |worker| async move { worker.prepare(volume, view, token).await },
        )
        .await
    }

    async fn count(&self, volume: &VolumeStep, view: &View, token: &CancellationToken) -> Result<FullCount, WorkError> {
        self.perform(volume, |worker| async move { worker.count(volume, view, token).await })
            .await
    }

    async fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        token: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        self.perform(volume, |worker| async move {
            worker.refine(volume, view, step, token).await
        })
        .await
    }

    async fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Refinement>, WorkError> {
        self.perform(
            volume,
            |worker| async move { worker.improve(volume, view, token).await },
        )
        .await
    }

    async fn measure(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        self.perform(
            volume,
            |worker| async move { worker.measure(volume, view, token).await },
        )
        .await
    }

    async fn answer(
        &self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        token: &CancellationToken,
    ) -> Result<Answer, WorkError> {
        self.perform(volume, |worker| async move {
            worker.answer(volume, shown, question, token).await
        })
        .await
    }
}

/// Returns a view with every value resolved, and the description of its volume.
async fn describe_and_resolve(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    view: &View,
    token: &CancellationToken,
) -> Result<(View, Box<RawValue>), WorkError> {
    // The description comes first. It takes many jobs, so viewers see progress; then resolving the view finds the histograms in the cache.
    let description = describe_json(worker, volume).await?;
    let view = worker.resolve(volume, view, token).await?;
    Ok((view, description))
}

/// Returns the description of a volume as JSON.
async fn describe_json(worker: &DeviceWorker, volume: &VolumeStep) -> Result<Box<RawValue>, WorkError> {
    let description = describe(worker, volume).await?;
    serde_json::value::to_raw_value(&description).map_err(|error| {
        tracing::error!(%error, "a volume's description could not be serialised");
        WorkError::Stopped
    })
}

/// Publishes the progress of opening the device whenever its state changes. Never returns.
async fn report_device(mut states: watch::Receiver<DeviceState>, progress: &watch::Sender<OpeningProgress>) -> ! {
    loop {
        let preparation = match *states.borrow_and_update() {
            DeviceState::Opening(preparation) if preparation.of > 0 => Some(preparation),
            _ => None,
        };
        if let Some(preparation) = preparation {
            progress.send_replace(OpeningProgress {
                device: Some(preparation),
                ..OpeningProgress::default()
            });
        }
        if states.changed().await.is_err() {
            std::future::pending().await
        }
    }
}

/// Publishes the progress of opening a volume, at most once per [`PROGRESS_INTERVAL`] and only if it has advanced. Never returns.
async fn report_progress(watch: &OpeningWatch, progress: &watch::Sender<OpeningProgress>) -> ! {
    loop {
        tokio::time::sleep(PROGRESS_INTERVAL).await;
        let current = watch.progress();
        progress.send_if_modified(|reported| {
            let has_advanced = current.bytes > reported.bytes;
            if has_advanced {
                *reported = current;
            }
            has_advanced
        });
    }
}
