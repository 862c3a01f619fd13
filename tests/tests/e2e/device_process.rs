//! The device has a process of its own: what happens to viewers, requests and batch jobs when that process is killed, stops, hangs, crashes
//! or takes too much memory.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use isopeel::service::process::landlock_version;
use serde_json::json;

use crate::faults::{Faulty, counts};
use crate::jobs::{Setting, extracted, extraction, finished, request, submit};
use crate::metrics::{counted, metrics_of};
use crate::support::process;
use crate::support::viewer::Viewer;
use crate::support::{ball, demo, http};

/// Longest time from the end of the process to an edit's surface, on a machine that does nothing else.
const SOON: Duration = Duration::from_secs(3);
/// The asserted limit, for a machine that is also used by others.
const LIMIT: Duration = Duration::from_secs(60);

const ENDED: &str = "isopeel_device_process_ended_total";

/// A slice of a field that an expression gives: its status.
fn slice(server: &Faulty, expression: &str) -> http::Answer {
    let path = format!("/api/v1/volumes/ball/slices?axis=z&index=5&field={expression}");
    http::get(server.address(), &path)
}

/// How often the process has ended for this reason.
fn ends(server: &Faulty, reason: &str) -> f64 {
    counted(&metrics_of(server.address()), ENDED, &format!("reason=\"{reason}\""))
}

/// Waits until the process has ended for this reason as often.
fn wait_for_ends(server: &Faulty, reason: &str, times: f64) {
    let start = Instant::now();
    while ends(server, reason) < times {
        if start.elapsed() > LIMIT {
            let metrics = metrics_of(server.address());
            let ended: Vec<_> = metrics.lines().filter(|line| line.starts_with(ENDED)).collect();
            panic!("{reason}, found {ended:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_keeps_its_connection_when_the_process_is_killed_or_stops() {
    let Some(server) = process::start(&[], &[]) else { return };
    let mut viewer = Viewer::open(server.address, demo::ID).await;
    let shown = viewer.edit(json!({"iso": 100})).await;
    for (signal, iso) in [("KILL", 90), ("KILL", 95), ("STOP", 91), ("STOP", 96)] {
        let old = server.device_process();
        let start = Instant::now();
        server.signal_device(signal);
        viewer.edit(json!({"iso": iso})).await;
        let edited = start.elapsed();
        assert!(edited < LIMIT, "{signal}: {edited:?}");
        println!("a surface {edited:?} after {signal}, wanted {SOON:?}");
        assert_ne!(server.device_process(), old, "another process");
        assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown));
    }
    // In the middle of edits.
    for iso in 101..105 {
        viewer.send(json!({"type": "edit", "iso": iso})).await;
        tokio::time::sleep(Duration::from_millis(7 * (iso - 100))).await;
        server.signal_device("KILL");
    }
    assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown));
    let killed = counted(&metrics_of(server.address), ENDED, "reason=\"killed\"");
    assert!((6.0..=8.0).contains(&killed), "{killed}");
}

#[test]
fn a_batch_job_loses_no_result_when_the_process_is_killed() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let extractions: Vec<_> = (0..10).map(|n| extraction(f64::from(n) / 2.0, "stl")).collect();
    let answer = submit(server.address, &request(&extractions), "").json();
    let id = answer["id"].as_str().expect("an id").to_owned();
    for _ in 0..3 {
        std::thread::sleep(Duration::from_millis(150));
        server.signal_device("KILL");
    }
    let job = finished(server.address, &id);
    assert_eq!(job["state"], "done", "{job}");
    for (n, extraction) in extractions.iter().enumerate() {
        let result = http::get(server.address, &format!("/api/v1/jobs/{id}/results/{n}"));
        assert!(result.body == extracted(server.address, extraction), "result {n}");
    }
}

#[test]
fn a_driver_that_is_stuck_is_replaced_and_nobody_has_to_ask_twice() {
    let Some(server) = Faulty::start() else { return };
    // The first launch may compile for long.
    assert_eq!(slice(&server, "2*ball").status, 200);
    server.fail("hang evaluate");
    let stuck = Instant::now();
    let answer = std::thread::scope(|scope| {
        let asking = scope.spawn(|| slice(&server, "3*ball-1"));
        wait_for_ends(&server, "stuck", 1.0);
        server.mend();
        asking.join().expect("no panic")
    });
    assert_eq!(answer.status, 200);
    println!(
        "a stuck driver is replaced and the slice made after {:?}",
        stuck.elapsed()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn an_expression_that_has_ended_the_process_twice_is_refused_by_name() {
    let Some(server) = Faulty::start() else { return };
    let mut viewer = Viewer::open(server.address(), demo::ID).await;
    let shown = viewer.edit(json!({"iso": 100})).await;
    server.fail("crash evaluate");
    // Tried twice, each time in a new process.
    let refused = slice(&server, "2*ball");
    assert_eq!(refused.problem(500), "device");
    let detail = refused.json()["detail"].to_string();
    assert!(
        detail.contains("2*ball") && detail.contains("ended the process"),
        "{detail}"
    );
    assert_eq!(ends(&server, "crashed"), 2.0, "it is not tried again");
    server.mend();
    assert_eq!(slice(&server, "3*ball").status, 200, "another expression");
    assert_eq!(slice(&server, "2*ball").problem(500), "device");
    viewer.edit(json!({"iso": 90})).await;
    assert_eq!(counts(&viewer.edit(json!({"iso": 100})).await), counts(&shown));
}

#[test]
fn a_process_that_takes_too_much_memory_is_replaced() {
    let Some(server) = Faulty::start_with(&["--host-memory", "1000"]) else {
        return;
    };
    assert_eq!(slice(&server, "2*ball").status, 200);
    server.fail("leak 1200");
    assert!([200, 503].contains(&slice(&server, "3*ball").status));
    wait_for_ends(&server, "memory", 1.0);
    server.ready();
    assert_eq!(slice(&server, "4*ball").status, 200);
}

/// Version of Landlock that has all rules.
const LANDLOCK: i64 = 6;

/// What a driver that was taken over finds.
#[test]
fn the_process_of_the_device_reads_no_secrets_and_writes_only_where_drivers_must() {
    let version = landlock_version();
    if version < LANDLOCK {
        return eprintln!("not tested: the kernel has version {version} of Landlock, expected {LANDLOCK}");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let names = ["state", "uploads", "token", "audit", "other", "link", "aside"];
    let [state, uploads, token, audit, other, link, aside] = names.map(|name| folder.path().join(name));
    std::fs::write(&token, "a token of at least thirty-two characters").expect("written");
    std::fs::set_permissions(&token, PermissionsExt::from_mode(0o600)).expect("private");
    std::fs::write(&other, "no secret").expect("written");
    std::os::unix::fs::symlink(&token, &link).expect("a link");
    std::fs::hard_link(&token, &aside).expect("a link");
    let volume = folder.path().join("ball.npy");
    let secret = state.join("secret");
    let denied = [&volume, &token, &link, &aside, &state, &secret, &uploads, &audit];
    let readable = [&other, Path::new("/etc/passwd"), Path::new("/usr")];
    let paths = denied.map(PathBuf::as_path).into_iter().chain(readable);
    let paths: Vec<_> = paths.map(|path| path.to_str().expect("UTF-8")).collect();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("an address").port().to_string();
    let environment = [
        ("DEVICE_FAULT_PEEK", Path::new(&*paths.join(":")).to_owned()),
        ("DEVICE_FAULT_PORT", Path::new(&port).to_owned()),
    ];
    let environment = [0, 1].map(|index| (environment[index].0, &*environment[index].1));
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (state_folder, uploads_folder, token_file, audit_log) =
        (text(&state), text(&uploads), text(&token), text(&audit));
    let options = [
        "--state-folder",
        &state_folder,
        "--uploads",
        &uploads_folder,
        "--token-file",
        &token_file,
        "--audit-log",
        &audit_log,
    ];
    let Some(server) = Faulty::start_in(folder, &options, &environment) else {
        return;
    };
    std::fs::write(&secret, "").expect("written");
    let mut seen = String::new();
    // Also the process that takes the place of another one is confined.
    for round in 0..2 {
        server.fail("peek");
        assert_eq!(slice(&server, &format!("{}*ball", round + 2)).status, 200);
        let file = server.driver().join("fault.seen");
        seen = std::fs::read_to_string(&file).expect("the layer has tried");
        std::fs::remove_file(file).expect("removed");
        let refused = "Permission denied";
        for path in denied.map(|path| text(path)) {
            assert!(seen.contains(&format!("read {path}: {refused}\n")), "{path}: {seen}");
            assert!(seen.contains(&format!("make {path}: {refused}\n")), "{path}: {seen}");
        }
        for path in readable.map(text) {
            assert!(seen.contains(&format!("read {path}: done\n")), "{path}: {seen}");
            assert!(seen.contains(&format!("make {path}: {refused}\n")), "{path}: {seen}");
        }
        let own = "/tmp: done\n";
        assert_eq!(seen.matches(own).count(), 2, "temporary files: {seen}");
        for denied in ["connect TCP", "listen TCP"] {
            assert!(seen.contains(&format!("{denied}: {refused}\n")), "{denied}: {seen}");
        }
        assert!(seen.contains("signal parent: Operation not permitted\n"), "{seen}");
        assert!(seen.contains("memory parent: Permission denied\n"), "{seen}");
        server.process.signal_device("KILL");
    }
    println!("{seen}");
}

/// The driver is in a folder of volumes, which is hidden from it.
#[test]
fn a_driver_that_cannot_be_loaded_when_confined_is_used_without_confinement_and_logged() {
    let vendors = std::env::var_os("OCL_ICD_VENDORS").map_or("/etc/OpenCL/vendors".into(), PathBuf::from);
    let Ok(drivers) = std::fs::read_dir(vendors) else {
        return eprintln!("not tested: the drivers are not named in a folder");
    };
    if landlock_version() < 1 {
        return eprintln!("not tested: the kernel has no Landlock");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (volumes, log) = (folder.path().join("volumes"), folder.path().join("log"));
    let hidden = volumes.join("vendors");
    std::fs::create_dir_all(&hidden).expect("a folder");
    for driver in drivers {
        let driver = driver.expect("an entry");
        std::fs::copy(driver.path(), hidden.join(driver.file_name())).expect("copied");
    }
    ball::write(&volumes.join("ball.npy"));
    let environment = [("OCL_ICD_VENDORS", &*hidden)];
    let Some(server) = process::start_logged_in(&[volumes], &[], &environment, "warn", &log) else {
        return;
    };
    let body = json!({"volume": demo::ID, "iso": 100, "format": "stl", "triangles": 1000});
    assert_eq!(http::post_json(server.address, "/api/v1/extract", &body).status, 200);
    let log = std::fs::read_to_string(log).expect("text");
    assert!(log.contains("by a process that is not confined"), "{log}");
}

/// The server ends, and its device's process with it, however it ends.
#[test]
fn no_process_is_left_behind() {
    for signal in ["TERM", "KILL"] {
        let Some(server) = process::start(&[], &[]) else { return };
        let id = server.device_process().expect("a process");
        server.signal(signal);
        server.ended_within(Duration::from_secs(5));
        let start = Instant::now();
        while std::fs::exists(format!("/proc/{id}/exe")).unwrap_or(false) {
            assert!(start.elapsed() < Duration::from_secs(5), "{signal}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn the_device_can_be_used_by_the_server_itself() {
    let Some(server) = process::start(&[], &["--in-process"]) else {
        return;
    };
    assert_eq!(server.device_process(), None);
    let body = json!({"volume": demo::ID, "iso": 100, "format": "stl", "triangles": 1000});
    assert_eq!(http::post_json(server.address, "/api/v1/extract", &body).status, 200);
}
