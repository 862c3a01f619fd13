//! The audit log, and the rate limits of clients, which are distinguished by the address that their proxy sends.

use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::jobs::{Setting, extraction, request};
use crate::support::{command, http, process};

/// The lines of an audit log, once there are as many as expected; without their times.
fn lines(log: &Path, count: usize) -> Vec<Value> {
    let start = Instant::now();
    loop {
        let text = std::fs::read_to_string(log).unwrap_or_default();
        // The last line may be half written.
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
        let lines = whole.lines().map(|line| {
            let mut line: Value = serde_json::from_str(line).expect("JSON");
            assert!(
                line["time"].take().as_str().is_some_and(|time| time.ends_with('Z')),
                "{line}"
            );
            line.as_object_mut().expect("an object").remove("time");
            line
        });
        let lines: Vec<Value> = lines.collect();
        if lines.len() >= count {
            return lines;
        }
        assert!(
            start.elapsed() < Duration::from_secs(5),
            "{count} lines expected: {text}"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

struct Client {
    address: SocketAddr,
    /// Client address, as the proxy states it.
    peer: &'static str,
    bearer: String,
}

impl Client {
    fn ask(&self, method: &str, path: &str, body: &str) -> http::Answer {
        let headers = [
            ("x-forwarded-for", self.peer),
            ("authorization", self.bearer.as_str()),
            ("content-type", "application/json"),
        ];
        http::send(self.address, method, path, &headers, body.as_bytes()).expect("an answer")
    }
}

#[test]
fn who_has_done_what_is_written_down_without_secrets_and_names() {
    let setting = Setting::new();
    let (state, log) = (setting.state(), setting.folder.path().join("audit"));
    let [state, path] = [&state, &log].map(|path| path.to_str().expect("UTF-8"));
    let options = [
        "--no-demo",
        "--state-folder",
        state,
        "--audit-log",
        path,
        "--trusted-proxy",
        "127.0.0.1",
    ];
    let Some((server, printed)) = process::launch(std::slice::from_ref(&setting.volume), &options) else {
        return;
    };
    let token = printed.split("/#token=").nth(1).expect("a token");
    let operator = Client {
        address: server.address,
        peer: "192.0.2.7",
        bearer: format!("Bearer {token}"),
    };
    assert_eq!(operator.ask("GET", "/api/v1/volumes/ball", "").status, 200);
    let sign_in = operator.ask("POST", "/api/v1/session", &json!({"token": token}).to_string());
    assert_eq!(sign_in.status, 204);
    let mut export = extraction(0.0, "stl");
    export["volume"] = json!("ball");
    assert_eq!(operator.ask("POST", "/api/v1/extract", &export.to_string()).status, 200);
    let job = operator.ask("POST", "/api/v1/jobs", &request(&[extraction(0.0, "stl")]).to_string());
    assert_eq!(job.status, 201);
    let job = job.json()["id"].as_str().expect("an id").to_owned();
    let stranger = Client {
        bearer: "Bearer of-another-server-altogether-0123456789".to_owned(),
        peer: "6.6.6.6, 192.0.2.8",
        ..operator
    };
    assert_eq!(stranger.ask("GET", "/api/v1/volumes/ball", "").status, 401);
    let who = |event: &str, result: &str, status: u16, rest: Value| {
        let mut line = json!({"event": event, "result": result, "status": status, "peer": "192.0.2.7"});
        line.as_object_mut()
            .expect("an object")
            .append(rest.clone().as_object_mut().expect("an object"));
        line
    };
    let operator = json!({"user": "operator", "token": "start"});
    let expected = [
        who("sign-in", "ok", 204, operator.clone()),
        who("export", "ok", 200, operator.clone()),
        who(
            "job-submit",
            "ok",
            201,
            json!({"user": "operator", "token": "start", "job": job}),
        ),
        who(
            "request",
            "refused",
            401,
            json!({"code": "unauthorized", "peer": "192.0.2.8"}),
        ),
    ];
    assert_eq!(lines(&log, 4), expected);

    // Creation and revocation of tokens, in a new file.
    let moved = setting.folder.path().join("audit.1");
    std::fs::rename(&log, &moved).expect("moved");
    server.signal("HUP");
    std::thread::sleep(Duration::from_millis(200));
    let made = command::succeed([
        "token",
        "create",
        "--state-folder",
        state,
        "--user",
        "ann",
        "--role",
        "view",
    ]);
    let id = made.split('_').nth(1).expect("an id");
    let of_token = |event: &str| json!({"event": event, "result": "ok", "user": "ann", "token": id});
    assert_eq!(lines(&log, 1), [of_token("token-created")]);
    command::succeed(["token", "revoke", "--state-folder", state, id]);
    assert_eq!(lines(&log, 2)[1], of_token("token-revoked"));
    assert_eq!(lines(&moved, 4).len(), 4);
    for text in [&log, &moved].map(|path| std::fs::read_to_string(path).expect("text")) {
        assert!(
            !text.contains("ball") && !text.contains(token) && !text.contains(made.trim()),
            "{text}"
        );
    }
}

#[test]
fn who_asks_too_often_waits_and_others_do_not() {
    let options = [
        "--rate-peer",
        "50",
        "--rate-token",
        "3",
        "--trusted-proxy",
        "127.0.0.0/8",
    ];
    let Some((server, printed)) = process::launch(&[], &options) else {
        return;
    };
    let token = printed.split("/#token=").nth(1).expect("a token");
    let client = |peer, token: &str| Client {
        address: server.address,
        peer,
        bearer: format!("Bearer {token}"),
    };
    // A client that guesses tokens has five tries in a burst, and then one in two seconds.
    let guesser = client("192.0.2.1", &"x".repeat(43));
    let tries = (0..20).find(|_| guesser.ask("GET", "/api/v1/session", "").status == 429);
    assert!(tries.is_some_and(|tries| (4..=6).contains(&tries)), "{tries:?}");
    let refused = guesser.ask("GET", "/api/v1/session", "");
    assert_eq!(refused.problem(429), "too-many-requests");
    let wait: u64 = refused.header("retry-after").parse().expect("seconds");
    assert!((1..=4).contains(&wait), "{wait}");
    // No other client has to wait, at the same address or another one.
    for peer in ["192.0.2.1", "192.0.2.2"] {
        assert_eq!(
            client(peer, token).ask("GET", "/api/v1/session", "").status,
            200,
            "{peer}"
        );
    }
    // The limit of a token holds for all addresses together.
    let peers = ["192.0.2.3", "192.0.2.4", "2001:db8::1"];
    let tries = (0..100).find(|&i| client(peers[i % 3], token).ask("GET", "/api/v1/session", "").status == 429);
    assert!(tries.is_some_and(|tries| (27..=60).contains(&tries)), "{tries:?}");
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(
        client("192.0.2.3", token).ask("GET", "/api/v1/session", "").status,
        200,
        "it has waited"
    );
}
