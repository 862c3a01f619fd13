//! Servers for the tests: `isopeel serve` as a library call, on a port that the system chooses.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{LazyLock, Mutex, mpsc};
use std::thread::JoinHandle;

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

/// Whether there is an OpenCL device. With `OPENCL_EXPECTED=1` there has to be one.
pub fn has_device() -> bool {
    static FOUND: LazyLock<Result<(), String>> =
        LazyLock::new(|| isopeel_kernels::device::list().map(|_| ()).map_err(|error| error.to_string()));
    let Err(why) = &*FOUND else { return true };
    let expected = std::env::var_os("OPENCL_EXPECTED").is_some_and(|value| value == "1");
    assert!(!expected, "OPENCL_EXPECTED=1, but: {why}");
    eprintln!("not run: {why}");
    false
}

/// Starts a server with the embedded demo.
pub fn start() -> Option<Server> {
    has_device().then(|| {
        let (address_known, address) = mpsc::channel();
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Runtime::new().expect("a runtime");
            runtime.block_on(async move {
                let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a free port");
                address_known.send(listener.local_addr().expect("an address")).expect("the test waits");
                let shutdown = async move {
                    stopped.await.ok();
                };
                isopeel::serve::run(listener, isopeel::serve::Config::default(), shutdown).await.expect("the server runs");
            });
        });
        Server { address: address.recv().expect("the server listens"), running: Some((stop, thread)) }
    })
}

/// The server that all tests share which do not harm it. Started by the first of them, it ends with the process.
pub fn shared() -> Option<SocketAddr> {
    static SHARED: LazyLock<Option<Mutex<Server>>> = LazyLock::new(|| start().map(Mutex::new));
    has_device().then(|| SHARED.as_ref().map(|server| server.lock().expect("not poisoned").address)).flatten()
}
