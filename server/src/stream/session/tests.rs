//! The session against a scripted device: the test answers each job itself, so every order of events can be played.

use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::{Count, Level, Region, SampleType, Samples, Statistics, Surface, Vertex};
use serde_json::Value;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::super::chunk::{DecodedChunk, decode};
use super::super::protocol::CloseCode;
use super::scene::PATIENCE;
use super::{Backend, HIGH_WATER, Incoming, Opening, Outgoing, Session};
use crate::device_worker::{Extraction, Plan, PrefixCount, VolumeStep, WorkError};
use crate::edit::View;
use crate::volumes::{Dataset, Field, Geometry, ReadError, Source};

const ANSWER: Duration = Duration::from_millis(100);

/// A β for which the scripted device has too many triangles.
const TOO_FINE: f32 = 0.0625;

#[derive(Debug)]
struct NoSamples;

impl Source for NoSamples {
    fn load(&self, _step: u32) -> Result<Samples, ReadError> {
        unreachable!("the scripted device reads no samples")
    }
}

fn dataset(id: &str) -> Arc<Dataset> {
    Arc::new(Dataset {
        id: id.into(),
        title: "Test".into(),
        geometry: Geometry {
            dims: [65; 3],
            spacing: [1.0; 3],
            origin: [0.0; 3],
            direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        },
        steps: 2,
        fields: vec![Field {
            name: "density".into(),
            stored_type: "u8".into(),
            sample_type: SampleType::U8,
            missing: None,
            unit: None,
            source: Arc::new(NoSamples),
        }],
        notice: None,
        opening: None,
    })
}

/// A job that waits for the test's answer.
struct Job<T> {
    volume: VolumeStep,
    view: View,
    prefix: Option<Level>,
    token: CancellationToken,
    reply: oneshot::Sender<Result<T, WorkError>>,
}

#[derive(Clone)]
struct Scripted {
    opens: mpsc::Sender<Job<Opening>>,
    extracts: mpsc::Sender<Job<Extraction>>,
}

impl Scripted {
    async fn ask<T>(
        to: &mpsc::Sender<Job<T>>,
        volume: &VolumeStep,
        view: &View,
        prefix: Option<Level>,
        token: &CancellationToken,
    ) -> Result<T, WorkError> {
        let (reply, answer) = oneshot::channel();
        let job = Job {
            volume: volume.clone(),
            view: view.clone(),
            prefix,
            token: token.clone(),
            reply,
        };
        to.send(job).await.map_err(|_| WorkError::Stopped)?;
        answer.await.unwrap_or(Err(WorkError::Stopped))
    }
}

impl Backend for Scripted {
    fn find(&self, volume: &str) -> Option<Arc<Dataset>> {
        ["head", "other"].contains(&volume).then(|| dataset(volume))
    }

    async fn open(&self, volume: &VolumeStep, view: &View, token: &CancellationToken) -> Result<Opening, WorkError> {
        Self::ask(&self.opens, volume, view, None, token).await
    }

    /// Counts at once, so that level 4 comes first, then the final surface. A preview is of level 2.
    async fn plan(
        &self,
        _: &VolumeStep,
        view: &View,
        levels: Vec<Level>,
        _: &CancellationToken,
    ) -> Result<Plan, WorkError> {
        let triangles = |level: Level| match level.get() {
            5 => 50,
            4 => 100,
            0 => 100_000,
            _ => 10_000,
        };
        let prefixes = levels.into_iter().map(|level| PrefixCount {
            level,
            count: Count {
                triangles: triangles(level),
                ..Count::default()
            },
        });
        if view.budget.is_none() && view.beta == TOO_FINE {
            return Err(WorkError::TooManyTriangles {
                triangles: 30,
                ceiling: 20,
            });
        }
        Ok(Plan {
            view: view.clone(),
            prefixes: prefixes.collect(),
            regions: 1,
            wall: Duration::ZERO,
        })
    }

    async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        prefix: Level,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        Self::ask(&self.extracts, volume, view, Some(prefix), token).await
    }
}

/// A region with one triangle; different shapes differ.
fn region(x: u32, shape: i32) -> Region {
    let vertex = |position| Vertex {
        position,
        normal: [0, 0],
        smoothness: 0,
        feature: 0,
    };
    Region {
        coords: [x, 0, 0],
        vertices: [[0, 0, 0], [65536, 0, 0], [0, 65536 * shape, 0]].map(vertex).to_vec(),
        indices: vec![0, 1, 2],
        level_triangles: [1, 0, 0, 0, 0, 0],
        error: None,
    }
}

/// A surface of regions 0, 1, … with these shapes; 0 leaves a region out.
fn shapes(shapes: &[i32]) -> Vec<Region> {
    let regions = shapes.iter().enumerate().filter(|(_, shape)| **shape != 0);
    regions.map(|(x, shape)| region(x as u32, *shape)).collect()
}

impl Job<Extraction> {
    fn level(&self) -> u8 {
        self.prefix.expect("an extraction").get()
    }

    fn answer(self, regions: Vec<Region>) {
        self.answer_after(regions, Duration::from_millis(10));
    }

    /// Answers as a device that took so long.
    fn answer_after(self, regions: Vec<Region>, wall: Duration) {
        let statistics = Statistics {
            triangles: regions.len() as u64,
            full_triangles: 1000,
            ..Statistics::default()
        };
        let extraction = Extraction {
            surface: Surface {
                prefix: self.prefix.expect("an extraction"),
                regions,
                statistics,
            },
            view: self.view.clone(),
            wall,
        };
        assert!(self.reply.send(Ok(extraction)).is_ok(), "the session dropped its job");
    }

    fn answer_cancelled(self) {
        assert!(self.token.is_cancelled(), "the job was not cancelled");
        assert!(
            self.reply.send(Err(WorkError::Cancelled)).is_ok(),
            "the session dropped its job"
        );
    }
}

impl Job<Opening> {
    fn answer(self) {
        let mut view = self.view.clone();
        view.iso = isopeel_kernels::Isovalue::new(100.0).ok();
        view.feature_range = Some([0.0, 50.0]);
        let opening = Opening {
            volume: serde_json::value::to_raw_value(&serde_json::json!({ "id": self.volume.dataset().id }))
                .expect("JSON"),
            view,
            device: "scripted".into(),
        };
        assert!(self.reply.send(Ok(opening)).is_ok(), "the session dropped its job");
    }
}

struct Viewer {
    inbox: Option<mpsc::Sender<Incoming>>,
    frames: mpsc::Receiver<Outgoing>,
    opens: mpsc::Receiver<Job<Opening>>,
    extracts: mpsc::Receiver<Job<Extraction>>,
    shutdown: CancellationToken,
    session: JoinHandle<()>,
}

impl Viewer {
    fn new() -> Self {
        let (inbox, to_session) = mpsc::channel(1);
        let (outgoing, frames) = mpsc::channel(1);
        let (opens, open_jobs) = mpsc::channel(8);
        let (extracts, extract_jobs) = mpsc::channel(8);
        let shutdown = CancellationToken::new();
        let session = Session::new(Scripted { opens, extracts }, ANSWER);
        Self {
            inbox: Some(inbox),
            frames,
            opens: open_jobs,
            extracts: extract_jobs,
            session: tokio::spawn(session.run(to_session, outgoing, shutdown.clone())),
            shutdown,
        }
    }

    /// With a volume open and `opened` read.
    async fn opened() -> Self {
        let mut viewer = Self::new();
        viewer.say(r#"{"type":"open","volume":"head"}"#).await;
        viewer.opens.recv().await.expect("an open job").answer();
        assert_eq!(viewer.text().await["type"], "opened");
        viewer
    }

    /// With the final surface of these shapes shown, generation 1.
    async fn showing(start: &[i32]) -> Self {
        let mut viewer = Self::opened().await;
        viewer.say(r#"{"type":"edit"}"#).await;
        viewer.job(4).await.answer(shapes(&[9]));
        viewer.job(0).await.answer(shapes(start));
        while viewer.text_or_chunk().await.0["type"] != "done" {}
        viewer
    }

    async fn say(&self, text: &str) {
        let inbox = self.inbox.as_ref().expect("still connected");
        inbox
            .send(Incoming::Text(text.into()))
            .await
            .expect("the session listens");
    }

    async fn frame(&mut self) -> Outgoing {
        self.frames.recv().await.expect("a frame")
    }

    async fn text(&mut self) -> Value {
        match self.frame().await {
            Outgoing::Text(text) => serde_json::from_str(&text).expect("JSON"),
            other => panic!("expected text, found {other:?}"),
        }
    }

    async fn chunk(&mut self) -> DecodedChunk {
        match self.frame().await {
            Outgoing::Binary(bytes) => decode(&bytes).expect("a valid chunk"),
            other => panic!("expected a chunk, found {other:?}"),
        }
    }

    /// The next frame; for a chunk the text is null.
    async fn text_or_chunk(&mut self) -> (Value, Option<DecodedChunk>) {
        match self.frame().await {
            Outgoing::Text(text) => (serde_json::from_str(&text).expect("JSON"), None),
            Outgoing::Binary(bytes) => (Value::Null, Some(decode(&bytes).expect("a valid chunk"))),
            Outgoing::Close(code) => panic!("closed with {code:?}"),
        }
    }

    async fn error(&mut self) -> (String, bool) {
        let text = self.text().await;
        assert_eq!(text["type"], "error", "{text}");
        let code = text["code"].as_str().expect("a code").to_owned();
        (code, text["open"].as_bool().expect("open"))
    }

    async fn job(&mut self, level: u8) -> Job<Extraction> {
        let job = self.extracts.recv().await.expect("an extraction");
        assert_eq!(job.level(), level);
        job
    }

    async fn expect(&mut self, json: &str) {
        let expected: Value = serde_json::from_str(json).expect("JSON");
        assert_eq!(self.text().await, expected);
    }

    /// Nothing happens any more: neither a frame nor a job.
    async fn quiet(&mut self) {
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert!(self.frames.try_recv().is_err(), "a frame");
        assert!(self.extracts.try_recv().is_err(), "a job");
    }
}

#[tokio::test]
async fn prefixes_come_coarse_first_and_end_with_the_statistics() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.job(4).await;
    assert_eq!((job.view.beta, job.view.iso.map(|iso| iso.get())), (0.5, Some(100.0)));
    job.answer(shapes(&[1]));
    viewer
        .expect(r#"{"type":"prefix","generation":1,"level":4,"regions":1,"standing":0}"#)
        .await;
    let chunk = viewer.chunk().await;
    assert_eq!(
        (chunk.header.generation, chunk.header.level, chunk.header.region),
        (1, 4, [0, 0, 0])
    );
    viewer.expect(r#"{"type":"committed","generation":1,"level":4}"#).await;
    viewer.job(0).await.answer(shapes(&[1, 2]));
    viewer
        .expect(r#"{"type":"prefix","generation":1,"level":0,"regions":1,"standing":1}"#)
        .await;
    assert_eq!(viewer.chunk().await.header.region, [1, 0, 0]);
    viewer.expect(r#"{"type":"committed","generation":1,"level":0}"#).await;
    let done = viewer.text().await;
    assert_eq!((&done["type"], &done["generation"]), (&"done".into(), &1.into()));
    let mut names: Vec<_> = done["statistics"].as_object().expect("an object").keys().collect();
    names.sort();
    let mut expected = vec![
        "mesher",
        "beta",
        "max_error",
        "topology",
        "polished",
        "error",
        "full_triangles",
        "active_cells",
        "leaves",
        "triangles",
        "vertices",
        "lost_cubes",
        "unpatched_vertices",
        "stages_ms",
        "wall_ms",
        "device_bytes",
        "volume_bytes",
        "device",
    ];
    expected.sort_unstable();
    assert_eq!(names, expected);
    assert_eq!(done["statistics"]["triangles"], 2);
    assert_eq!(done["statistics"]["wall_ms"], 20.0, "both prefixes");
    assert_eq!(done["statistics"]["device"], "scripted");
    viewer.quiet().await;
}

#[tokio::test]
async fn the_device_works_on_the_next_prefix_while_this_one_is_sent() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[1, 2, 3, 4, 5, 6]));
    // Not one frame was read.
    viewer.job(0).await.answer(shapes(&[1]));
    let mut levels = Vec::new();
    loop {
        let (text, chunk) = viewer.text_or_chunk().await;
        levels.extend(chunk.map(|c| c.header.level));
        if text["type"] == "done" {
            break;
        }
    }
    assert_eq!(levels, [4, 4, 4, 4, 4, 4, 0, 0, 0, 0, 0], "six, then five removals");
}

#[tokio::test]
async fn only_what_changed_is_sent() {
    let mut viewer = Viewer::showing(&[1, 2, 3, 4, 5]).await;
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    // Same surface, other cut: straight to the final prefix. One region new, one gone, three as they were.
    viewer.job(0).await.answer(shapes(&[1, 7, 3, 0, 5]));
    viewer
        .expect(r#"{"type":"prefix","generation":2,"level":0,"regions":2,"standing":3}"#)
        .await;
    let (changed, gone) = (viewer.chunk().await, viewer.chunk().await);
    assert_eq!((changed.header.region, changed.header.vertex_count), ([1, 0, 0], 3));
    assert_eq!((gone.header.region, gone.header.vertex_count), ([3, 0, 0], 0));
    viewer.expect(r#"{"type":"committed","generation":2,"level":0}"#).await;
    assert_eq!(viewer.text().await["type"], "done");

    viewer.say(r#"{"type":"edit","alpha":0.9}"#).await;
    viewer.job(0).await.answer(shapes(&[1, 7, 3, 0, 5]));
    viewer
        .expect(r#"{"type":"prefix","generation":3,"level":0,"regions":0,"standing":4}"#)
        .await;
    viewer.expect(r#"{"type":"committed","generation":3,"level":0}"#).await;
    assert_eq!(viewer.text().await["type"], "done");
}

#[tokio::test]
async fn another_isovalue_starts_coarse_again() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","iso":5}"#).await;
    viewer.job(4).await.answer(shapes(&[3]));
}

#[tokio::test]
async fn the_first_prefix_waits_for_no_plan() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    // A plan of this is refused at once: the prefix was made before it.
    viewer
        .say(&format!(r#"{{"type":"edit","iso":5,"beta":{TOO_FINE}}}"#))
        .await;
    viewer.job(4).await.answer(shapes(&[3]));
    let error = loop {
        let (text, _) = viewer.text_or_chunk().await;
        if text["type"] == "error" {
            break text;
        }
    };
    assert_eq!(error["code"], "too-large");
    viewer.expect(r#"{"type":"superseded","generation":2}"#).await;
}

#[tokio::test]
async fn a_slow_change_of_the_cut_begins_with_a_preview_and_a_drag_goes_on_with_it() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[9]));
    viewer.job(0).await.answer_after(shapes(&[1]), 2 * ANSWER);
    while viewer.text_or_chunk().await.0["type"] != "done" {}
    for beta in [0.1, 0.2] {
        viewer.say(&format!(r#"{{"type":"edit","beta":{beta}}}"#)).await;
        viewer.job(2).await.answer(shapes(&[7]));
        while viewer.text_or_chunk().await.0["type"] != "committed" {}
        viewer.job(0).await.answer(shapes(&[4]));
        while viewer.text_or_chunk().await.0["type"] != "done" {}
        // Now the device is fast.
        viewer.say(r#"{"type":"edit","alpha":0.5}"#).await;
        viewer.job(0).await.answer_after(shapes(&[5]), 2 * ANSWER);
        while viewer.text_or_chunk().await.0["type"] != "done" {}
    }
    viewer.say(r#"{"type":"edit","beta":0.3}"#).await;
    viewer.job(2).await.answer(shapes(&[6]));
    while viewer.text_or_chunk().await.0["type"] != "committed" {}
    let overtaken = viewer.job(0).await;
    viewer.say(r#"{"type":"edit","beta":0.4}"#).await;
    viewer.expect(r#"{"type":"superseded","generation":6}"#).await;
    overtaken.answer_cancelled();
    viewer.job(2).await.answer(shapes(&[8]));
}

#[tokio::test]
async fn a_newer_edit_ends_the_older_and_edits_coalesce() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","beta":0.1}"#).await;
    let first = viewer.job(4).await;
    for beta in [0.2, 0.3, 0.4] {
        viewer.say(&format!(r#"{{"type":"edit","beta":{beta}}}"#)).await;
    }
    viewer.say(r#"{"type":"edit","alpha":1}"#).await;
    viewer.expect(r#"{"type":"superseded","generation":1}"#).await;
    viewer.quiet().await;
    first.answer_cancelled();
    let job = viewer.job(4).await;
    assert_eq!((job.view.beta, job.view.alpha), (0.4, 1.0));
    job.answer(shapes(&[1]));
    viewer
        .expect(r#"{"type":"prefix","generation":2,"level":4,"regions":1,"standing":0}"#)
        .await;
}

#[tokio::test]
async fn nothing_of_an_older_generation_follows_the_newer() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[1; 40]));
    viewer
        .expect(r#"{"type":"prefix","generation":1,"level":4,"regions":40,"standing":0}"#)
        .await;
    viewer.chunk().await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    // A result that came too late is as good as none.
    let late = viewer.job(0).await;
    late.answer(shapes(&[2; 40]));
    let mut chunks = 0;
    loop {
        let (text, chunk) = viewer.text_or_chunk().await;
        match chunk {
            Some(chunk) => assert_eq!(chunk.header.generation, 1),
            None => {
                assert_eq!(text["type"], "superseded");
                break;
            }
        }
        chunks += 1;
    }
    assert!(chunks < 38, "{chunks} chunks came though the edit was there");
    // The client committed nothing of generation 1, so every region goes again.
    viewer.job(4).await.answer(shapes(&[1; 40]));
    viewer
        .expect(r#"{"type":"prefix","generation":2,"level":4,"regions":40,"standing":0}"#)
        .await;
    for _ in 0..40 {
        assert_eq!(viewer.chunk().await.header.generation, 2);
    }
    viewer.expect(r#"{"type":"committed","generation":2,"level":4}"#).await;
}

#[tokio::test]
async fn cancel_ends_the_generation_and_keeps_what_was_committed() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.job(0).await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer.expect(r#"{"type":"superseded","generation":2}"#).await;
    job.answer_cancelled();
    viewer.quiet().await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(0).await.answer(shapes(&[1, 2, 4]));
    viewer
        .expect(r#"{"type":"prefix","generation":3,"level":0,"regions":1,"standing":2}"#)
        .await;
}

#[tokio::test]
async fn a_storm_without_commits_goes_coarse_first() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    viewer.say(r#"{"type":"edit","beta":0.1}"#).await;
    let first = viewer.job(0).await;
    tokio::time::sleep(PATIENCE + Duration::from_millis(20)).await;
    viewer.say(r#"{"type":"edit","beta":0.2}"#).await;
    viewer.expect(r#"{"type":"superseded","generation":2}"#).await;
    first.answer_cancelled();
    viewer.job(2).await.answer(shapes(&[9]));
    while viewer.text_or_chunk().await.0["type"] != "committed" {}
    viewer.job(0).await.answer(shapes(&[1]));
}

#[tokio::test]
async fn edits_while_a_volume_opens_are_kept() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"open","volume":"head","step":1}"#).await;
    viewer.say(r#"{"type":"edit","beta":0.25}"#).await;
    let open = viewer.opens.recv().await.expect("an open job");
    assert_eq!(open.volume.step(), 1);
    open.answer();
    let opened = viewer.text().await;
    assert_eq!((&opened["type"], &opened["step"]), (&"opened".into(), &1.into()));
    assert_eq!(opened["edit"]["iso"], 100.0);
    assert_eq!(opened["device"], "scripted");
    let job = viewer.job(4).await;
    assert_eq!((job.view.beta, job.view.iso.map(|iso| iso.get())), (0.25, Some(100.0)));
}

#[tokio::test]
async fn another_open_replaces_the_first() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let first = viewer.opens.recv().await.expect("an open job");
    viewer.say(r#"{"type":"open","volume":"other"}"#).await;
    first.token.cancelled().await;
    first.answer();
    viewer.opens.recv().await.expect("an open job").answer();
    let opened = viewer.text().await;
    assert_eq!(opened["volume"]["id"], "other");
    // The server's picture of the client is empty again.
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[1, 2]));
    viewer
        .expect(r#"{"type":"prefix","generation":2,"level":4,"regions":2,"standing":0}"#)
        .await;
}

#[tokio::test]
async fn faults_are_said_and_the_connection_lives_on() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"edit"}"#).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    viewer.say(r#"{"type":"open","volume":"heart"}"#).await;
    assert_eq!(viewer.error().await, ("unknown-volume".into(), true));
    viewer.say(r#"{"type":"open","volume":"head","step":2}"#).await;
    assert_eq!(viewer.error().await, ("unknown-step".into(), true));
    viewer.say("[1").await;
    assert_eq!(viewer.error().await, ("bad-message".into(), true));
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    viewer.say(r#"{"type":"edit","alpha":2}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","beta":0.125}"#).await;
    let job = viewer.job(4).await;
    assert_eq!(
        (job.view.alpha, job.view.beta),
        (0.3, 0.125),
        "the bad edit was not applied"
    );
}

#[tokio::test]
async fn a_failing_device_ends_the_generation_alone() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.job(0).await;
    let error = WorkError::Device(isopeel_kernels::Error::NoDriver);
    assert!(job.reply.send(Err(error)).is_ok());
    assert_eq!(viewer.error().await, ("device".into(), true));
    viewer.expect(r#"{"type":"superseded","generation":2}"#).await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(0).await.answer(shapes(&[1, 3]));
    viewer
        .expect(r#"{"type":"prefix","generation":3,"level":0,"regions":1,"standing":1}"#)
        .await;
}

#[tokio::test]
async fn what_is_too_large_is_refused_before_it_is_made_and_a_budget_offered() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(&format!(r#"{{"type":"edit","beta":{TOO_FINE}}}"#)).await;
    let error = viewer.text().await;
    assert_eq!(
        (
            &error["type"],
            &error["code"],
            &error["open"],
            &error["suggestedTriangles"]
        ),
        (&"error".into(), &"too-large".into(), &true.into(), &20.into())
    );
    viewer.expect(r#"{"type":"superseded","generation":2}"#).await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","cap":true}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","triangles":20,"beta":0.5}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
}

#[tokio::test]
async fn sixteen_malformed_messages_in_a_row_close() {
    let mut viewer = Viewer::new();
    for _ in 0..15 {
        viewer.say("{").await;
        assert_eq!(viewer.error().await, ("bad-message".into(), true));
    }
    viewer.say(r#"{"type":"cancel"}"#).await;
    for _ in 0..15 {
        viewer.say("{").await;
        assert_eq!(viewer.error().await, ("bad-message".into(), true));
    }
    viewer.say("{").await;
    assert_eq!(viewer.error().await, ("bad-message".into(), false));
    assert_eq!(viewer.frame().await, Outgoing::Close(CloseCode::Malformed));
    viewer.session.await.expect("ends");
}

#[tokio::test]
async fn a_client_that_talks_and_does_not_read_fills_no_memory() {
    let viewer = Viewer::new();
    let inbox = viewer.inbox.clone().expect("connected");
    let mut taken = 0;
    while tokio::time::timeout(
        Duration::from_millis(100),
        inbox.send(Incoming::Text(r#"{"type":"edit"}"#.into())),
    )
    .await
    .is_ok()
    {
        taken += 1;
        assert!(taken < 10 * HIGH_WATER, "every message is taken");
    }
    assert!(taken >= HIGH_WATER, "{taken}");
}

#[tokio::test]
async fn a_shutdown_says_so_and_cancels_the_work() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    let job = viewer.job(4).await;
    viewer.shutdown.cancel();
    assert_eq!(viewer.frame().await, Outgoing::Close(CloseCode::Shutdown));
    viewer.session.await.expect("ends");
    assert!(job.token.is_cancelled());
}

#[tokio::test]
async fn a_client_that_vanishes_leaves_nothing_behind() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[1; 64]));
    viewer.frame().await;
    let job = viewer.job(0).await;
    // Mid-send: 64 chunks wait. First only the writer goes, as when the network breaks.
    viewer.frames.close();
    viewer.session.await.expect("ends");
    assert!(job.token.is_cancelled());
    assert!(job.reply.is_closed());
    assert!(viewer.extracts.recv().await.is_none(), "the backend's handles are gone");

    let mut viewer = Viewer::opened().await;
    viewer.inbox = None;
    viewer.session.await.expect("ends when the reader goes, too");
}
