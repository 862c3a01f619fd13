//! Metrics of the server, and the names of edits and options in its log.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener};

use serde_json::{Value, json};

use crate::jobs::{Setting, extraction, finished, request, submit};
use crate::support::viewer::{Frame, Viewer};
use crate::support::{command, http, process};

/// Returns an address on which no server listens.
fn free_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("an address");
    listener.local_addr().expect("an address")
}

/// Value of each series, by its name with labels.
fn series(text: &str) -> BTreeMap<&str, f64> {
    let lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let parsed = lines.map(|line| {
        let (name, value) = line.rsplit_once(' ').unwrap_or_else(|| panic!("{line}"));
        (name, value.parse().unwrap_or_else(|_| panic!("{line}")))
    });
    parsed.collect()
}

/// Sum of the series of a name, whatever their other labels.
fn sum(series: &BTreeMap<&str, f64>, name: &str, label: &str) -> f64 {
    let of_name = series.iter().filter(|(key, _)| {
        let (own, labels) = key.split_once('{').unwrap_or((key, ""));
        own == name && labels.contains(label)
    });
    of_name.map(|(_, value)| value).sum()
}

/// Answer of `GET /metrics` at an address.
pub fn metrics_of(address: SocketAddr) -> String {
    String::from_utf8(http::get(address, "/metrics").body).expect("UTF-8")
}

/// The same of what `GET /metrics` has answered.
pub fn counted(text: &str, name: &str, label: &str) -> f64 {
    sum(&series(text), name, label)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_happens_is_counted_without_names() {
    let setting = Setting::new();
    let (state, metrics) = (setting.state(), free_address());
    let listen = metrics.to_string();
    let options = [
        "--state-folder",
        state.to_str().expect("UTF-8"),
        "--no-demo",
        "--metrics-listen",
        &listen,
    ];
    let Some(server) = process::start(std::slice::from_ref(&setting.volume), &options) else {
        return;
    };
    let address = server.address;
    let text = || metrics_of(metrics);
    let before = text();
    assert_eq!(sum(&series(&before), "isopeel_edits_total", ""), 0.0);

    let mut viewer = Viewer::open(address, "ball").await;
    viewer.send(json!({"type": "edit", "alpha": 2})).await;
    let refused = viewer.next().await;
    assert!(
        matches!(&refused, Frame::Error { code, .. } if code == "bad-edit"),
        "{refused:?}"
    );
    viewer.edit(json!({"iso": 0.5})).await;
    viewer.edit(json!({"iso": 1.0})).await;
    let looked = text();
    assert_eq!(sum(&series(&looked), "isopeel_viewers", ""), 1.0);
    viewer.close().await;
    let body = json!({"volume": "ball", "iso": 0, "format": "stl"});
    assert_eq!(http::post_json(address, "/api/v1/extract", &body).status, 200);
    assert_eq!(
        http::get(address, "/api/v1/volumes/none").problem(404),
        "unknown-volume"
    );
    let job = submit(address, &request(&[extraction(0.0, "stl")]), "a").json();
    finished(address, job["id"].as_str().expect("an id"));

    let answer = http::get(metrics, "/metrics");
    assert_eq!(answer.content_type, "text/plain; version=0.0.4; charset=utf-8");
    let text = text();
    let after = series(&text);
    for (name, label, minimum) in [
        ("isopeel_http_requests_total", r#"route="/api/v1/extract""#, 1.0),
        ("isopeel_http_requests_total", r#"status="404""#, 1.0),
        (
            "isopeel_http_request_seconds_count",
            r#"route="/api/v1/volumes/{id}""#,
            1.0,
        ),
        ("isopeel_problems_total", r#"code="unknown-volume""#, 1.0),
        ("isopeel_stream_errors_total", r#"code="bad-edit""#, 1.0),
        ("isopeel_streams_total", r#"outcome="served""#, 1.0),
        ("isopeel_stream_sent_bytes_total", r#"kind="chunk""#, 10_000.0),
        ("isopeel_edits_total", "", 2.0),
        ("isopeel_edit_first_commit_seconds_count", "", 2.0),
        ("isopeel_edit_done_seconds_count", "", 2.0),
        ("isopeel_device_stage_seconds_count", r#"stage="construct""#, 2.0),
        ("isopeel_device_job_seconds_count", r#"caller="viewer""#, 2.0),
        ("isopeel_device_job_wait_seconds_count", r#"length="export""#, 1.0),
        ("isopeel_cache_requests_total", r#"what="pyramid",result="miss""#, 2.0),
        ("isopeel_batch_jobs", r#"state="done""#, 1.0),
        ("isopeel_memory_bytes", r#"owner="volumes""#, 48.0 * 40.0 * 44.0 * 4.0),
        ("process_resident_memory_bytes", "", 1e7),
        ("isopeel_build_info", "version", 1.0),
    ] {
        let found = sum(&after, name, label);
        assert!(
            found >= minimum,
            "{name} {label}: {found}, expected {minimum} or more in\n{text}"
        );
    }
    assert_eq!(sum(&after, "isopeel_viewers", ""), 0.0, "{text}");
    assert!(!text.contains("ball"), "{text}");
    // There is nothing else at that address but health, and the server's own has them too.
    assert_eq!(http::get(metrics, "/healthz").status, 200);
    assert_eq!(http::get(metrics, "/readyz").status, 200);
    assert_eq!(http::get(metrics, "/api/v1/volumes").status, 404);
    assert_eq!(http::get(address, "/metrics").status, 200);
}

/// Memory summed over all owners equals that of the process, within a fifth.
#[tokio::test(flavor = "multi_thread")]
async fn memory_is_told_by_what_holds_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("waves.npy");
    crate::support::ball::write_field(&volume, [200, 200, 200], |at| {
        (0.2 * at[0]).sin() + (0.15 * at[1]).sin() + (0.1 * at[2]).sin()
    });
    let Some(server) = process::start(&[volume], &["--no-demo"]) else {
        return;
    };
    let mut viewer = Viewer::open(server.address, "waves").await;
    viewer.edit_and_rest(json!({"iso": 0.3, "maxError": "auto"})).await;
    let answer = http::get(server.address, "/metrics");
    let text = String::from_utf8(answer.body).expect("UTF-8");
    let found = series(&text);
    let (owners, resident) = (
        sum(&found, "isopeel_memory_bytes", ""),
        sum(&found, "process_resident_memory_bytes", ""),
    );
    // On a GPU the volume is elsewhere.
    let memory = http::get(server.address, "/api/v1/memory").json();
    if memory["isHostMemory"] == json!(true) {
        assert!((owners / resident - 1.0).abs() < 0.2, "{owners} of {resident}\n{text}");
    }
    viewer.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_has_its_trace_in_a_log_of_json() {
    let folder = tempfile::tempdir().expect("a folder");
    let (log, file) = (folder.path().join("log"), folder.path().join("isopeel.toml"));
    // What is there of it comes before the file.
    std::fs::write(&file, "no-auth = true\nrate-peer = 1\n").expect("a file");
    let options = [
        "--log-format",
        "json",
        "--config",
        file.to_str().expect("UTF-8"),
        "--rate-peer",
        "0",
    ];
    let Some((server, line)) = process::launch_logged(&[], &options, "debug", &log) else {
        return;
    };
    assert!(!line.contains("token="), "{line}");
    let mut viewer = Viewer::open(server.address, "mni152").await;
    viewer.send(json!({"type": "edit", "beta": 0.03})).await;
    let trace = loop {
        if let Frame::Done { trace, .. } = viewer.next().await {
            break trace;
        }
    };
    assert_eq!(trace.len(), 16, "{trace}");
    viewer.close().await;
    drop(server);
    let text = std::fs::read_to_string(&log).expect("a log");
    let lines: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let of_edit = lines.iter().filter(|line| line["trace"] == trace.as_str());
    let said: Vec<_> = of_edit
        .map(|line| line["message"].as_str().unwrap_or_default())
        .collect();
    assert!(said.contains(&"a surface is done"), "{said:?} in\n{text}");
    // The device's lines, too.
    let of_job = |line: &&Value| line["message"] == "a job has ended" && line["span"]["trace"] == trace.as_str();
    assert!(lines.iter().filter(of_job).count() > 0, "{text}");
}

#[test]
fn a_wrong_file_of_options_is_refused_with_its_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("isopeel.toml");
    std::fs::write(&file, "lisen = \"127.0.0.1:0\"\n").expect("a file");
    let said = command::fail(["serve", "--config", file.to_str().expect("UTF-8")]);
    assert!(
        said.contains("isopeel.toml: lisen is no option of isopeel serve, expected one of paths, listen"),
        "{said}"
    );
}
