//! Device memory beyond the volume grows with the surface, not with the volume; the server reports the owners of memory.

use std::ffi::OsStr;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::metrics::{counted, metrics_of};
use crate::support::viewer::Viewer;
use crate::support::{command, data_file, demo, demo_file, http, process, server};

/// Samples along each axis of the volume that is nearly empty.
const SIDE: usize = 512;
/// Of the sphere in it, in samples.
const RADIUS: f32 = 40.0;

/// An NRRD file of one byte a sample: 128 on the sphere, 10 more each sample inwards.
fn sphere(folder: &Path) -> PathBuf {
    sphere_in(folder, SIDE)
}

/// As [`sphere`], with `side` samples along each axis.
fn sphere_in(folder: &Path, side: usize) -> PathBuf {
    let path = folder.join(format!("sphere{side}.nrrd"));
    let mut samples = vec![0u8; side * side * side];
    let middle = side / 2;
    // Farther out than this the value is 0 anyway.
    let near = middle - 53..middle + 54;
    for z in near.clone() {
        for y in near.clone() {
            for x in near.clone() {
                let [dx, dy, dz] = [x, y, z].map(|at| at as f32 - middle as f32);
                let depth = RADIUS - (dx * dx + dy * dy + dz * dz).sqrt();
                samples[(z * side + y) * side + x] = (128.0 + 10.0 * depth).clamp(0.0, 255.0) as u8;
            }
        }
    }
    let mut file = std::fs::File::create(&path).expect("a file");
    write!(
        file,
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {side} {side} {side}\nspacings: 1 1 1\nencoding: raw\n\n"
    )
    .expect("written");
    file.write_all(&samples).expect("written");
    path
}

/// The surface with default options, the paper's surface, and both in full.
#[track_caller]
fn assert_bytes_follow(volume: &Path, iso: &str) {
    for rest in [
        "",
        "--beta 0.02 --mesher marching-cubes",
        "--beta -1",
        "--beta -1 --mesher marching-cubes",
    ] {
        let line = ["--iso", iso]
            .into_iter()
            .chain(rest.split_whitespace())
            .map(OsStr::new);
        let statistics = command::extract([volume.as_os_str()].into_iter().chain(line));
        let count = |name: &str| {
            statistics[name]
                .as_u64()
                .unwrap_or_else(|| panic!("{name} in {statistics}"))
        };
        let (full, device, whole) = (count("fullTriangles"), count("deviceBytes"), count("volumeBytes"));
        let name = volume.file_name().expect("a name").to_string_lossy();
        let each = (device as f64 - 0.02 * whole as f64) / full as f64;
        println!(
            "{name} at {iso} {rest}: {full} full triangles, {device} bytes beside {whole} of the volume: \
             {each:.1} a triangle beyond 2 %"
        );
        assert!(full > 10_000, "a surface: {statistics}");
        assert!(
            device > 0 && each < 100.0,
            "{device} bytes for {full} full triangles: {statistics}"
        );
    }
}

#[test]
fn a_small_surface_in_a_large_volume_takes_little_memory() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = sphere(folder.path());
    assert_bytes_follow(&volume, "128");
}

/// Memory that a process of `isopeel extract` holds at most.
#[cfg(target_os = "linux")]
fn peak_of_extract(volume: &Path) -> u64 {
    let mut process = std::process::Command::new(command::binary())
        .arg("extract")
        .arg(volume)
        .args(["--iso", "128", "--beta", "0.05", "-o"])
        .arg(volume.with_extension("stl"))
        .spawn()
        .expect("the binary starts");
    let status = format!("/proc/{}/status", process.id());
    let mut peak = 0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let held = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<u64>().ok());
        peak = peak.max(1024 * held.unwrap_or(0));
        if let Some(status) = process.try_wait().expect("a process") {
            assert!(status.success(), "{status}");
            return peak;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// On a device that is this machine's processors the volume is held once, not once more as it is read.
#[test]
#[cfg(target_os = "linux")]
fn a_volume_is_read_in_pieces() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let small = peak_of_extract(&sphere_in(folder.path(), 128));
    let large = peak_of_extract(&sphere(folder.path()));
    let (volume, mib) = ((SIDE * SIDE * SIDE) as u64, 1 << 20);
    println!(
        "{} MiB with a small volume, {} MiB with one of {} MiB",
        small / mib,
        large / mib,
        volume / mib
    );
    assert!(
        large.saturating_sub(small) < volume * 3 / 2,
        "{large} bytes, {small} with a small volume"
    );
}

#[test]
fn device_memory_follows_the_surface() {
    if server::has_device() {
        assert_bytes_follow(&demo_file(), "100");
    }
}

#[test]
#[ignore = "its volume is not in the repository: make test-volumes"]
fn device_memory_follows_the_surface_of_ct_head() {
    if !server::has_device() {
        return;
    }
    let volume = data_file("ct-head.nrrd");
    for iso in ["517", "-300"] {
        assert_bytes_follow(&volume, iso);
    }
}

#[tokio::test]
async fn the_server_says_what_holds_memory() {
    let Some(server) = server::start() else { return };
    let stated = || http::get(server.address, "/api/v1/memory").json();
    let bytes = |memory: &Value, name: &str| memory[name].as_u64().unwrap_or_else(|| panic!("{name} in {memory}"));
    let before = stated();
    for name in ["volumeBytes", "pyramidBytes", "treeBytes"] {
        assert_eq!(bytes(&before, name), 0, "{name}");
    }
    assert!(bytes(&before, "residentBytes") > 0 && bytes(&before, "programBytes") > 0);

    let mut viewer = Viewer::open(server.address, demo::ID).await;
    for iso in [demo::ISO, demo::ISO + 1.0] {
        viewer.edit(json!({"iso": iso, "beta": 0.02})).await;
    }
    viewer
        .edit_and_rest(json!({"triangles": demo::FULL_TRIANGLES / 4, "maxError": "auto"}))
        .await;
    viewer.close().await;
    let after = stated();
    let samples: u64 = demo::DIMS.iter().map(|&n| u64::from(n)).product();
    assert!(bytes(&after, "volumeBytes") >= samples, "{after}");
    for name in ["pyramidBytes", "treeBytes", "cutBytes"] {
        assert!(bytes(&after, name) > 0, "{name} in {after}");
    }
}

/// Cache hits and misses of a pyramid or a tree.
fn looked_up(address: SocketAddr, what: &str) -> [f64; 2] {
    let text = metrics_of(address);
    ["hit", "miss"].map(|result| {
        let label = format!(r#"what="{what}",result="{result}""#);
        counted(&text, "isopeel_cache_requests_total", &label)
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_kept_of_many_isovalues_is_bounded() {
    let (bound, mebibytes) = (200 << 20, Path::new("200"));
    let variables = [("ISOPEEL_SURFACE_MEMORY", mebibytes)];
    let Some(server) = process::start_in(&[], &["--shared-memory", "0"], &variables) else {
        return;
    };
    let mut viewer = Viewer::open(server.address, demo::ID).await;
    let mut pyramids = 0;
    for step in 0..24 {
        viewer.edit(json!({"iso": 60 + 2 * step})).await;
        let memory = http::get(server.address, "/api/v1/memory").json();
        let bytes = |name: &str| memory[name].as_u64().unwrap_or_else(|| panic!("{name} in {memory}"));
        let kept = ["pyramidBytes", "treeBytes", "cutBytes", "idleBytes"].map(bytes);
        assert!(kept.iter().sum::<u64>() <= bound, "{memory}");
        pyramids = kept[0];
    }
    // Of 24 isovalues, as many are cached as fit the share: the last one is, the first one is not.
    assert!(pyramids > bound * 2 / 5 && pyramids < bound / 2, "{pyramids}");
    let [_, misses] = looked_up(server.address, "pyramid");
    viewer.edit(json!({"iso": 104})).await;
    assert_eq!(looked_up(server.address, "pyramid")[1], misses);
    viewer.edit(json!({"iso": 60})).await;
    assert_eq!(looked_up(server.address, "pyramid")[1], misses + 1.0);
    viewer.close().await;
}

/// Even if caches keep nothing, an edit does not rebuild the shown surface's pyramid and tree from the beginning.
#[tokio::test(flavor = "multi_thread")]
async fn the_surface_that_is_shown_stays_where_nothing_else_is_kept() {
    let Some(server) = process::start(&[], &["--surface-memory", "0", "--shared-memory", "0"]) else {
        return;
    };
    let mut viewer = Viewer::open(server.address, demo::ID).await;
    viewer.edit(json!({"iso": demo::ISO, "beta": 0.02})).await;
    let [hits, misses] = looked_up(server.address, "pyramid");
    for beta in [0.05, 0.02, 0.1] {
        viewer.edit(json!({"beta": beta})).await;
    }
    viewer
        .edit_and_rest(json!({"triangles": demo::FULL_TRIANGLES / 4, "maxError": "auto"}))
        .await;
    let [_, trees] = looked_up(server.address, "tree");
    assert!(trees > 0.0);
    viewer
        .edit_and_rest(json!({"triangles": demo::FULL_TRIANGLES / 5}))
        .await;
    let [more, same] = looked_up(server.address, "pyramid");
    assert!(more >= hits + 5.0 && same == misses, "{hits}, {misses}; {more}, {same}");
    let [found, same] = looked_up(server.address, "tree");
    assert!(found > 0.0 && same == trees, "{trees}; {found}, {same}");
    viewer.close().await;
}

/// Each expression gives a field of 35 MB, of floats. Kept without a limit, forty of them take three times the memory that the server has.
#[tokio::test(flavor = "multi_thread")]
#[cfg(target_os = "linux")]
async fn fields_of_expressions_stay_within_the_hosts_memory_and_edits_go_on() {
    let limit = 700 << 20;
    let options = ["--host-memory", "700", "--rate-peer", "0"];
    let Some(server) = process::start(&[], &options) else {
        return;
    };
    let address = server.address;
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut peak = 0;
    for n in 0..40 {
        let field = format!("t1*{}", n + 2);
        let path = format!("/api/v1/volumes/{}/slices?axis=z&index=5&field={field}", demo::ID);
        let answer = tokio::task::spawn_blocking(move || http::get(address, &path)).await;
        assert_eq!(answer.expect("no panic").status, 200, "{field}");
        peak = peak.max(server.resident_bytes());
        if n % 4 == 3 {
            // Fails if an edit is refused.
            viewer.edit(json!({"iso": 80 + n})).await;
        }
    }
    viewer.close().await;
    println!("{peak} bytes at most, the limit is {limit}");
    assert!(peak < limit * 11 / 10, "{peak} bytes, the limit is {limit}");
    // A newcomer is served too.
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.edit(json!({"iso": demo::ISO})).await;
    viewer.close().await;
}
