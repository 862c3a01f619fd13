//! Tokens for people and programs, created while a server runs: their roles, the ownership of jobs, and their expiry.

use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use isopeel_client::{Connection, Error};
use serde_json::json;

use crate::jobs::{Setting, extraction, request};
use crate::support::viewer::status;
use crate::support::{command, http, process};

/// Runs `isopeel token create`; returns the token.
fn create(state: &Path, user: &str, options: &[&str]) -> String {
    let state = state.to_str().expect("UTF-8");
    let arguments = ["token", "create", "--state-folder", state, "--user", user];
    let printed = command::succeed(arguments.iter().chain(options));
    let token = printed.trim().to_owned();
    assert!(token.starts_with("isop_") && token.lines().count() == 1, "{printed}");
    token
}

fn id(token: &str) -> &str {
    token.split('_').nth(1).expect("an id")
}

fn ask(address: SocketAddr, method: &str, path: &str, token: &str, body: &str) -> http::Answer {
    let bearer = format!("Bearer {token}");
    let headers = [("authorization", bearer.as_str()), ("content-type", "application/json")];
    http::send(address, method, path, &headers, body.as_bytes()).expect("an answer")
}

/// Waits until the server knows a token, or does not know it any more.
fn until_status(address: SocketAddr, token: &str, status: u16) {
    let start = Instant::now();
    while ask(address, "GET", "/api/v1/session", token, "").status != status {
        assert!(start.elapsed() < Duration::from_secs(5), "not yet {status}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

async fn connect(address: SocketAddr, token: &str) -> Result<Connection, Error> {
    let bearer = format!("Bearer {token}");
    Connection::connect_with(address, "", &[("authorization", &bearer)]).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_for_its_roles_and_until_it_is_revoked() {
    let setting = Setting::new();
    let state = setting.state();
    let before = create(&state, "ann", &["--role", "view", "--role", "export"]);
    let options = ["--state-folder", state.to_str().expect("UTF-8"), "--no-demo"];
    let Some((server, printed)) = process::launch(std::slice::from_ref(&setting.volume), &options) else {
        return;
    };
    let address = server.address;
    // The token of the start still allows everything.
    let start = printed.split("/#token=").nth(1).expect("a token").to_owned();
    assert_eq!(ask(address, "GET", "/api/v1/memory", &start, "").status, 200);
    // One that was there before, and one that is made while the server runs.
    until_status(address, &before, 200);
    let bob = create(&state, "bob", &["--role", "export", "--expires", "1h"]);
    until_status(address, &bob, 200);
    assert_eq!(ask(address, "GET", "/api/v1/volumes", &bob, "").status, 200);
    let refused = ask(address, "GET", "/api/v1/volumes/ball/slices?axis=x&index=0", &bob, "");
    assert_eq!(refused.problem(403), "forbidden");
    assert_eq!(status(connect(address, &bob).await), Some(403));
    assert_eq!(
        ask(address, "GET", "/api/v1/memory", &before, "").problem(403),
        "forbidden"
    );
    let wrong = format!("{}x", &bob[..bob.len() - 1]);
    assert_eq!(
        ask(address, "GET", "/api/v1/volumes", &wrong, "").problem(401),
        "unauthorized"
    );

    // Jobs are their users'.
    let body = request(&[extraction(0.0, "stl")]).to_string();
    let job = ask(address, "POST", "/api/v1/jobs", &bob, &body);
    assert_eq!(job.status, 201);
    let path = format!("/api/v1/jobs/{}", job.json()["id"].as_str().expect("an id"));
    assert_eq!(ask(address, "GET", &path, &bob, "").status, 200);
    for other in [&before, &start] {
        assert_eq!(ask(address, "GET", &path, other, "").problem(404), "unknown-job");
        assert_eq!(ask(address, "GET", "/api/v1/jobs", other, "").json(), json!([]));
    }
    let bobs_other = create(&state, "bob", &["--role", "export"]);
    until_status(address, &bobs_other, 200);
    assert_eq!(ask(address, "GET", &path, &bobs_other, "").status, 200);

    // The list has no secrets, and revoking a token closes its connections.
    let mut viewer = connect(address, &before).await.expect("who may look connects");
    let listed = command::succeed(["token", "list", "--json", "--state-folder", options[1]]);
    assert!(listed.contains(id(&before)) && !listed.contains("sha256"), "{listed}");
    let plain = command::succeed(["token", "list", "--state-folder", options[1]]);
    for (text, token) in [(&listed, &before), (&plain, &bob)] {
        // The secret may have an underscore itself.
        assert!(!text.contains(token.splitn(3, '_').nth(2).expect("a secret")), "{text}");
    }
    let revoked = Instant::now();
    command::succeed(["token", "revoke", "--state-folder", options[1], id(&before)]);
    assert_eq!(close_code_of_revoked(&mut viewer).await, Some(4004));
    assert!(revoked.elapsed() < Duration::from_secs(5), "{:?}", revoked.elapsed());
    assert_eq!(
        ask(address, "GET", "/api/v1/volumes", &before, "").problem(401),
        "unauthorized"
    );
    assert_eq!(ask(address, "GET", "/api/v1/volumes", &bob, "").status, 200);
}

/// A page of another origin, whose browser sends neither header nor cookie with a stream.
#[tokio::test(flavor = "multi_thread")]
async fn a_ticket_opens_one_stream_and_is_in_no_log() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("log");
    let page = ("origin", "https://viewer.example");
    let Some((server, printed)) = process::launch_logged(&[], &["--allow-origin", page.1], "debug", &log) else {
        return;
    };
    let address = server.address;
    let token = printed.split("/#token=").nth(1).expect("a token");
    let bearer = format!("Bearer {token}");
    let issue =
        |headers: &[(&str, &str)]| http::send(address, "POST", "/api/v1/tickets", headers, b"").expect("an answer");
    assert_eq!(issue(&[page]).problem(401), "unauthorized");
    let evil = ("origin", "https://evil.example");
    assert_eq!(
        issue(&[("authorization", &bearer), evil]).problem(403),
        "foreign-origin"
    );
    let ticket = || {
        let made = issue(&[("authorization", &bearer), page]);
        assert_eq!((made.status, made.header("cache-control")), (201, "no-store"));
        assert_eq!(made.header("access-control-allow-origin"), page.1);
        let made = made.json();
        assert_eq!(made["expiresSeconds"], 30);
        made["ticket"].as_str().expect("a ticket").to_owned()
    };
    let (first, second) = (ticket(), ticket());
    let open = async |ticket: &str, headers: &[(&'static str, &str)]| {
        status(Connection::connect_with(address, &format!("?ticket={ticket}"), headers).await)
    };
    assert_eq!(open(&first, &[page]).await, None);
    assert_eq!(open(&first, &[page]).await, Some(401), "used");
    assert_eq!(open(&second, &[evil]).await, Some(403), "a page that may not");
    assert_eq!(open(&second, &[]).await, Some(401), "another page's");
    assert_eq!(open(&second, &[page]).await, None, "others do not use it up");
    assert_eq!(open("", &[page]).await, Some(401));
    let path = format!("/api/v1/volumes?ticket={}", ticket());
    let answer = http::send(address, "GET", &path, &[page], b"").expect("an answer");
    assert_eq!(answer.problem(401), "unauthorized", "for streams alone");
    server.signal("TERM");
    assert!(server.ended_within(Duration::from_secs(10)).success());
    let logged = std::fs::read_to_string(&log).expect("a log");
    assert!(logged.contains("/api/v1/stream"), "requests are logged: {logged}");
    for secret in [first.as_str(), &second, token] {
        assert!(!logged.contains(secret), "{logged}");
    }
}

/// A token for a frame, from the server of a site that has one itself.
#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_lent_is_for_less_and_ends_with_the_lenders() {
    let setting = Setting::new();
    let state = setting.state();
    let site = create(&state, "site", &["--role", "edit", "--role", "export"]);
    let folder = state.to_str().expect("UTF-8");
    let options = [
        "--state-folder",
        folder,
        "--no-demo",
        "--embed-origin",
        "https://lab.example",
    ];
    let Some((server, _)) = process::launch(std::slice::from_ref(&setting.volume), &options) else {
        return;
    };
    let address = server.address;
    until_status(address, &site, 200);
    let named = http::send(address, "GET", "/api/v1/embed", &[], b"").expect("an answer");
    assert_eq!(named.json(), json!({"origins": ["https://lab.example"]}));
    let lend = |token: &str, body: &str| ask(address, "POST", "/api/v1/embed-tokens", token, body);
    for (body, status, code) in [
        (r#"{"roles": ["export"]}"#, 400, "bad-embed-token"),
        (r#"{"seconds": 3601}"#, 400, "bad-embed-token"),
        (r#"{"second": 60}"#, 400, "bad-json"),
    ] {
        assert_eq!(lend(&site, body).problem(status), code, "{body}");
    }
    let made = lend(&site, "{}");
    assert_eq!((made.status, made.header("cache-control")), (201, "no-store"));
    let made = made.json();
    assert_eq!(
        (&made["roles"], &made["expiresSeconds"]),
        (&json!(["view"]), &json!(600))
    );
    let lent = made["token"].as_str().expect("a token");
    let session = ask(address, "GET", "/api/v1/session", lent, "").json();
    assert_eq!(session["roles"], json!(["view"]));
    assert!(
        session["expiresSeconds"]
            .as_u64()
            .is_some_and(|seconds| (590..=600).contains(&seconds))
    );
    assert_eq!(ask(address, "GET", "/api/v1/volumes", lent, "").status, 200);
    let surface = json!({"volume": "ball", "iso": 0, "format": "stl"}).to_string();
    assert_eq!(
        ask(address, "POST", "/api/v1/extract", lent, &surface).problem(403),
        "forbidden"
    );
    assert_eq!(lend(lent, "{}").problem(403), "forbidden");
    let exchanged = http::post_json(address, "/api/v1/session", &json!({"token": lent}));
    assert_eq!(exchanged.problem(403), "lent-token");

    let ticket = ask(address, "POST", "/api/v1/tickets", lent, "").json();
    let query = format!("?ticket={}", ticket["ticket"].as_str().expect("a ticket"));
    let connected = Connection::connect_with(address, &query, &[]).await;
    let mut viewer = connected.expect("a stream");
    command::succeed(["token", "revoke", "--state-folder", folder, id(&site)]);
    assert_eq!(close_code_of_revoked(&mut viewer).await, Some(4004));
    assert_eq!(
        ask(address, "GET", "/api/v1/volumes", lent, "").problem(401),
        "unauthorized"
    );
}

/// The code with which a stream is closed; the only message before states that its token is not valid any more.
async fn close_code_of_revoked(viewer: &mut Connection) -> Option<u16> {
    loop {
        match viewer.next_message().await {
            Err(Error::Closed(code)) => return code,
            message => assert_eq!(message.expect("no error")["code"], "unauthorized"),
        }
    }
}

#[test]
fn a_role_that_is_for_nothing_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().join("state");
    let state = state.to_str().expect("UTF-8");
    let said = |role: &str| {
        let made = command::run([
            "token",
            "create",
            "--state-folder",
            state,
            "--user",
            "ann",
            "--role",
            role,
        ]);
        assert!(made.status.success());
        String::from_utf8(made.stderr).expect("UTF-8")
    };
    assert!(said("push").contains("the role push is for nothing"));
    assert!(!said("upload").contains("for nothing"));
}

#[test]
fn tokens_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().join("state");
    let state = state.to_str().expect("UTF-8");
    let refused = |arguments: &[&str]| command::fail([&["token"], arguments, &["--state-folder", state]].concat());
    assert!(refused(&["create", "--user", "ann"]).contains("--role"));
    assert!(refused(&["create", "--user", "a b", "--role", "view"]).contains("expected 1 to 64"));
    assert!(refused(&["create", "--user", "ann", "--role", "root"]).contains("expected view, edit"));
    assert!(refused(&["create", "--user", "ann", "--role", "view", "--expires", "soon"]).contains("such as 30d"));
    assert!(refused(&["revoke", "0123456789ab"]).contains("no token has the id"));
    assert!(command::fail(["token", "list"]).contains("expected --state-folder DIR"));
}
