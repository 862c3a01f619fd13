//! A server on a real device, and its viewers.

use std::net::SocketAddr;
use std::ops::Deref;
use std::path::PathBuf;
use std::time::Duration;

use isopeel::access::Access;
use isopeel::serve::{Config, run};
use isopeel::service::DeviceWorker;
use isopeel::stream::{Deadlines, LiveOptions, StepTimes};
use isopeel_client::{Connection, Frame, Surface};
use isopeel_reference::edges;
use isopeel_volumes::Catalog;
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::sync::{Mutex, MutexGuard};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// One server at a time: PoCL 3.1 fails with two engines in one process.
static ALONE: Mutex<()> = Mutex::const_new(());

/// Longest wait for a frame.
const FRAME_LIMIT: Duration = Duration::from_secs(120);

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
        let connection = Connection::connect(self.address).await.expect("connects");
        let mut viewer = Viewer {
            client: isopeel_client::Viewer::new(connection),
            closed: false,
        };
        viewer.open(volume, 0).await;
        viewer
    }

    pub async fn stop(self) {
        self.shutdown.cancel();
        self.task.await.expect("no panic").expect("a clean end");
    }
}

/// A viewer with one surface.
pub struct Viewer {
    client: isopeel_client::Viewer,
    /// Whether every surface must be closed, checked at each `committed`.
    pub closed: bool,
}

impl Deref for Viewer {
    type Target = Surface;

    fn deref(&self) -> &Surface {
        &self.client
    }
}

/// A received prefix.
#[derive(Debug)]
pub struct Prefix {
    pub level: u8,
    pub unchanged: usize,
    pub chunks: usize,
    pub bytes: usize,
}

impl Viewer {
    /// Opens a step of a volume.
    pub async fn open(&mut self, volume: &str, step: u32) {
        self.send(json!({"type": "open", "volume": volume, "step": step})).await;
        loop {
            match self.next().await {
                Frame::Opening { .. } => {}
                Frame::Opened { volume: opened, .. } => return assert_eq!(opened["id"], volume),
                other => panic!("expected `opened`, found {other:?}"),
            }
        }
    }

    /// Sends a message.
    pub async fn send(&mut self, message: Value) {
        self.client.send(&message).await.expect("sent");
    }

    /// Sends an edit with these fields.
    pub async fn edit(&mut self, mut fields: Value) {
        fields["type"] = json!("edit");
        self.send(fields).await;
    }

    /// Returns the next frame.
    pub async fn next(&mut self) -> Frame {
        let frame = timeout(FRAME_LIMIT, self.client.next()).await;
        frame.expect("a frame in time").expect("no error")
    }

    /// Receives everything up to `done`: the prefixes and the statistics. Generations before may be superseded.
    pub async fn until_done(&mut self) -> (Vec<Prefix>, Value) {
        let mut prefixes: Vec<Prefix> = Vec::new();
        let mut is_pending = false;
        loop {
            match self.next().await {
                Frame::Prefix(prefix) => {
                    is_pending = true;
                    prefixes.push(Prefix {
                        level: prefix.level,
                        unchanged: prefix.unchanged,
                        chunks: 0,
                        bytes: 0,
                    });
                }
                Frame::Chunk { bytes, .. } => {
                    let last = prefixes.last_mut().expect("a prefix");
                    last.chunks += 1;
                    last.bytes += bytes;
                }
                Frame::Committed { .. } => {
                    is_pending = false;
                    if self.closed {
                        assert_eq!(self.open_edges(), 0);
                    }
                }
                Frame::Superseded { .. } => {
                    if std::mem::take(&mut is_pending) {
                        prefixes.pop();
                    }
                }
                Frame::Measured { .. } => {}
                Frame::Done { statistics, .. } => return (prefixes, statistics),
                other => panic!("unexpected {other:?}"),
            }
        }
    }

    /// Returns the number of edges at which the surface is open; vertices with equal positions are one.
    pub fn open_edges(&self) -> usize {
        let mut edges = Vec::new();
        for mesh in self.shown.values() {
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|vertex| mesh.lattice(vertex).map(i64::from));
                edges.extend([[a, b], [b, c], [c, a]]);
            }
        }
        edges::open(edges).len()
    }
}
