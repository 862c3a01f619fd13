//! The stream over real sockets, with a device that answers at once: handshake, close codes, deadlines and shutdown. The order of a
//! session's messages is tested beside the session.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use isopeel::access::{Access, Identity, NewToken, Role, Token, TokenFile, TokenWatch};
use isopeel::service::OpeningProgress;
use isopeel::stream::{Backend, Deadlines, MAX_VIEWERS, Opening, StreamState, router};
use isopeel_client::{Chunk, Connection, Error, Message, RawFrame, request};
use isopeel_extraction::{
    Answer, CutId, FullCount, Measurement, Question, Refinement, Shown, ShownSurface, Step, WorkError,
};
use isopeel_kernels::{Level, Region, Surface, SurfaceStatistics, Vertex};
use isopeel_view::View;
use isopeel_volumes::testing::dataset;
use isopeel_volumes::{Dataset, VolumeStep};
use serde_json::Value;
use serde_json::value::RawValue;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// Answers every extraction at once with the same surface: `regions` regions of vertices that do not compress.
#[derive(Clone)]
struct NoiseDevice {
    dataset: Arc<Dataset>,
    regions: u32,
}

/// Triangles of a region: 360 kB of vertices, some 260 kB as a chunk.
const TRIANGLES: u32 = 10_000;

/// 63 MB: more than the buffers of loopback take, 32 MiB on the receiver's side and 4 on the sender's.
const MANY_REGIONS: u32 = 240;

impl NoiseDevice {
    fn new(regions: u32) -> Self {
        Self {
            dataset: Arc::new(dataset("noise", [33; 3], &["noise"])),
            regions,
        }
    }

    fn region(x: u32, iso: f32) -> Region {
        // A linear congruential generator.
        let mut state = u64::from(x) << 32 | u64::from(iso.to_bits());
        let mut random = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32
        };
        let mut vertex = |_| Vertex {
            position: [0; 3].map(|_| (random() & 0x1f_ffff) as i32),
            normal: [random() as i16, random() as i16],
            smoothness: random() as u16,
            feature: random() as u16,
        };
        Region {
            coords: [x, 0, 0],
            size: 0,
            vertices: (0..3 * TRIANGLES).map(&mut vertex).collect::<Vec<_>>().into(),
            indices: (0..3 * TRIANGLES).collect::<Vec<_>>().into(),
            values: Vec::new().into(),
            level_triangles: [TRIANGLES, 0, 0, 0, 0, 0],
            error: None,
        }
    }
}

impl Backend for NoiseDevice {
    fn find(&self, volume: &str, _: &Identity) -> Option<Arc<Dataset>> {
        (volume == "noise").then(|| Arc::clone(&self.dataset))
    }

    async fn open(
        &self,
        _: &VolumeStep,
        view: &View,
        _: &CancellationToken,
        _: &watch::Sender<OpeningProgress>,
    ) -> Result<Opening, WorkError> {
        let mut view = view.clone();
        view.iso = isopeel_kernels::Isovalue::new(1.0).ok();
        view.feature_range = Some([0.0, 1.0]);
        Ok(Opening {
            volume: serde_json::value::to_raw_value(&self.dataset.id).expect("JSON"),
            view,
            device: "noise".into(),
            shares_processors: true,
        })
    }

    async fn describe(&self, volume: &VolumeStep, _: &CancellationToken) -> Result<Box<RawValue>, WorkError> {
        Ok(serde_json::value::to_raw_value(&volume.step()).expect("JSON"))
    }

    async fn read_ahead(&self, _: &VolumeStep, _: &[View], _: &CancellationToken) {}

    async fn resolve(&self, _: &VolumeStep, view: &View, _: &CancellationToken) -> Result<View, WorkError> {
        Ok(View {
            feature_range: view.feature_range.or(Some([0.0, 1.0])),
            ..view.clone()
        })
    }

    async fn count(&self, _: &VolumeStep, _: &View, _: &CancellationToken) -> Result<FullCount, WorkError> {
        Ok(FullCount::default())
    }

    /// A coarse prefix of one region, then the final surface.
    async fn refine(
        &self,
        _: &VolumeStep,
        view: &View,
        step: Step,
        _: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        let iso = view.iso.map_or(0.0, |iso| iso.get());
        let is_final = step.shown != Shown::Another;
        let count = if is_final { self.regions } else { 1 };
        Ok(Refinement {
            surface: Surface {
                regions: (0..count).map(|x| Self::region(x, iso)).collect(),
                remade: None,
                prefix: Level::new(if is_final { 0 } else { 4 }).expect("a level"),
                statistics: SurfaceStatistics::default(),
            },
            view: view.clone(),
            cut: CutId::new(1),
            target: Some(CutId::new(2)),
            is_final,
            can_improve: false,
            wall: Duration::ZERO,
            meshing: Duration::ZERO,
        })
    }

    async fn improve(&self, _: &VolumeStep, _: &View, _: &CancellationToken) -> Result<Option<Refinement>, WorkError> {
        Ok(None)
    }

    async fn measure(&self, _: &VolumeStep, _: &View, _: &CancellationToken) -> Result<Option<Measurement>, WorkError> {
        Ok(None)
    }

    async fn answer(
        &self,
        _: &VolumeStep,
        _: Option<&ShownSurface>,
        _: Question,
        _: &CancellationToken,
    ) -> Result<Answer, WorkError> {
        Err(WorkError::NothingShown)
    }
}

struct Server {
    address: SocketAddr,
    state: StreamState<NoiseDevice>,
    shutdown: CancellationToken,
}

async fn start(regions: u32, deadlines: Deadlines) -> Server {
    start_for(Identity::without_token(), regions, deadlines).await
}

async fn start_for(who: Identity, regions: u32, deadlines: Deadlines) -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    let shutdown = CancellationToken::new();
    let state = StreamState::new(NoiseDevice::new(regions), deadlines, shutdown.clone());
    let app = router(state.clone()).layer(Extension(who));
    tokio::spawn(async move { axum::serve(listener, app).await });
    Server {
        address,
        state,
        shutdown,
    }
}

impl Server {
    async fn connect(&self) -> Connection {
        Connection::connect(self.address).await.expect("connects")
    }

    /// Waits until no viewer is connected.
    async fn until_empty(&self) {
        let closed = timeout(Duration::from_secs(60), self.state.closed()).await;
        closed.expect("everybody has left");
    }
}

async fn say(viewer: &mut Connection, text: impl Into<String>) {
    viewer.send_raw(Message::text(text.into())).await.expect("sent");
}

async fn try_next(viewer: &mut Connection) -> Result<RawFrame, Error> {
    let frame = timeout(Duration::from_secs(30), viewer.next()).await;
    frame.expect("no frame within 30 s")
}

async fn next(viewer: &mut Connection) -> RawFrame {
    try_next(viewer).await.expect("no error")
}

/// Reads until the close frame: the frames before it, and its code.
async fn until_close(viewer: &mut Connection) -> (Vec<RawFrame>, u16) {
    let mut before = Vec::new();
    loop {
        match try_next(viewer).await {
            Err(Error::Closed(code)) => return (before, code.expect("a code")),
            frame => before.push(frame.expect("no error")),
        }
    }
}

/// Reads up to the first `committed`.
async fn until_committed(viewer: &mut Connection) {
    let committed = timeout(Duration::from_secs(30), viewer.until("committed")).await;
    committed.expect("in time").expect("no error");
}

fn json(frame: &RawFrame) -> Value {
    match frame {
        RawFrame::Text(text) => serde_json::from_str(text).expect("JSON"),
        other => panic!("expected text, found {other:?}"),
    }
}

/// Opens the volume and receives one edit up to `done`; the number of chunks.
async fn view_once(socket: &mut Connection, iso: u32) -> usize {
    say(socket, r#"{"type":"open","volume":"noise"}"#).await;
    assert_eq!(json(&next(socket).await)["type"], "opened");
    say(socket, format!(r#"{{"type":"edit","iso":{iso}}}"#)).await;
    let mut chunks = 0;
    loop {
        let frame = next(socket).await;
        if let RawFrame::Chunk(bytes) = &frame {
            let chunk = Chunk::decode(bytes).expect("a valid chunk");
            assert_eq!(chunk.triangles.len() as u32, TRIANGLES);
            chunks += 1;
        } else if json(&frame)["type"] == "done" {
            return chunks;
        }
    }
}

#[tokio::test]
async fn a_handshake_without_the_subprotocol_is_refused() {
    let server = start(1, Deadlines::default()).await;
    for subprotocol in [None, Some("isopeel.v1")] {
        let mut request = request(server.address, "", &[]).expect("a request");
        let headers = request.headers_mut();
        headers.remove("sec-websocket-protocol");
        if let Some(name) = subprotocol {
            headers.insert("sec-websocket-protocol", name.parse().expect("a header"));
        }
        let tcp = TcpStream::connect(server.address).await.expect("connects");
        match Connection::handshake(tcp, request, None).await.err() {
            Some(Error::Refused { status: 400, body }) => {
                let problem: Value = serde_json::from_slice(&body).expect("a problem");
                assert_eq!(problem["code"], "bad-request");
            }
            other => panic!("{other:?}"),
        }
    }
    server.connect().await;
}

#[tokio::test]
async fn faults_of_the_client_have_their_close_codes() {
    let server = start(1, Deadlines::default()).await;
    let long = format!(r#"{{"type":"open","volume":"{}"}}"#, "x".repeat(64 * 1024));
    let faults = [
        (Message::binary(vec![1, 2, 3]), "bad-message", 1003),
        (Message::text(long), "too-large", 1009),
    ];
    for (message, error, code) in faults {
        let mut socket = server.connect().await;
        socket.send_raw(message).await.expect("sent");
        let (before, closed) = until_close(&mut socket).await;
        assert_eq!(closed, code);
        assert_eq!(before.len(), 1);
        let said = json(&before[0]);
        assert_eq!((&said["code"], &said["open"]), (&error.into(), &false.into()));
    }
    // Far too long: the connection ends, read or not.
    let mut socket = server.connect().await;
    let _ = socket.send_raw(Message::text("x".repeat(4 << 20))).await;
    let end = timeout(Duration::from_secs(30), socket.close_code()).await;
    let _ = end.expect("the connection ends");
}

#[tokio::test]
async fn a_whole_surface_arrives() {
    let server = start(40, Deadlines::default()).await;
    let mut socket = server.connect().await;
    assert_eq!(view_once(&mut socket, 1).await, 1 + 39, "region 0 of the prefix stands");
}

#[tokio::test]
async fn a_slow_reader_is_closed_and_delays_no_other() {
    let deadlines = Deadlines {
        send: Duration::from_millis(1500),
        ..Deadlines::default()
    };
    let server = start(MANY_REGIONS, deadlines).await;
    let mut slow = server.connect().await;
    say(&mut slow, r#"{"type":"open","volume":"noise"}"#).await;
    say(&mut slow, r#"{"type":"edit","iso":2}"#).await;
    // The first step and its ping, then some frames of the second, then nothing more is read.
    until_committed(&mut slow).await;
    for _ in 0..3 {
        next(&mut slow).await;
    }
    let stalled = Instant::now();
    let mut other = server.connect().await;
    assert_eq!(view_once(&mut other, 3).await, MANY_REGIONS as usize);
    // Without pongs the session sends no more than a window for two seconds, then all that the buffers take.
    let closed = Duration::from_secs(2) + 2 * deadlines.send;
    tokio::time::sleep(closed.saturating_sub(stalled.elapsed())).await;
    // Frames that were sent before arrive, then the close frame.
    let (_, code) = until_close(&mut slow).await;
    assert_eq!(code, 4001);
    assert_eq!(view_once(&mut other, 4).await, MANY_REGIONS as usize);
}

#[tokio::test]
async fn who_does_not_read_is_closed_too_when_the_token_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = TokenFile::in_folder(folder.path());
    let new = NewToken {
        user: "ann".into(),
        roles: vec![Role::Edit].into(),
        lifetime: None,
    };
    let (token, made) = file.create(new).expect("a token");
    let watch = TokenWatch::open(file.clone()).expect("tokens");
    let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[])
        .with_token(&Token::random().expect("random"))
        .with_named(&watch);
    tokio::spawn(watch.run());
    let who = access.who(token.text()).expect("it was made");
    let server = start_for(who, MANY_REGIONS, Deadlines::default()).await;
    let mut socket = server.connect().await;
    say(&mut socket, r#"{"type":"open","volume":"noise"}"#).await;
    say(&mut socket, r#"{"type":"edit","iso":2}"#).await;
    until_committed(&mut socket).await;
    // From now on nothing is read, until the buffers of loopback are full.
    tokio::time::sleep(Duration::from_millis(500)).await;
    file.revoke(&made.id).expect("revoked");
    let revoked = Instant::now();
    server.until_empty().await;
    assert!(revoked.elapsed() < Duration::from_secs(5), "{:?}", revoked.elapsed());
}

#[tokio::test]
async fn there_is_room_for_so_many_viewers_and_again_when_one_leaves() {
    // Both ends of each connection are files of this process.
    rlimit::increase_nofile_limit(3 * MAX_VIEWERS as u64).expect("the limit of open files is known");
    let server = start(1, Deadlines::default()).await;
    let mut viewers = Vec::new();
    for _ in 0..MAX_VIEWERS {
        let mut socket = server.connect().await;
        assert_eq!(view_once(&mut socket, 1).await, 1);
        viewers.push(socket);
    }
    let mut refused = server.connect().await;
    assert_eq!(until_close(&mut refused).await.1, 4002);

    // One closes its connection, one drops it.
    viewers.pop().expect("a viewer").close().await.expect("closes");
    drop(viewers.pop());
    for _ in 0..2 {
        let enter = async {
            loop {
                let mut socket = server.connect().await;
                say(&mut socket, "{").await;
                match try_next(&mut socket).await {
                    Err(_) => tokio::task::yield_now().await,
                    Ok(_) => return socket,
                }
            }
        };
        let entered = timeout(Duration::from_secs(10), enter).await;
        viewers.push(entered.expect("a free slot"));
    }
}

#[tokio::test]
async fn a_silent_client_is_closed_and_one_that_pongs_is_not() {
    let deadlines = Deadlines {
        ping: Duration::from_millis(100),
        silence: Duration::from_millis(600),
        ..Deadlines::default()
    };
    let server = start(1, deadlines).await;
    let mut dead = server.connect().await;
    let mut idle = server.connect().await;
    // Polling the socket answers pings.
    let polled = timeout(Duration::from_millis(1500), idle.next()).await;
    assert!(polled.is_err(), "{polled:?}");
    let (before, code) = until_close(&mut dead).await;
    assert_eq!(code, 4003);
    assert_eq!(json(&before[0])["open"], false);
    assert_eq!(view_once(&mut idle, 1).await, 1);
}

#[tokio::test]
async fn a_shutdown_closes_every_viewer_and_waits_for_them() {
    let server = start(60, Deadlines::default()).await;
    let mut idle = server.connect().await;
    let mut busy = server.connect().await;
    say(&mut busy, r#"{"type":"open","volume":"noise"}"#).await;
    say(&mut busy, r#"{"type":"edit"}"#).await;
    next(&mut busy).await;
    server.shutdown.cancel();
    assert_eq!(until_close(&mut idle).await.1, 1001);
    assert_eq!(until_close(&mut busy).await.1, 1001);
    drop((idle, busy));
    let closed = timeout(Duration::from_secs(10), server.state.closed()).await;
    closed.expect("no task is left");
}
