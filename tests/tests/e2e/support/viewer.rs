//! A viewer that panics at each violation of `server/PROTOCOL.md`, and keeps a log of all frames.

use std::net::SocketAddr;
use std::ops::{Deref, DerefMut};
use std::time::Duration;

use isopeel_client::{Connection, Error, Message, request};
use serde_json::{Value, json};
use tokio::net::TcpStream;

pub use isopeel_client::Frame;

/// Longest wait for a frame: long enough for a cold start on a small, busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct Viewer {
    client: isopeel_client::Viewer,
    /// Every frame so far.
    pub log: Vec<Frame>,
}

impl Deref for Viewer {
    type Target = isopeel_client::Viewer;

    fn deref(&self) -> &isopeel_client::Viewer {
        &self.client
    }
}

impl DerefMut for Viewer {
    fn deref_mut(&mut self) -> &mut isopeel_client::Viewer {
        &mut self.client
    }
}

/// Connects.
pub async fn connect(address: SocketAddr) -> Connection {
    Connection::connect(address).await.expect("the handshake is accepted")
}

/// Returns the HTTP status of a handshake that is refused.
pub fn status(connected: Result<Connection, Error>) -> Option<u16> {
    match connected {
        Ok(_) => None,
        Err(Error::Refused { status, .. }) => Some(status),
        Err(error) => panic!("handshake: {error:?}"),
    }
}

impl Viewer {
    /// Connects; nothing is opened yet.
    pub async fn connect(address: SocketAddr) -> Self {
        Self::connect_on(TcpStream::connect(address).await.expect("the server listens"), address).await
    }

    /// Connects on a socket of the caller's making.
    pub async fn connect_on(tcp: TcpStream, address: SocketAddr) -> Self {
        let request = request(address, "", &[]).expect("a request");
        let connection = Connection::handshake(tcp, request, None)
            .await
            .expect("the handshake is accepted");
        Self {
            client: isopeel_client::Viewer::new(connection),
            log: Vec::new(),
        }
    }

    /// Connects and opens a volume.
    pub async fn open(address: SocketAddr, volume: &str) -> Self {
        let mut viewer = Self::connect(address).await;
        viewer.send(json!({"type": "open", "volume": volume})).await;
        viewer.until_opened().await;
        viewer
    }

    /// Reads up to `opened` and returns it.
    pub async fn until_opened(&mut self) -> Frame {
        loop {
            match self.next().await {
                Frame::Opening { .. } => {}
                opened @ Frame::Opened { .. } => return opened,
                other => panic!("expected `opened`, got {other:?}"),
            }
        }
    }

    /// Sends a control message.
    pub async fn send(&mut self, message: Value) {
        self.client
            .send(&message)
            .await
            .expect("the connection takes a message");
    }

    /// Sends any frame.
    pub async fn send_raw(&mut self, message: Message) {
        let sent = self.client.connection.send_raw(message).await;
        sent.expect("the connection takes a frame");
    }

    /// Sends several messages in one flush, faster than a device can work on them.
    pub async fn send_all(&mut self, messages: impl IntoIterator<Item = Value>) {
        let sent = self.client.connection.send_all(messages).await;
        sent.expect("the connection takes the messages");
    }

    /// Closes with 1000.
    pub async fn close(self) {
        self.client.connection.close().await.expect("the connection closes");
    }

    /// Sends an edit (its fields without `type`) and reads to the end of its generation: the statistics of its `done`.
    pub async fn edit(&mut self, mut edit: Value) -> Value {
        edit["type"] = json!("edit");
        let surface = edit["surface"].as_u64().unwrap_or(0) as usize;
        let before = self.surfaces[surface].generation();
        self.send(edit).await;
        loop {
            let statistics = self.until_done().await;
            // An improved surface of the previous generation may be in flight, or one of another surface.
            let generation = self.surfaces[surface].generation();
            if generation > before
                && self
                    .log
                    .last()
                    .is_some_and(|frame| frame.generation() == Some(generation))
            {
                return statistics;
            }
        }
    }

    /// Asks a question and reads up to its answer; returns the generation that it is about, and the answer.
    pub async fn ask(&mut self, question: Value) -> (u32, Value) {
        let kind = match question["type"].as_str() {
            Some("probe") => "probed",
            Some("annotate") => "annotated",
            Some(other) => other,
            None => panic!("a question has a type: {question}"),
        }
        .to_owned();
        self.send(question).await;
        loop {
            match self.next().await {
                Frame::Answer {
                    kind: found,
                    generation,
                    answer,
                } if found == kind => return (generation, answer),
                Frame::Error { code, message, .. } => panic!("error {code}: {message}"),
                Frame::Closed { code } => panic!("closed with {code:?} before the answer"),
                _ => {}
            }
        }
    }

    /// Reads up to the next `done`.
    pub async fn until_done(&mut self) -> Value {
        loop {
            match self.next().await {
                Frame::Done { statistics, .. } => return statistics,
                Frame::Error { code, message, .. } => panic!("error {code}: {message}"),
                Frame::Closed { code } => panic!("closed with {code:?} before `done`"),
                _ => {}
            }
        }
    }

    /// Sends an edit and reads until all frames that follow at rest have arrived; returns the statistics of each `done`.
    pub async fn edit_and_rest(&mut self, edit: Value) -> Vec<Value> {
        let mut done = vec![self.edit(edit).await];
        loop {
            match self.next().await {
                Frame::Done { statistics, .. } => done.push(statistics),
                Frame::Measured { .. } => return done,
                Frame::Prefix(_) | Frame::Chunk { .. } | Frame::Committed { .. } => {}
                other => panic!("unexpected {other:?}"),
            }
        }
    }

    /// Sends an edit that fails; returns the code and the suggested budget.
    pub async fn refused(&mut self, mut edit: Value) -> (String, Option<u64>) {
        edit["type"] = json!("edit");
        self.send(edit).await;
        let refused = loop {
            match self.next().await {
                Frame::Error {
                    code,
                    suggested_triangles,
                    open: true,
                    ..
                } => break (code, suggested_triangles),
                Frame::Prefix(_) | Frame::Chunk { .. } | Frame::Committed { .. } => {}
                other => panic!("unexpected {other:?}"),
            }
        };
        let ended = self.next().await;
        assert!(matches!(ended, Frame::Superseded { .. }), "{ended:?}");
        refused
    }

    /// Reads one frame, checks it against the page, logs it.
    pub async fn next(&mut self) -> Frame {
        let next = tokio::time::timeout(PATIENCE, self.client.next()).await;
        let frame =
            match next.unwrap_or_else(|_| panic!("no frame for {PATIENCE:?}, the last was {:?}", self.log.last())) {
                Ok(frame) => frame,
                Err(Error::Connection(_) | Error::Socket(_)) => Frame::Closed { code: None },
                Err(error) => panic!("{error:?} after {:?}", self.log.last()),
            };
        self.log.push(frame.clone());
        frame
    }
}
