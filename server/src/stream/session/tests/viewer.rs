//! A viewer without a socket.

use std::time::Duration;

use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::super::{Incoming, Outgoing, Session};
use super::scripted::{Job, Scripted, shapes};
use crate::extraction::Extraction;
use crate::stream::backend::Opening;
use crate::wire::chunk::{DecodedChunk, decode};

/// First prefix target of the sessions in these tests.
pub(super) const FIRST_PREFIX_TARGET: Duration = Duration::from_millis(100);

/// The other end of a session.
pub(super) struct Viewer {
    pub inbox: Option<mpsc::Sender<Incoming>>,
    pub frames: mpsc::Receiver<Outgoing>,
    pub opens: mpsc::Receiver<Job<Opening>>,
    pub extracts: mpsc::Receiver<Job<Extraction>>,
    pub shutdown: CancellationToken,
    pub session: JoinHandle<()>,
}

impl Viewer {
    pub(super) fn new() -> Self {
        let (inbox, to_session) = mpsc::channel(1);
        let (outgoing, frames) = mpsc::channel(1);
        let (opens, open_jobs) = mpsc::channel(8);
        let (extracts, extract_jobs) = mpsc::channel(8);
        let shutdown = CancellationToken::new();
        let session = Session::new(Scripted { opens, extracts }, FIRST_PREFIX_TARGET);
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
    pub(super) async fn opened() -> Self {
        let mut viewer = Self::new();
        viewer.say(r#"{"type":"open","volume":"head"}"#).await;
        viewer.opens.recv().await.expect("an open job").answer();
        assert_eq!(viewer.text().await["type"], "opened");
        viewer
    }

    /// With the final surface of these shapes shown, generation 1.
    pub(super) async fn showing(start: &[i32]) -> Self {
        let mut viewer = Self::opened().await;
        viewer.say(r#"{"type":"edit"}"#).await;
        viewer.job(4).await.answer(shapes(&[9]));
        viewer.job(0).await.answer(shapes(start));
        while viewer.text_or_chunk().await.0["type"] != "done" {}
        viewer
    }

    pub(super) async fn say(&self, text: &str) {
        let inbox = self.inbox.as_ref().expect("still connected");
        inbox
            .send(Incoming::Text(text.into()))
            .await
            .expect("the session listens");
    }

    pub(super) async fn frame(&mut self) -> Outgoing {
        self.frames.recv().await.expect("a frame")
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
            Outgoing::Close(code) => panic!("closed with {code:?}"),
        }
    }

    pub(super) async fn error(&mut self) -> (String, bool) {
        let text = self.text().await;
        assert_eq!(text["type"], "error", "{text}");
        let code = text["code"].as_str().expect("a code").to_owned();
        (code, text["open"].as_bool().expect("open"))
    }

    pub(super) async fn job(&mut self, level: u8) -> Job<Extraction> {
        let job = self.extracts.recv().await.expect("an extraction");
        assert_eq!(job.level(), level);
        job
    }

    pub(super) async fn expect(&mut self, json: &str) {
        let expected: Value = serde_json::from_str(json).expect("JSON");
        assert_eq!(self.text().await, expected);
    }

    /// Nothing happens any more: neither a frame nor a job.
    pub(super) async fn quiet(&mut self) {
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert!(self.frames.try_recv().is_err(), "a frame");
        assert!(self.extracts.try_recv().is_err(), "a job");
    }
}
