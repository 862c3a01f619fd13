//! State of version 0.1 remains usable: tests/fixtures/state-0.1 is a state folder that 0.1 made, with a token and a finished job.
//! uploads-0.1 has a complete upload and one of which 100 bytes had arrived, with records as 0.1 wrote them. A client of another version of
//! the stream gets an error that says so. Links of 0.1: web/test/oldLinks.test.ts.

use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::Path;

use crate::support::{http, process, server};

/// The token that the folder was made with; the folder has its hash. It opens nothing but copies of it.
const TOKEN: &str = "isop_f40e25572447_UytP0kRwla19BouDTzJhwJcJpx43_yOrLLdnaw9du8o";

const JOB: &str = "3d6bdd0e873ebf05ce669e5fff2f0ab8";

const UPLOAD: &str = "aaaa13394c25f54cd9aa8611477df58a";
const HALF: &str = "bbbb31e193ac08b1e79f6709fecfa1a0";

/// Copies a folder for this user alone, as a server wants it.
fn copy(from: &Path, to: &Path) {
    std::fs::DirBuilder::new().mode(0o700).create(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("the fixture") {
        let entry = entry.expect("an entry");
        let place = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &place);
        } else {
            std::fs::copy(entry.path(), &place).expect("a copy");
            std::fs::set_permissions(&place, std::fs::Permissions::from_mode(0o600)).expect("a mode");
        }
    }
}

#[test]
fn a_state_folder_of_0_1_keeps_its_tokens_jobs_and_results() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/state-0.1");
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().join("state");
    copy(&fixture, &state);
    let options = ["--state-folder", state.to_str().expect("UTF-8")];
    let Some((server, _)) = process::launch(&[], &options) else {
        return;
    };
    let get = |path: &str| {
        let bearer = format!("Bearer {TOKEN}");
        let headers = [("authorization", bearer.as_str())];
        http::send(server.address, "GET", path, &headers, b"").expect("an answer")
    };
    let job = get(&format!("/api/v1/jobs/{JOB}"));
    assert_eq!(job.status, 200, "{}", String::from_utf8_lossy(&job.body));
    let job = job.json();
    assert_eq!(
        (&job["state"], &job["extractions"]["done"]),
        (&"done".into(), &2.into()),
        "{job}"
    );
    for place in ["0", "1"] {
        let result = get(&format!("/api/v1/jobs/{JOB}/results/{place}"));
        let kept = std::fs::read(fixture.join("results").join(JOB).join(place)).expect("a result");
        assert!(
            result.status == 200 && result.body == kept,
            "result {place}: {}",
            result.status
        );
    }
}

#[test]
fn an_uploads_folder_of_0_1_keeps_volumes_and_what_has_come() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/uploads-0.1");
    let folder = tempfile::tempdir().expect("a folder");
    let uploads = folder.path().join("uploads");
    copy(&fixture, &uploads);
    // Uploads expire within a week: these are of today.
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed().expect("a clock").as_secs();
    for upload in std::fs::read_dir(&uploads).expect("a folder") {
        let record = upload.expect("an entry").path().join("upload.json");
        let text = std::fs::read_to_string(&record).expect("a record");
        assert!(!text.contains("unpacked"), "0.1 has no such name: {text}");
        std::fs::write(&record, text.replace("1795839630", &now.to_string())).expect("a record");
    }
    let Some(server) = process::start(&[], &["--uploads", uploads.to_str().expect("UTF-8")]) else {
        return;
    };
    let ready = http::get(server.address, &format!("/api/v1/volumes/upload-{UPLOAD}"));
    assert_eq!(ready.status, 200, "{}", String::from_utf8_lossy(&ready.body));
    let half = http::get(server.address, &format!("/api/v1/uploads/{HALF}")).json();
    assert_eq!(
        (&half["state"], &half["receivedBytes"]),
        (&"receiving".into(), &100.into()),
        "{half}"
    );
}

#[test]
fn a_client_of_another_stream_is_told_both_versions() {
    let Some(address) = server::shared() else { return };
    let headers = [
        ("connection", "upgrade"),
        ("upgrade", "websocket"),
        ("sec-websocket-version", "13"),
        ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
        ("sec-websocket-protocol", "isopeel.v1, other"),
    ];
    let refused = http::send(address, "GET", "/api/v1/stream", &headers, b"").expect("an answer");
    assert_eq!(refused.problem(400), "bad-request");
    let detail = refused.json()["detail"].as_str().expect("a text").to_owned();
    assert!(
        detail.contains("isopeel.v1, other") && detail.contains("isopeel.v3"),
        "{detail}"
    );
}
