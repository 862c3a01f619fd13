//! A server with batch jobs that is killed at random moments: no job is lost, and none exists twice.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::jobs::{Setting, checksum, extracted, extraction, files_below, finished, request};
use crate::support::http;
use crate::support::process::{self, Process};

/// Kills; `ISOPEEL_KILLS` has another number.
const KILLS: usize = 5;
/// Longest life of a server: its device is ready after a tenth to a half of that.
const LIFE: Duration = Duration::from_millis(2_500);
/// Longest wait for anything that a server should do soon.
const LIMIT: Duration = Duration::from_secs(60);
/// Extractions of the first job for each kill: as many as a life makes.
const EXTRACTIONS_PER_KILL: usize = 12;

/// Numbers that are the same in each run (Knuth's MMIX generator).
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// Six surfaces in two formats, so that each is made many times.
fn extractions(count: usize) -> Vec<Value> {
    let one = |n: usize| extraction((n % 6) as f64, if n.is_multiple_of(2) { "stl" } else { "ply" });
    (0..count).map(one).collect()
}

fn start(setting: &Setting) -> Option<Process> {
    let state = setting.state();
    let options = [
        "--no-auth",
        "--no-demo",
        "--state-folder",
        state.to_str().expect("UTF-8"),
    ];
    Some(process::begin(std::slice::from_ref(&setting.volume), &options)?.0)
}

/// Submits a job under its own key; returns its id, or `None` if the server ends before it answers.
fn submit(address: SocketAddr, key: &str, request: &Value) -> Option<String> {
    let headers = [("content-type", "application/json"), ("idempotency-key", key)];
    let body = request.to_string();
    let answer = http::send(address, "POST", "/api/v1/jobs", &headers, body.as_bytes())?;
    // Others are being accepted, or the device is not open yet.
    (answer.status != 503).then(|| {
        answer.json()["id"]
            .as_str()
            .unwrap_or_else(|| panic!("{}", answer.json()))
            .to_owned()
    })
}

/// Extractions that are done, of all jobs.
fn done(address: SocketAddr) -> u64 {
    let Some(answer) = http::send(address, "GET", "/api/v1/jobs", &[], b"") else {
        return 0;
    };
    let jobs = answer.json();
    let jobs = jobs.as_array().expect("a list").iter();
    jobs.map(|job| job["extractions"]["done"].as_u64().expect("a number"))
        .sum()
}

/// Runs a server until it is killed, and submits a job meanwhile; adds the ids of acknowledged jobs. `made`: extractions done when the
/// previous server began; returns those done when this one began.
fn live_and_die(
    setting: &Setting,
    random: &mut Random,
    jobs: &[(String, Value)],
    known: &mut HashMap<String, String>,
    made: Option<u64>,
) -> Option<u64> {
    let server = start(setting)?;
    let address = server.address;
    let life = Duration::from_millis(random.below(LIFE.as_millis() as u64));
    let before = done(address);
    std::thread::scope(|scope| {
        let submitted = scope.spawn(|| {
            let acknowledged = jobs
                .iter()
                .filter_map(|(key, request)| Some((key.clone(), submit(address, key, request)?)));
            acknowledged.collect::<Vec<_>>()
        });
        if made == Some(before) {
            // The previous server made no progress: an extraction may have been killed twice, and so be at its last attempt. Wait until one
            // is done, because failing after three attempts is intended and not the subject of this test.
            let start = Instant::now();
            while done(address) == before {
                assert!(start.elapsed() < LIMIT, "a server that lives makes nothing");
                std::thread::sleep(Duration::from_millis(10));
            }
        }
        std::thread::sleep(life);
        // SIGKILL.
        drop(server);
        for (key, id) in submitted.join().expect("no panic") {
            let first = known.entry(key.clone()).or_insert_with(|| id.clone());
            assert_eq!(*first, id, "{key} is one job");
        }
    });
    Some(before)
}

#[test]
fn kills_lose_nothing_and_double_nothing() {
    let kills = std::env::var("ISOPEEL_KILLS").map_or(KILLS, |text| text.parse().expect("a number of kills"));
    let setting = Setting::new();
    let mut random = Random(2013);
    let mut requests = vec![("long".to_owned(), request(&extractions(EXTRACTIONS_PER_KILL * kills)))];
    let mut known = HashMap::new();
    let mut made = None;
    for kill in 0..kills {
        requests.push((format!("short-{kill}"), request(&extractions(2))));
        // The latest, and the long one until it is known.
        let from = if known.contains_key("long") {
            requests.len() - 1
        } else {
            0
        };
        let began = live_and_die(&setting, &mut random, &requests[from..], &mut known, made);
        if began.is_none() {
            return;
        }
        made = began;
    }

    let server = start(&setting).expect("a device, as before");
    let address = server.address;
    check_jobs(address, &requests, &known);
    let expected: usize = requests
        .iter()
        .map(|(_, request)| request["extractions"].as_array().expect("a list").len())
        .sum();
    assert_eq!(
        files_below(&setting.state().join("results")),
        expected,
        "one file for each extraction"
    );
    // A server that is asked to end has time until its deadline, and leaves the same state.
    submit(address, "last", &request(&extractions(200))).expect("accepted");
    server.signal("TERM");
    assert!(server.ended_within(Duration::from_secs(3)).success());
    let server = start(&setting).expect("a device, as before");
    let last = submit(server.address, "last", &request(&extractions(200))).expect("the same job");
    let job = finished(server.address, &last);
    assert_eq!(
        (&job["state"], &job["extractions"]["done"]),
        (&"done".into(), &200.into()),
        "{job}"
    );
}

/// Checks that each request is one job with all results, and that their bytes are those of an undisturbed extraction.
fn check_jobs(address: SocketAddr, requests: &[(String, Value)], known: &HashMap<String, String>) {
    let mut bytes = HashMap::new();
    for (key, request) in requests {
        let start = Instant::now();
        let id = loop {
            if let Some(id) = submit(address, key, request) {
                break id;
            }
            assert!(start.elapsed() < LIMIT, "{key} is not accepted");
            std::thread::sleep(Duration::from_millis(50));
        };
        assert!(known.get(key).is_none_or(|first| *first == id), "{key} is one job");
        let job = finished(address, &id);
        assert_eq!(job["state"], "done", "{key}: {job}");
        for (n, extraction) in request["extractions"].as_array().expect("a list").iter().enumerate() {
            let expected = bytes
                .entry(extraction.to_string())
                .or_insert_with(|| extracted(address, extraction));
            let result = http::get(address, &format!("/api/v1/jobs/{id}/results/{n}"));
            assert_eq!(result.status, 200);
            assert_eq!(
                result.header("etag"),
                format!("\"{}\"", checksum(expected)),
                "{key} {n}"
            );
            assert!(result.body == *expected, "{key} {n}");
        }
    }
    let jobs = http::get(address, "/api/v1/jobs").json();
    assert_eq!(
        jobs.as_array().map(Vec::len),
        Some(requests.len()),
        "no job is there twice"
    );
}
