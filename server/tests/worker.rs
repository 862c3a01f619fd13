//! The device worker on a real device: loads, caches and errors.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use futures_util::future::join_all;
use isopeel::extraction::{DeviceState, DeviceWorker, Extractor, OpeningProgress, QUEUED_JOBS, Shown, Step, WorkError};
use isopeel::view::{Edit, FeatureName, View};
use isopeel::volumes::{Dataset, Field, FileLocation, Geometry, ReadError, ReadProgress, Source, VolumeStep};
use isopeel_kernels::{DerivedFeature, Error, SampleType, Samples};
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;

/// One engine at a time: PoCL 3.1 fails with two in one process.
static ALONE: Mutex<()> = Mutex::const_new(());

/// Samples along each axis.
const SIDE: usize = 40;

/// Distance from the volume's centre, in samples; counts how often it is read.
#[derive(Debug, Default)]
struct Distance {
    loads: AtomicUsize,
    broken: bool,
}

impl Source for Distance {
    fn stored_bytes(&self) -> u64 {
        4 * (SIDE * SIDE * SIDE) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        self.loads.fetch_add(1, Ordering::Relaxed);
        progress.add(self.stored_bytes());
        if self.broken {
            return Err(ReadError {
                path: PathBuf::from("broken.nrrd"),
                field: "data".into(),
                why: "3 bytes, expected 64000".into(),
                source: None,
            });
        }
        let centre = (SIDE - 1) as f32 / 2.0;
        let at = |i: usize| i as f32 - centre;
        let sample = |i: usize| {
            let (x, y, z) = (at(i % SIDE), at(i / SIDE % SIDE), at(i / SIDE / SIDE));
            (x * x + y * y + z * z).sqrt() + step as f32
        };
        Ok(Samples::F32((0..SIDE * SIDE * SIDE).map(sample).collect()))
    }
}

fn field(name: &str, source: &Arc<Distance>) -> Field {
    Field {
        name: name.into(),
        stored_type: "f32".into(),
        sample_type: SampleType::F32,
        missing: None,
        unit: None,
        source: source.clone(),
    }
}

fn dataset(fields: Vec<Field>) -> Arc<Dataset> {
    Arc::new(Dataset {
        id: "sphere".into(),
        title: "Sphere".into(),
        layout: "file",
        geometry: Geometry::of_index([SIDE as u32; 3]),
        steps: 2,
        times: None,
        revision: 0,
        fields,
        notice: None,
        opening: None,
    })
}

/// Reading does not end before it is cancelled, the first time.
#[derive(Debug, Default)]
struct Slow {
    loads: AtomicUsize,
    cancelled: AtomicUsize,
}

impl Source for Slow {
    fn stored_bytes(&self) -> u64 {
        0
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        if self.loads.fetch_add(1, Ordering::Relaxed) == 0 {
            while !progress.is_cancelled() {
                std::thread::sleep(Duration::from_millis(1));
            }
            self.cancelled.fetch_add(1, Ordering::Relaxed);
            progress.go_on(&PathBuf::from("slow.nrrd"))?;
        }
        Ok(Samples::F32((0..SIDE * SIDE * SIDE).map(|i| i as f32).collect()))
    }
}

/// Folds every few samples along each axis: a surface whose vertex tree takes many launches.
#[derive(Debug)]
struct Folds;

impl Folds {
    const SIDE: usize = 128;
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
        let wave = |i: usize| (i as f32 * 0.7).sin();
        let sample = |i: usize| wave(i % Self::SIDE) + wave(i / Self::SIDE % Self::SIDE) + wave(i / Self::SIDE.pow(2));
        Ok(Samples::F32((0..Self::SIDE.pow(3)).map(sample).collect()))
    }
}

fn view(dataset: &Dataset, json: &str) -> View {
    let edit: Edit = serde_json::from_str(json).expect("an edit");
    dataset
        .opening_view()
        .expect("opens")
        .apply(&edit, &dataset.field_names())
        .expect("fits")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_field_is_read_once_for_all_callers() {
    let (shown, other) = (Arc::new(Distance::default()), Arc::new(Distance::default()));
    let dataset = dataset(vec![field("shown", &shown), field("other", &other)]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let token = CancellationToken::new();
    let view = view(
        &dataset,
        r#"{"iso":12.25,"feature":"other","beta":-1,"mesher":"marching-cubes"}"#,
    );

    // Four at once, and a histogram beside them.
    let none = FeatureName::None;
    let (a, b, c, d, histogram) = tokio::join!(
        worker.extract(&volume, &view, u64::MAX, &token),
        worker.extract(&volume, &view, u64::MAX, &token),
        worker.extract(&volume, &view, u64::MAX, &token),
        worker.extract(&volume, &view, u64::MAX, &token),
        worker.histogram(&volume, "shown", &none),
    );
    let a = a.expect("extracts");
    for extraction in [b, c, d] {
        assert_eq!(extraction.expect("extracts").surface.regions, a.surface.regions);
    }
    assert_eq!(
        (shown.loads.load(Ordering::Relaxed), other.loads.load(Ordering::Relaxed)),
        (1, 1)
    );
    assert_eq!(a.surface.statistics.triangles, a.surface.statistics.full_triangles);
    assert!(a.surface.statistics.triangles > 1000);
    let histogram = histogram.expect("a histogram");
    assert_eq!(histogram.bins.iter().sum::<u64>(), (SIDE * SIDE * SIDE) as u64);
    // The range of the feature was filled in from the feature's field.
    assert_eq!(a.view.feature_range, Some(histogram.range), "both fields hold the same");

    // Another step is another volume.
    let later = VolumeStep::new(Arc::clone(&dataset), 1).expect("a step");
    let moved = worker.extract(&later, &view, u64::MAX, &token).await.expect("extracts");
    assert_ne!(moved.surface.regions, a.surface.regions);
    assert_eq!(shown.loads.load(Ordering::Relaxed), 2);
    assert!(matches!(worker.state(), DeviceState::Ready(_)));
}

#[tokio::test(flavor = "multi_thread")]
async fn expressions_are_fields_and_features() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let (value, other) = (Arc::<Distance>::default(), Arc::<Distance>::default());
    let data = dataset(vec![field("value", &value), field("other", &other)]);
    let step = VolumeStep::new(data.clone(), 1).expect("a step");
    let token = CancellationToken::new();
    let extract = async |json: &str| {
        let view = view(&data, json);
        let made = worker.extract(&step, &view, u64::MAX, &token).await.expect("a surface");
        (
            made.surface.statistics.full_triangles,
            made.surface.statistics.triangles,
        )
    };
    // Three times the distance: the same surface where the isovalue is, too.
    let computed = r#""field": "2 * value + other""#;
    for rest in [
        "",
        r#", "cap": true"#,
        r#", "mask": "other>9""#,
        r#", "feature": "other", "alpha": 0.5"#,
    ] {
        let plain = extract(&format!(r#"{{"field": "value", "iso": 11.25, "beta": 0.01{rest}}}"#)).await;
        let found = extract(&format!(r#"{{{computed}, "iso": 33.75, "beta": 0.01{rest}}}"#)).await;
        assert!(plain.0 > 1000, "{plain:?}");
        assert_eq!(found, plain, "{rest}");
    }
    // As a feature: the field itself, scaled.
    let with = async |feature: &str, lo: f32| {
        let json = format!(
            r#"{{"field": "value", "iso": 11.25, "beta": 0.3, "alpha": 0.5, "feature": "{feature}", "featureRange": [{lo}, {}]}}"#,
            2.0 * lo
        );
        extract(&json).await
    };
    assert_eq!(with("magnitude(other, 0)", 9.0).await, with("other", 9.0).await);
    assert_eq!(with("4 * other", 36.0).await, with("other", 9.0).await);
    // Nothing was read for a second expression: padded and masked ones are computed on the host.
    let loads = (value.loads.load(Ordering::Relaxed), other.loads.load(Ordering::Relaxed));
    extract(r#"{"field": "value - 3 * other", "iso": -30}"#).await;
    assert_eq!(
        loads,
        (value.loads.load(Ordering::Relaxed), other.loads.load(Ordering::Relaxed))
    );
    // Isovalue and range come from its own histogram.
    let resolved = worker
        .resolve(
            &step,
            &view(&data, r#"{"field": "-value", "feature": "other / 2"}"#),
            &token,
        )
        .await
        .expect("a view");
    assert!(resolved.iso.expect("an isovalue").get() < 0.0);
    let [low, high] = resolved.feature_range.expect("a range");
    assert!(low > 0.5 && high < 20.0 && low < high, "{low} to {high}");
    let error = View::plain(&data.field_names())
        .apply(
            &serde_json::from_str(r#"{"field": "log(valu)"}"#).expect("an edit"),
            &data.field_names(),
        )
        .expect_err("no such field");
    assert!(error.to_string().contains("character 5: no field \"valu\""), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_opening_takes_is_counted_for_everyone_who_waits_for_it() {
    let (first, second) = (Arc::new(Distance::default()), Arc::new(Distance::default()));
    let dataset = dataset(vec![field("first", &first), field("second", &second)]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let opening = view(&dataset, "{}");
    let (none, gradient) = (
        FeatureName::None,
        FeatureName::Derived(DerivedFeature::GradientMagnitude),
    );
    // Each field is read, put on the device, and counted by itself and its gradient. Its file is as long as its samples.
    let times = |done, all| OpeningProgress {
        bytes: done * first.stored_bytes(),
        total_bytes: all * first.stored_bytes(),
    };

    let (one, watch) = worker.watched(&volume, &opening).await.expect("a device");
    let (two, same) = worker.watched(&volume, &opening).await.expect("a device");
    assert_eq!(watch.progress(), times(0, 8));
    let (a, b) = tokio::join!(
        one.histogram(&volume, "first", &none),
        two.histogram(&volume, "first", &none),
    );
    assert!(a.is_ok() && b.is_ok());
    assert_eq!(first.loads.load(Ordering::Relaxed), 1);
    assert_eq!(watch.progress(), times(3, 8));
    assert_eq!(same.progress(), times(3, 8), "who waits for another's load");

    // What is there already is not counted.
    let (three, rest) = worker.watched(&volume, &opening).await.expect("a device");
    assert_eq!(rest.progress(), times(0, 5));
    three.histogram(&volume, "second", &none).await.expect("a histogram");
    three
        .histogram(&volume, "second", &gradient)
        .await
        .expect("a histogram");
    assert_eq!(rest.progress(), times(4, 5));
    three.histogram(&volume, "first", &gradient).await.expect("a histogram");
    assert_eq!(rest.progress(), times(5, 5));
    let (_, nothing) = worker.watched(&volume, &opening).await.expect("a device");
    assert_eq!(nothing.progress(), times(0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_load_that_nobody_waits_for_is_cancelled() {
    let slow = Arc::new(Slow::default());
    let plain = field("slow", &Arc::default());
    let dataset = dataset(vec![Field {
        source: slow.clone(),
        ..plain
    }]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    worker.ready().await.expect("a device");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let none = FeatureName::None;
    let count = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);

    // Who leaves and comes back soon, as with an edit, finds the same load.
    for wait in [500, 4000] {
        let histogram = worker.histogram(&volume, "slow", &none);
        let ended = tokio::time::timeout(Duration::from_millis(wait), histogram).await;
        assert!(ended.is_err(), "{ended:?}");
        assert_eq!((count(&slow.loads), count(&slow.cancelled)), (1, 0), "after {wait} ms");
    }
    for _ in 0..1000 {
        if count(&slow.cancelled) > 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(count(&slow.cancelled), 1);
    // The next one loads it anew.
    let histogram = worker.histogram(&volume, "slow", &none).await.expect("a histogram");
    assert_eq!(histogram.range[0], 0.0);
    assert_eq!(count(&slow.loads), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_goes_wrong_is_told_apart() {
    let good = Arc::new(Distance::default());
    let broken = Arc::new(Distance {
        broken: true,
        ..Distance::default()
    });
    let dataset = dataset(vec![field("good", &good), field("broken", &broken)]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let token = CancellationToken::new();

    let error = worker
        .extract(
            &volume,
            &view(&dataset, r#"{"iso":9,"field":"broken"}"#),
            u64::MAX,
            &token,
        )
        .await
        .expect_err("a broken file");
    assert_eq!(error.code(), "unreadable-volume");
    assert_eq!(error.to_string(), "broken.nrrd: data: 3 bytes, expected 64000");

    let error = worker
        .histogram(&volume, "absent", &FeatureName::None)
        .await
        .expect_err("no such field");
    assert_eq!(error.code(), "bad-edit");

    let error = VolumeStep::new(Arc::clone(&dataset), 2).expect_err("two steps");
    assert_eq!(error.to_string(), r#"step 2 of volume "sphere", expected 0 to 1"#);

    token.cancel();
    let good_view = view(&dataset, r#"{"iso":9}"#);
    let error = worker.extract(&volume, &good_view, u64::MAX, &token).await;
    assert!(matches!(error, Err(WorkError::Cancelled)));
    // The worker goes on.
    let token = CancellationToken::new();
    worker
        .extract(&volume, &good_view, u64::MAX, &token)
        .await
        .expect("extracts");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_no_device_holds_is_refused_before_it_is_read() {
    let source = Arc::new(Distance::default());
    let small = dataset(vec![field("large", &source)]);
    let geometry = Geometry {
        dims: [1 << 14; 3],
        ..small.geometry
    };
    let large = Arc::new(Dataset {
        geometry,
        ..Dataset::clone(&small)
    });
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&large), 0).expect("a step");
    let token = CancellationToken::new();
    let histogram = worker.histogram(&volume, "large", &FeatureName::None).await;
    assert!(matches!(histogram, Err(WorkError::TooLarge { .. })), "{histogram:?}");
    let surface = worker.extract(&volume, &view(&large, "{}"), u64::MAX, &token).await;
    assert!(matches!(surface, Err(WorkError::TooLarge { .. })), "{surface:?}");
    assert_eq!(source.loads.load(Ordering::Relaxed), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_its_device_every_job_says_why() {
    let dataset = dataset(vec![field("good", &Arc::default())]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(Some("no such device".into())).expect("a thread");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let error = worker.ready().await.expect_err("no such device");
    let WorkError::NoDevice(cause) = &error else {
        panic!("{error:?}");
    };
    assert!(matches!(&**cause, Error::NoDevice { wanted: Some(name), .. } if name == "no such device"));
    let error = worker.histogram(&volume, "good", &FeatureName::None).await;
    assert!(matches!(error, Err(WorkError::NoDevice(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_was_read_ahead_is_not_read_again() {
    let source = Arc::new(Distance::default());
    let dataset = dataset(vec![field("shown", &source), field("other", &source)]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let [now, next] = [0, 1].map(|step| VolumeStep::new(Arc::clone(&dataset), step).expect("a step"));
    let (token, view) = (CancellationToken::new(), view(&dataset, r#"{"iso":12.25}"#));
    let views = std::slice::from_ref(&view);
    let bytes = 1 << 20;
    let reads = || source.loads.load(Ordering::Relaxed);
    worker.read_ahead(&next, views, 0, &token).await.expect("off");
    worker.read_ahead(&next, views, 1000, &token).await.expect("too little");
    let gone = CancellationToken::new();
    gone.cancel();
    worker.read_ahead(&next, views, bytes, &gone).await.expect("cancelled");
    assert_eq!(reads(), 0);
    worker.read_ahead(&next, views, bytes, &token).await.expect("reads");
    worker
        .read_ahead(&next, views, bytes, &token)
        .await
        .expect("it is there");
    assert_eq!(reads(), 1, "the field that the view uses");
    worker.extract(&next, &view, u64::MAX, &token).await.expect("extracts");
    assert_eq!(reads(), 1);
    // With a budget of one field: the other field of this step takes the place of what was read ahead and not used, not of what was.
    worker
        .read_ahead(&now, views, bytes * 3 / 10, &token)
        .await
        .expect("reads");
    let other = View {
        field: "other".into(),
        ..view.clone()
    };
    worker
        .read_ahead(&now, &[other], bytes * 3 / 10, &token)
        .await
        .expect("reads");
    assert_eq!(reads(), 3);
    worker.extract(&next, &view, u64::MAX, &token).await.expect("extracts");
    assert_eq!(reads(), 3);
    worker.extract(&now, &view, u64::MAX, &token).await.expect("extracts");
    assert_eq!(reads(), 4, "the first one had to go");
}

/// A step that makes the whole surface.
const WHOLE: Step = Step {
    shown: Shown::Another,
    target: None,
    fresh_triangles: u64::MAX,
    triangles: u64::MAX,
    bytes: u64::MAX,
};

#[tokio::test(flavor = "multi_thread")]
async fn viewers_wait_in_order_and_leave_a_request_space_in_the_queue() {
    let dataset = dataset(vec![field("good", &Arc::default())]);
    let _alone = ALONE.lock().await;
    // Jobs wait until it is open.
    let worker = DeviceWorker::start(None).expect("a thread");
    let extractor = Extractor::new(worker.clone(), u64::MAX, |surface, _| {
        Ok(Some(5 * surface.statistics.triangles))
    });
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let token = CancellationToken::new();
    let plain = view(&dataset, r#"{"iso":9}"#);
    let others = join_all((0..QUEUED_JOBS).map(|_| worker.resolve(&volume, &plain, &token)));
    // Its budget takes jobs that an export has too.
    let of_bytes = view(&dataset, r#"{"iso":9,"bytes":5000}"#);
    let edit = async {
        let is_open = matches!(worker.state(), DeviceState::Ready(_));
        assert!(!is_open, "the queue is being emptied already");
        extractor.refine(&volume, &of_bytes, WHOLE, &token).await
    };
    let (others, request, edit) = tokio::join!(others, worker.extract(&volume, &plain, u64::MAX, &token), edit);
    assert!(request.is_ok(), "the request was refused: {:?}", request.err());
    let triangles = edit.expect("the edit's surface").surface.statistics.triangles;
    assert!(triangles > 0 && 5 * triangles <= 5000, "{triangles} triangles");
    assert!(others.iter().all(Result::is_ok));
}

/// A viewer that rests, another one, and the surface that both show.
struct TwoViewers {
    worker: DeviceWorker,
    volume: VolumeStep,
    view: View,
}

impl TwoViewers {
    /// With the first surface made: what follows is the tree.
    async fn start() -> Self {
        let small = dataset(vec![Field {
            source: Arc::new(Folds),
            ..field("folds", &Arc::default())
        }]);
        let dataset = Arc::new(Dataset {
            geometry: Geometry {
                dims: [Folds::SIDE as u32; 3],
                ..small.geometry
            },
            ..Dataset::clone(&small)
        });
        let viewers = Self {
            worker: DeviceWorker::start(None).expect("a thread"),
            view: view(&dataset, r#"{"iso":0.1,"triangles":{"share":0.2}}"#),
            volume: VolumeStep::new(dataset, 0).expect("a step"),
        };
        let token = CancellationToken::new();
        let TwoViewers { worker, volume, view } = &viewers;
        worker
            .refine(volume, view, WHOLE, u64::MAX, &token)
            .await
            .expect("a surface");
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
        // The first may run in a pause that has begun, the second after what was cancelled.
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
        improved = worker.improve(volume, view, u64::MAX, &token) => improved.expect("improves").expect("a tree"),
        () = others => unreachable!("there is no end of others"),
    };
    let jobs = jobs.into_inner();
    assert!(jobs >= 10, "{jobs} jobs of others while a tree was built");
    let made = improved.surface.statistics;
    assert!(made.stages.iter().any(|time| time.stage == "tree"), "{:?}", made.stages);
    // The same that is made where nobody else is.
    let alone = worker.extract(volume, view, u64::MAX, &token).await.expect("extracts");
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
    let (improved, ()) = tokio::join!(worker.improve(volume, view, u64::MAX, &token), edit);
    assert!(matches!(improved, Err(WorkError::Cancelled)));
    assert_eq!(viewers.in_use().await, before, "after an edit");

    // The viewer leaves.
    let token = CancellationToken::new();
    tokio::select! {
        improved = worker.improve(volume, view, u64::MAX, &token) => panic!("{improved:?} after a few jobs"),
        () = some_jobs() => {}
    }
    assert_eq!(viewers.in_use().await, before, "after the viewer left");

    // The next one is not held up.
    let token = CancellationToken::new();
    let improved = worker.improve(volume, view, u64::MAX, &token).await;
    assert!(improved.expect("improves").is_some());
    assert!(viewers.in_use().await > before, "the tree is kept");
}
