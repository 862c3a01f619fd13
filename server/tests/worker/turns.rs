//! Scheduling: viewers and requests in one queue, and long jobs beside others.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use futures_util::future::join_all;
use isopeel::service::{DeviceState, DeviceWorker, QUEUED_JOBS};
use isopeel_codec::encode::encoded_bytes;
use isopeel_extraction::{Shown, Step, WorkError};
use isopeel_kernels::Samples;
use isopeel_view::View;
use isopeel_volumes::{Dataset, Field, FileLocation, Geometry, ReadError, ReadProgress, Source, VolumeStep};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, dataset, field, view};

/// A sum of sines along the axes. The number: radians a sample.
#[derive(Debug)]
pub struct Folds(f32);

impl Folds {
    pub const SIDE: usize = 128;

    pub fn dataset(radians: f32) -> Arc<Dataset> {
        let small = dataset(vec![Field {
            labels: Vec::new(),
            declares_labels: false,
            source: Arc::new(Folds(radians)),
            ..field("folds", &Arc::default())
        }]);
        Arc::new(Dataset {
            geometry: Geometry {
                dims: [Self::SIDE as u32; 3],
                ..small.geometry
            },
            ..Dataset::clone(&small)
        })
    }
}

impl Source for Folds {
    fn stored_bytes(&self) -> u64 {
        4 * Self::SIDE.pow(3) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        progress.add(self.stored_bytes());
        let wave = |i: usize| (i as f32 * self.0).sin();
        let sample = |i: usize| wave(i % Self::SIDE) + wave(i / Self::SIDE % Self::SIDE) + wave(i / Self::SIDE.pow(2));
        Ok(Samples::F32((0..Self::SIDE.pow(3)).map(sample).collect()))
    }
}

/// A step that makes the whole surface.
pub const WHOLE: Step = Step {
    shown: Shown::Another,
    target: None,
    made_triangles: 0,
    fresh_triangles: u64::MAX,
    triangles: u64::MAX,
    bytes: u64::MAX,
    line_bytes: u64::MAX,
};

#[tokio::test(flavor = "multi_thread")]
async fn viewers_wait_in_order_and_leave_a_request_space_in_the_queue() {
    let dataset = dataset(vec![field("good", &Arc::default())]);
    let _alone = ALONE.lock().await;
    // Jobs wait until it is open.
    let worker = DeviceWorker::start(None).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let token = CancellationToken::new();
    let plain = view(&dataset, r#"{"iso":9}"#);
    let others = join_all((0..QUEUED_JOBS).map(|_| worker.resolve(&volume, &plain, &token)));
    // Its budget takes jobs that an export has too.
    let of_bytes = view(&dataset, r#"{"iso":9,"bytes":5000}"#);
    let edit = async {
        let is_open = matches!(worker.state(), DeviceState::Ready(_));
        assert!(!is_open, "the queue is being emptied already");
        worker.refine(&volume, &of_bytes, WHOLE, &token).await
    };
    let (others, request, edit) = tokio::join!(others, worker.extract(&volume, &plain, &token), edit);
    assert!(request.is_ok(), "the request was refused: {:?}", request.err());
    let surface = edit.expect("the edit's surface").surface;
    let bytes = encoded_bytes(&surface, &|| false).expect("encodes").expect("no cancel");
    assert!(surface.statistics.triangles > 0 && bytes <= 5000, "{bytes} bytes");
    assert!(others.iter().all(Result::is_ok));
}

/// A viewer that rests, another one, and the surface that both show.
struct TwoViewers {
    worker: DeviceWorker,
    volume: VolumeStep,
    view: View,
}

impl TwoViewers {
    /// With the first surface made: the tree comes next.
    async fn start() -> Self {
        // Many folds, so that the vertex tree takes many launches.
        let dataset = Folds::dataset(0.7);
        let viewers = Self {
            worker: DeviceWorker::start(None).expect("a thread"),
            view: view(&dataset, r#"{"iso":0.1,"triangles":{"share":0.2}}"#),
            volume: VolumeStep::new(dataset, 0).expect("a step"),
        };
        let token = CancellationToken::new();
        let TwoViewers { worker, volume, view } = &viewers;
        worker.refine(volume, view, WHOLE, &token).await.expect("a surface");
        viewers
    }

    /// A job of the other viewer.
    async fn other_job(&self) {
        let token = CancellationToken::new();
        self.worker
            .resolve(&self.volume, &self.view, &token)
            .await
            .expect("resolves");
    }

    /// Bytes in use on the device.
    async fn in_use(&self) -> u64 {
        // The first job may run in a pause that has begun already, the second one runs after the cancelled work has ended.
        self.other_job().await;
        self.other_job().await;
        let memory = self.worker.memory().await.expect("a device");
        memory.volume_bytes + memory.pyramid_bytes + memory.tree_bytes + memory.cut_bytes + memory.other_device_bytes
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn others_use_the_device_while_a_tree_is_built() {
    let _alone = ALONE.lock().await;
    let viewers = TwoViewers::start().await;
    let TwoViewers { worker, volume, view } = &viewers;
    let token = CancellationToken::new();
    let jobs = AtomicUsize::new(0);
    let others = async {
        loop {
            viewers.other_job().await;
            jobs.fetch_add(1, Ordering::Relaxed);
        }
    };
    let improved = tokio::select! {
        improved = worker.improve(volume, view, &token) => improved.expect("improves").expect("a tree"),
        () = others => unreachable!("there is no end of others"),
    };
    let jobs = jobs.into_inner();
    assert!(jobs >= 10, "{jobs} jobs of others while a tree was built");
    let made = improved.surface.statistics;
    assert!(made.stages.iter().any(|time| time.stage == "tree"), "{:?}", made.stages);
    // The same surface when no other viewer uses the device.
    let alone = worker.extract(volume, view, &token).await.expect("extracts");
    assert_eq!(improved.surface.regions.len(), alone.surface.regions.len());
    for (shared, alone) in improved.surface.regions.iter().zip(&alone.surface.regions) {
        assert_eq!((&shared.vertices, &shared.indices), (&alone.vertices, &alone.indices));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tree_that_nobody_waits_for_leaves_no_memory() {
    let _alone = ALONE.lock().await;
    let viewers = TwoViewers::start().await;
    let TwoViewers { worker, volume, view } = &viewers;
    let before = viewers.in_use().await;
    let some_jobs = || async {
        for _ in 0..5 {
            viewers.other_job().await;
        }
    };

    // An edit of the same viewer.
    let token = CancellationToken::new();
    let edit = async {
        some_jobs().await;
        token.cancel();
    };
    let (improved, ()) = tokio::join!(worker.improve(volume, view, &token), edit);
    assert!(matches!(improved, Err(WorkError::Cancelled)));
    assert_eq!(viewers.in_use().await, before, "after an edit");

    // The viewer leaves.
    let token = CancellationToken::new();
    tokio::select! {
        improved = worker.improve(volume, view, &token) => panic!("{improved:?} after a few jobs"),
        () = some_jobs() => {}
    }
    assert_eq!(viewers.in_use().await, before, "after the viewer left");

    // The next one is not held up.
    let token = CancellationToken::new();
    let improved = worker.improve(volume, view, &token).await;
    assert!(improved.expect("improves").is_some());
    assert!(viewers.in_use().await > before, "the tree is kept");
}
