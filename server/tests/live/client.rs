//! A server on a real device, and a client that is written by `PROTOCOL.md` alone.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use isopeel::access::Access;
use isopeel::serve::{Config, run};
use isopeel::service::DeviceWorker;
use isopeel::stream::{Deadlines, LiveOptions, StepTimes};
use isopeel_codec::chunk::{ChunkKind, DecodedChunk, LATTICE};
use isopeel_codec::decode::decode;
use isopeel_reference::edges;
use isopeel_volumes::Catalog;
use serde_json::Value;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Mutex, MutexGuard};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};
use tokio_util::sync::CancellationToken;

/// One server at a time: PoCL 3.1 fails with two engines in one process.
static ALONE: Mutex<()> = Mutex::const_new(());

/// The smallest steps: surfaces come in many.
pub const SMALL_STEPS: StepTimes = StepTimes {
    fresh: Duration::ZERO,
    first: Duration::ZERO,
    next: Duration::ZERO,
    line: Duration::from_millis(400),
};

/// A new surface comes in two steps, a changed one in one.
pub const LARGE_STEPS: StepTimes = StepTimes {
    fresh: Duration::from_millis(10),
    first: Duration::MAX,
    next: Duration::MAX,
    line: Duration::MAX,
};

/// A whole server on a free port.
pub struct Server {
    _alone: MutexGuard<'static, ()>,
    address: SocketAddr,
    shutdown: CancellationToken,
    task: JoinHandle<Result<(), isopeel::serve::ServeError>>,
}

impl Server {
    /// `steps` decides in how many steps a surface comes, however fast the machine is.
    pub async fn start(paths: &[PathBuf], demo: bool, steps: StepTimes) -> Self {
        let alone = ALONE.lock().await;
        let catalog = Catalog::open(paths, demo).expect("readable volumes").into();
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let worker = DeviceWorker::start(None).expect("a thread");
        let config = Config {
            live: LiveOptions {
                ahead_bytes: 1 << 30,
                shared_bytes: 1 << 28,
                watches: false,
            },
            deadlines: Deadlines {
                steps,
                ..Deadlines::default()
            },
            ..Config::new(catalog, worker, Access::new(address, &[], &[]))
        };
        let shutdown = CancellationToken::new();
        let task = tokio::spawn(run(listener, config, shutdown.clone().cancelled_owned()));
        Self {
            _alone: alone,
            address,
            shutdown,
            task,
        }
    }

    pub async fn viewer(&self, volume: &str) -> Viewer {
        let url = format!("ws://{}/api/v1/stream", self.address);
        let mut request = url.into_client_request().expect("a request");
        let headers = request.headers_mut();
        headers.insert("sec-websocket-protocol", "isopeel.v2".parse().expect("a header"));
        let (socket, _) = connect_async_with_config(request, None, true).await.expect("connects");
        let mut viewer = Viewer {
            socket,
            held: BTreeMap::new(),
            closed: false,
            opened: Value::Null,
        };
        viewer.open(volume, 0).await;
        viewer
    }

    pub async fn stop(self) {
        self.shutdown.cancel();
        self.task.await.expect("no panic").expect("a clean end");
    }
}

/// A client that keeps the map of regions of `PROTOCOL.md`, section 3.
pub struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    pub held: BTreeMap<[u32; 3], Mesh>,
    /// Whether every surface must be closed, checked at each `committed`.
    pub closed: bool,
    /// The view of `opened`.
    pub opened: Value,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    level_triangles: [u32; 6],
    vertices: Vec<[i64; 3]>,
    attributes: Vec<(i8, i8, u16, u16)>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// With positions on the lattice of the whole volume.
    pub fn new(chunk: &DecodedChunk) -> Self {
        let corner = chunk.header.region.map(|c| i64::from(c) * 32 * i64::from(LATTICE));
        let place = |p: [i16; 3]| [0, 1, 2].map(|axis| corner[axis] + i64::from(p[axis]));
        Self {
            level_triangles: chunk.header.level_triangles,
            vertices: chunk.vertices.iter().map(|v| place(v.position)).collect(),
            attributes: chunk
                .vertices
                .iter()
                .map(|v| (v.normal[0], v.normal[1], v.smoothness, v.feature))
                .collect(),
            triangles: chunk.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        }
    }
}

/// Changes of the map by a prefix; `None` removes a region.
pub type Change = HashMap<[u32; 3], Option<Mesh>>;

/// A received prefix.
#[derive(Debug)]
pub struct Prefix {
    pub level: u64,
    pub unchanged: usize,
    pub chunks: usize,
    pub bytes: usize,
}

impl Viewer {
    /// Opens a step of a volume. If that takes long, messages before `opened` say how much was read.
    pub async fn open(&mut self, volume: &str, step: u32) {
        self.say(&format!(r#"{{"type":"open","volume":"{volume}","step":{step}}}"#))
            .await;
        self.held.clear();
        let mut read_bytes = 0;
        let opened = loop {
            let message = self.text().await;
            if message["type"] != "opening" {
                break message;
            }
            let (bytes, total) = (message["bytes"].as_u64(), message["totalBytes"].as_u64());
            assert!(
                bytes >= Some(read_bytes) && bytes <= total,
                "{message} after {read_bytes}"
            );
            read_bytes = bytes.expect("a number");
        };
        assert_eq!(opened["type"], "opened", "{opened}");
        assert_eq!(opened["volume"]["id"], volume);
        self.opened = opened["edit"].clone();
    }

    pub async fn say(&mut self, text: &str) {
        self.socket.send(Message::text(text)).await.expect("sent");
    }

    pub async fn message(&mut self) -> Message {
        let message = timeout(Duration::from_secs(120), self.socket.next()).await;
        message
            .expect("no frame within 120 s")
            .expect("the stream ended")
            .expect("no error")
    }

    pub async fn text(&mut self) -> Value {
        loop {
            match self.message().await {
                Message::Text(text) => return serde_json::from_str(&text).expect("JSON"),
                Message::Ping(_) => {}
                other => panic!("expected text, found {other:?}"),
            }
        }
    }

    /// Receives everything up to `done`: the prefixes and the statistics. Generations before may be superseded.
    pub async fn until_done(&mut self) -> (Vec<Prefix>, Value) {
        let mut prefixes: Vec<Prefix> = Vec::new();
        let mut newest = 0;
        let mut pending: Option<(Value, Change)> = None;
        loop {
            let text = match self.message().await {
                Message::Binary(frame) => {
                    let chunk = decode(&frame).expect("a valid chunk");
                    let (prefix, meshes) = pending.as_mut().expect("chunks follow a prefix");
                    let of = chunk.header.prefix;
                    assert_eq!(u64::from(of.generation), prefix["generation"]);
                    assert_eq!(u64::from(of.level), prefix["level"]);
                    assert_eq!(u64::from(of.surface), prefix["surface"]);
                    assert_eq!((of.kind, &prefix["kind"]), (ChunkKind::Cut, &"cut".into()));
                    let mesh = (!chunk.vertices.is_empty()).then(|| Mesh::new(&chunk));
                    assert!(
                        meshes.insert(chunk.header.region, mesh).is_none(),
                        "a region comes once"
                    );
                    let last = prefixes.last_mut().expect("a prefix");
                    last.chunks += 1;
                    last.bytes += frame.len();
                    continue;
                }
                Message::Text(text) => serde_json::from_str::<Value>(&text).expect("JSON"),
                Message::Ping(_) => continue,
                other => panic!("unexpected {other:?}"),
            };
            let generation = text["generation"].as_u64().unwrap_or_else(|| panic!("{text}"));
            assert!(generation >= newest, "generation {generation} after {newest}");
            newest = generation;
            match text["type"].as_str().expect("a type") {
                "prefix" => {
                    assert!(pending.is_none(), "a prefix inside another");
                    prefixes.push(Prefix {
                        level: text["level"].as_u64().expect("a level"),
                        unchanged: text["unchanged"].as_u64().expect("a number") as usize,
                        chunks: 0,
                        bytes: 0,
                    });
                    pending = Some((text, HashMap::new()));
                }
                "committed" => {
                    let (prefix, meshes) = pending.take().expect("a prefix");
                    for name in ["level", "final"] {
                        assert_eq!(prefix[name], text[name], "{name}");
                    }
                    assert_eq!(prefix["regions"], meshes.len());
                    let unchanged = self.held.keys().filter(|c| !meshes.contains_key(*c)).count();
                    assert_eq!(prefix["unchanged"], unchanged);
                    for (coords, mesh) in meshes {
                        match mesh {
                            Some(mesh) => drop(self.held.insert(coords, mesh)),
                            None => assert!(self.held.remove(&coords).is_some(), "only what was there is removed"),
                        }
                    }
                    assert_eq!(prefix["triangles"], self.triangles(), "{prefix}");
                    if self.closed {
                        assert_eq!(self.open_edges(), 0, "after {text}");
                    }
                }
                "superseded" => {
                    if pending.take().is_some() {
                        prefixes.pop();
                    }
                }
                "measured" => assert!(text["error"]["rms"].as_f64() >= Some(0.0), "{text}"),
                "done" => return (prefixes, text["statistics"].clone()),
                other => panic!("unexpected {other}: {text}"),
            }
        }
    }

    /// Returns the number of edges at which the surface is open; vertices with equal positions are one.
    pub fn open_edges(&self) -> usize {
        let mut edges = Vec::new();
        for mesh in self.held.values() {
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
                edges.extend([[a, b], [b, c], [c, a]]);
            }
        }
        edges::open(edges).len()
    }

    /// The number of triangles held.
    pub fn triangles(&self) -> usize {
        self.held.values().map(|mesh| mesh.triangles.len()).sum()
    }
}
