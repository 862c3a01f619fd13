//! An independent viewer, written from `server/PROTOCOL.md` alone. It checks every frame against that page while it reads,
//! and keeps the state of a viewer (the map from region to mesh) and a log of all frames.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::ops::Deref;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::http::{HeaderValue, StatusCode};

use super::chunk::Chunk;
pub use super::frame::Frame;
use super::surface::{Pending, Surface};

/// Longest wait for a frame: long enough for a cold start on a small, busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct Viewer {
    socket: WebSocketStream<TcpStream>,
    /// Every frame so far.
    pub log: Vec<Frame>,
    /// By their numbers.
    pub surfaces: [Surface; 4],
    /// At most one at a time over all surfaces.
    pending: Option<Pending>,
    /// Bytes that the last `opening` stated since `open` was sent.
    read_bytes: u64,
    /// Whether the last `open` or `join` asked for other codings of chunks.
    asks_for_codings: bool,
    /// Whether regions that have not changed may be sent again.
    pub may_repeat: bool,
}

/// Surface 0, which is the only one in most tests.
impl Deref for Viewer {
    type Target = Surface;

    fn deref(&self) -> &Surface {
        &self.surfaces[0]
    }
}

/// The handshake of the page.
pub async fn connect(
    address: SocketAddr,
    subprotocol: Option<&'static str>,
) -> Result<WebSocketStream<TcpStream>, StatusCode> {
    handshake(
        TcpStream::connect(address).await.expect("the server listens"),
        address,
        subprotocol,
    )
    .await
}

/// The handshake of a page of that origin.
pub async fn connect_from(address: SocketAddr, origin: &str) -> Result<WebSocketStream<TcpStream>, StatusCode> {
    connect_with(address, "", &[("Origin", origin)]).await
}

/// The handshake with a query and headers.
pub async fn connect_with(
    address: SocketAddr,
    query: &str,
    headers: &[(&'static str, &str)],
) -> Result<WebSocketStream<TcpStream>, StatusCode> {
    let url = format!("ws://{address}/api/v1/stream{query}");
    let mut request = url.into_client_request().expect("the URL is well formed");
    for (name, value) in headers {
        let value = HeaderValue::from_str(value).expect("a header");
        request.headers_mut().insert(*name, value);
    }
    let tcp = TcpStream::connect(address).await.expect("the server listens");
    shake_hands(request, tcp, Some("isopeel.v2")).await
}

fn request(address: SocketAddr) -> Request {
    let url = format!("ws://{address}/api/v1/stream");
    url.into_client_request().expect("the URL is well formed")
}

/// The handshake on a socket of the caller's making.
pub async fn handshake(
    tcp: TcpStream,
    address: SocketAddr,
    subprotocol: Option<&'static str>,
) -> Result<WebSocketStream<TcpStream>, StatusCode> {
    shake_hands(request(address), tcp, subprotocol).await
}

async fn shake_hands(
    mut request: Request,
    tcp: TcpStream,
    subprotocol: Option<&'static str>,
) -> Result<WebSocketStream<TcpStream>, StatusCode> {
    if let Some(name) = subprotocol {
        request
            .headers_mut()
            .insert("Sec-WebSocket-Protocol", HeaderValue::from_static(name));
    }
    // As browsers do: a pong would wait for the one before.
    tcp.set_nodelay(true).expect("a socket");
    match tokio_tungstenite::client_async(request, tcp).await {
        Ok((socket, answer)) => {
            let chosen = answer
                .headers()
                .get("Sec-WebSocket-Protocol")
                .map(HeaderValue::as_bytes);
            assert_eq!(
                chosen,
                subprotocol.map(str::as_bytes),
                "the subprotocol that the server chose"
            );
            Ok(socket)
        }
        Err(tokio_tungstenite::tungstenite::Error::Http(answer)) => Err(answer.status()),
        Err(error) => panic!("handshake: {error}"),
    }
}

impl Viewer {
    /// Connects; nothing is opened yet.
    pub async fn connect(address: SocketAddr) -> Self {
        Self::connect_on(TcpStream::connect(address).await.expect("the server listens"), address).await
    }

    /// Connects on a socket of the caller's making.
    pub async fn connect_on(tcp: TcpStream, address: SocketAddr) -> Self {
        let socket = handshake(tcp, address, Some("isopeel.v2"))
            .await
            .expect("the handshake is accepted");
        Self {
            socket,
            log: Vec::new(),
            surfaces: Default::default(),
            pending: None,
            read_bytes: 0,
            asks_for_codings: false,
            may_repeat: false,
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
        if message["type"] == "open" || message["type"] == "join" {
            self.asks_for_codings = message["codings"].is_array();
            self.read_bytes = 0;
        }
        self.send_raw(Message::text(message.to_string())).await;
    }

    /// Sends any frame.
    pub async fn send_raw(&mut self, message: Message) {
        self.socket.send(message).await.expect("the connection takes a frame");
    }

    /// Sends several messages in one flush, faster than a device can work on them.
    pub async fn send_all(&mut self, messages: impl IntoIterator<Item = Value>) {
        for message in messages {
            self.socket
                .feed(Message::text(message.to_string()))
                .await
                .expect("the connection takes a frame");
        }
        self.socket.flush().await.expect("the connection takes the frames");
    }

    /// Closes with 1000.
    pub async fn close(mut self) {
        self.socket.close(None).await.expect("the connection closes");
        while let Some(Ok(_)) = self.socket.next().await {}
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
        let message = tokio::time::timeout(PATIENCE, self.next_message()).await;
        let frame =
            match message.unwrap_or_else(|_| panic!("no frame for {PATIENCE:?}, the last was {:?}", self.log.last())) {
                Some(Message::Text(text)) => self.control(Frame::read(&text)),
                Some(Message::Binary(bytes)) => self.chunk(&bytes),
                Some(Message::Close(reason)) => Frame::Closed {
                    code: reason.map(|reason| reason.code.into()),
                },
                None => Frame::Closed { code: None },
                Some(other) => panic!("a frame that the page does not know: {other:?}"),
            };
        self.log.push(frame.clone());
        frame
    }

    async fn next_message(&mut self) -> Option<Message> {
        loop {
            match self.socket.next().await {
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                Some(Ok(message)) => return Some(message),
                Some(Err(_)) | None => return None,
            }
        }
    }

    fn control(&mut self, frame: Frame) -> Frame {
        match &frame {
            &Frame::Opening { bytes, total_bytes } => {
                assert!(
                    self.read_bytes <= bytes && bytes <= total_bytes,
                    "{frame:?} after {}",
                    self.read_bytes
                );
                self.read_bytes = bytes;
            }
            Frame::Opened { .. } => {
                self.surfaces.iter_mut().for_each(Surface::on_opened);
                self.pending = None;
            }
            &Frame::Prefix(announced) => {
                assert!(self.pending.is_none(), "a prefix inside a prefix");
                self.surfaces[usize::from(announced.surface)].on_prefix(announced);
                self.pending = Some(Pending {
                    announced,
                    chunks: HashMap::new(),
                });
            }
            &Frame::Committed {
                surface,
                generation,
                level,
                is_final,
            } => {
                let pending = self.pending.take().expect("`committed` ends a prefix");
                let of = (surface, generation, level, is_final);
                self.surfaces[usize::from(surface)].on_committed(of, pending);
            }
            Frame::Done {
                surface,
                generation,
                trace: _,
                statistics,
            } => {
                assert!(!self.is_pending(*surface), "`done` inside a prefix");
                self.surfaces[usize::from(*surface)].on_done(*generation, statistics);
            }
            Frame::Measured {
                surface,
                generation,
                regions,
                ..
            } => self.surfaces[usize::from(*surface)].on_measured(*generation, regions),
            &Frame::Superseded { surface, generation } => {
                self.surfaces[usize::from(surface)].on_superseded(generation);
                if self.is_pending(surface) {
                    self.pending = None;
                }
            }
            &Frame::Removed { surface } => {
                assert!(
                    !self.is_pending(surface),
                    "surface {surface} was removed inside a prefix"
                );
                self.surfaces[usize::from(surface)].on_removed();
            }
            Frame::Answer { generation, .. } => {
                let newest = self.surfaces.iter().map(|surface| surface.generation()).max();
                assert!(Some(*generation) <= newest, "an answer of a generation to come");
            }
            Frame::Stepped { .. }
            | Frame::Described { .. }
            | Frame::Group(_)
            | Frame::Led(_)
            | Frame::Posed(_)
            | Frame::Left { .. }
            | Frame::Error { .. }
            | Frame::Errors { .. }
            | Frame::Chunk { .. }
            | Frame::Closed { .. } => {}
        }
        frame
    }

    /// Whether a prefix of this surface was begun.
    fn is_pending(&self, surface: u8) -> bool {
        self.pending
            .as_ref()
            .is_some_and(|pending| pending.announced.surface == surface)
    }

    /// Distances of the vertices of a region that is shown, as the page has them.
    fn errors(&self, bytes: &[u8]) -> Frame {
        let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[at + i]));
        let of = bytes[14];
        let surface = &self.surfaces[usize::from(of)];
        assert_eq!(&bytes[..4], b"ISOP");
        assert!(number(8) <= surface.generation(), "errors of a generation to come");
        assert!(surface.may_annotate(), "errors come after all else at rest");
        let region = [20, 24, 28].map(number);
        let (vertices, indices) = (number(56) as usize, number(60) as usize);
        let shown = surface
            .shown
            .get(&region)
            .unwrap_or_else(|| panic!("errors of {region:?}, which is not shown"));
        assert_eq!((vertices, indices), (shown.vertices.len(), 3 * shown.triangles.len()));
        assert_eq!((number(64) as usize, number(68)), (4 * vertices, 0));
        assert_eq!(bytes.len(), 96 + 4 * vertices);
        let distances = bytes[96..]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Frame::Errors {
            surface: of,
            generation: number(8),
            region,
            distances: distances.collect(),
        }
    }

    fn chunk(&mut self, bytes: &[u8]) -> Frame {
        if bytes.len() >= 96 && bytes[13] == 1 {
            return self.errors(bytes);
        }
        let chunk = Chunk::decode(bytes).unwrap_or_else(|why| panic!("chunk: {why}"));
        assert!(
            self.asks_for_codings || !chunk.is_predictive,
            "a coding that nobody has asked for"
        );
        let pending = self.pending.as_mut().expect("a chunk comes inside a prefix");
        let announced = pending.announced;
        assert_eq!(
            (chunk.surface, chunk.generation, chunk.prefix_level),
            (announced.surface, announced.generation, announced.level),
            "surface, generation and prefix of a chunk"
        );
        super::mesh::assert_bounds(&chunk);
        let frame = Frame::Chunk {
            surface: chunk.surface,
            generation: chunk.generation,
            level: chunk.prefix_level,
            region: chunk.region,
            bytes: chunk.frame_bytes,
            triangles: chunk.triangles.len(),
        };
        let region = chunk.region;
        if let Some(before) = self.surfaces[usize::from(chunk.surface)].shown.get(&region) {
            assert!(
                self.may_repeat || !before.same_mesh(&chunk),
                "region {region:?} was sent again, unchanged, in {announced:?}"
            );
        } else {
            assert!(
                !chunk.vertices.is_empty(),
                "region {region:?}, which the client does not hold, was removed"
            );
        }
        assert!(
            pending.chunks.insert(region, chunk).is_none(),
            "region {region:?} twice in one prefix"
        );
        frame
    }
}
