//! The whole server on a real device, with a client that is written by `PROTOCOL.md` alone.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use isopeel::access::Access;
use isopeel::extraction::DeviceWorker;
use isopeel::serve::{Config, ConnectionLimits, run};
use isopeel::stream::{Deadlines, LiveOptions, StepTimes};
use isopeel::volumes::Catalog;
use isopeel::wire::chunk::{ChunkKind, DecodedChunk, LATTICE, decode};
use serde_json::Value;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Mutex, MutexGuard};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};
use tokio_util::sync::CancellationToken;

/// One server at a time: PoCL 3.1 fails with two engines in one process.
static ALONE: Mutex<()> = Mutex::const_new(());

/// The smallest steps: surfaces come in many.
const SMALL_STEPS: StepTimes = StepTimes {
    fresh: Duration::ZERO,
    first: Duration::ZERO,
    next: Duration::ZERO,
    line: Duration::from_millis(400),
};

/// A new surface comes in two steps, a changed one in one.
const LARGE_STEPS: StepTimes = StepTimes {
    fresh: Duration::from_millis(10),
    first: Duration::MAX,
    next: Duration::MAX,
    line: Duration::MAX,
};

/// A whole server on a free port.
struct Server {
    _alone: MutexGuard<'static, ()>,
    address: SocketAddr,
    shutdown: CancellationToken,
    task: JoinHandle<Result<(), isopeel::serve::ServeError>>,
}

impl Server {
    /// `steps` decides in how many steps a surface comes, however fast the machine is.
    async fn start(paths: &[PathBuf], demo: bool, steps: StepTimes) -> Self {
        let alone = ALONE.lock().await;
        let catalog = Catalog::open(paths, demo).expect("readable volumes").into();
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let config = Config {
            catalog,
            live: LiveOptions {
                ahead_bytes: 1 << 30,
                shared_bytes: 1 << 28,
                watches: false,
            },
            worker: DeviceWorker::start(None).expect("a thread"),
            ceiling_triangles: u64::MAX,
            deadlines: Deadlines {
                steps,
                ..Deadlines::default()
            },
            access: Access::new(address, None, &[]),
            tls: None,
            metrics: None,
            connections: ConnectionLimits::default(),
            jobs: None,
            uploads: None,
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

    async fn viewer(&self, volume: &str) -> Viewer {
        let url = format!("ws://{}/api/v1/stream", self.address);
        let mut request = url.into_client_request().expect("a request");
        let headers = request.headers_mut();
        headers.insert("sec-websocket-protocol", "isopeel.v2".parse().expect("a header"));
        let (socket, _) = connect_async(request).await.expect("connects");
        let mut viewer = Viewer {
            socket,
            held: BTreeMap::new(),
            closed: false,
            opened: Value::Null,
        };
        viewer.say(&format!(r#"{{"type":"open","volume":"{volume}"}}"#)).await;
        let mut read_bytes = 0;
        let opened = loop {
            let message = viewer.text().await;
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
        viewer.opened = opened["edit"].clone();
        viewer
    }

    async fn stop(self) {
        self.shutdown.cancel();
        self.task.await.expect("no panic").expect("a clean end");
    }
}

/// A client that keeps the map of regions of `PROTOCOL.md`, section 3.
struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    held: BTreeMap<[u32; 3], Mesh>,
    /// Whether every surface must be closed, checked at each `committed`.
    closed: bool,
    /// The view of `opened`.
    opened: Value,
}

#[derive(Clone, Debug, PartialEq)]
struct Mesh {
    level_triangles: [u32; 6],
    vertices: Vec<[i64; 3]>,
    attributes: Vec<(i8, i8, u16, u16)>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// With positions on the lattice of the whole volume.
    fn new(chunk: &DecodedChunk) -> Self {
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
type Change = HashMap<[u32; 3], Option<Mesh>>;

/// A received prefix.
#[derive(Debug)]
struct Prefix {
    level: u64,
    unchanged: usize,
    chunks: usize,
    bytes: usize,
}

impl Viewer {
    async fn say(&mut self, text: &str) {
        self.socket.send(Message::text(text)).await.expect("sent");
    }

    async fn message(&mut self) -> Message {
        let message = timeout(Duration::from_secs(120), self.socket.next()).await;
        message
            .expect("no frame within 120 s")
            .expect("the stream ended")
            .expect("no error")
    }

    async fn text(&mut self) -> Value {
        loop {
            match self.message().await {
                Message::Text(text) => return serde_json::from_str(&text).expect("JSON"),
                Message::Ping(_) => {}
                other => panic!("expected text, found {other:?}"),
            }
        }
    }

    /// Receives everything up to `done`: the prefixes and the statistics. Generations before may be superseded.
    async fn until_done(&mut self) -> (Vec<Prefix>, Value) {
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
                        assert_eq!(self.odd_edges(), 0, "after {text}");
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

    /// Number of edges with an odd number of triangles; vertices with equal positions are one.
    fn odd_edges(&self) -> usize {
        let mut odd = HashSet::new();
        for mesh in self.held.values() {
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
                if a == b || b == c || c == a {
                    continue;
                }
                for (a, b) in [(a, b), (b, c), (c, a)] {
                    let edge = (a.min(b), a.max(b));
                    if !odd.insert(edge) {
                        odd.remove(&edge);
                    }
                }
            }
        }
        odd.len()
    }

    /// The number of triangles held.
    fn triangles(&self) -> usize {
        self.held.values().map(|mesh| mesh.triangles.len()).sum()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_comes_coarse_first_and_whole() {
    let server = Server::start(&[], true, LARGE_STEPS).await;
    let mut viewer = server.viewer("mni152").await;
    viewer.say(r#"{"type":"edit","beta":0.4}"#).await;
    let (prefixes, statistics) = viewer.until_done().await;
    let (first, last) = (&prefixes[0], &prefixes[prefixes.len() - 1]);
    assert!(prefixes.len() >= 2 && last.level == 0);
    assert!(prefixes.is_sorted_by(|a, b| a.level > b.level));
    assert!(
        first.bytes * 20 < last.bytes,
        "first prefix {} bytes, last {} bytes",
        first.bytes,
        last.bytes
    );
    assert_eq!(viewer.triangles() as u64, statistics["triangles"]);

    // An edit of the cut sends what changed; the result equals what a new client gets.
    let before = viewer.held.clone();
    let edit = r#"{"type":"edit","beta":0.4002}"#;
    viewer.say(edit).await;
    let (prefixes, statistics) = viewer.until_done().await;
    assert_eq!(viewer.triangles() as u64, statistics["triangles"]);
    let [prefix] = prefixes.as_slice() else {
        panic!("straight to the final surface, found {prefixes:?}");
    };
    let is_unchanged = |(coords, mesh): &(&[u32; 3], &Mesh)| before.get(*coords) == Some(*mesh);
    let unchanged = viewer.held.iter().filter(is_unchanged).count();
    let removed = before
        .keys()
        .filter(|coords| !viewer.held.contains_key(*coords))
        .count();
    assert!(
        unchanged > 0 && unchanged < viewer.held.len(),
        "{unchanged} of {} are unchanged",
        viewer.held.len()
    );
    assert_eq!(prefix.unchanged, unchanged);
    assert_eq!(
        prefix.chunks,
        viewer.held.len() - unchanged + removed,
        "only what changed is sent"
    );
    let mut fresh = server.viewer("mni152").await;
    fresh.say(edit).await;
    fresh.until_done().await;
    assert!(fresh.held == viewer.held, "two clients of one view hold the same");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_storm_of_edits_ends_at_the_last_and_starves_nobody() {
    let server = Server::start(&[], true, StepTimes::default()).await;
    let mut storm = server.viewer("mni152").await;
    let mut calm = server.viewer("mni152").await;
    calm.say(r#"{"type":"edit"}"#).await;
    for i in 0..40 {
        storm.say(&format!(r#"{{"type":"edit","iso":{}}}"#, 60 + i)).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    storm.say(r#"{"type":"edit","iso":45,"beta":0.1}"#).await;
    let ((_, calm_statistics), ()) = tokio::join!(calm.until_done(), async {
        // Edits before the last may reach `done`.
        while storm.until_done().await.1["beta"].as_f64() != Some(0.1) {}
    });
    assert_eq!(calm.triangles() as u64, calm_statistics["triangles"]);
    let mut fresh = server.viewer("mni152").await;
    fresh.say(r#"{"type":"edit","iso":45,"beta":0.1}"#).await;
    fresh.until_done().await;
    assert!(fresh.held == storm.held, "the storm ends at its last edit");
    server.stop().await;
}

/// A noisy volume of two steps, below every isovalue on its border, so that all surfaces are closed.
fn closed_volume(path: &std::path::Path) {
    const DIMS: [usize; 3] = [75, 66, 70];
    let [nx, ny, nz] = DIMS;
    let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': (2, {nz}, {ny}, {nx}), }}");
    let length = (header.len() + 11).next_multiple_of(64) - 10;
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((length as u16).to_le_bytes());
    file.extend(format!("{header:<width$}\n", width = length - 1).bytes());
    let mut state = 1u32;
    for step in 0..2 {
        for i in 0..nx * ny * nz {
            let p = [i % nx, i / nx % ny, i / nx / ny];
            let inside = (0..3).all(|axis| p[axis] > 0 && p[axis] + 1 < DIMS[axis]);
            let [x, y, z] = p.map(|v| v as f32 * 0.17 + step as f32 * 0.3);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (state >> 24) as f32 / 16.0;
            let value = 120.0 + 60.0 * (x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()) + noise;
            file.push(if inside { value.clamp(1.0, 255.0) as u8 } else { 0 });
        }
    }
    std::fs::write(path, file).expect("written");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_commit_of_a_session_is_a_closed_surface() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("closed.npy");
    closed_volume(&path);
    let server = Server::start(&[path], false, SMALL_STEPS).await;
    let mut viewer = server.viewer("closed").await;
    viewer.closed = true;
    let mut commits = 0;
    for step in [0, 1] {
        if step > 0 {
            viewer
                .say(&format!(r#"{{"type":"open","volume":"closed","step":{step}}}"#))
                .await;
            viewer.held.clear();
            assert_eq!(viewer.text().await["type"], "opened");
        }
        for edit in [
            r#""iso":120"#,
            r#""beta":0.02,"maxError":null,"topology":"free""#,
            r#""beta":0.3"#,
            r#""beta":0.3,"topology":"preserve""#,
            r#""beta":1,"maxLevel":3"#,
            r#""beta":-1"#,
            r#""iso":150,"feature":"gradient-magnitude","alpha":0.7,"maxLevel":5"#,
            r#""featureRange":[1,40]"#,
            r##""transferFunction":{"points":[{"x":0.2,"importance":1,"color":"#000000"},{"x":0.4,"importance":0,"color":"#ffffff"}]}"##,
            r#""triangles":20000,"maxError":"auto","topology":"auto""#,
            r#""bytes":150000"#,
            r#""error":"0.2vx","triangles":9000"#,
            r#""field":"2 * closed","iso":180"#,
            r#""field":"closed","iso":90,"feature":"sqrt(abs(closed))""#,
            r#""beta":0.05,"maxError":"0.1vx""#,
        ] {
            viewer.say(&format!(r#"{{"type":"edit",{edit}}}"#)).await;
            let (prefixes, statistics) = viewer.until_done().await;
            commits += prefixes.len();
            assert_eq!(viewer.triangles() as u64, statistics["triangles"], "{edit}");
        }
        // `cancel` and superseded edits keep what was committed.
        for iso in [80, 100, 130, 160] {
            viewer.say(&format!(r#"{{"type":"edit","iso":{iso}}}"#)).await;
            tokio::time::sleep(Duration::from_millis(iso)).await;
            viewer.say(r#"{"type":"cancel"}"#).await;
            viewer.say(&format!(r#"{{"type":"edit","beta":0.{iso}}}"#)).await;
        }
        // An edit before the last may reach `done`.
        while timeout(Duration::from_secs(3), viewer.until_done()).await.is_ok() {
            commits += 1;
        }
        assert_eq!(viewer.odd_edges(), 0);
    }
    assert!(commits > 30, "{commits}");
    server.stop().await;
}

/// Samples along each axis of [`write_steps`].
const SIDE: usize = 96;

/// Writes three time steps that differ in one corner alone: some waves, higher there in the second one.
fn write_steps(folder: &std::path::Path) {
    for step in 0..3 {
        let wave = |i: usize| (i as f32 * 0.3).sin();
        let sample = |at: usize| {
            let [x, y, z] = [at % SIDE, at / SIDE % SIDE, at / SIDE / SIDE];
            let is_corner = step == 1 && x.max(y).max(z) < 20;
            wave(x) + wave(y) + wave(z) + if is_corner { 0.5 } else { 0.0 }
        };
        let samples = (0..SIDE.pow(3)).flat_map(|at| sample(at).to_le_bytes());
        let header = format!(
            "NRRD0004\ntype: float\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nendian: little\nencoding: raw\n\n"
        );
        let bytes: Vec<u8> = header.into_bytes().into_iter().chain(samples).collect();
        std::fs::write(folder.join(format!("waves_{step:02}.nrrd")), bytes).expect("a file");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_time_step_sends_only_the_regions_that_differ() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("waves");
    std::fs::create_dir(&path).expect("a folder");
    write_steps(&path);
    let server = Server::start(&[path], false, LARGE_STEPS).await;
    let mut viewer = server.viewer("waves").await;
    // Values of the feature are in every vertex: their range stays, though that of the second step is another one.
    viewer
        .say(r#"{"type":"edit","iso":0.2,"beta":0.02,"feature":"gradient-magnitude","alpha":0.2}"#)
        .await;
    viewer.until_done().await;
    let first = viewer.held.clone();
    assert_eq!(first.len(), 27);
    for step in [1, 2] {
        viewer.say(&format!(r#"{{"type":"step","step":{step}}}"#)).await;
        let stepped = loop {
            let message = viewer.text().await;
            if message["type"] != "measured" {
                break message;
            }
        };
        assert_eq!(
            (&stepped["type"], &stepped["step"], &stepped["label"]),
            (&"stepped".into(), &step.into(), &format!("step {step:02}").into())
        );
        let (prefixes, _) = viewer.until_done().await;
        let [prefix] = prefixes.as_slice() else {
            panic!("in one commit, found {prefixes:?}");
        };
        // The corner's region, and neighbours whose polygons meet its.
        assert!((1..=4).contains(&prefix.chunks), "{prefix:?}");
        assert_eq!(prefix.unchanged, 27 - prefix.chunks);
        assert_eq!(viewer.held == first, step == 2, "the third step is the first one again");
    }
    server.stop().await;
}
