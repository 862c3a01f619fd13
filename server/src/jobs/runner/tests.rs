use std::fmt;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use futures_util::stream::BoxStream;
use object_store::path::Path as ObjectPath;
use object_store::{
    CopyOptions, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore, PutMultipartOptions,
    PutOptions, PutPayload, PutResult, UploadPart,
};

use super::super::state::{JobInfo, JobState};
use super::super::testing::{FakeMaker, LIMITS, checksum, content, job, open, open_new, runner};
use super::super::{MAX_ATTEMPTS, OPERATOR};
use super::*;

const SOON: Duration = Duration::from_secs(20);

/// Waits until a job is as it is wanted.
async fn wait_for(store: &Store, id: &str, wanted: impl Fn(&JobInfo) -> bool) -> JobInfo {
    let start = Instant::now();
    loop {
        let info = store.get(OPERATOR, id).await.unwrap();
        if wanted(&info) {
            return info;
        }
        assert!(start.elapsed() < SOON, "still {info:?}");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// Checks that exactly the results of the store are in the folder, each with its bytes.
async fn check_results(folder: &std::path::Path, store: &Store, job: &str, count: u32) {
    let mut names: Vec<_> = std::fs::read_dir(folder.join("results").join(job))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, (0..count).map(|n| n.to_string()).collect::<Vec<_>>());
    for (n, name) in names.iter().enumerate() {
        let bytes = std::fs::read(folder.join("results").join(job).join(name)).unwrap();
        let info = store.result(OPERATOR, job, n as u32).await.unwrap();
        assert_eq!((info.bytes, info.checksum), (bytes.len() as u64, checksum(&bytes)));
    }
}

#[tokio::test]
async fn jobs_are_made_in_their_order_and_stay() {
    let (folder, store, results) = open_new().await;
    store.submit(job("x", None, 3), LIMITS).await.unwrap();
    store.submit(job("y", None, 2), LIMITS).await.unwrap();
    let order = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&order);
    let maker = FakeMaker {
        trouble: Arc::new(move |work, _| {
            seen.lock().unwrap().push((work.job.clone(), content(work).len()));
            None
        }),
        ..FakeMaker::default()
    };
    let runner = runner(&store, &results, maker);
    let (stop, signals) = (runner.stop.clone(), Arc::clone(&runner.signals));
    let running = tokio::spawn(runner.run());
    wait_for(&store, "y", |job| job.state == JobState::Done).await;
    // One that comes when there was nothing to do.
    store.submit(job("z", None, 1), LIMITS).await.unwrap();
    signals.wake.notify_one();
    wait_for(&store, "z", |job| job.state == JobState::Done).await;
    stop.cancel();
    running.await.unwrap();
    let made: Vec<_> = order.lock().unwrap().iter().map(|(job, _)| job.clone()).collect();
    assert_eq!(made, ["x", "x", "x", "y", "y", "z"]);
    let (store, _) = open(folder.path()).await;
    check_results(folder.path(), &store, "x", 3).await;
    check_results(folder.path(), &store, "y", 2).await;
}

#[tokio::test]
async fn a_failure_is_tried_three_times_and_others_go_on() {
    let (_folder, store, results) = open_new().await;
    store.submit(job("x", None, 3), LIMITS).await.unwrap();
    let lost = || Cause {
        code: "device".into(),
        detail: "lost".into(),
    };
    let maker = FakeMaker {
        // The first two attempts of the first one, and all of the last one.
        trouble: Arc::new(move |work, made| {
            ((work.extraction == 0 && made < 2) || work.extraction == 2).then(|| MakeFailure::Retry(lost()))
        }),
        ..FakeMaker::default()
    };
    let made = Arc::clone(&maker.made);
    let runner = runner(&store, &results, maker);
    let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
    let info = wait_for(&store, "x", |job| job.state.is_finished()).await;
    assert_eq!((info.state, info.extractions.done), (JobState::Failed, 2));
    assert_eq!((info.failures[0].extraction, &info.failures[0].cause), (2, &lost()));
    assert_eq!(made.load(Ordering::Relaxed), 3 + 1 + MAX_ATTEMPTS);
    stop.cancel();
    running.await.unwrap();
}

#[tokio::test]
async fn an_input_that_changed_ends_the_job() {
    let (_folder, store, results) = open_new().await;
    store.submit(job("x", None, 5), LIMITS).await.unwrap();
    let changed = || Cause {
        code: "input-changed".into(),
        detail: "a.raw: it was written since the job was submitted".into(),
    };
    let maker = FakeMaker {
        trouble: Arc::new(move |work, _| (work.extraction == 1).then(|| MakeFailure::JobFailed(changed()))),
        ..FakeMaker::default()
    };
    let runner = runner(&store, &results, maker);
    let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
    let info = wait_for(&store, "x", |job| job.state.is_finished()).await;
    assert_eq!(
        (info.state, info.extractions.done, info.error),
        (JobState::Failed, 1, Some(changed()))
    );
    stop.cancel();
    running.await.unwrap();
}

#[tokio::test]
async fn who_cancels_a_job_ends_its_work_and_who_stops_the_server_loses_no_attempt() {
    let (folder, store, results) = open_new().await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    store.submit(job("y", None, 1), LIMITS).await.unwrap();
    let maker = FakeMaker {
        is_slow: true,
        ..FakeMaker::default()
    };
    let runner = runner(&store, &results, maker);
    let (stop, signals) = (runner.stop.clone(), Arc::clone(&runner.signals));
    let running = tokio::spawn(runner.run());
    wait_for(&store, "x", |job| job.state == JobState::Running).await;
    store.cancel(OPERATOR, "x").await.unwrap();
    signals.cancel("x").await;
    wait_for(&store, "y", |job| job.state == JobState::Running).await;
    assert_eq!(store.get(OPERATOR, "x").await.unwrap().state, JobState::Cancelled);
    assert!(store.results().await.unwrap().is_empty());
    stop.cancel();
    tokio::time::timeout(Duration::from_secs(1), running)
        .await
        .unwrap()
        .unwrap();
    drop(store);
    // Stopped more often than it may fail.
    for _ in 0..2 * MAX_ATTEMPTS {
        let (store, _) = open(folder.path()).await;
        let work = store.begin_attempt().await.unwrap().expect("an attempt");
        store.finish(&work, Outcome::GivenBack).await.unwrap();
    }
}

/// A store whose disk is full as long as it is said to be, or which fails once at one of its calls.
#[derive(Debug)]
struct FaultyStore {
    inner: Arc<dyn ObjectStore>,
    faults: Arc<Faults>,
}

#[derive(Debug, Default)]
struct Faults {
    is_full: AtomicBool,
    /// Calls until one fails; 0: none.
    countdown: AtomicU32,
    calls: AtomicU32,
}

impl Faults {
    fn check(&self) -> object_store::Result<()> {
        self.calls.fetch_add(1, Ordering::Relaxed);
        let fail = |kind: io::ErrorKind| {
            Err(object_store::Error::Generic {
                store: "faulty",
                source: Box::new(io::Error::from(kind)),
            })
        };
        if self.is_full.load(Ordering::Relaxed) {
            return fail(io::ErrorKind::StorageFull);
        }
        let countdown = self.countdown.load(Ordering::Relaxed);
        self.countdown.store(countdown.saturating_sub(1), Ordering::Relaxed);
        if countdown == 1 {
            fail(io::ErrorKind::Other)
        } else {
            Ok(())
        }
    }
}

impl fmt::Display for FaultyStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "faulty {}", self.inner)
    }
}

#[async_trait::async_trait]
impl ObjectStore for FaultyStore {
    async fn put_opts(&self, to: &ObjectPath, bytes: PutPayload, opts: PutOptions) -> object_store::Result<PutResult> {
        self.inner.put_opts(to, bytes, opts).await
    }

    async fn put_multipart_opts(
        &self,
        to: &ObjectPath,
        opts: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.faults.check()?;
        let (inner, faults) = (self.inner.put_multipart_opts(to, opts).await?, Arc::clone(&self.faults));
        Ok(Box::new(FaultyUpload { inner, faults }))
    }

    async fn get_opts(&self, from: &ObjectPath, options: GetOptions) -> object_store::Result<GetResult> {
        self.inner.get_opts(from, options).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, object_store::Result<ObjectPath>>,
    ) -> BoxStream<'static, object_store::Result<ObjectPath>> {
        self.inner.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&ObjectPath>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&ObjectPath>) -> object_store::Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &ObjectPath, to: &ObjectPath, options: CopyOptions) -> object_store::Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}

#[derive(Debug)]
struct FaultyUpload {
    inner: Box<dyn MultipartUpload>,
    faults: Arc<Faults>,
}

#[async_trait::async_trait]
impl MultipartUpload for FaultyUpload {
    fn put_part(&mut self, data: PutPayload) -> UploadPart {
        match self.faults.check() {
            Ok(()) => self.inner.put_part(data),
            Err(error) => Box::pin(std::future::ready(Err(error))),
        }
    }

    async fn complete(&mut self) -> object_store::Result<PutResult> {
        self.faults.check()?;
        self.inner.complete().await
    }

    async fn abort(&mut self) -> object_store::Result<()> {
        self.inner.abort().await
    }
}

fn faulty(results: Results) -> (Results, Arc<Faults>) {
    let faults = Arc::new(Faults::default());
    let of_store = Arc::clone(&faults);
    let results = results.with_store(|inner| {
        Arc::new(FaultyStore {
            inner,
            faults: of_store,
        })
    });
    (results, faults)
}

#[tokio::test]
async fn a_full_disk_pauses_and_the_job_goes_on_when_there_is_space() {
    let (folder, store, results) = open_new().await;
    let (results, faults) = faulty(results);
    faults.is_full.store(true, Ordering::Relaxed);
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    let maker = FakeMaker::default();
    let made = Arc::clone(&maker.made);
    let runner = runner(&store, &results, maker);
    let (stop, signals) = (runner.stop.clone(), Arc::clone(&runner.signals));
    let running = tokio::spawn(runner.run());
    // Longer than attempts would last.
    let start = Instant::now();
    while made.load(Ordering::Relaxed) <= 2 * MAX_ATTEMPTS {
        assert!(start.elapsed() < SOON);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    assert_eq!(signals.paused(), Some("disk-full"));
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!((info.state, info.extractions.failed), (JobState::Running, 0));
    faults.is_full.store(false, Ordering::Relaxed);
    wait_for(&store, "x", |job| job.state == JobState::Done).await;
    check_results(folder.path(), &store, "x", 2).await;
    stop.cancel();
    running.await.unwrap();
    assert_eq!(signals.paused(), None);
}

#[tokio::test]
async fn each_call_of_the_object_store_may_fail_once() {
    let mut countdown = 1;
    loop {
        let (folder, store, results) = open_new().await;
        let (results, faults) = faulty(results);
        faults.countdown.store(countdown, Ordering::Relaxed);
        store.submit(job("x", None, 3), LIMITS).await.unwrap();
        let runner = runner(&store, &results, FakeMaker::default());
        let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
        wait_for(&store, "x", |job| job.state == JobState::Done).await;
        check_results(folder.path(), &store, "x", 3).await;
        stop.cancel();
        running.await.unwrap();
        if faults.countdown.load(Ordering::Relaxed) > 0 {
            // Three results of three calls, and a part more of a long one.
            assert_eq!((countdown, faults.calls.load(Ordering::Relaxed)), (11, 10));
            return;
        }
        countdown += 1;
    }
}

#[tokio::test]
async fn a_result_above_the_quota_is_refused() {
    let (folder, store, results) = open_new().await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    let runner = Runner {
        quota_bytes: 150_000,
        ..runner(&store, &results, FakeMaker::default())
    };
    let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
    let info = wait_for(&store, "x", |job| job.state.is_finished()).await;
    assert_eq!((info.extractions.done, info.extractions.failed), (1, 1));
    assert_eq!(info.failures[0].cause.code, "over-quota");
    check_results(folder.path(), &store, "x", 1).await;
    stop.cancel();
    running.await.unwrap();
}

#[tokio::test]
async fn what_an_ended_process_has_left_is_removed() {
    let (folder, store, results) = open_new().await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    let runner = runner(&store, &results, FakeMaker::default());
    let (stop, running) = (runner.stop.clone(), tokio::spawn(runner.run()));
    wait_for(&store, "x", |job| job.state == JobState::Done).await;
    stop.cancel();
    running.await.unwrap();
    let path = folder.path().join("results");
    std::fs::write(path.join("x/1#2"), "staged").unwrap();
    std::fs::write(path.join("x/2"), "written, but not noted").unwrap();
    std::fs::create_dir(path.join("deleted")).unwrap();
    std::fs::write(path.join("deleted/0"), "of a job that is not there").unwrap();
    let (store, _) = open(folder.path()).await;
    check_results(folder.path(), &store, "x", 2).await;
    assert!(!path.join("deleted").exists());
}
