//! A viewer without a socket.

use std::time::Duration;

use isopeel_codec::chunk::DecodedChunk;
use isopeel_codec::decode::decode;
use isopeel_extraction::{FullCount, Measurement, Refinement};
use isopeel_view::View;
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::super::{Common, Incoming, Outgoing, Session, StepTimes};
use super::scripted::{Answer, Asked, Job, Scripted, shapes};
use crate::access::Identity;
use crate::stream::backend::Opening;

/// The other end of a session.
pub(super) struct Viewer {
    pub inbox: Option<mpsc::Sender<Incoming>>,
    pub frames: mpsc::Receiver<Outgoing>,
    pub opens: mpsc::Receiver<Job<Opening>>,
    pub counts: mpsc::Receiver<Job<FullCount>>,
    pub steps: mpsc::Receiver<Job<Refinement>>,
    pub improvements: mpsc::Receiver<Job<Option<Refinement>>>,
    pub measurements: mpsc::Receiver<Job<Option<Measurement>>>,
    pub questions: mpsc::Receiver<Asked>,
    pub ahead: mpsc::Receiver<Job<()>>,
    /// Jobs that resolve views, of a viewer made by [`Viewer::that_resolves`].
    pub resolutions: mpsc::Receiver<Job<View>>,
    pub shutdown: CancellationToken,
    pub session: JoinHandle<()>,
}

impl Viewer {
    pub(super) fn new() -> Self {
        Self::with_token_of(Identity::without_token())
    }

    /// A viewer with the identity `who`.
    pub(super) fn with_token_of(who: Identity) -> Self {
        // Without a cache: each step is a job of the device.
        Self::among(&Common::new(0), who)
    }

    /// One of several viewers of a server, each with a device of its own.
    pub(super) fn among(common: &Common, who: Identity) -> Self {
        Self::with_device(common, who, false)
    }

    /// A viewer whose views the test resolves.
    pub(super) fn that_resolves(common: &Common) -> Self {
        Self::with_device(common, Identity::without_token(), true)
    }

    fn with_device(common: &Common, who: Identity, resolves: bool) -> Self {
        let (inbox, to_session) = mpsc::channel(1);
        let (outgoing, frames) = mpsc::channel(1);
        let (opens, open_jobs) = mpsc::channel(8);
        let (counts, count_jobs) = mpsc::channel(8);
        let (steps, step_jobs) = mpsc::channel(8);
        let (improvements, improvement_jobs) = mpsc::channel(8);
        let (measurements, measurement_jobs) = mpsc::channel(8);
        let (questions, asked) = mpsc::channel(8);
        let (ahead, ahead_jobs) = mpsc::channel(8);
        let (resolutions, resolution_jobs) = mpsc::channel(8);
        let shutdown = CancellationToken::new();
        let device = Scripted {
            opens,
            counts,
            steps,
            improvements,
            measurements,
            questions,
            ahead,
            resolutions: resolves.then_some(resolutions),
        };
        let session = Session::new(device, StepTimes::default(), common.clone(), who);
        Self {
            inbox: Some(inbox),
            frames,
            opens: open_jobs,
            counts: count_jobs,
            steps: step_jobs,
            improvements: improvement_jobs,
            measurements: measurement_jobs,
            questions: asked,
            ahead: ahead_jobs,
            resolutions: resolution_jobs,
            session: tokio::spawn(session.run(to_session, outgoing, shutdown.clone())),
            shutdown,
        }
    }

    /// Returns a viewer that has opened a volume and read `opened`.
    pub(super) async fn opened() -> Self {
        Self::new().open().await
    }

    pub(super) async fn open(self) -> Self {
        let mut viewer = self;
        viewer.say(r#"{"type":"open","volume":"head"}"#).await;
        viewer.opens.recv().await.expect("an open job").answer();
        assert_eq!(viewer.text().await["type"], "opened");
        viewer
    }

    /// Returns a viewer that is shown the final surface of these shapes: generation 1, cut 2.
    pub(super) async fn showing(start: &[i32]) -> Self {
        let mut viewer = Self::opened().await;
        viewer.say(r#"{"type":"edit"}"#).await;
        viewer.step().await.answer(Answer::prefix(1, shapes(&[9])));
        // The pong after the first step measures the line; before that, no second step is made.
        viewer.until("committed").await;
        viewer.step().await.answer(Answer::last(2, shapes(start)));
        viewer.until("done").await;
        viewer
    }

    pub(super) async fn say(&self, text: &str) {
        let inbox = self.inbox.as_ref().expect("still connected");
        inbox
            .send(Incoming::Text(text.into()))
            .await
            .expect("the session listens");
    }

    /// The next frame; pings are answered.
    pub(super) async fn frame(&mut self) -> Outgoing {
        let mut frame = self.frames.recv().await.expect("a frame");
        while let Outgoing::Ping(number) = frame {
            self.answer_ping(number).await;
            frame = self.frames.recv().await.expect("a frame");
        }
        if matches!(&frame, Outgoing::Text(text) if text.contains(r#""type":"committed""#)) {
            let Some(Outgoing::Ping(number)) = self.frames.recv().await else {
                panic!("no ping behind a step");
            };
            self.answer_ping(number).await;
        }
        frame
    }

    /// Answers pings, as any client's network layer does.
    async fn answer_ping(&self, number: u32) {
        if let Some(inbox) = &self.inbox {
            inbox.send(Incoming::Pong(number)).await.expect("the session listens");
        }
    }

    /// Reads on to a message of this type.
    pub(super) async fn until(&mut self, name: &str) -> Value {
        loop {
            let (text, _) = self.text_or_chunk().await;
            if text["type"] == name {
                return text;
            }
        }
    }

    pub(super) async fn text(&mut self) -> Value {
        match self.frame().await {
            Outgoing::Text(text) => serde_json::from_str(&text).expect("JSON"),
            other => panic!("expected text, found {other:?}"),
        }
    }

    pub(super) async fn chunk(&mut self) -> DecodedChunk {
        match self.frame().await {
            Outgoing::Binary(bytes) => decode(&bytes).expect("a valid chunk"),
            other => panic!("expected a chunk, found {other:?}"),
        }
    }

    /// The next frame; for a chunk the text is null.
    pub(super) async fn text_or_chunk(&mut self) -> (Value, Option<DecodedChunk>) {
        match self.frame().await {
            Outgoing::Text(text) => (serde_json::from_str(&text).expect("JSON"), None),
            Outgoing::Binary(bytes) => (Value::Null, Some(decode(&bytes).expect("a valid chunk"))),
            other => panic!("expected text or a chunk, found {other:?}"),
        }
    }

    pub(super) async fn error(&mut self) -> (String, bool) {
        let text = self.text().await;
        assert_eq!(text["type"], "error", "{text}");
        let code = text["code"].as_str().expect("a code").to_owned();
        (code, text["open"].as_bool().expect("open"))
    }

    pub(super) async fn step(&mut self) -> Job<Refinement> {
        self.steps.recv().await.expect("a step")
    }

    /// Answers the next job, a count of a full surface, with this number of triangles. Returns its isovalue.
    pub(super) async fn count(&mut self, triangles: u64) -> f32 {
        let job = self.counts.recv().await.expect("a count");
        let count = FullCount {
            triangles,
            ..FullCount::default()
        };
        let iso = job.view.iso.expect("an isovalue").get();
        assert!(job.reply.send(Ok(count)).is_ok(), "the session dropped its job");
        iso
    }

    pub(super) async fn expect(&mut self, json: &str) {
        let expected: Value = serde_json::from_str(json).expect("JSON");
        assert_eq!(self.text().await, expected);
    }

    /// Expects that nothing happens any more: neither a frame nor a job comes.
    pub(super) async fn quiet(&mut self) {
        let next = tokio::time::timeout(Duration::from_millis(50), self.frame()).await;
        assert!(next.is_err(), "{next:?}");
        assert!(self.steps.try_recv().is_err(), "a job");
        assert!(self.counts.try_recv().is_err(), "a count");
    }
}

/// The message `prefix` of surface 0.
pub(super) fn prefix(generation: u32, level: u8, counts: [u64; 3], is_final: bool) -> String {
    prefix_of(0, generation, level, counts, is_final)
}

/// The message `prefix` of a cut; `counts`: regions that follow, unchanged ones, and triangles of the surface.
pub(super) fn prefix_of(surface: u8, generation: u32, level: u8, counts: [u64; 3], is_final: bool) -> String {
    let [regions, unchanged, triangles] = counts;
    format!(
        r#"{{"type":"prefix","surface":{surface},"generation":{generation},"level":{level},"kind":"cut","mesher":"dual","regions":{regions},"unchanged":{unchanged},"triangles":{triangles},"final":{is_final}}}"#
    )
}

/// The message `committed` of surface 0.
pub(super) fn committed(generation: u32, level: u8, is_final: bool) -> String {
    committed_of(0, generation, level, is_final)
}

/// The message `committed`.
pub(super) fn committed_of(surface: u8, generation: u32, level: u8, is_final: bool) -> String {
    format!(
        r#"{{"type":"committed","surface":{surface},"generation":{generation},"level":{level},"final":{is_final}}}"#
    )
}
