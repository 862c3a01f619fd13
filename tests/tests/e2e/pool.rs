//! Several devices in one server. Two members on one device show what two devices would.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::faults::counts;
use crate::metrics::{counted, metrics_of};
use crate::shared::look_at;
use crate::support::process::{self, Process};
use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, command, http, server};

/// The asserted limit of waiting, for a machine that is also used by others.
const LIMIT: Duration = Duration::from_secs(60);

/// Two members on the first device.
const TWO: [&str; 5] = ["--no-demo", "--device", "0", "--device", "0"];

/// Viewers that keep a device busy.
const BUSY_VIEWERS: usize = 24;

/// Volumes with different surfaces: `ball` and `waves`.
fn volumes() -> (TempDir, Vec<PathBuf>) {
    let folder = tempfile::tempdir().expect("a folder");
    let paths = ["ball.npy", "waves.npy"].map(|name| folder.path().join(name));
    ball::write(&paths[0]);
    ball::write_field(&paths[1], [90, 80, 70], |at| {
        (0.2 * at[0]).sin() + (0.15 * at[1]).sin() + (0.1 * at[2]).sin()
    });
    (folder, paths.to_vec())
}

/// Starts a server and waits until all of its devices are ready.
fn start(paths: &[PathBuf], options: &[&str]) -> Option<Process> {
    let options = [options, &["--rate-peer", "0"]].concat();
    let server = process::start(paths, &options)?;
    wait_for(&server, "all devices are ready", |devices| {
        devices.iter().all(|device| device["state"] == "ready")
    });
    Some(server)
}

/// The devices of a server.
fn devices(address: SocketAddr) -> Vec<Value> {
    let answer = http::get(address, "/api/v1/devices").json();
    answer.as_array().expect("a list").clone()
}

/// Waits until the devices of a server are as expected.
#[track_caller]
fn wait_for(server: &Process, what: &str, is_so: impl Fn(&[Value]) -> bool) {
    let start = Instant::now();
    loop {
        let devices = devices(server.address);
        if is_so(&devices) {
            return;
        }
        assert!(start.elapsed() < LIMIT, "{what}: {devices:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Number of volumes on each device.
fn assigned(address: SocketAddr) -> Vec<u64> {
    let devices = devices(address).into_iter();
    devices
        .map(|device| device["volumes"].as_u64().expect("a number"))
        .collect()
}

/// Process of each device.
fn processes(address: SocketAddr) -> Vec<Option<u32>> {
    devices(address)
        .iter()
        .map(|device| u32::try_from(device["process"].as_u64()?).ok())
        .collect()
}

/// Value of a metric of a device.
fn of_device(address: SocketAddr, name: &str, device: usize) -> f64 {
    counted(&metrics_of(address), name, &format!("device=\"{device}\""))
}

/// Opens a viewer of each volume, and shows a surface in both; returns them with these surfaces. The volumes are on two devices then.
async fn two_viewers(address: SocketAddr) -> [(Viewer, Value); 2] {
    let mut first = Viewer::open(address, "ball").await;
    let shown = first.edit(json!({"iso": 0.5})).await;
    let mut other = Viewer::open(address, "waves").await;
    let shown_to_other = other.edit(json!({"iso": 0.5})).await;
    assert_eq!(assigned(address), [1, 1]);
    [(first, shown), (other, shown_to_other)]
}

/// Asks for a volume, as new callers do, until a condition holds.
fn ask_until(address: SocketAddr, volume: &str, holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < LIMIT, "{:?}", devices(address));
        let answer = http::get(address, &format!("/api/v1/volumes/{volume}"));
        assert!([200, 503].contains(&answer.status));
    }
}

/// A surface as an export.
fn export(address: SocketAddr, volume: &str) -> Vec<u8> {
    let body = json!({"volume": volume, "iso": 0.5, "format": "stl"});
    let answer = http::post_json(address, "/api/v1/extract", &body);
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    answer.body
}

#[tokio::test(flavor = "multi_thread")]
async fn two_volumes_are_on_two_devices_and_have_the_surfaces_of_one_device() {
    let (_folder, paths) = volumes();
    let Some(single) = start(&paths, &["--no-demo"]) else {
        return;
    };
    let in_process = [&TWO[..], &["--in-process"]].concat();
    for options in [&TWO[..], &in_process] {
        let pool = start(&paths, options).expect("a device");
        for (n, volume) in ["ball", "waves"].into_iter().enumerate() {
            let [expected, found] = [single.address, pool.address].map(|address| look_at(address, volume));
            let (expected, found) = (expected.await.chunks, found.await.chunks);
            assert!(!expected.is_empty());
            assert_eq!(
                found.keys().collect::<Vec<_>>(),
                expected.keys().collect::<Vec<_>>(),
                "{volume}"
            );
            assert!(found == expected, "{volume}: a region has other bytes");
            assert_eq!(assigned(pool.address), [1, n as u64], "{volume} is assigned");
            assert!(
                export(pool.address, volume) == export(single.address, volume),
                "{volume}"
            );
        }
        // Exports have found the volumes where viewers have them.
        assert_eq!(assigned(pool.address), [1, 1]);
        for (device, samples) in [150 * 130 * 140, 90 * 80 * 70].into_iter().enumerate() {
            let bytes = devices(pool.address)[device]["memory"]["volumeBytes"].as_u64();
            assert!(
                bytes.is_some_and(|bytes| (4 * samples..5 * samples).contains(&bytes)),
                "{bytes:?}"
            );
            let jobs = of_device(pool.address, "isopeel_device_job_seconds_count", device);
            assert!(jobs > 0.0, "device {device} has worked");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_a_process_concerns_its_own_viewers_alone_and_they_keep_their_picture() {
    let (_folder, paths) = volumes();
    let Some(server) = start(&paths, &TWO) else { return };
    let address = server.address;
    let [(mut first, shown), (mut other, shown_to_other)] = two_viewers(address).await;
    let before = processes(address);
    let [Some(process), Some(_)] = before[..] else {
        panic!("{before:?}")
    };
    process::signal(process, "KILL");
    assert_eq!(http::get(address, "/readyz").status, 200, "the other device answers");
    other.edit(json!({"iso": 0.6})).await;
    assert_eq!(counts(&other.edit(json!({"iso": 0.5})).await), counts(&shown_to_other));
    first.edit(json!({"iso": 0.6})).await;
    assert_eq!(counts(&first.edit(json!({"iso": 0.5})).await), counts(&shown));
    let after = processes(address);
    assert_eq!(after[1], before[1], "the process of the other device");
    assert!(after[0].is_some() && after[0] != before[0], "{before:?} {after:?}");
    assert_eq!(
        assigned(address),
        [1, 1],
        "a process is replaced so soon that its volumes stay"
    );
    let ended = "isopeel_device_process_ended_total";
    assert_eq!([0, 1].map(|device| of_device(address, ended, device)), [1.0, 0.0]);
    assert_eq!(
        [0, 1].map(|device| of_device(address, "isopeel_device_ready", device)),
        [1.0, 1.0]
    );
    first.close().await;
    other.close().await;
}

/// Kills each process of a device as soon as it is there, until it is dropped.
struct Killing(Arc<AtomicBool>, Option<std::thread::JoinHandle<()>>);

impl Killing {
    /// `spared`: process of the other device.
    fn start(server: &Process, spared: u32) -> Self {
        let (is_over, parent) = (Arc::new(AtomicBool::new(false)), server.id());
        let over = Arc::clone(&is_over);
        let kill_all = move || {
            while !over.load(Ordering::Relaxed) {
                children(parent)
                    .into_iter()
                    .filter(|&child| child != spared)
                    .for_each(|child| _ = process::signal(child, "KILL"));
                std::thread::sleep(Duration::from_millis(2));
            }
        };
        Self(is_over, Some(std::thread::spawn(kill_all)))
    }
}

impl Drop for Killing {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        self.1.take().map(|thread| thread.join());
    }
}

/// Children of all threads of a process.
fn children(process: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).expect("the process runs");
    let files = threads.flatten().map(|thread| thread.path().join("children"));
    let texts: Vec<String> = files.flat_map(std::fs::read_to_string).collect();
    let ids = texts.iter().flat_map(|text| text.split_whitespace());
    ids.map(|id| id.parse().expect("a number")).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_volumes_of_a_device_that_cannot_be_opened_any_more_move_to_another() {
    if !Path::new("/proc/self/task").exists() {
        return;
    }
    let (_folder, paths) = volumes();
    let Some(server) = start(&paths, &TWO) else { return };
    let address = server.address;
    let [(mut first, shown), (mut other, _)] = two_viewers(address).await;
    let spared = processes(address)[1].expect("a process");
    let expected = export(address, "ball");
    let killing = Killing::start(&server, spared);
    let start = Instant::now();
    // No error reaches the viewer.
    first.edit(json!({"iso": 0.6})).await;
    println!("a surface {:?} after the device was gone", start.elapsed());
    assert!(start.elapsed() < LIMIT);
    assert_eq!(counts(&first.edit(json!({"iso": 0.5})).await), counts(&shown));
    assert_eq!(assigned(address), [0, 2]);
    assert_eq!(of_device(address, "isopeel_device_volumes_moved_total", 1), 1.0);
    assert_eq!(http::get(address, "/readyz").status, 200);
    assert!(export(address, "ball") == expected, "the same export");
    other.edit(json!({"iso": 0.6})).await;
    assert_eq!(processes(address)[1], Some(spared));
    drop(killing);
    wait_for(&server, "the device is back", |devices| devices[0]["state"] == "ready");
    // The volume stays on its new device.
    first.edit(json!({"iso": 0.4})).await;
    assert_eq!(assigned(address), [0, 2]);
    first.close().await;
    other.close().await;
}

/// Edits as fast as the server makes surfaces.
async fn edit_until(mut viewer: Viewer, number: usize, is_over: Arc<AtomicBool>) {
    let mut n = 0;
    while !is_over.load(Ordering::Relaxed) {
        n += 1;
        let iso = 0.001 * (BUSY_VIEWERS * n + number) as f64 % 10.0;
        viewer.edit(json!({"iso": iso})).await;
    }
    viewer.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_volume_whose_queue_is_long_gets_a_further_device() {
    let (_folder, paths) = volumes();
    let Some(server) = start(&paths, &TWO) else { return };
    let address = server.address;
    let calm = look_at(address, "ball").await.chunks;
    assert_eq!(assigned(address), [1, 0]);
    let is_over = Arc::new(AtomicBool::new(false));
    let mut busy = Vec::new();
    for number in 0..BUSY_VIEWERS {
        let viewer = Viewer::open(address, "ball").await;
        busy.push(tokio::spawn(edit_until(viewer, number, Arc::clone(&is_over))));
    }
    ask_until(address, "ball", || assigned(address) == [1, 1]);
    assert_eq!(of_device(address, "isopeel_device_volumes_replicated_total", 1), 1.0);
    is_over.store(true, Ordering::Relaxed);
    for viewer in busy {
        viewer.await.expect("no error");
    }
    // The device has the volume, and its surface is the same.
    let bytes = |device: usize| devices(address)[device]["memory"]["volumeBytes"].as_u64();
    ask_until(address, "ball", || bytes(1).is_some() && bytes(1) == bytes(0));
    assert!(look_at(address, "ball").await.chunks == calm);
}

#[test]
fn all_devices_are_those_of_the_kind_of_the_first() {
    if !server::has_device() {
        return;
    }
    let listed = isopeel_kernels::device::list().expect("devices");
    let alike = listed.iter().filter(|device| device.kind == listed[0].kind);
    let expected: Vec<_> = alike.map(|device| json!(device.name)).collect();
    let server = start(&[], &["--device", "all"]).expect("a device");
    let found: Vec<_> = devices(server.address)
        .iter()
        .map(|device| device["name"].clone())
        .collect();
    assert_eq!(found, expected);
}

#[test]
fn a_device_that_is_not_there_is_named() {
    if !server::has_device() {
        return;
    }
    for (options, expected) in [
        (&["0", "nowhere"][..], "--device nowhere: there is no such device"),
        (&["0", "all"], "--device all was given with 1 more, expected it alone"),
        (&["0"; 17], "17 devices, expected at most 16"),
    ] {
        let devices = options.iter().flat_map(|device| ["--device", device]);
        let arguments = ["serve", "--listen", "127.0.0.1:0"].into_iter().chain(devices);
        let said = command::fail(arguments);
        assert!(said.contains(expected), "{said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_device_has_the_number_0() {
    let (_folder, paths) = volumes();
    let Some(server) = start(&paths, &["--no-demo"]) else {
        return;
    };
    let mut viewer = Viewer::open(server.address, "waves").await;
    viewer.edit(json!({"iso": 0.5})).await;
    assert!(viewer.log.iter().any(|frame| matches!(frame, Frame::Done { .. })));
    let devices = devices(server.address);
    let [device] = &devices[..] else { panic!("{devices:?}") };
    assert_eq!((&device["device"], &device["state"]), (&json!(0), &json!("ready")));
    assert!(device["name"].is_string() && device["process"].is_u64(), "{device}");
    let memory = http::get(server.address, "/api/v1/memory").json();
    assert_eq!(memory["volumeBytes"], device["memory"]["volumeBytes"]);
    let ready = of_device(server.address, "isopeel_device_ready", 0);
    assert_eq!(
        (ready, of_device(server.address, "isopeel_device_ready", 1)),
        (1.0, 0.0)
    );
    viewer.close().await;
}
