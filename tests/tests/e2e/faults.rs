//! A server survives failures of its device: `faults.c` is a layer between it and the driver that injects them.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::metrics::{counted, metrics_of};
use crate::support::process::{self, Process};
use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, demo, http, server};

/// Longest time to an answer after the device is back, and to the demo's surface.
const SOON: Duration = Duration::from_secs(5);
/// The asserted limit, for a machine that is also used by others.
const LIMIT: Duration = Duration::from_secs(60);

/// Environment variable of a folder that the process of the device may read and write. The layer uses it; PoCL does not.
pub const DRIVER_FOLDER: &str = "MESA_SHADER_CACHE_DIR";

/// Creates the folder of [`DRIVER_FOLDER`] in the folder of a test, unless it exists, and returns it.
pub fn driver_folder(folder: &Path) -> PathBuf {
    let driver = folder.join("driver");
    std::fs::create_dir_all(&driver).expect("a folder");
    driver
}

/// A server whose device fails as the test says.
pub struct Faulty {
    pub process: Process,
    folder: TempDir,
}

impl Faulty {
    /// Starts a server with a ball beside the demo; `None` if there is no device.
    pub fn start() -> Option<Self> {
        Self::start_with(&[])
    }

    /// As [`Faulty::start`], with these options too.
    pub fn start_with(options: &[&str]) -> Option<Self> {
        Self::start_in(tempfile::tempdir().expect("a folder"), options, &[])
    }

    /// As [`Faulty::start_with`], with the volume and the driver in this folder, in an environment that has these variables too.
    pub fn start_in(folder: TempDir, options: &[&str], environment: &[(&str, &Path)]) -> Option<Self> {
        if !server::has_device() {
            return None;
        }
        let layer = build_layer(folder.path());
        let volume = folder.path().join("ball.npy");
        ball::write(&volume);
        let driver = driver_folder(folder.path());
        let fault = driver.join("fault");
        let faulty = [
            ("OPENCL_LAYERS", &*layer),
            ("DEVICE_FAULT", &*fault),
            (DRIVER_FOLDER, &*driver),
        ];
        let environment = [&faulty[..], environment].concat();
        let options: Vec<_> = ["--demo"].iter().chain(options).copied().collect();
        let process = process::start_in(&[volume], &options, &environment)?;
        Some(Self { process, folder })
    }

    pub fn address(&self) -> SocketAddr {
        self.process.address
    }

    /// Makes the device fail in this way from now on.
    pub fn fail(&self, what: &str) {
        // Renamed into place, so that it is never read half written.
        let new = self.driver().join("new");
        std::fs::write(&new, what).expect("written");
        std::fs::rename(new, self.fault()).expect("renamed");
    }

    /// Ends the failure of the device.
    pub fn mend(&self) {
        std::fs::remove_file(self.fault()).expect("the fault was still there");
    }

    fn fault(&self) -> PathBuf {
        self.driver().join("fault")
    }

    /// The folder that the process of the device may write.
    pub fn driver(&self) -> PathBuf {
        driver_folder(self.folder.path())
    }

    /// How often the device was lost.
    fn losses(&self) -> u64 {
        counted(&metrics_of(self.address()), "isopeel_device_lost_total", "") as u64
    }

    /// Waits until the device is ready; returns how long that took.
    pub fn ready(&self) -> Duration {
        let start = Instant::now();
        while http::get(self.address(), "/readyz").status != 200 {
            assert!(start.elapsed() < LIMIT, "the device is not back");
            std::thread::sleep(Duration::from_millis(20));
        }
        start.elapsed()
    }
}

pub fn build_layer(folder: &Path) -> PathBuf {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/e2e/faults.c");
    let layer = folder.join("layer.so");
    let status = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", source, "-pthread", "-o"])
        .arg(&layer)
        .status();
    assert!(status.expect("a compiler").success());
    layer
}

/// The ball's surface as an export.
fn extract(address: SocketAddr, iso: f32) -> http::Answer {
    let body = json!({"volume": "ball", "iso": iso, "format": "stl"});
    http::post_json(address, "/api/v1/extract", &body)
}

/// Counts of the surface, without times.
pub fn counts(statistics: &Value) -> (Option<u64>, Option<u64>) {
    (statistics["triangles"].as_u64(), statistics["fullTriangles"].as_u64())
}

/// Sends an edit that fails on the device; returns the error's message.
async fn failed(viewer: &mut Viewer, edit: Value) -> String {
    viewer.send(edit).await;
    loop {
        match viewer.next().await {
            Frame::Error { code, message, .. } => {
                assert_eq!(code, "device", "{message}");
                return message;
            }
            Frame::Prefix(_) | Frame::Chunk { .. } | Frame::Committed { .. } => {}
            other => panic!("unexpected {other:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_is_lost_is_opened_again_and_nobody_has_to_ask_twice() {
    let Some(server) = Faulty::start() else { return };
    let address = server.address();
    let first = Instant::now();
    let before = extract(address, 0.0);
    let first = first.elapsed();
    assert_eq!(before.status, 200);
    let mut viewer = Viewer::open(address, demo::ID).await;
    let shown = viewer.edit(json!({"iso": 100})).await;

    server.fail("lost");
    let start = Instant::now();
    let again = viewer.edit(json!({"iso": 90})).await;
    let edited = start.elapsed();
    assert_eq!(server.losses(), 1);
    assert!(edited < LIMIT, "{edited:?}");
    assert_ne!(counts(&again), counts(&shown), "another isovalue");
    assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown));
    // A volume without viewers is loaded when it is requested.
    let start = Instant::now();
    let after = extract(address, 0.0);
    let loaded = start.elapsed();
    assert_eq!(after.body, before.body, "the same export");

    // The device is lost during an export, which is completed nevertheless.
    server.fail("lost");
    assert_eq!(extract(address, 1.0).status, 200);
    assert_eq!(server.losses(), 2);
    println!("first edit after a loss {edited:?}, wanted {SOON:?}; an export {loaded:?}, the first of all {first:?}");
}

/// After a fault, NVIDIA's driver does not let the process open a device any more.
#[tokio::test(flavor = "multi_thread")]
async fn where_the_driver_asks_for_another_process_the_server_is_back_with_its_address_and_token() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let driver = driver_folder(folder.path());
    let environment = [
        ("OPENCL_LAYERS", &*build_layer(folder.path())),
        ("DEVICE_FAULT", &*driver.join("fault")),
        (DRIVER_FOLDER, &*driver),
    ];
    let Some((process, line)) = process::launch_in(&[], &["--demo"], &environment) else {
        return;
    };
    let (address, start) = (process.address, Instant::now());
    let (_, token) = line.split_once("#token=").expect("a token");
    let bearer = format!("Bearer {token}");
    let get = |path: &str| http::send(address, "GET", path, &[("Authorization", &bearer)], b"");
    let status = |path: &str| get(path).map(|answer| answer.status);
    assert_eq!(status("/api/v1/volumes"), Some(200));
    std::fs::write(driver.join("fault"), "spoiled").expect("written");
    let body = json!({"volume": demo::ID, "iso": 100, "format": "stl"}).to_string();
    let headers = [("Authorization", &*bearer), ("Content-Type", "application/json")];
    let ask = || http::send(address, "POST", "/api/v1/extract", &headers, body.as_bytes());
    let lost = Instant::now();
    // Refused while the device is lost, dropped while the process is replaced.
    let made = loop {
        match ask() {
            Some(answer) if answer.status == 200 => break answer,
            _ => assert!(lost.elapsed() < LIMIT, "the server is not back"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    println!("a surface {:?} after the fault, wanted {SOON:?}", lost.elapsed());
    assert!(made.body.len() > 1_000_000 && start.elapsed() > lost.elapsed());
    assert_eq!(
        http::get(address, "/api/v1/volumes").status,
        401,
        "the token is asked for"
    );
    process.signal("TERM");
    process.ended_within(Duration::from_secs(3));
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_while_the_device_is_gone_is_told_so_at_once() {
    let Some(server) = Faulty::start() else { return };
    let address = server.address();
    let mut viewer = Viewer::open(address, demo::ID).await;
    let shown = viewer.edit(json!({"iso": 100})).await;

    server.fail("gone");
    let message = failed(&mut viewer, json!({"type": "edit", "iso": 90})).await;
    assert!(message.contains("the device was lost"), "{message}");
    let start = Instant::now();
    while http::get(address, "/readyz").problem(503) != "device" {
        assert!(start.elapsed() < LIMIT, "it is known that the device is gone");
        std::thread::sleep(Duration::from_millis(20));
    }
    let start = Instant::now();
    let refused = extract(address, 0.0);
    assert_eq!(refused.problem(503), "device");
    assert_ne!(refused.header("retry-after"), "");
    let told = start.elapsed();
    assert!(told < Duration::from_secs(1), "{told:?}");
    assert_eq!(http::get(address, "/healthz").status, 200, "the server lives");

    server.mend();
    let back = server.ready();
    // The same viewer, whose connection and picture are as they were.
    assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown));
    assert_eq!(extract(address, 0.0).status, 200);
    assert_eq!(server.losses(), 1);
    println!("ready {back:?} after the device was there again, wanted {SOON:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_whose_device_is_gone_ends_in_time() {
    let Some(server) = Faulty::start() else { return };
    server.fail("gone");
    assert_eq!(extract(server.address(), 0.0).problem(503), "device");
    let Faulty { process, folder } = server;
    process.signal("TERM");
    process.ended_within(Duration::from_secs(3));
    drop(folder);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_launch_that_fails_ends_one_job() {
    let Some(server) = Faulty::start() else { return };
    let mut viewer = Viewer::open(server.address(), demo::ID).await;
    viewer.edit_and_rest(json!({"iso": 100})).await;
    server.fail("fail");
    let message = failed(&mut viewer, json!({"type": "edit", "iso": 90})).await;
    assert!(
        message.contains("stage") && message.contains("failed on the device"),
        "{message}"
    );
    viewer.edit(json!({"iso": 90})).await;
    assert_eq!(server.losses(), 0, "the device is the same");
}

#[test]
fn a_file_that_goes_away_is_named_and_others_are_served() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let [ball, other] = ["ball.npy", "other.npy"].map(|name| folder.path().join(name));
    ball::write(&ball);
    ball::write(&other);
    let Some(server) = process::start(&[ball.clone(), other], &["--no-demo"]) else {
        return;
    };
    let whole = std::fs::read(&ball).expect("readable");
    std::fs::write(&ball, &whole[..whole.len() / 2]).expect("written");
    for _ in 0..2 {
        let refused = extract(server.address, 0.0);
        assert_eq!(refused.problem(500), "unreadable-volume");
        let detail = refused.json()["detail"].to_string();
        assert!(detail.contains("ball.npy") && !detail.contains("/"), "{detail}");
        std::fs::remove_file(&ball).ok();
    }
    let body = json!({"volume": "other", "iso": 0, "format": "stl"});
    let of_other = http::post_json(server.address, "/api/v1/extract", &body);
    assert_eq!(of_other.status, 200);
    // Restored, the file is read as before.
    std::fs::write(&ball, &whole).expect("written");
    assert_eq!(extract(server.address, 0.0).body.len(), of_other.body.len());
    // Data on the device stays usable if the file is removed.
    std::fs::remove_file(&ball).expect("it was there");
    assert_eq!(extract(server.address, 1.0).status, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_that_cannot_be_had_is_named() {
    let Some(server) = Faulty::start() else { return };
    let address = server.address();
    let mut viewer = Viewer::open(address, demo::ID).await;
    let shown = viewer.edit_and_rest(json!({"iso": 100})).await;
    // Enough for nothing but tables.
    server.fail("full 65536");
    let refused = extract(address, 0.0);
    assert_eq!(refused.problem(507), "too-large");
    server.mend();
    assert_eq!(extract(address, 0.0).status, 200);
    assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown[0]));
    assert_eq!(server.losses(), 0);
}

/// A kernel of the device does not return until the fault ends: requests wait for it, and health probes report it.
#[test]
fn a_driver_that_is_stuck_is_noticed() {
    let Some(faulty) = Faulty::start() else { return };
    let address = faulty.address();
    faulty.ready();
    faulty.fail("hang evaluate");
    let asking = std::thread::spawn(move || {
        http::get(address, "/api/v1/volumes/ball/slices?axis=z&index=5&field=2*ball").status
    });
    let start = Instant::now();
    while http::get(address, "/readyz").status == 200 {
        assert!(start.elapsed() < LIMIT, "the server says that it is ready");
        std::thread::sleep(Duration::from_millis(100));
    }
    let answer = http::get(address, "/readyz");
    assert_eq!(answer.problem(503), "busy");
    assert_eq!(http::get(address, "/healthz").status, 200);
    faulty.mend();
    faulty.ready();
    assert_eq!(asking.join().expect("no panic"), 200);
}
