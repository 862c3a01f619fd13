//! Viewers of equal views share one extraction and one encoding, and each gets the same surface as it would get alone.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use futures_util::future::join_all;
use isopeel_client::RawFrame;
use serde_json::{Value, json};

use crate::metrics::{counted, metrics_of};
use crate::support::viewer::connect;
use crate::support::{ball, http, process};

/// Viewers at once.
const VIEWERS: usize = 8;

/// A viewer's final chunks by region, and the time until `done`.
pub struct Shown {
    pub chunks: BTreeMap<[u8; 14], Vec<u8>>,
    done: Duration,
}

/// Opens a volume and reads its first surface, up to the measured error.
async fn look(address: SocketAddr) -> Shown {
    look_at(address, "ball").await
}

/// As [`look`], for a volume.
pub async fn look_at(address: SocketAddr, volume: &str) -> Shown {
    let mut connection = connect(address).await;
    let messages = [json!({"type": "open", "volume": volume}), json!({"type": "edit"})];
    connection.send_all(messages).await.expect("it is sent");
    let start = Instant::now();
    let (mut chunks, mut done) = (BTreeMap::new(), Duration::ZERO);
    loop {
        match connection.next().await.expect("a frame") {
            RawFrame::Chunk(frame) => {
                // The mesh with its region, of which size and coordinates are the key, without generation, level, kind and surface.
                let region = frame[18..32].try_into().expect("fourteen bytes");
                chunks.insert(region, [&frame[..8], &frame[16..]].concat());
            }
            RawFrame::Text(text) => {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                match message["type"].as_str().expect("a type") {
                    "done" if done.is_zero() => done = start.elapsed(),
                    "measured" => break,
                    "error" => panic!("{message}"),
                    _ => {}
                }
            }
        }
    }
    connection.close().await.expect("a close frame");
    // A chunk without vertices: the region has no surface any more.
    chunks.retain(|_, chunk: &mut Vec<u8>| chunk.len() > 88);
    Shown { chunks, done }
}

/// Counts of the work done: surfaces on the device, steps, chunks; and the cached bytes.
fn made(address: SocketAddr) -> [f64; 4] {
    let text = metrics_of(address);
    [
        ("isopeel_device_stage_seconds_count", r#"stage="construct""#),
        ("isopeel_cache_requests_total", r#"what="step",result="miss""#),
        ("isopeel_cache_requests_total", r#"what="chunk",result="miss""#),
        ("isopeel_memory_bytes", r#"owner="chunks""#),
    ]
    .map(|(name, label)| counted(&text, name, label))
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_viewers_of_one_view_are_as_much_work_as_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let start = || process::start(std::slice::from_ref(&volume), &["--no-demo"]);
    let Some(server) = start() else { return };
    let alone = look(server.address).await;
    let once = made(server.address);
    assert!(once.iter().all(|&count| count > 0.0), "{once:?}");
    // A later viewer causes no more work. On a busy machine the connection is slow at times; then there may be more steps of the same
    // chunks.
    let later = look(server.address).await;
    let twice = made(server.address);
    assert_eq!([twice[0], twice[2]], [once[0], once[2]], "{twice:?}, {once:?}");
    assert!(
        twice[1] <= 2.0 * once[1] && twice[3] <= 2.0 * once[3],
        "{twice:?}, {once:?}"
    );
    assert!(later.chunks == alone.chunks, "other bytes");
    drop(server);

    let server = start().expect("a device");
    let shown = join_all((0..VIEWERS).map(|_| look(server.address))).await;
    // One surface. On a busy machine lines are slow at times, and then a coarser prefix may be shown to some before.
    let together = made(server.address);
    assert_eq!(together[0], once[0]);
    assert!(
        together.iter().zip(once).all(|(&now, once)| now <= 2.0 * once),
        "{together:?}, alone {once:?}"
    );
    for viewer in &shown {
        assert!(viewer.chunks == alone.chunks, "other bytes");
    }
    let mut times: Vec<_> = shown.iter().map(|viewer| viewer.done).collect();
    times.sort();
    let (first, last) = (times[0], times[VIEWERS - 1]);
    println!(
        "one alone {:?}, one later {:?}, of eight the first {first:?}, the last {last:?}",
        alone.done, later.done
    );
    assert!(last < 2 * first + Duration::from_millis(300), "{times:?}");
}

/// An export of a shown surface reuses the viewer's pyramid and vertex tree, so it only cuts, meshes and writes.
#[tokio::test(flavor = "multi_thread")]
async fn an_export_of_what_a_viewer_is_shown_makes_neither_pyramid_nor_tree() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let Some(server) = process::start(&[volume], &["--no-demo"]) else {
        return;
    };
    let address = server.address;
    look(address).await;
    let made = || {
        let text = metrics_of(address);
        ["pyramid", "tree"].map(|what| {
            let counted = |result| {
                counted(
                    &text,
                    "isopeel_cache_requests_total",
                    &format!(r#"what="{what}",result="{result}""#),
                )
            };
            (counted("miss"), counted("hit"))
        })
    };
    let before = made();
    let export = |iso: Option<f64>| {
        let start = Instant::now();
        // The view with which a viewer opens the volume.
        let mut body = json!({"volume": "ball", "format": "glb", "feature": "gradient-magnitude", "alpha": 0.5, "error": "0.1vx",
            "triangles": {"share": 0.25, "max": 1_000_000}});
        if let Some(iso) = iso {
            body["iso"] = json!(iso);
        }
        assert_eq!(http::post_json(address, "/api/v1/extract", &body).status, 200);
        start.elapsed()
    };
    let shared = export(None);
    let after = made();
    for (kind, (before, after)) in ["pyramid", "tree"].iter().zip(before.iter().zip(after)) {
        assert_eq!(after.0, before.0, "a {kind} was made");
        assert!(after.1 > before.1, "no {kind} was found");
    }
    // Of another isovalue both are made.
    let own = export(Some(3.0));
    for (before, after) in after.iter().zip(made()) {
        assert!(after.0 > before.0);
    }
    println!("an export of what is shown {shared:?}, of another isovalue {own:?}");

    // By its address it is the same file. A client that already has it causes no work.
    let path = "/api/v1/extract?volume=ball&format=stl&iso=3";
    let file = http::get(address, path);
    let posted = http::post_json(
        address,
        "/api/v1/extract",
        &json!({"volume": "ball", "format": "stl", "iso": 3}),
    );
    assert_eq!((file.status, file.content_type.as_str()), (200, "model/stl"));
    assert!(file.body == posted.body, "other bytes");
    let (before, tag) = (made(), file.header("etag"));
    let shown =
        |path: &str, tag: &str| http::send(address, "GET", path, &[("If-None-Match", tag)], b"").expect("an answer");
    let again = shown(path, tag);
    assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, tag));
    assert_eq!(made(), before);
    for answer in [&file, &again] {
        assert_eq!(answer.header("cache-control"), "private, no-cache");
        assert!(
            answer
                .header("vary")
                .contains("Authorization, Cookie, Origin, Accept-Encoding")
        );
    }
    let other = shown("/api/v1/extract?volume=ball&format=stl&iso=3.5", tag);
    assert_eq!(other.status, 200);
    assert_ne!(other.header("etag"), tag);
    let path = "/api/v1/extract?volume=none&format=stl";
    assert_eq!(shown(path, "*").problem(404), "unknown-volume");
    let path = "/api/v1/extract?volume=ball&format=stl&isovalue=3";
    assert_eq!(shown(path, "*").problem(400), "bad-request");
}

/// If nothing is cached, the surface is made again for a later viewer.
#[tokio::test(flavor = "multi_thread")]
async fn without_memory_for_it_nothing_is_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let Some(server) = process::start(&[volume], &["--no-demo", "--shared-memory", "0"]) else {
        return;
    };
    let first = look(server.address).await;
    let [_, _, once, kept] = made(server.address);
    assert_eq!(kept, 0.0);
    let later = look(server.address).await;
    assert!(later.chunks == first.chunks, "other bytes");
    // At least the final surface is made again; fewer steps are needed, because the tree is built.
    let again = made(server.address)[2] - once;
    assert!(again >= later.chunks.len() as f64, "{again} chunks, {once} before");
}
