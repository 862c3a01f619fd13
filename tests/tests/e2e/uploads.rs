//! Uploads over HTTP as a program or a tus client sends them: interrupted by kills, with hostile names, false sizes and full quotas, and
//! from two owners who do not see each other's volumes.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use isopeel_client::Connection;
use serde_json::{Value, json};

use crate::jobs::{checksum, extraction};
use crate::support::uploader::{PART, Setting, User, declared, send_half};
use crate::support::{command, http, process, repository};

/// Waits for something that comes soon.
fn until(what: &str, is_true: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_true() {
        assert!(start.elapsed() < Duration::from_secs(10), "not yet: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn only_lock(folder: &Path) -> bool {
    let names = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name());
    names.collect::<Vec<_>>() == ["lock"]
}

#[test]
fn an_upload_goes_on_after_lost_connections_and_kills() {
    let setting = Setting::new();
    let (volume, roles) = (&setting.volume, ["--no-auth", "--no-demo", "--uploads"]);
    let options = [roles[0], roles[1], roles[2], &setting.path("uploads")];
    let begin = || {
        let server = process::launch(&[], &options)?.0;
        let user = User {
            address: server.address,
            bearer: String::new(),
        };
        Some((server, user))
    };
    let Some((mut server, mut user)) = begin() else { return };
    let path = user.create(&[("scan/ball.npy", volume.len())]);
    let mut sent = 0;
    for part in [3_000, 20_000, 50_000] {
        // A fraction of a part arrives, and then the server is killed.
        let lost = send_half(&user, &path, sent, part, &volume[sent..sent + part / 2]);
        until("half a part", || {
            let there = user.get(&path).json()["receivedBytes"].as_u64().expect("a number");
            there == (sent + part / 2) as u64
        });
        server.signal("KILL");
        drop((server, lost));
        (server, user) = begin().expect("a server");
        let there = user.offset(&path);
        assert_eq!(there, sent + part / 2, "what the server has said to have");
        assert_eq!(user.send(&path, there, &volume[there..sent + part]).status, 204);
        sent += part;
        assert_eq!(user.offset(&path), sent);
    }
    // A connection that hangs: a request for the offset ends it, and the bytes that it has brought count.
    let hanging = send_half(&user, &path, sent, 2_000, &volume[sent..sent + 1_000]);
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(user.offset(&path), sent + 1_000);
    drop(hanging);
    sent += 1_000;
    assert_eq!(
        user.send(&path, sent, &volume[sent..]).header("upload-offset"),
        volume.len().to_string()
    );
    let finished = user.finish(&path).json();
    let id = finished["volumes"][0].as_str().expect("an id").to_owned();
    let kept = Path::new(&options[3])
        .join(finished["id"].as_str().expect("an id"))
        .join("files/scan/ball.npy");
    assert_eq!(checksum(&std::fs::read(kept).expect("a file")), checksum(volume));
    // The volume exists, and after a restart it is unchanged.
    let shown = user.get(&format!("/api/v1/volumes/{id}")).json();
    assert_eq!(
        (&shown["title"], &shown["geometry"]["dims"]),
        (&json!("ball"), &json!([30, 28, 26]))
    );
    server.signal("KILL");
    drop(server);
    let (_server, user) = begin().expect("a server");
    assert_eq!(user.volumes(), [id.as_str()]);
    assert_eq!(user.get(&format!("/api/v1/volumes/{id}")).json(), shown);
}

#[test]
fn what_is_declared_is_checked_and_what_is_sent_is_held_to_it() {
    let setting = Setting::new();
    let Some((_server, [ann, bob], _)) = setting.server(&["--upload-quota", "1"]) else {
        return;
    };
    let folder = setting.folder.path().join("uploads");
    for hostile in [
        "../../etc/cron.d/x",
        "/etc/passwd",
        "a\u{0}b",
        "a/../../b",
        "nul\nline",
        "..\\..\\x",
        "\u{202e}dcm.exe",
    ] {
        let answer = ann.post("/api/v1/uploads", &declared(&[(hostile, 5)]));
        assert_eq!(answer.problem(422), "bad-upload", "{hostile:?}");
    }
    let quota = ann.post("/api/v1/uploads", &declared(&[("a.npy", (1 << 20) + 1)]));
    assert_eq!(quota.problem(413), "over-quota");
    assert!(
        quota.json()["detail"]
            .as_str()
            .expect("text")
            .contains("expected at most 1048576")
    );
    let body = json!({"files": [{"name": "a.npy", "bytes": -5}]});
    assert_eq!(ann.post("/api/v1/uploads", &body).problem(400), "bad-json");
    assert!(only_lock(&folder), "nothing is stored");

    // Ann's declared files alone take half of the quota.
    let path = ann.create(&[("a.npy", 600_000)]);
    let over = ann.post("/api/v1/uploads", &declared(&[("b.npy", 600_000)]));
    assert_eq!(over.problem(413), "over-quota");
    bob.create(&[("b.npy", 600_000)]);
    // A body that says that it is longer, one that only is, one from elsewhere, and one of another kind.
    assert_eq!(ann.send(&path, 0, &vec![0; 600_001]).problem(413), "over-declared");
    assert_eq!(ann.offset(&path), 0, "nothing is stored");
    let mut tcp = TcpStream::connect(ann.address).expect("the server listens");
    let head = format!(
        "PATCH {path} HTTP/1.1\r\nHost: {}\r\nAuthorization: {}\r\nContent-Type: {PART}\r\nUpload-Offset: 0\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n",
        ann.address, ann.bearer
    );
    tcp.write_all(head.as_bytes()).expect("written");
    for _ in 0..7 {
        tcp.write_all(b"186a0\r\n").expect("written");
        tcp.write_all(&vec![1; 100_000]).expect("written");
        tcp.write_all(b"\r\n").expect("written");
    }
    tcp.write_all(b"0\r\n\r\n").expect("written");
    let mut answer = String::new();
    tcp.read_to_string(&mut answer).expect("an answer");
    assert!(
        answer.starts_with("HTTP/1.1 413") && answer.contains("over-declared"),
        "{answer}"
    );
    let there = ann.offset(&path);
    assert!(there <= 600_000, "{there}");
    assert_eq!(ann.ask("DELETE", &path, &[], b"").status, 204);
    let path = ann.create(&[("a.npy", 600_000)]);
    assert_eq!(ann.send(&path, 0, &[0; 10]).header("upload-offset"), "10");
    assert_eq!(ann.send(&path, 9, b"").problem(409), "wrong-offset");
    let wrong = [("content-type", "application/octet-stream"), ("upload-offset", "0")];
    assert_eq!(
        ann.ask("PATCH", &path, &wrong, b"x").problem(415),
        "unsupported-media-type"
    );
    assert_eq!(
        ann.ask("PATCH", &path, &[("content-type", PART)], b"x").problem(400),
        "bad-request"
    );
    let newer = [
        ("content-type", PART),
        ("upload-offset", "0"),
        ("tus-resumable", "2.0.0"),
    ];
    let newer = ann.ask("PATCH", &path, &newer, b"x");
    assert_eq!(
        (newer.problem(412).as_str(), newer.header("tus-version")),
        ("unsupported-version", "1.0.0")
    );
    assert_eq!(ann.finish(&path).problem(409), "upload-incomplete");
    assert_eq!(ann.ask("DELETE", &path, &[], b"").status, 204);

    // A file that is not a volume gets the same message as from `isopeel serve`.
    let path = ann.create(&[("ball.npy", 100)]);
    assert_eq!(ann.send(&path, 0, &[7; 100]).status, 204);
    let unreadable = ann.finish(&path);
    assert_eq!(unreadable.problem(422), "unreadable-volume");
    let file = setting.folder.path().join("bad/ball.npy");
    std::fs::create_dir(file.parent().expect("a folder")).expect("made");
    std::fs::write(&file, [7; 100]).expect("a file");
    let local = command::fail(["info", file.to_str().expect("UTF-8")]);
    let detail = unreadable.json()["detail"].as_str().expect("text").to_owned();
    assert!(local.contains(&detail), "{detail} in {local}");
    assert_eq!(ann.get(&path).json()["error"], json!(detail));
    // A header whose data would be elsewhere.
    let header = b"ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = ../../../ball.npy\n";
    let path = ann.create(&[("a.mhd", header.len())]);
    assert_eq!(ann.send(&path, 0, header).status, 204);
    assert_eq!(ann.finish(&path).problem(422), "unreadable-volume");
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_sees_what_another_has_brought() {
    let setting = Setting::new();
    let log = setting.path("audit");
    let Some((_server, [ann, bob], operator)) = setting.server(&["--audit-log", &log]) else {
        return;
    };
    let (path, id) = ann.bring("MUSTERMANN-ERIKA.npy", &setting.volume);
    assert!(!id.to_lowercase().contains("mustermann"));
    assert_eq!(ann.volumes(), [id.as_str()]);
    assert_eq!(operator.volumes(), [id.as_str()], "an administrator");
    assert!(bob.volumes().is_empty());
    // The same answers as for volumes that do not exist.
    let nothing = id.replace(|c: char| c.is_ascii_digit(), "0");
    let unknown = |id: &str, answer: &http::Answer| {
        let mut problem = answer.json();
        let detail = problem["detail"].take().as_str().expect("text").replace(id, "ID");
        (answer.status, problem, detail)
    };
    let export = |id: &str| {
        let mut export = extraction(0.0, "stl");
        export["volume"] = json!(id);
        export
    };
    let address = |id: &str| format!("/api/v1/extract?volume={id}&format=stl");
    let had = [("if-none-match", "*")];
    let job = |id: &str| json!({"volume": id, "extractions": [extraction(0.0, "stl")]});
    let (upload, no_upload) = (path.rsplit('/').next().expect("an id"), &nothing["upload-".len()..]);
    for (own, other) in [
        (
            bob.get(&format!("/api/v1/volumes/{id}")),
            bob.get(&format!("/api/v1/volumes/{nothing}")),
        ),
        (
            bob.get(&format!("/api/v1/volumes/{id}/slices?axis=x&index=0")),
            bob.get(&format!("/api/v1/volumes/{nothing}/slices?axis=x&index=0")),
        ),
        (
            bob.post("/api/v1/extract", &export(&id)),
            bob.post("/api/v1/extract", &export(&nothing)),
        ),
        // Even if the client says that it has the file.
        (
            bob.ask("GET", &address(&id), &had, b""),
            bob.ask("GET", &address(&nothing), &had, b""),
        ),
        (
            bob.post("/api/v1/jobs", &job(&id)),
            bob.post("/api/v1/jobs", &job(&nothing)),
        ),
        (bob.get(&path), bob.get(&format!("/api/v1/uploads/{no_upload}"))),
        (bob.finish(&path), bob.finish(&format!("/api/v1/uploads/{no_upload}"))),
        (
            bob.send(&path, 0, b"x"),
            bob.send(&format!("/api/v1/uploads/{no_upload}"), 0, b"x"),
        ),
        (
            bob.ask("DELETE", &path, &[], b""),
            bob.ask("DELETE", &format!("/api/v1/uploads/{no_upload}"), &[], b""),
        ),
    ] {
        let (found, expected) = (unknown(&id, &own), unknown(&nothing, &other));
        let strip = |(status, problem, detail): (u16, Value, String)| (status, problem, detail.replace(upload, "ID"));
        let expected = (expected.0, expected.1, expected.2.replace(no_upload, "ID"));
        assert_eq!(found.0, 404, "{found:?}");
        assert_eq!(strip(found), expected);
    }
    assert_eq!(bob.ask("HEAD", &path, &[], b"").status, 404);
    assert_eq!(bob.get("/api/v1/uploads").json()["uploads"], json!([]));
    let of_all = operator.get("/api/v1/uploads").json();
    assert_eq!(of_all["uploads"][0]["owner"], "ann");
    // Ann's own requests are answered.
    assert_eq!(ann.post("/api/v1/extract", &export(&id)).status, 200);
    assert_eq!(ann.ask("GET", &address(&id), &had, b"").status, 304);
    assert_eq!(ann.post("/api/v1/jobs", &job(&id)).status, 201);

    // On the stream.
    let open = async |user: &User, id: &str| {
        let connected = Connection::connect_with(user.address, "", &[("authorization", &user.bearer)]).await;
        let mut connection = connected.expect("a stream");
        let open = json!({"type": "open", "volume": id});
        connection.send(&open).await.expect("sent");
        connection
    };
    let mut bobs = open(&bob, &id).await;
    let refused = next(&mut bobs).await;
    assert_eq!(
        (&refused["type"], &refused["code"]),
        (&json!("error"), &json!("unknown-volume"))
    );
    let mut anns = open(&ann, &id).await;
    while next(&mut anns).await["type"] != "opened" {}
    // Viewers, jobs and lists are updated when the volume is removed.
    let many: Vec<Value> = (0..2_000).map(|n| extraction(f64::from(n) / 500.0, "stl")).collect();
    let job = ann.post("/api/v1/jobs", &json!({"volume": id, "extractions": many}));
    assert_eq!(job.status, 201, "{}", String::from_utf8_lossy(&job.body));
    let job = job.header("location").to_owned();
    assert_eq!(ann.ask("DELETE", &path, &[], b"").status, 204);
    let told = loop {
        let message = next(&mut anns).await;
        if message["type"] == "error" {
            break message;
        }
    };
    assert_eq!((&told["code"], &told["open"]), (&json!("volume-removed"), &json!(true)));
    anns.send(&json!({"type": "edit", "iso": 1.0})).await.expect("sent");
    assert_eq!(next(&mut anns).await["code"], "not-open");
    assert!(ann.volumes().is_empty());
    assert_eq!(ann.get(&format!("/api/v1/volumes/{id}")).problem(404), "unknown-volume");
    until("the job has failed", || ann.get(&job).json()["state"] == "failed");
    assert_eq!(ann.get(&job).json()["error"]["code"], "unknown-volume");
    until("the files are gone", || {
        only_lock(&setting.folder.path().join("uploads"))
    });

    // The actions are logged, without names.
    until("lines", || {
        std::fs::read_to_string(&log).is_ok_and(|text| text.contains("upload-delete"))
    });
    let text = std::fs::read_to_string(&log).expect("a log");
    for event in ["upload-create", "upload-finish", "upload-delete"] {
        let is_line = |line: &str| line.contains(event) && line.contains(upload) && line.contains("\"ann\"");
        assert!(text.lines().any(is_line), "{event}: {text}");
    }
    assert!(!text.contains("MUSTERMANN"), "{text}");
    let metrics = operator.get("/metrics");
    let metrics = String::from_utf8(metrics.body).expect("text");
    assert!(metrics.contains("isopeel_uploads{state=\"ready\"} 0"), "{metrics}");
    let received = format!("isopeel_upload_received_bytes_total {}", setting.volume.len());
    assert!(
        metrics.contains(&received) && !metrics.contains("MUSTERMANN") && !metrics.contains(&id),
        "{metrics}"
    );
}

/// Returns the next message of a stream; skips chunks.
async fn next(connection: &mut Connection) -> Value {
    let message = tokio::time::timeout(Duration::from_secs(60), connection.next_message()).await;
    message.expect("a message").expect("no error")
}

#[test]
fn what_nobody_uses_expires_and_a_server_without_a_folder_takes_nothing() {
    let setting = Setting::new();
    let Some((server, [ann, _], _)) = setting.server(&["--upload-expiry", "2s", "--upload-timeout", "1s"]) else {
        return;
    };
    let (path, id) = ann.bring("ball.npy", &setting.volume);
    let half = ann.create(&[("half.npy", 10)]);
    assert_eq!(ann.send(&half, 0, b"12345").status, 204);
    until("the half one has expired", || ann.get(&half).status == 404);
    until("the volume has expired", || ann.volumes().is_empty());
    assert_eq!(ann.get(&path).problem(404), "unknown-upload");
    assert_eq!(ann.get(&format!("/api/v1/volumes/{id}")).problem(404), "unknown-volume");
    drop(server);
    // Off is the default; the role alone is not enough, nor is another role.
    let state = setting.path("state");
    let arguments = [
        "token",
        "create",
        "--state-folder",
        &state,
        "--user",
        "eve",
        "--role",
        "edit",
    ];
    let eve = command::succeed(arguments).trim().to_owned();
    let (server, _) = process::launch(&[], &["--state-folder", &state]).expect("a server");
    let user = |bearer: String| User {
        address: server.address,
        bearer,
    };
    let (ann, eve) = (user(ann.bearer), user(format!("Bearer {eve}")));
    let file = declared(&[("a.npy", 5)]);
    assert_eq!(ann.post("/api/v1/uploads", &file).problem(501), "uploads-off");
    assert_eq!(eve.post("/api/v1/uploads", &file).problem(403), "forbidden");
}

/// Files of a fixture, with the names that a browser has for those of a folder that is dropped.
fn files_of(path: &Path, name: &str, files: &mut Vec<(String, Vec<u8>)>) {
    if path.is_file() {
        return files.push((name.to_owned(), std::fs::read(path).expect("a file")));
    }
    let entries = std::fs::read_dir(path)
        .expect("a folder")
        .map(|entry| entry.expect("an entry"));
    for entry in entries {
        let inner = format!("{name}/{}", entry.file_name().to_string_lossy());
        files_of(&entry.path(), &inner, files);
    }
}

#[test]
fn folders_are_what_they_are_on_the_command_line() {
    let setting = Setting::new();
    let Some((_server, [ann, _], _)) = setting.server(&[]) else {
        return;
    };
    let fixtures = repository().join("tests/fixtures/volumes");
    for (what, names) in [
        ("DICOM", &["dicom/ct"][..]),
        ("slices", &["tiff_slices"]),
        ("OME-Zarr", &["image-0.5.ome.zarr"]),
        ("a header and its samples", &["nifti1-pair.hdr", "nifti1-pair.img"]),
        (
            "pieces",
            &[
                "pieces.pvti",
                "pieces_0.vti",
                "pieces_1.vti",
                "pieces_2.vti",
                "pieces_3.vti",
            ],
        ),
    ] {
        let mut files = Vec::new();
        let local = setting.folder.path().join(what);
        for name in names {
            let path = fixtures.join(name);
            let last = path.file_name().expect("a name").to_string_lossy().into_owned();
            files_of(&path, &last, &mut files);
        }
        for (name, bytes) in &files {
            let file = local.join(name);
            std::fs::create_dir_all(file.parent().expect("a folder")).expect("made");
            std::fs::write(file, bytes).expect("written");
        }
        let sizes: Vec<(&str, usize)> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.len())).collect();
        let path = ann.create(&sizes);
        let bytes: Vec<u8> = files.iter().flat_map(|(_, bytes)| bytes.iter().copied()).collect();
        assert_eq!(ann.send(&path, 0, &bytes).status, 204, "{what}");
        let finished = ann.finish(&path).json();
        let id = finished["volumes"][0]
            .as_str()
            .unwrap_or_else(|| panic!("{what}: {finished}"));
        let shown = ann.get(&format!("/api/v1/volumes/{id}")).json();
        let named = if names.len() == 1 {
            local.join(names[0].rsplit('/').next().expect("a name"))
        } else {
            local
        };
        let expected: Value =
            serde_json::from_str(&command::succeed(["info", "--json", named.to_str().expect("UTF-8")])).expect("JSON");
        for key in ["dims", "spacing", "origin", "direction", "frame", "unit"] {
            assert_eq!(shown["geometry"][key], expected[key], "{what}: {key}");
        }
        assert_eq!(
            (&shown["steps"], &shown["notice"]),
            (&expected["steps"], &expected["notice"]),
            "{what}"
        );
        let fields = |of: &Value| -> Vec<(Value, Value)> {
            let fields = of["fields"].as_array().expect("a list").iter();
            fields
                .map(|field| (field["name"].clone(), field["range"].clone()))
                .collect()
        };
        assert_eq!(fields(&shown), fields(&expected), "{what}");
    }
}
