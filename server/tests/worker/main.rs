//! The device worker on a real device: loads, caches and errors.

mod computed;
mod distances;
mod pool;
mod slices;
mod torn;
mod tree_steps;
mod turns;
mod uneven;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use isopeel::service::{DeviceState, DeviceWorker, OpeningProgress};
use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{OpenError, WorkError};
use isopeel_kernels::{DerivedFeature, Error, SampleType, Samples};
use isopeel_view::{Edit, FeatureName, View};
use isopeel_volumes::{Dataset, Field, FileLocation, Geometry, Notices, ReadError, ReadProgress, Source, VolumeStep};
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
            // A share that does not answer.
            std::thread::sleep(Duration::from_millis(200));
            return Err(ReadError {
                can_retry: false,
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
        labels: Vec::new(),
        declares_labels: false,
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
        uneven: None,
        axes: None,
        times: None,
        revision: 0,
        rewrites: Vec::new(),
        fields,
        notices: Notices::default(),
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

fn view(dataset: &Dataset, json: &str) -> View {
    let edit: Edit = serde_json::from_str(json).expect("an edit");
    opening_view(dataset)
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
        worker.extract(&volume, &view, &token),
        worker.extract(&volume, &view, &token),
        worker.extract(&volume, &view, &token),
        worker.extract(&volume, &view, &token),
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
    let moved = worker.extract(&later, &view, &token).await.expect("extracts");
    assert_ne!(moved.surface.regions, a.surface.regions);
    assert_eq!(shown.loads.load(Ordering::Relaxed), 2);
    assert!(matches!(worker.state(), DeviceState::Ready(_)));
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
        device: None,
        bytes: done * first.stored_bytes(),
        total_bytes: all * first.stored_bytes(),
    };

    let (one, watch) = worker.with_watch(&volume, &opening).await.expect("a device");
    let (two, same) = worker.with_watch(&volume, &opening).await.expect("a device");
    assert_eq!(watch.progress(), times(0, 8));
    let (a, b) = tokio::join!(
        one.histogram(&volume, "first", &none),
        two.histogram(&volume, "first", &none),
    );
    assert!(a.is_ok() && b.is_ok());
    assert_eq!(first.loads.load(Ordering::Relaxed), 1);
    assert_eq!(watch.progress(), times(3, 8));
    assert_eq!(same.progress(), times(3, 8), "who waits for another's load");

    // Resident data is not counted.
    let (three, rest) = worker.with_watch(&volume, &opening).await.expect("a device");
    assert_eq!(rest.progress(), times(0, 5));
    three.histogram(&volume, "second", &none).await.expect("a histogram");
    three
        .histogram(&volume, "second", &gradient)
        .await
        .expect("a histogram");
    assert_eq!(rest.progress(), times(4, 5));
    three.histogram(&volume, "first", &gradient).await.expect("a histogram");
    assert_eq!(rest.progress(), times(5, 5));
    let (_, nothing) = worker.with_watch(&volume, &opening).await.expect("a device");
    assert_eq!(nothing.progress(), times(0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_load_that_nobody_waits_for_is_cancelled() {
    let slow = Arc::new(Slow::default());
    let plain = field("slow", &Arc::default());
    let dataset = dataset(vec![Field {
        labels: Vec::new(),
        declares_labels: false,
        source: slow.clone(),
        ..plain
    }]);
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    worker.ready().await.expect("a device");
    let volume = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let none = FeatureName::None;
    let count = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);

    // A client that leaves and comes back soon, as with an edit, joins the same load. The time until it is cancelled begins with the last
    // departure: 1.6 s after the second one, 2.7 s have passed since the first.
    for (wait, away) in [(500, 1000), (100, 1600), (4000, 0)] {
        let histogram = worker.histogram(&volume, "slow", &none);
        let ended = tokio::time::timeout(Duration::from_millis(wait), histogram).await;
        assert!(ended.is_err(), "{ended:?}");
        tokio::time::sleep(Duration::from_millis(away)).await;
        assert_eq!((count(&slow.loads), count(&slow.cancelled)), (1, 0), "after {wait} ms");
    }
    for _ in 0..1000 {
        if count(&slow.cancelled) > 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(count(&slow.cancelled), 1);
    // The next request loads it again.
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
        .extract(&volume, &view(&dataset, r#"{"iso":9,"field":"broken"}"#), &token)
        .await
        .expect_err("a broken file");
    assert_eq!(error.code(), "unreadable-volume");
    assert_eq!(error.to_string(), "broken.nrrd: data: 3 bytes, expected 64000");

    // Callers that waited for the same load do not read the file again.
    let before = broken.loads.load(Ordering::Relaxed);
    let none = FeatureName::None;
    let histogram = || worker.histogram(&volume, "broken", &none);
    let (a, b, c) = tokio::join!(histogram(), histogram(), histogram());
    for error in [a, b, c].map(|outcome| outcome.expect_err("a broken file")) {
        assert_eq!(error.to_string(), "broken.nrrd: data: 3 bytes, expected 64000");
    }
    assert_eq!(broken.loads.load(Ordering::Relaxed) - before, 1);

    let error = worker
        .histogram(&volume, "absent", &FeatureName::None)
        .await
        .expect_err("no such field");
    assert_eq!(error.code(), "bad-edit");

    let error = VolumeStep::new(Arc::clone(&dataset), 2).expect_err("two steps");
    assert_eq!(error.to_string(), r#"step 2 of volume "sphere", expected 0 to 1"#);

    token.cancel();
    let good_view = view(&dataset, r#"{"iso":9}"#);
    let error = worker.extract(&volume, &good_view, &token).await;
    assert!(matches!(error, Err(WorkError::Cancelled)));
    // The worker goes on.
    let token = CancellationToken::new();
    worker.extract(&volume, &good_view, &token).await.expect("extracts");
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
    let surface = worker.extract(&volume, &view(&large, "{}"), &token).await;
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
    let OpenError::Device(Error::NoDevice { wanted, .. }) = &**cause else {
        panic!("{cause:?}")
    };
    assert_eq!(wanted.as_deref(), Some("no such device"));
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
    let other = View {
        field: "other".into(),
        ..view.clone()
    };
    let both = [view.clone(), other.clone()];
    worker.read_ahead(&next, &both, bytes, &token).await.expect("reads");
    assert_eq!(reads(), 2, "a field that is there does not end the reading of others");
    worker.extract(&next, &view, &token).await.expect("extracts");
    assert_eq!(reads(), 2);
    // With a budget of one field, the other field of this step evicts the field that was read ahead and not used, not the one in use.
    worker
        .read_ahead(&now, views, bytes * 3 / 10, &token)
        .await
        .expect("reads");
    worker
        .read_ahead(&now, &[other], bytes * 3 / 10, &token)
        .await
        .expect("reads");
    assert_eq!(reads(), 4);
    worker.extract(&next, &view, &token).await.expect("extracts");
    assert_eq!(reads(), 4);
    worker.extract(&now, &view, &token).await.expect("extracts");
    assert_eq!(reads(), 5, "the first one had to go");
}
