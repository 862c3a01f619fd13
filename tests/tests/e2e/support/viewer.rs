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
pub use super::frame::{Frame, Prefix};

/// The longest any one frame may take: a cold start of a small machine's processor, and others beside it.
const PATIENCE: Duration = Duration::from_secs(120);

/// A prefix between `prefix` and `committed`.
struct Pending {
    announced: Prefix,
    chunks: HashMap<[u32; 3], Chunk>,
}

/// Where the newest generation stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// Prefixes come; the last committed one, and whether it was final.
    Running { committed: Option<(u8, bool)> },
    /// After `done`; whether a better surface came, and `measured`.
    Done { improved: bool, measured: bool },
    /// A better surface comes after `done`; whether it is committed.
    Improving { committed: bool },
    /// After `superseded`, or before the first generation.
    Ended,
}

pub struct Viewer {
    socket: WebSocketStream<TcpStream>,
    /// Every frame so far.
    pub log: Vec<Frame>,
    /// What a viewer shows: the last committed mesh of every region that has one.
    pub shown: HashMap<[u32; 3], Chunk>,
    pending: Option<Pending>,
    /// Bytes that the last `opening` stated since `open` was sent.
    read_bytes: u64,
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
        let socket = connect(address, Some("isopeel.v2"))
            .await
            .expect("the handshake is accepted");
        Self {
            socket,
            log: Vec::new(),
            shown: HashMap::new(),
            pending: None,
            read_bytes: 0,
            generation: 0,
            stage: Stage::Ended,
        }
    }

    /// Connects and opens a volume.
    pub async fn open(address: SocketAddr, volume: &str) -> Self {
        let mut viewer = Self::connect(address).await;
        viewer.send(json!({"type": "open", "volume": volume})).await;
        viewer.until_opened().await;
        viewer
    }

    /// Reads up to `opened`; what it holds.
    pub async fn until_opened(&mut self) -> Frame {
        self.read_bytes = 0;
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
        let before = self.generation;
        self.send(edit).await;
        loop {
            let statistics = self.until_done().await;
            // A better surface of the generation before may be on its way.
            if self.generation > before {
                return statistics;
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

    /// Sends an edit and reads until all came that comes while the viewer rests: the statistics of each `done`.
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

    /// Sends an edit that fails: code and suggested budget.
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
                self.shown.clear();
                self.pending = None;
            }
            &Frame::Prefix(announced) => self.on_prefix(announced),
            &Frame::Committed {
                generation,
                level,
                is_final,
            } => self.on_committed(generation, level, is_final),
            Frame::Done { generation, statistics } => {
                assert_eq!(*generation, self.generation, "`done` of the newest generation");
                let improved = match self.stage {
                    Stage::Running {
                        committed: Some((_, true)),
                    } => false,
                    Stage::Improving { committed: true } => true,
                    other => panic!("`done` follows the final prefix, found {other:?}"),
                };
                assert!(self.pending.is_none(), "`done` inside a prefix");
                assert!(
                    !improved || statistics["isTreeCut"] == true,
                    "a better surface is a tree cut"
                );
                self.stage = Stage::Done {
                    improved,
                    measured: false,
                };
                let triangles = self.triangles();
                assert_eq!(
                    statistics["triangles"], triangles,
                    "triangles of the map and of the statistics"
                );
            }
            Frame::Measured {
                generation, regions, ..
            } => {
                assert_eq!(*generation, self.generation, "`measured` of the newest generation");
                let Stage::Done {
                    improved,
                    measured: false,
                } = self.stage
                else {
                    panic!("`measured` once, after `done`, found {:?}", self.stage)
                };
                self.stage = Stage::Done {
                    improved,
                    measured: true,
                };
                for (region, _) in regions {
                    assert!(
                        self.shown.contains_key(region),
                        "region {region:?} was measured, but is not there"
                    );
                }
            }
            &Frame::Superseded { generation } => {
                let is_done = generation == self.generation && matches!(self.stage, Stage::Done { .. });
                assert!(
                    !is_done && self.takes_up(generation),
                    "generation {generation} ended before"
                );
                self.pending = None;
                self.stage = Stage::Ended;
            }
            Frame::Error { .. } | Frame::Chunk { .. } | Frame::Closed { .. } => {}
        }
        frame
    }

    /// Triangles of the map.
    fn triangles(&self) -> usize {
        self.shown.values().map(|chunk| chunk.triangles.len()).sum()
    }

    /// Takes a generation up if it is newer; false if it has ended already.
    fn takes_up(&mut self, generation: u32) -> bool {
        assert!(generation > 0, "generations count from 1");
        assert!(
            generation >= self.generation,
            "generation {generation} after a frame of {}",
            self.generation
        );
        if generation > self.generation {
            assert!(
                !matches!(self.stage, Stage::Running { .. } | Stage::Improving { .. }),
                "generation {generation} begins before {} ended",
                self.generation
            );
            self.generation = generation;
            self.stage = Stage::Running { committed: None };
        }
        if let Stage::Done {
            improved: false,
            measured: false,
        } = self.stage
        {
            self.stage = Stage::Improving { committed: false };
        }
        matches!(
            self.stage,
            Stage::Running { .. } | Stage::Improving { committed: false }
        )
    }

    fn on_prefix(&mut self, announced: Prefix) {
        let Prefix { generation, level, .. } = announced;
        assert!(
            self.takes_up(generation),
            "a prefix of generation {generation}, which has ended"
        );
        assert!(self.pending.is_none(), "a prefix inside a prefix");
        assert!(
            announced.is_final || !matches!(self.stage, Stage::Improving { .. }),
            "a better surface is final: {announced:?}"
        );
        if let Stage::Running {
            committed: Some((before, was_final)),
        } = self.stage
        {
            assert!(!was_final, "prefix {level} after the final surface");
            assert!(
                level <= before,
                "prefix {level} after prefix {before}: levels do not rise"
            );
        }
        self.pending = Some(Pending {
            announced,
            chunks: HashMap::new(),
        });
    }

    fn chunk(&mut self, bytes: &[u8]) -> Frame {
        let chunk = Chunk::decode(bytes).unwrap_or_else(|why| panic!("chunk: {why}"));
        let pending = self.pending.as_mut().expect("a chunk comes inside a prefix");
        assert_eq!(chunk.generation, self.generation, "generation of a chunk");
        assert_eq!(chunk.prefix_level, pending.announced.level, "prefix of a chunk");
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
                !before.same_mesh(&chunk),
                "region {region:?} was sent again, unchanged, in {:?}",
                pending.announced
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

    fn on_committed(&mut self, generation: u32, level: u8, is_final: bool) {
        let Pending { announced, chunks } = self.pending.take().expect("`committed` ends a prefix");
        assert_eq!(
            (generation, level, is_final),
            (self.generation, announced.level, announced.is_final),
            "generation, level and `final` of `committed`"
        );
        assert_eq!(
            chunks.len(),
            announced.regions,
            "chunks of the prefix and its `regions`"
        );
        let is_unchanged = |region: &&[u32; 3]| !chunks.contains_key(*region);
        assert_eq!(
            self.shown.keys().filter(is_unchanged).count(),
            announced.unchanged,
            "regions that stay and the prefix's `unchanged`"
        );
        for (region, chunk) in chunks {
            if chunk.vertices.is_empty() {
                self.shown.remove(&region);
            } else {
                self.shown.insert(region, chunk);
            }
        }
        assert_eq!(
            self.triangles(),
            announced.triangles,
            "triangles of the map and of the prefix"
        );
        self.stage = match self.stage {
            Stage::Improving { .. } => Stage::Improving { committed: true },
            _ => Stage::Running {
                committed: Some((level, is_final)),
            },
        };
    }
}
