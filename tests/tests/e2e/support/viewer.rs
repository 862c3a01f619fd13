//! A stranger's viewer, written from `server/PROTOCOL.md` alone. It holds every frame against the page while it reads,
//! keeps what a viewer must keep (the map from region to mesh) and a log of all frames.

use std::collections::HashMap;
use std::net::SocketAddr;
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

/// The longest any one frame may take: a cold start of a small machine's processor, and others beside it.
const PATIENCE: Duration = Duration::from_secs(120);

/// A frame from the server, as the log keeps it.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    Opened {
        volume: Value,
        step: u64,
        edit: Value,
        device: Value,
    },
    Prefix {
        generation: u32,
        level: u8,
        regions: usize,
        standing: usize,
    },
    Chunk {
        generation: u32,
        level: u8,
        region: [u32; 3],
        bytes: usize,
        triangles: usize,
    },
    Committed {
        generation: u32,
        level: u8,
    },
    Done {
        generation: u32,
        statistics: Value,
    },
    Superseded {
        generation: u32,
    },
    Error {
        code: String,
        message: String,
        open: bool,
    },
    Closed {
        code: Option<u16>,
    },
}

impl Frame {
    /// The generation it carries, if it carries one.
    pub fn generation(&self) -> Option<u32> {
        match *self {
            Self::Prefix { generation, .. }
            | Self::Chunk { generation, .. }
            | Self::Committed { generation, .. }
            | Self::Done { generation, .. }
            | Self::Superseded { generation } => Some(generation),
            Self::Opened { .. } | Self::Error { .. } | Self::Closed { .. } => None,
        }
    }
}

/// A prefix between `prefix` and `committed`.
struct Pending {
    level: u8,
    regions: usize,
    standing: usize,
    chunks: HashMap<[u32; 3], Chunk>,
}

/// Where the newest generation stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// Prefixes come; the level of the last committed one.
    Running { committed: Option<u8> },
    /// `done` or `superseded` was its last frame.
    Ended,
}

pub struct Viewer {
    socket: WebSocketStream<TcpStream>,
    /// Every frame so far.
    pub log: Vec<Frame>,
    /// What a viewer shows: the last committed mesh of every region that has one.
    pub shown: HashMap<[u32; 3], Chunk>,
    pending: Option<Pending>,
    generation: u32,
    stage: Stage,
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
    let mut request = request(address);
    let origin = HeaderValue::from_str(origin).expect("a header");
    request.headers_mut().insert("Origin", origin);
    let tcp = TcpStream::connect(address).await.expect("the server listens");
    shake_hands(request, tcp, Some("isopeel.v1")).await
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
        let socket = connect(address, Some("isopeel.v1"))
            .await
            .expect("the handshake is accepted");
        Self {
            socket,
            log: Vec::new(),
            shown: HashMap::new(),
            pending: None,
            generation: 0,
            stage: Stage::Ended,
        }
    }

    /// Connects and opens a volume.
    pub async fn open(address: SocketAddr, volume: &str) -> Self {
        let mut viewer = Self::connect(address).await;
        viewer.send(json!({"type": "open", "volume": volume})).await;
        match viewer.next().await {
            Frame::Opened { .. } => viewer,
            other => panic!("expected `opened`, got {other:?}"),
        }
    }

    /// Sends a control message.
    pub async fn send(&mut self, message: Value) {
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
        self.send(edit).await;
        self.until_done().await
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

    /// Reads one frame, checks it against the page, logs it.
    pub async fn next(&mut self) -> Frame {
        let message = tokio::time::timeout(PATIENCE, self.next_message()).await;
        let frame =
            match message.unwrap_or_else(|_| panic!("no frame for {PATIENCE:?}, the last was {:?}", self.log.last())) {
                Some(Message::Text(text)) => self.control(serde_json::from_str(&text).expect("a text frame is JSON")),
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

    fn control(&mut self, message: Value) -> Frame {
        let text = |field: &str| {
            message[field]
                .as_str()
                .unwrap_or_else(|| panic!("{field} is text: {message}"))
                .to_owned()
        };
        let number = |field: &str| {
            message[field]
                .as_u64()
                .unwrap_or_else(|| panic!("{field} is a count: {message}"))
        };
        let generation = || number("generation") as u32;
        let level = || number("level") as u8;
        match text("type").as_str() {
            "opened" => {
                assert_fields(&message, &["volume", "step", "edit", "device"]);
                self.shown.clear();
                self.pending = None;
                Frame::Opened {
                    volume: message["volume"].clone(),
                    step: number("step"),
                    edit: message["edit"].clone(),
                    device: message["device"].clone(),
                }
            }
            "prefix" => {
                assert_fields(&message, &["generation", "level", "regions", "standing"]);
                let (regions, standing) = (number("regions") as usize, number("standing") as usize);
                self.on_prefix(generation(), level(), regions, standing);
                Frame::Prefix {
                    generation: generation(),
                    level: level(),
                    regions,
                    standing,
                }
            }
            "committed" => {
                assert_fields(&message, &["generation", "level"]);
                self.on_committed(generation(), level());
                Frame::Committed {
                    generation: generation(),
                    level: level(),
                }
            }
            "done" => {
                assert_fields(&message, &["generation", "statistics"]);
                assert_eq!(generation(), self.generation, "`done` of the newest generation");
                assert_eq!(
                    self.stage,
                    Stage::Running { committed: Some(0) },
                    "`done` follows the prefix of level 0"
                );
                assert!(self.pending.is_none(), "`done` inside a prefix");
                self.stage = Stage::Ended;
                let statistics = message["statistics"].clone();
                let triangles: usize = self.shown.values().map(|chunk| chunk.triangles.len()).sum();
                assert_eq!(
                    statistics["triangles"], triangles,
                    "triangles of the map and of the statistics"
                );
                Frame::Done {
                    generation: generation(),
                    statistics,
                }
            }
            "superseded" => {
                assert_fields(&message, &["generation"]);
                assert_eq!(
                    self.stage_of(generation()),
                    None,
                    "generation {} ended before",
                    generation()
                );
                self.pending = None;
                self.stage = Stage::Ended;
                Frame::Superseded {
                    generation: generation(),
                }
            }
            "error" => {
                assert_fields(&message, &["code", "message", "open"]);
                let open = message["open"].as_bool().expect("open is true or false");
                Frame::Error {
                    code: text("code"),
                    message: text("message"),
                    open,
                }
            }
            other => panic!("a message of type {other:?}, which the page does not know"),
        }
    }

    /// Takes a generation up if it is newer; `Some` if it has ended already.
    fn stage_of(&mut self, generation: u32) -> Option<Stage> {
        assert!(generation > 0, "generations count from 1");
        assert!(
            generation >= self.generation,
            "generation {generation} after a frame of {}",
            self.generation
        );
        if generation > self.generation {
            assert_eq!(
                self.stage,
                Stage::Ended,
                "generation {generation} begins before {} ended",
                self.generation
            );
            self.generation = generation;
            self.stage = Stage::Running { committed: None };
        }
        (self.stage == Stage::Ended).then_some(self.stage)
    }

    fn on_prefix(&mut self, generation: u32, level: u8, regions: usize, standing: usize) {
        assert_eq!(
            self.stage_of(generation),
            None,
            "a prefix of generation {generation}, which has ended"
        );
        assert!(self.pending.is_none(), "a prefix inside a prefix");
        if let Stage::Running {
            committed: Some(before),
        } = self.stage
        {
            assert!(
                level < before,
                "prefix {level} after prefix {before}: coarse ones come first"
            );
        }
        assert!(level <= 5, "prefix {level}, levels are 0 to 5");
        self.pending = Some(Pending {
            level,
            regions,
            standing,
            chunks: HashMap::new(),
        });
    }

    fn chunk(&mut self, bytes: &[u8]) -> Frame {
        let chunk = Chunk::decode(bytes).unwrap_or_else(|why| panic!("chunk: {why}"));
        let pending = self.pending.as_mut().expect("a chunk comes inside a prefix");
        assert_eq!(chunk.generation, self.generation, "generation of a chunk");
        assert_eq!(chunk.prefix_level, pending.level, "prefix of a chunk");
        super::mesh::assert_bounds(&chunk);
        let frame = Frame::Chunk {
            generation: chunk.generation,
            level: chunk.prefix_level,
            region: chunk.region,
            bytes: chunk.frame_bytes,
            triangles: chunk.triangles.len(),
        };
        let region = chunk.region;
        if let Some(before) = self.shown.get(&region) {
            assert!(
                !before.same_mesh(&chunk) || before.error_bits != chunk.error_bits,
                "region {region:?} was sent again, unchanged"
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

    fn on_committed(&mut self, generation: u32, level: u8) {
        let pending = self.pending.take().expect("`committed` ends a prefix");
        assert_eq!(
            (generation, level),
            (self.generation, pending.level),
            "generation and level of `committed`"
        );
        assert_eq!(
            pending.chunks.len(),
            pending.regions,
            "chunks of the prefix and its `regions`"
        );
        let standing = self
            .shown
            .keys()
            .filter(|&region| !pending.chunks.contains_key(region))
            .count();
        assert_eq!(
            standing, pending.standing,
            "regions that stay and the prefix's `standing`"
        );
        for (region, chunk) in pending.chunks {
            if chunk.vertices.is_empty() {
                self.shown.remove(&region);
            } else {
                self.shown.insert(region, chunk);
            }
        }
        self.stage = Stage::Running { committed: Some(level) };
    }
}

/// A message has the fields of the page, no more and no fewer.
#[track_caller]
fn assert_fields(message: &Value, fields: &[&str]) {
    let object = message.as_object().expect("a message is an object");
    let mut found: Vec<&str> = object.keys().map(String::as_str).filter(|&key| key != "type").collect();
    let mut expected = fields.to_vec();
    found.sort_unstable();
    expected.sort_unstable();
    assert_eq!(found, expected, "fields of {}", message["type"]);
}
