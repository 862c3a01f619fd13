//! Batch jobs of a running server: their results, and how they are watched, refused, cancelled and deleted; the commands for them.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::process::{self, Process};
use crate::support::{ball, command, http, server};

/// Longest wait for a job of these tests.
const LIMIT: Duration = Duration::from_secs(120);

/// A folder with a volume and place for a server's state.
pub struct Setting {
    pub folder: tempfile::TempDir,
    pub volume: PathBuf,
}

impl Setting {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let volume = folder.path().join("ball.npy");
        ball::write_field(&volume, [48, 40, 44], |at| {
            let [u, v, w] = [at[0] - 24.0, at[1] - 20.0, at[2] - 22.0];
            16.0 + (0.6 * u).sin() - (u * u + v * v + w * w).sqrt()
        });
        Self { folder, volume }
    }

    pub fn state(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    pub fn server(&self) -> Option<Process> {
        let state = self.state();
        let options = ["--state-folder", state.to_str().expect("UTF-8"), "--no-demo"];
        process::start(std::slice::from_ref(&self.volume), &options)
    }
}

/// An extraction of the ball.
pub fn extraction(iso: f64, format: &str) -> Value {
    json!({"iso": iso, "format": format, "error": "0.1vx"})
}

pub fn request(extractions: &[Value]) -> Value {
    json!({"volume": "ball", "extractions": extractions})
}

pub fn submit(address: SocketAddr, request: &Value, key: &str) -> http::Answer {
    let headers = [("content-type", "application/json"), ("idempotency-key", key)];
    // An empty one has no key.
    let headers = if key.is_empty() { &headers[..1] } else { &headers };
    let body = request.to_string();
    http::send(address, "POST", "/api/v1/jobs", headers, body.as_bytes()).expect("an answer")
}

/// Waits until a job is finished.
pub fn finished(address: SocketAddr, id: &str) -> Value {
    let start = Instant::now();
    loop {
        let job = http::get(address, &format!("/api/v1/jobs/{id}")).json();
        if !["queued", "running"].contains(&job["state"].as_str().expect("a state")) {
            return job;
        }
        assert!(start.elapsed() < LIMIT, "still {job}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// SHA-256 in hexadecimal.
pub fn checksum(bytes: &[u8]) -> String {
    use sha2::Digest;
    sha2::Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// Answer of `POST extract` to an extraction of a job.
pub fn extracted(address: SocketAddr, extraction: &Value) -> Vec<u8> {
    let mut request = extraction.clone();
    request["volume"] = json!("ball");
    let answer = http::post_json(address, "/api/v1/extract", &request);
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    answer.body
}

/// Events as they were sent: id, name and data.
fn events(address: SocketAddr, id: &str, after: &str) -> (u16, Vec<(i64, String, Value)>) {
    let path = format!("/api/v1/jobs/{id}/events");
    let answer = http::send(address, "GET", &path, &[("last-event-id", after)], b"").expect("an answer");
    let text = String::from_utf8(answer.body).expect("text");
    let field = |event: &str, name: &str| -> String {
        let line = event.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap_or_else(|| panic!("{name} in {event:?}")).trim().to_owned()
    };
    let parse = |event: &str| {
        let data = serde_json::from_str(&field(event, "data:")).expect("JSON");
        (
            field(event, "id:").parse().expect("a number"),
            field(event, "event:"),
            data,
        )
    };
    let events = text.split("\n\n").filter(|event| event.contains("data:"));
    (answer.status, events.map(parse).collect())
}

#[test]
fn a_job_makes_what_extract_does_and_keeps_it() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let address = server.address;
    let extractions = [
        extraction(1.0, "ply"),
        extraction(2.0, "stl"),
        extraction(3.0, "vtp"),
        extraction(4.0, "glb"),
        extraction(5.0, "ply"),
    ];
    let answer = submit(address, &request(&extractions), "first");
    assert_eq!(answer.status, 201, "{}", String::from_utf8_lossy(&answer.body));
    let job = answer.json();
    let id = job["id"].as_str().expect("an id").to_owned();
    assert_eq!(answer.header("location"), format!("/api/v1/jobs/{id}"));
    for cost in ["triangles", "bytes", "seconds"] {
        assert!(job["estimate"][cost].as_f64() > Some(0.0), "{cost}: {job}");
    }

    // The stream ends with the job.
    let (status, all) = events(address, &id, "0");
    assert_eq!(status, 200);
    assert!(all.is_sorted_by(|a, b| a.0 < b.0), "{all:?}");
    let names: Vec<&str> = all.iter().map(|(_, name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        ["queued", "running", "running", "running", "running", "running", "done"]
    );
    let last = &all.last().expect("events").2;
    assert_eq!(
        last["extractions"],
        json!({"total": 5, "done": 5, "failed": 0, "empty": 0}),
        "{last}"
    );
    let (_, rest) = events(address, &id, &all[2].0.to_string());
    assert_eq!(rest, all[3..], "resumed");
    assert_eq!(events(address, &id, &all[6].0.to_string()).0, 204, "nothing more comes");

    let job = finished(address, &id);
    assert_eq!(
        (&job["state"], &job["extractions"]["done"]),
        (&json!("done"), &json!(5))
    );
    let mut bytes = 0;
    for (n, extraction) in extractions.iter().enumerate() {
        let result = http::get(address, &format!("/api/v1/jobs/{id}/results/{n}"));
        assert_eq!(result.status, 200);
        assert_eq!(result.header("etag"), format!("\"{}\"", checksum(&result.body)));
        let named = format!("attachment; filename=\"{n:05}-{}.", n + 1);
        assert!(result.header("content-disposition").starts_with(&named), "{named}");
        assert!(result.body == extracted(address, extraction), "result {n}");
        bytes += result.body.len() as u64;
    }
    assert_eq!(job["bytes"], bytes);
    assert!(
        job["estimate"]["bytes"].as_u64() >= Some(bytes),
        "an upper bound: {job}"
    );
    ranges(address, &format!("/api/v1/jobs/{id}/results/1"));

    assert_eq!(submit(address, &request(&extractions), "first").json()["id"], job["id"]);
    let other = submit(address, &request(&extractions[1..]), "first");
    assert_eq!(other.problem(409), "key-reused");
    assert_eq!(
        http::get(address, "/api/v1/jobs").json().as_array().map(Vec::len),
        Some(1)
    );
    assert_eq!(
        http::get(address, &format!("/api/v1/jobs/{id}/results/5")).problem(404),
        "no-result"
    );

    let second = command::fail(
        ["serve", "--listen", "127.0.0.1:0", "--state-folder"]
            .map(String::from)
            .into_iter()
            .chain([setting.state().display().to_string()]),
    );
    assert!(second.contains("is used by another server"), "{second}");

    let path = format!("/api/v1/jobs/{id}");
    let delete = || http::send(address, "DELETE", &path, &[], b"").expect("an answer");
    assert_eq!(delete().status, 204);
    assert_eq!(delete().problem(404), "unknown-job");
    assert_eq!(files_below(&setting.state().join("results")), 0);
}

/// Files in a folder and below.
pub fn files_below(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path());
    entries
        .map(|path| if path.is_dir() { files_below(&path) } else { 1 })
        .sum()
}

fn ranges(address: SocketAddr, path: &str) {
    let whole = http::get(address, path);
    let etag = whole.header("etag");
    let part = |headers: &[(&str, &str)]| http::send(address, "GET", path, headers, b"").expect("an answer");
    let length = whole.body.len();
    let middle = part(&[("range", "bytes=100-199")]);
    assert_eq!(
        (middle.status, middle.header("content-range")),
        (206, format!("bytes 100-199/{length}").as_str())
    );
    assert!(middle.body == whole.body[100..200]);
    let tail = part(&[("range", "bytes=-7"), ("if-range", etag)]);
    assert!(tail.status == 206 && tail.body == whole.body[length - 7..]);
    let of_another = part(&[("range", "bytes=0-1"), ("if-range", "\"another\"")]);
    assert!(of_another.status == 200 && of_another.body == whole.body);
    let beyond = part(&[("range", &format!("bytes={length}-"))]);
    assert_eq!(
        (beyond.problem(416).as_str(), beyond.header("content-range")),
        ("bad-range", format!("bytes */{length}").as_str())
    );
    assert_eq!(part(&[("if-none-match", etag)]).status, 304);
}

#[test]
fn bad_jobs_are_refused_by_name_and_others_can_be_cancelled() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let address = server.address;
    let refused = |request: &Value, status: u16, code: &str, said: &str| {
        let answer = submit(address, request, "k");
        assert_eq!(answer.problem(status), code, "{request}");
        let detail = answer.json()["detail"].as_str().expect("a detail").to_owned();
        assert!(detail.contains(said), "{detail}");
    };
    let good = extraction(1.0, "stl");
    refused(&request(&[]), 422, "bad-job", "0 extractions, expected 1 to 10000");
    refused(
        &request(&vec![good.clone(); 10_001]),
        422,
        "bad-job",
        "10001 extractions",
    );
    refused(
        &json!({"volume": "cube", "extractions": [good]}),
        404,
        "unknown-volume",
        "\"cube\"",
    );
    let late = json!({"iso": 1, "format": "stl", "step": 3});
    refused(
        &request(&[good.clone(), late]),
        404,
        "unknown-step",
        "extraction 1: step 3",
    );
    let alpha = json!({"iso": 1, "format": "stl", "alpha": 7});
    refused(&request(&[good.clone(), alpha]), 422, "bad-edit", "extraction 1: alpha");
    let unknown = json!({"iso": 1, "format": "stl", "isovalue": 7});
    refused(&request(&[unknown]), 400, "bad-json", "unknown field `isovalue`");
    assert_eq!(
        submit(address, &request(std::slice::from_ref(&good)), "a b").problem(400),
        "bad-request"
    );

    let many: Vec<Value> = (0..2_000).map(|n| extraction(f64::from(n) / 400.0, "stl")).collect();
    let id = submit(address, &request(&many), "many").json()["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    let path = format!("/api/v1/jobs/{id}");
    assert_eq!(
        http::send(address, "DELETE", &path, &[], b"")
            .expect("an answer")
            .problem(409),
        "job-not-finished"
    );
    let start = Instant::now();
    while http::get(address, &path).json()["extractions"]["done"].as_u64() < Some(2) {
        assert!(start.elapsed() < LIMIT);
        std::thread::sleep(Duration::from_millis(20));
    }
    let cancel = || http::send(address, "POST", &format!("{path}/cancel"), &[], b"").expect("an answer");
    assert_eq!(cancel().json()["state"], "cancelled");
    assert_eq!(cancel().problem(409), "job-finished");
    let done = http::get(address, &path).json()["extractions"]["done"].clone();
    assert_eq!(
        http::get(address, &format!("{path}/results/0")).status,
        200,
        "what was made stays"
    );
    assert_eq!(
        http::get(address, &format!("{path}/results/1999")).problem(404),
        "no-result"
    );
    // The next one runs at once.
    let next = submit(address, &request(&[good]), "next").json()["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    assert_eq!(finished(address, &next)["state"], "done");
    assert_eq!(
        http::get(address, &path).json()["extractions"]["done"],
        done,
        "nothing of it is made any more"
    );
}

/// In place: a file that is written from its start is empty for a moment.
fn flip_last_byte(path: &Path) {
    let mut file = File::options().read(true).write(true).open(path).expect("the volume");
    let mut byte = [0];
    file.seek(SeekFrom::End(-1))
        .and_then(|_| file.read_exact(&mut byte))
        .expect("read");
    file.seek(SeekFrom::End(-1))
        .and_then(|_| file.write_all(&[!byte[0]]))
        .expect("written");
}

#[test]
fn an_input_that_changes_ends_the_job() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let address = server.address;
    let many: Vec<Value> = (0..2_000).map(|n| extraction(f64::from(n) / 400.0, "stl")).collect();
    let id = submit(address, &request(&many), "many").json()["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    flip_last_byte(&setting.volume);
    let job = finished(address, &id);
    assert_eq!(
        (&job["state"], &job["error"]["code"]),
        (&json!("failed"), &json!("input-changed")),
        "{job}"
    );
    // If the clock of the file system has not advanced meanwhile, only the content shows the change.
    let detail = job["error"]["detail"].as_str().expect("a text");
    let expected =
        ["it was written", "its content changed"].map(|how| format!("ball.npy: {how} since the job was submitted"));
    assert!(expected.iter().any(|text| text == detail), "{detail}");
    // The samples that the server has read differ from the file now.
    let again = submit(address, &request(&[extraction(1.0, "stl")]), "again");
    assert_eq!(again.problem(409), "input-changed");
}

#[test]
fn without_a_state_folder_the_missing_option_is_named() {
    let Some(address) = server::shared() else { return };
    for answer in [
        http::get(address, "/api/v1/jobs"),
        http::get(address, "/api/v1/jobs/x/events"),
        http::post_json(address, "/api/v1/jobs", &request(&[extraction(1.0, "stl")])),
    ] {
        assert_eq!(answer.problem(501), "jobs-off");
        assert!(
            answer.json()["detail"]
                .as_str()
                .is_some_and(|detail| detail.contains("--state-folder DIR"))
        );
    }
}

#[test]
fn the_commands_submit_watch_fetch_and_delete() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let url = format!("http://{}", server.address);
    let jobs = |arguments: &[&str]| command::succeed(["jobs", "--server", &url].iter().chain(arguments));
    let extractions = [extraction(1.0, "ply"), extraction(2.0, "stl")];
    let file = setting.folder.path().join("request.json");
    std::fs::write(&file, request(&extractions).to_string()).expect("written");
    let file = file.to_str().expect("UTF-8");
    let id = jobs(&["submit", file, "--key", "k"]).trim().to_owned();
    assert_eq!(jobs(&["submit", file, "--key", "k"]).trim(), id);
    let watched = jobs(&["watch", &id]);
    assert!(watched.starts_with(&id) && watched.contains("2/2 done"), "{watched}");
    assert_eq!(jobs(&["list"]), watched);
    let folder = setting.folder.path().join("results");
    jobs(&["fetch", &id, "-o", folder.to_str().expect("UTF-8")]);
    for (name, extraction) in ["00000.ply", "00001.stl"].iter().zip(&extractions) {
        let fetched = std::fs::read(folder.join(name)).expect("a result");
        assert!(fetched == extracted(server.address, extraction), "{name}");
    }
    let finished = command::fail(["jobs", "--server", &url, "cancel", &id]);
    assert!(
        finished.contains("is done, expected one that is queued or running (job-finished)"),
        "{finished}"
    );
    jobs(&["delete", &id]);
    assert_eq!(jobs(&["list"]), "");
    let gone = command::fail(["jobs", "--server", &url, "watch", &id]);
    assert!(gone.contains("(unknown-job)"), "{gone}");
    drop(server);
    let unreachable = command::fail(["jobs", "--server", &url, "list"]);
    assert!(unreachable.contains(&format!("no answer from {url}")), "{unreachable}");
}

#[test]
fn the_commands_show_the_token_and_say_what_is_above_the_quota() {
    let setting = Setting::new();
    let path = |name: &str| setting.folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (token, state, file) = (path("token"), path("state"), path("request.json"));
    std::fs::write(&token, "0123456789abcdef0123456789abcdef\n").expect("written");
    let volumes = std::slice::from_ref(&setting.volume);
    let options = ["--state-folder", &state, "--job-quota", "1", "--token-file", &token];
    let Some((server, _)) = process::launch(volumes, &options) else {
        return;
    };
    let url = format!("http://{}", server.address);
    let refused = command::fail(["jobs", "--server", &url, "list"]);
    assert!(refused.contains("(unauthorized)"), "{refused}");
    let arguments = ["jobs", "--server", &url, "--token-file", &token];
    assert_eq!(command::succeed(arguments.iter().chain(&["list"])), "");
    let many = vec![extraction(1.0, "stl"); 1_000];
    std::fs::write(&file, request(&many).to_string()).expect("written");
    let refused = command::fail(arguments.iter().chain(&["submit", &file]));
    assert!(
        refused.contains("1048576 of the quota of 1048576 are left") && refused.contains("(over-quota)"),
        "{refused}"
    );
}

#[test]
fn a_request_file_above_the_limit_is_refused_with_both_sizes() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("request.json");
    let bytes = request(&[extraction(1.0, "stl")]).to_string();
    std::fs::write(&file, &bytes).expect("written");
    // The request is followed by blanks: cut at the limit, it would be valid.
    let with_length = |length: usize| {
        let padded = bytes.clone() + &" ".repeat(length - bytes.len());
        std::fs::write(&file, padded).expect("written");
    };
    // No server listens on this port.
    let submit = ["jobs", "--server", "http://127.0.0.1:9", "submit"].map(std::ffi::OsStr::new);
    let batch = ["batch", "-o", "/nowhere"].map(std::ffi::OsStr::new);
    for arguments in [&submit[..], &batch] {
        let run = || command::fail(arguments.iter().copied().chain([file.as_os_str()]));
        with_length((8 << 20) + 1);
        let refused = run();
        assert!(
            refused.contains("it has 8388609 bytes, a request has 8388608 or fewer"),
            "{refused}"
        );
        with_length(8 << 20);
        let accepted = run();
        assert!(!accepted.contains("8388608"), "{accepted}");
    }
    let refused = command::fail(submit.into_iter().chain(["/dev/zero".as_ref()]));
    assert!(refused.contains("it has more than 8388608 bytes"), "{refused}");
}

/// The lines of a folder's manifest.
pub fn manifest(folder: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join("manifest.jsonl")).expect("a manifest");
    let lines = text.lines();
    lines.map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

#[test]
fn a_surface_without_triangles_is_noted_in_a_job_and_written_where_that_is_asked_for() {
    let setting = Setting::new();
    let Some(server) = setting.server() else { return };
    let address = server.address;
    let url = format!("http://{address}");
    let nothing = extraction(400.0, "stl");
    let mut written = nothing.clone();
    written["allowEmpty"] = json!(true);
    let submitted = |extractions: &[Value]| {
        let id = submit(address, &request(extractions), "").json()["id"].clone();
        finished(address, id.as_str().expect("an id"))
    };
    let job = submitted(&[nothing.clone(), extraction(1.0, "stl"), written]);
    assert_eq!(
        (&job["state"], &job["extractions"]),
        (&json!("done"), &json!({"total": 3, "done": 2, "failed": 0, "empty": 1})),
        "{job}"
    );
    let path = format!("/api/v1/jobs/{}/results", job["id"].as_str().expect("an id"));
    let entries = http::get(address, &path).json();
    assert_eq!(
        (&entries[0]["state"], &entries[2]["triangles"]),
        (&json!("empty"), &json!(0))
    );
    assert_eq!(http::get(address, &format!("{path}/0")).problem(404), "no-result");
    assert_eq!(http::get(address, &format!("{path}/2")).body.len(), 84);
    let folder = setting.folder.path().join("fetched");
    let id = job["id"].as_str().expect("an id");
    command::succeed([
        "jobs",
        "--server",
        &url,
        "fetch",
        id,
        "-o",
        folder.to_str().expect("UTF-8"),
    ]);
    let fetched = manifest(&folder);
    assert_eq!(
        (fetched.len(), &fetched[0]["problem"]["code"]),
        (3, &json!("empty-surface"))
    );
    assert_eq!(files_below(&folder), 3, "two surfaces and the manifest");

    let job = submitted(&[nothing.clone(), nothing]);
    assert_eq!(
        (&job["state"], &job["error"]["code"]),
        (&json!("failed"), &json!("empty-surface")),
        "{job}"
    );
}
