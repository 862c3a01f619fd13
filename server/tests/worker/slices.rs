//! Work on a whole volume leaves others their turns, ends with its callers, and has a limit.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use isopeel::service::{DeviceOptions, DeviceWorker};
use isopeel_extraction::WorkError;
use isopeel_kernels::{DerivedFeature, Overview, OverviewMode, Samples};
use isopeel_view::{FeatureName, View};
use isopeel_volumes::{Dataset, Field, FileLocation, Geometry, ReadError, ReadProgress, Source, VolumeStep};
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, dataset, field, view};

/// Admits any overview.
fn admit() -> Result<(), WorkError> {
    Ok(())
}

/// Samples along each axis of the large volume.
const SIDE: usize = 256;

/// Waves along each axis.
#[derive(Debug)]
struct Waves;

impl Source for Waves {
    fn stored_bytes(&self) -> u64 {
        4 * SIDE.pow(3) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        progress.add(self.stored_bytes());
        let wave: Vec<f32> = (0..SIDE).map(|i| (i as f32 * 0.3).sin()).collect();
        let sample = |i: usize| wave[i % SIDE] + wave[i / SIDE % SIDE] + wave[i / SIDE / SIDE];
        Ok(Samples::F32((0..SIDE.pow(3)).map(sample).collect()))
    }
}

/// A large volume that is resident, and a small one whose histogram is known.
struct Volumes {
    worker: DeviceWorker,
    large: VolumeStep,
    large_view: View,
    small: VolumeStep,
    small_view: View,
}

impl Volumes {
    async fn start(options: DeviceOptions) -> Self {
        let small = dataset(vec![field("small", &Arc::default())]);
        let waves = Field {
            source: Arc::new(Waves),
            ..field("waves", &Arc::default())
        };
        let large = Arc::new(Dataset {
            id: "large".into(),
            geometry: Geometry {
                dims: [SIDE as u32; 3],
                ..small.geometry
            },
            ..Dataset::clone(&dataset(vec![waves]))
        });
        let volumes = Self {
            worker: DeviceWorker::start_with(options).expect("a thread"),
            large_view: view(&large, "{}"),
            large: VolumeStep::new(large, 0).expect("a step"),
            small_view: view(&small, "{}"),
            small: VolumeStep::new(small, 0).expect("a step"),
        };
        let Self { worker, large, .. } = &volumes;
        worker
            .histogram(large, "waves", &FeatureName::None)
            .await
            .expect("a histogram");
        volumes.job_of_another().await;
        volumes
    }

    /// A job of a viewer of the small volume.
    async fn job_of_another(&self) {
        let token = CancellationToken::new();
        let resolved = self.worker.resolve(&self.small, &self.small_view, &token).await;
        resolved.expect("resolves");
    }

    /// Jobs of others that run while `work` does.
    async fn jobs_beside<T>(&self, work: impl Future<Output = T>) -> (usize, T) {
        let jobs = AtomicUsize::new(0);
        let others = async {
            loop {
                self.job_of_another().await;
                jobs.fetch_add(1, Ordering::Relaxed);
            }
        };
        let done = tokio::select! {
            done = work => done,
            () = others => unreachable!("there is no end of others"),
        };
        (jobs.into_inner(), done)
    }
}

/// The longest expression that is allowed, of the slowest functions.
fn costly(field: &str, seed: u32) -> String {
    (0..9).fold(format!("{field}+{seed}"), |inner, n| {
        format!("pow(log(abs({inner})+{}),1.{n})", n + 1)
    })
}

fn gradient() -> FeatureName {
    FeatureName::Derived(DerivedFeature::GradientMagnitude)
}

#[tokio::test(flavor = "multi_thread")]
async fn others_work_while_a_large_volume_is_described() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions::unchecked(None)).await;
    let Volumes { worker, large, .. } = &volumes;
    let (jobs, histogram) = volumes.jobs_beside(worker.histogram(large, "waves", &gradient())).await;
    assert_eq!(
        histogram.expect("a histogram").bins.iter().sum::<u64>(),
        SIDE.pow(3) as u64
    );
    assert!(jobs >= 10, "{jobs} jobs of others while a histogram was made");
}

#[tokio::test(flavor = "multi_thread")]
async fn others_work_while_an_overview_of_a_large_volume_is_made() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions::unchecked(None)).await;
    let Volumes { worker, large, .. } = &volumes;
    let (jobs, overview) = volumes
        .jobs_beside(worker.overview(large, "waves", OverviewMode::Mean, admit))
        .await;
    let overview = overview.expect("an overview");
    assert_eq!((overview.dims, overview.factors), ([128; 3], [2; 3]));
    assert!(jobs >= 2, "{jobs} jobs of others while an overview was made");
    let again = worker.overview(large, "waves", OverviewMode::Mean, admit).await;
    assert!(Arc::ptr_eq(&overview, &again.expect("it is cached")));
    let maximum = || worker.overview(large, "waves", OverviewMode::Maximum, admit);
    let (maxima, same) = tokio::join!(maximum(), maximum());
    let maxima = maxima.expect("another one");
    assert!(Arc::ptr_eq(&maxima, &same.expect("the same one")));
    let decoded = |overview: &Overview, code: u8| {
        let [lo, hi] = overview.range;
        lo + (hi - lo) * (f32::from(code) - 1.0) / 254.0
    };
    let below = |(mean, maximum): (&u8, &u8)| decoded(&overview, *mean) <= decoded(&maxima, *maximum) + 0.05;
    assert!(overview.codes.iter().zip(&maxima.codes).all(below));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_description_that_nobody_waits_for_pauses_and_goes_on_for_the_next_caller() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions::unchecked(None)).await;
    let Volumes {
        worker,
        large,
        large_view,
        ..
    } = &volumes;
    let feature = gradient();
    let left = timeout(Duration::from_millis(20), worker.histogram(large, "waves", &feature)).await;
    assert!(left.is_err(), "it took less than 20 ms");
    sleep(Duration::from_secs(2)).await;
    let (_, watch) = worker.with_watch(large, large_view).await.expect("a device");
    assert!(
        watch.progress().total_bytes > 0,
        "the histogram was made without a caller"
    );
    // Callers of the same share the work.
    let (a, b) = tokio::join!(
        worker.histogram(large, "waves", &feature),
        worker.histogram(large, "waves", &feature),
    );
    let (a, b) = (a.expect("a histogram"), b.expect("a histogram"));
    assert_eq!((a.range, &a.bins), (b.range, &b.bins));
    assert_eq!(a.bins.iter().sum::<u64>(), SIDE.pow(3) as u64);
}

#[tokio::test(flavor = "multi_thread")]
async fn others_work_while_a_costly_expression_is_computed() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions::unchecked(None)).await;
    let Volumes { worker, large, .. } = &volumes;
    let (jobs, slice) = volumes
        .jobs_beside(worker.slice(large, &costly("waves", 1), 2, 5))
        .await;
    assert!(slice.is_ok(), "{slice:?}");
    assert!(jobs >= 20, "{jobs} jobs of others while an expression was computed");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_expression_that_nobody_waits_for_ends_and_leaves_no_memory() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions::unchecked(None)).await;
    let Volumes { worker, large, .. } = &volumes;
    let bytes = async || worker.memory().await.expect("a device").volume_bytes;
    let before = bytes().await;
    // More than one, because each continues for a while without callers: the next edit may need it again.
    for seed in 0..6 {
        let text = costly("waves", seed);
        let left = timeout(Duration::from_millis(50), worker.slice(large, &text, 2, 5)).await;
        assert!(left.is_err(), "it took less than 50 ms");
    }
    sleep(Duration::from_secs(6)).await;
    volumes.job_of_another().await;
    let computed = (bytes().await - before) / (4 * SIDE.pow(3) as u64);
    assert!(computed <= 3, "{computed} of 6 fields without a caller were computed");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_user_whose_fields_have_taken_their_time_waits_and_others_do_not() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions {
        user_time: Some(Duration::from_millis(60)),
        ..DeviceOptions::unchecked(None)
    })
    .await;
    let Volumes {
        worker, large, small, ..
    } = &volumes;
    let ann = worker.charged_to(Some("ann"));
    let costly = ann.slice(large, &costly("waves", 1), 2, 5).await;
    let error = costly.expect_err("too long");
    assert!(matches!(error, WorkError::UserTime { .. }), "{error:?}");
    let further = ann.slice(small, "3*small", 2, 5).await.expect_err("nothing is left");
    assert_eq!(further.code(), "busy");
    assert!(
        further
            .to_string()
            .contains("the 0.06 s of the device's time that one user may take within 10 minutes"),
        "{further}"
    );
    let of_another = worker.charged_to(Some("bob")).slice(small, "3*small", 2, 5).await;
    of_another.expect("bob has taken nothing");
    ann.slice(small, "small", 2, 5).await.expect("nothing is computed");
    worker.slice(small, "4*small", 2, 5).await.expect("an administrator");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_field_that_takes_too_much_time_is_refused() {
    let _alone = ALONE.lock().await;
    let volumes = Volumes::start(DeviceOptions {
        request_time: Some(Duration::from_millis(60)),
        ..DeviceOptions::unchecked(None)
    })
    .await;
    let Volumes {
        worker, large, small, ..
    } = &volumes;
    let error = worker
        .slice(large, &costly("waves", 1), 2, 5)
        .await
        .expect_err("too long");
    assert!(matches!(error, WorkError::TookTooLong { .. }), "{error:?}");
    assert_eq!(error.code(), "too-large");
    assert!(
        error
            .to_string()
            .starts_with("it takes more than 0.06 s of the device's time"),
        "{error}"
    );
    worker.slice(small, "2*small", 2, 5).await.expect("it is small");
}
