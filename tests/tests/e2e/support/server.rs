//! Servers for the tests: `isopeel serve` as a library call, on a port that the system chooses.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, mpsc};
use std::thread::JoinHandle;

use isopeel::access::Access;
use isopeel::serve::{Config, run};
use isopeel::service::DeviceWorker;
use isopeel::stream::Deadlines;
use isopeel_volumes::Catalog;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// A running server; dropping it stops it.
pub struct Server {
    pub address: SocketAddr,
    running: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
}

impl Server {
    /// Shuts down as a signal would and waits for the end.
    pub fn stop(mut self) {
        self.shut_down();
    }

    fn shut_down(&mut self) {
        if let Some((stop, thread)) = self.running.take() {
            stop.send(()).ok();
            thread.join().expect("the server ends without a panic");
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shut_down();
    }
}

/// Whether there is an OpenCL device. There must be one unless `ISOPEEL_TESTS_WITHOUT_DEVICE=1`.
pub fn has_device() -> bool {
    static FOUND: LazyLock<Result<(), String>> = LazyLock::new(|| {
        isopeel_kernels::device::list()
            .map(|_| ())
            .map_err(|error| error.to_string())
    });
    let Err(why) = &*FOUND else { return true };
    let none_expected = std::env::var_os("ISOPEEL_TESTS_WITHOUT_DEVICE").is_some_and(|value| value == "1");
    assert!(
        none_expected,
        "{why}; ISOPEEL_TESTS_WITHOUT_DEVICE=1 leaves out tests that need a device"
    );
    false
}

/// The origin, beside a server's own, whose pages it serves.
pub const FRIEND: &str = "https://viewer.example";

/// Starts a server with the embedded demo.
pub fn start() -> Option<Server> {
    start_with(Deadlines::default())
}

/// Starts a server with the embedded demo and other deadlines for its viewers.
pub fn start_with(deadlines: Deadlines) -> Option<Server> {
    serve(&[], deadlines)
}

/// Starts a server with these files beside the embedded demo.
pub fn start_with_volumes(paths: &[PathBuf]) -> Option<Server> {
    serve(paths, Deadlines::default())
}

/// Starts a server with these files beside the embedded demo and other deadlines for its viewers.
pub fn serve(paths: &[PathBuf], deadlines: Deadlines) -> Option<Server> {
    if !has_device() {
        return None;
    }
    let (address_known, address) = mpsc::channel();
    let (stop, stopped) = oneshot::channel::<()>();
    let paths = paths.to_vec();
    let thread = std::thread::spawn(move || {
        let catalog = Catalog::open(&paths, true).expect("the volumes are readable").into();
        let worker = DeviceWorker::start(None).expect("a thread");
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async move {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a free port");
            let address = listener.local_addr().expect("an address");
            address_known.send(address).expect("the test waits");
            // a dropped sender stops the server as well
            let shutdown = async move { stopped.await.unwrap_or(()) };
            run(
                listener,
                Config {
                    ceiling_triangles: 20_000_000,
                    deadlines,
                    ..Config::new(
                        catalog,
                        worker,
                        Access::new(address, &[], &[FRIEND.parse().expect("an origin")]),
                    )
                },
                shutdown,
            )
            .await
            .expect("the server runs");
        });
    });
    let address = address.recv().expect("the server listens");
    Some(Server {
        address,
        running: Some((stop, thread)),
    })
}

/// The server shared by all tests that do not harm it. The first of them starts it; it ends with the process.
pub fn shared() -> Option<SocketAddr> {
    static SHARED: LazyLock<Option<Mutex<Server>>> = LazyLock::new(|| start().map(Mutex::new));
    SHARED
        .as_ref()
        .map(|server| server.lock().expect("not poisoned").address)
}
