//! Many viewers who follow one: what an edit of that one takes to be on all of their screens, and what they cost.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;

use crate::metrics::counted;
use crate::support::viewer::connect;
use crate::support::{ball, http, process};

/// Followers; `ISOPEEL_FOLLOWERS` has another number.
const FOLLOWERS: usize = 100;
/// Edits of the leader before anybody follows, and while they do.
const EDITS: usize = 4;
/// Between the end of an edit and the next.
const PAUSE: Duration = Duration::from_millis(300);
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);

type Socket = WebSocketStream<TcpStream>;

async fn say(socket: &mut Socket, message: Value) {
    socket
        .send(Message::text(message.to_string()))
        .await
        .expect("it is sent");
}

/// The next text frame; chunks are passed over.
async fn text(socket: &mut Socket) -> Value {
    loop {
        let frame = tokio::time::timeout(PATIENCE, socket.next())
            .await
            .expect("a frame in time");
        if let Message::Text(text) = frame.expect("a frame").expect("it is whole") {
            return serde_json::from_str(&text).expect("JSON");
        }
    }
}

async fn until(socket: &mut Socket, name: &str) -> Value {
    loop {
        let message = text(socket).await;
        assert_ne!(message["type"], "error", "{message}");
        if message["type"] == name {
            return message;
        }
    }
}

/// An edit of the leader: when it was sent, and how long it took to the first and the last commit.
async fn edit(leader: &mut Socket, iso: f64) -> (Instant, Duration, Duration) {
    let start = Instant::now();
    say(leader, json!({"type": "edit", "iso": iso})).await;
    until(leader, "committed").await;
    let first = start.elapsed();
    until(leader, "done").await;
    (start, first, start.elapsed())
}

/// One who follows: says when it has the first of each isovalue, until the group ends.
async fn follow(address: SocketAddr, group: String, seen: mpsc::Sender<(u64, Instant)>) {
    let mut socket = connect(address, Some("isopeel.v2")).await.expect("a handshake");
    say(&mut socket, json!({"type": "join", "group": group})).await;
    let mut expected = None;
    loop {
        let message = text(&mut socket).await;
        match message["type"].as_str().expect("a type") {
            "led" => expected = message["surfaces"][0]["edit"]["iso"].as_f64(),
            "committed" => {
                if let Some(iso) = expected.take() {
                    seen.send((iso.to_bits(), Instant::now()))
                        .await
                        .expect("the test listens");
                }
            }
            "error" => panic!("{message}"),
            "left" => return,
            _ => {}
        }
    }
}

/// That so many of a hundred are at or below it.
fn percentile(times: &mut [Duration], percent: usize) -> Duration {
    times.sort_unstable();
    times[(times.len() * percent / 100).min(times.len() - 1)]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_that_follows_sees_an_edit_soon_and_costs_little() {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let Some(server) = process::start(&[volume], &["--no-demo"]) else {
        return;
    };
    let followers = std::env::var("ISOPEEL_FOLLOWERS").map_or(FOLLOWERS, |n| n.parse().expect("a number"));
    let mut leader = connect(server.address, Some("isopeel.v2")).await.expect("a handshake");
    say(&mut leader, json!({"type": "open", "volume": "ball"})).await;
    until(&mut leader, "opened").await;
    // Isovalues that nobody has seen.
    let iso = |n: usize| 2.0 + n as f64 * 0.75;
    let mut alone = Vec::new();
    for n in 0..EDITS {
        alone.push(edit(&mut leader, iso(n)).await.1);
        tokio::time::sleep(PAUSE).await;
    }
    let alone = percentile(&mut alone, 50);
    let before = server.resident_bytes();

    say(&mut leader, json!({"type": "lead"})).await;
    let group = until(&mut leader, "group").await["group"]
        .as_str()
        .expect("an id")
        .to_owned();
    let (seen, mut all) = mpsc::channel(followers);
    let mut crowd = JoinSet::new();
    for _ in 0..followers {
        crowd.spawn(follow(server.address, group.clone(), seen.clone()));
    }
    // What was shown already.
    for _ in 0..followers {
        tokio::time::timeout(PATIENCE, all.recv())
            .await
            .expect("all join")
            .expect("a follower");
    }
    let mut times = Vec::new();
    for n in EDITS..2 * EDITS {
        let (start, ..) = edit(&mut leader, iso(n)).await;
        for _ in 0..followers {
            let (of, at) = tokio::time::timeout(PATIENCE, all.recv())
                .await
                .expect("all see it")
                .expect("a follower");
            assert_eq!(f64::from_bits(of), iso(n));
            times.push(at - start);
        }
        tokio::time::sleep(PAUSE).await;
    }
    let more = server.resident_bytes().saturating_sub(before);
    let (p50, p99) = (percentile(&mut times, 50), percentile(&mut times, 99));
    println!(
        "one alone: first commit {alone:?} (p50); {followers} followers: p50 {p50:?}, p99 {p99:?}; {} MiB more",
        more >> 20
    );
    let metrics = String::from_utf8(http::get(server.address, "/metrics").body).expect("UTF-8");
    assert_eq!(counted(&metrics, "isopeel_followers", ""), followers as f64);
    assert_eq!(counted(&metrics, "isopeel_stream_errors_total", ""), 0.0);
    // Each step is made once, for all: two or three an edit, and the better one.
    let made = counted(&metrics, "isopeel_cache_requests_total", r#"what="step",result="miss""#);
    assert!(made <= (2 * EDITS * 8) as f64, "{made} steps");
    assert!(more < 2 << 30, "{} MiB", more >> 20);
    say(&mut leader, json!({"type": "leave"})).await;
    until(&mut leader, "left").await;
    while let Some(ended) = crowd.join_next().await {
        ended.expect("no follower fails");
    }
}
