//! Batch jobs that are interrupted and continue: commands that end, servers that restart while clients watch, disks that are full.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::jobs::{Setting, extraction, files_below, finished, request, submit};
use crate::support::{command, http, process, server};

/// Longest wait for anything that should happen soon.
const LIMIT: Duration = Duration::from_secs(60);
/// Extractions of a job: many more than are made before it is interrupted for the last time.
const EXTRACTIONS: usize = 100;
/// Extractions of a job that is watched: a server that restarts makes extractions for a second before the watching client reconnects.
const WATCHED_EXTRACTIONS: usize = 400;

#[track_caller]
fn wait_until(mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < LIMIT, "not within {LIMIT:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn extractions(count: usize) -> Vec<Value> {
    (0..count).map(|n| extraction((n % 16) as f64 / 4.0, "stl")).collect()
}

/// Identity of the file of each extraction's result (file and time of writing): a rewritten file differs in one of them.
type Made = BTreeMap<usize, (u64, i64, i64)>;

fn made(path: &Path) -> Option<(u64, i64, i64)> {
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.ino(), metadata.mtime(), metadata.mtime_nsec()))
}

/// Results in the folders of jobs.
fn results(folder: &Path) -> Made {
    let jobs = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let files = jobs.flat_map(|job| std::fs::read_dir(job.path()).into_iter().flatten().flatten());
    let numbered = files.filter_map(|file| {
        let number = file.file_name().to_str()?.parse().ok()?;
        Some((number, made(&file.path())?))
    });
    numbered.collect()
}

fn batch(file: &Path, output: &Path) -> Child {
    Command::new(command::binary())
        .arg("batch")
        .arg(file)
        .arg("-o")
        .arg(output)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts")
}

#[test]
fn a_batch_that_is_interrupted_goes_on_and_makes_nothing_anew() {
    if !server::has_device() {
        return;
    }
    let setting = Setting::new();
    let file = setting.folder.path().join("request.json");
    let request = json!({"volume": "ball.npy", "extractions": extractions(EXTRACTIONS)});
    std::fs::write(&file, request.to_string()).expect("written");
    let output = setting.folder.path().join("out");
    let folder = output.join(".isopeel-batch/results");
    let mut known = Made::new();
    for signal in ["INT", "TERM", "KILL"] {
        let child = batch(&file, &output);
        wait_until(|| results(&folder).len() >= known.len() + 3);
        let kill = ["-s", signal, &child.id().to_string()].map(str::to_owned);
        assert!(Command::new("kill").args(kill).status().expect("kill runs").success());
        let ended = child.wait_with_output().expect("a child");
        let said = String::from_utf8_lossy(&ended.stderr);
        match signal {
            "KILL" => assert_eq!(ended.status.code(), None, "{said}"),
            _ => assert!(
                said.contains("interrupted, the same command goes on"),
                "{}: {said}",
                ended.status
            ),
        }
        let mut now = results(&folder);
        // It is unknown whether the last one was recorded.
        now.pop_last();
        for (n, before) in &known {
            assert_eq!(now.get(n), Some(before), "extraction {n}");
        }
        known = now;
        assert!((2..EXTRACTIONS - 1).contains(&known.len()), "{} were made", known.len());
    }
    let ended = batch(&file, &output).wait_with_output().expect("a child");
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    for (n, before) in &known {
        let path = output.join(format!("{n:05}.stl"));
        assert_eq!(made(&path).as_ref(), Some(before), "extraction {n} was made anew");
    }
    assert_eq!(
        files_below(&output),
        EXTRACTIONS + 1,
        "all of them and the manifest, and no state"
    );
}

/// Proxy between clients and a server that restarts at another address; records the bytes of both sides.
struct Proxy {
    address: SocketAddr,
    to: Arc<Mutex<SocketAddr>>,
    asked: Arc<Mutex<Vec<u8>>>,
    answered: Arc<Mutex<Vec<u8>>>,
}

impl Proxy {
    fn new(to: SocketAddr) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let proxy = Self {
            address: listener.local_addr().expect("an address"),
            to: Arc::new(Mutex::new(to)),
            asked: Arc::default(),
            answered: Arc::default(),
        };
        let (to, asked, answered) = (proxy.to.clone(), proxy.asked.clone(), proxy.answered.clone());
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let address = *to.lock().expect("not poisoned");
                // Dropping it breaks the client's connection.
                let Ok(server) = TcpStream::connect(address) else {
                    continue;
                };
                let clone = |stream: &TcpStream| stream.try_clone().expect("a handle");
                copy(clone(&client), clone(&server), asked.clone());
                copy(server, client, answered.clone());
            }
        });
        proxy
    }

    /// The numbers after a name at the beginning of lines.
    fn numbers(log: &Mutex<Vec<u8>>, name: &str) -> Vec<i64> {
        let log = log.lock().expect("not poisoned");
        let text = String::from_utf8_lossy(&log);
        let values = text.lines().filter_map(|line| line.strip_prefix(name));
        values.filter_map(|value| value.trim().parse().ok()).collect()
    }
}

/// Copies until either end closes, and closes both.
fn copy(mut from: TcpStream, mut to: TcpStream, log: Arc<Mutex<Vec<u8>>>) {
    std::thread::spawn(move || {
        let mut bytes = vec![0; 1 << 16];
        while let Ok(read @ 1..) = from.read(&mut bytes) {
            log.lock().expect("not poisoned").extend(&bytes[..read]);
            if to.write_all(&bytes[..read]).is_err() {
                break;
            }
        }
        from.shutdown(Shutdown::Both).ok();
        to.shutdown(Shutdown::Both).ok();
    });
}

#[test]
fn who_watches_a_job_goes_on_where_a_server_starts_again() {
    let setting = Setting::new();
    let Some(mut server) = setting.server() else { return };
    let answer = submit(server.address, &request(&extractions(WATCHED_EXTRACTIONS)), "k");
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    let proxy = Proxy::new(server.address);
    let url = format!("http://{}", proxy.address);
    let watched = std::thread::spawn(move || command::succeed(["jobs", "--server", &url, "watch", &id]));
    let (mut seen, mut resumed) = (0, Vec::new());
    for signal in ["TERM", "KILL"] {
        wait_until(|| Proxy::numbers(&proxy.answered, "id:").len() >= seen + 3);
        server.signal(signal);
        server.ended_within(LIMIT);
        let ids = Proxy::numbers(&proxy.answered, "id:");
        (seen, resumed) = (ids.len(), [resumed, ids[ids.len() - 1..].to_vec()].concat());
        server = setting.server().expect("a device, as before");
        *proxy.to.lock().expect("not poisoned") = server.address;
    }
    let said = watched.join().expect("the command succeeds");
    assert!(
        said.contains(&format!("{WATCHED_EXTRACTIONS}/{WATCHED_EXTRACTIONS} done")),
        "{said}"
    );
    let ids = Proxy::numbers(&proxy.answered, "id:");
    assert!(ids.is_sorted_by(|a, b| a < b), "no event twice: {ids:?}");
    // One when it was submitted, one when it began, and one for each extraction.
    assert_eq!(ids.len(), WATCHED_EXTRACTIONS + 2, "no event is left out: {ids:?}");
    // A server that ends may be asked once more.
    let asked = Proxy::numbers(&proxy.asked, "last-event-id:");
    assert!(asked.is_sorted() && asked[0] == 0, "{asked:?}");
    for last in resumed {
        assert!(asked.contains(&last), "{last} is the last one that was seen: {asked:?}");
    }
}

/// Returns the library that makes a disk full if a file says so.
fn full_disk(folder: &Path) -> PathBuf {
    let (source, shim) = (
        concat!(env!("CARGO_MANIFEST_DIR"), "/../server/src/jobs/faults.c"),
        folder.join("faults.so"),
    );
    let mut compiler = Command::new("cc");
    compiler
        .args(["-shared", "-fPIC", "-O1", source, "-o"])
        .arg(&shim)
        .arg("-ldl");
    assert!(compiler.status().expect("a compiler").success());
    shim
}

#[test]
fn a_job_that_a_full_disk_stops_says_so_and_goes_on() {
    let setting = Setting::new();
    let folder = setting.folder.path().canonicalize().expect("a folder");
    let (shim, full, state) = (full_disk(&folder), folder.join("full"), folder.join("state"));
    let environment = [
        ("LD_PRELOAD", &*shim),
        ("FAULT_FOLDER", &*state),
        ("FAULT_FULL", &*full),
    ];
    let options = ["--state-folder", state.to_str().expect("UTF-8"), "--no-demo"];
    let volumes = std::slice::from_ref(&setting.volume);
    let Some(server) = process::start_in(volumes, &options, &environment) else {
        return;
    };
    let address = server.address;
    let id = submit(address, &request(&extractions(EXTRACTIONS)), "k").json()["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    let path = format!("/api/v1/jobs/{id}");
    let follow = || {
        let path = format!("{path}/events");
        std::thread::spawn(move || String::from_utf8(http::get(address, &path).body).expect("text"))
    };
    let before = follow();
    wait_until(|| http::get(address, &path).json()["extractions"]["done"].as_u64() >= Some(2));
    std::fs::write(&full, "").expect("written");
    wait_until(|| http::get(address, &path).json()["paused"] == "disk-full");
    let job = http::get(address, &path).json();
    assert_eq!(job["state"], "running", "{job}");
    assert!(job["extractions"]["done"].as_u64() < Some(EXTRACTIONS as u64), "{job}");
    // A client that connects during the pause is notified too.
    let during = follow();
    std::thread::sleep(Duration::from_millis(500));
    std::fs::remove_file(&full).expect("removed");
    let job = finished(address, &id);
    assert_eq!(
        (&job["state"], &job["extractions"]["done"]),
        (&json!("done"), &json!(EXTRACTIONS))
    );
    assert_eq!(job.get("paused"), None, "{job}");
    for followed in [before, during] {
        told_of_a_pause(&followed.join().expect("events"));
    }
}

/// Checks the events of a job that stood still once.
fn told_of_a_pause(text: &str) {
    let events: Vec<&str> = text.split("\n\n").filter(|event| event.contains("data:")).collect();
    let data = |event: &str| -> Value {
        let line = event.lines().find_map(|line| line.strip_prefix("data:")).expect("data");
        serde_json::from_str(line).expect("JSON")
    };
    let has_id = |event: &str| event.lines().any(|line| line.starts_with("id:"));
    let is_pause = |event: &&str| event.lines().any(|line| line.trim() == "event: paused");
    let pause = events
        .iter()
        .position(|event| is_pause(event) && data(event)["paused"] == "disk-full");
    let pause = pause.unwrap_or_else(|| panic!("no pause in {text}"));
    assert_eq!(
        (has_id(events[pause]), &data(events[pause])["state"]),
        (false, &json!("running")),
        "{text}"
    );
    let end = events[pause..]
        .iter()
        .find(|event| !has_id(event) && data(event).get("paused").is_none());
    let end = end.unwrap_or_else(|| panic!("nothing says that it goes on: {text}"));
    assert!(end.lines().any(|line| line.trim() == "event: running"), "{end}");
    let with_ids = events.iter().filter(|event| has_id(event)).count();
    assert_eq!(with_ids, EXTRACTIONS + 2, "all others are there: {text}");
    assert!(
        events.last().is_some_and(|event| event.contains("event: done")),
        "{text}"
    );
}

/// While a server drains, `/readyz` tells load balancers to use other servers, and each request is still answered. Requests that run at the
/// end of this period get the same time again.
#[test]
fn a_server_that_drains_breaks_no_request_and_ends_in_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball.npy");
    crate::support::ball::write(&volume);
    let Some(process) = process::start(&[volume], &["--drain", "10", "--demo"]) else {
        return;
    };
    let address = process.address;
    let small = json!({"volume": "ball", "iso": 0.5, "format": "stl"});
    let large = |iso: f64| json!({"volume": "mni152", "iso": iso, "format": "stl", "triangles": 20_000});
    // Its volume is there, so that the later one is made at once.
    assert_eq!(http::post_json(address, "/api/v1/extract", &large(90.0)).status, 200);
    let start = Instant::now();
    process.signal("TERM");
    std::thread::sleep(Duration::from_millis(100));
    let mut answered = 0;
    while start.elapsed() < Duration::from_millis(1500) {
        let code = http::get(address, "/readyz").problem(503);
        assert_eq!(code, "busy");
        assert_eq!(http::get(address, "/healthz").status, 200);
        assert_eq!(http::post_json(address, "/api/v1/extract", &small).status, 200);
        answered += 1;
    }
    assert!(answered > 0, "{answered} requests");
    // The listener closes after five seconds: even on a busy machine these requests begin before that.
    let running: Vec<_> = (0..3)
        .map(|n| {
            std::thread::spawn(move || http::post_json(address, "/api/v1/extract", &large(80.0 + f64::from(n))).status)
        })
        .collect();
    for request in running {
        assert_eq!(request.join().expect("an answer"), 200);
    }
    assert!(process.ended_within(Duration::from_secs(10)).success());
    assert!(start.elapsed() < Duration::from_secs(12), "{:?}", start.elapsed());
}
