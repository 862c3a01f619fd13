//! Frames and requests that are changed at random; `ISOPEEL_MUTATIONS` sets their number (`make fuzz`). The server answers as documented or
//! closes the connection, never panics, and serves others as before.

use std::fs::read_to_string;
use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use fastrand::Rng;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::metrics::{counted, metrics_of};
use crate::support::ball;
use crate::support::process::{self, Process};
use crate::support::viewer::Viewer;

/// Cases without `ISOPEEL_MUTATIONS`, the same in each run.
const FRAMES: u64 = 4000;
const REQUESTS: u64 = 2000;
const SEED: u64 = 2013;
/// Connections at a time.
const AT_ONCE: usize = 32;
/// Frames of a connection: fewer than are read without a pause.
const FRAMES_OF_ONE: u64 = 32;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(120);
/// Time without an answer after which a client stops listening: its bytes may be the beginning of a longer message.
const SILENCE: Duration = Duration::from_millis(300);

/// Messages of a viewer.
const MESSAGES: [&str; 16] = [
    r#"{"type":"open","volume":"small"}"#,
    r#"{"type":"open","volume":"small","step":0}"#,
    r#"{"type":"edit","iso":3.5,"alpha":0.5,"beta":0.1,"maxLevel":3}"#,
    r#"{"type":"edit","surface":1,"iso":4,"triangles":{"share":0.5,"max":900},"error":0.1}"#,
    r##"{"type":"edit","iso":5,"transferFunction":{"points":[{"x":0,"importance":0.1,"color":"#ffffff"},{"x":1,"importance":1,"color":"#000000"}]}}"##,
    r#"{"type":"edit","interest":[{"sphere":{"center":[8,8,8],"radius":3},"importance":0.9}],"minPart":2}"#,
    r#"{"type":"edit","field":"small","feature":"mean-curvature","featureRange":[0,1],"mesher":"marching-cubes"}"#,
    r#"{"type":"remove","surface":1}"#,
    r#"{"type":"step","step":0}"#,
    r#"{"type":"cancel"}"#,
    r#"{"type":"probe","surface":0,"position":[8,8,4]}"#,
    r#"{"type":"distribution","surface":0,"bins":16}"#,
    r#"{"type":"lead"}"#,
    r#"{"type":"join","group":"00112233445566778899aabbccddeeff","name":"Ann"}"#,
    r#"{"type":"pose","camera":{"position":[1,2,3],"target":[0,0,0],"projection":"perspective"},"page":"v=1"}"#,
    r#"{"type":"leave"}"#,
];

/// Opens a stream; written as [`ASKED`].
const UPGRADE: &str = "GET /api/v1/stream HTTP/1.1\nConnection: Upgrade\nUpgrade: websocket\nSec-WebSocket-Version: 13\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\nSec-WebSocket-Protocol: isopeel.v3\n\n";

/// Requests without `Host`; `\n` ends a line, and the body follows an empty line.
const ASKED: [&str; 20] = [
    "GET /api/v1/volumes HTTP/1.1\n\n",
    "GET /api/v1/volumes/small HTTP/1.1\nAccept: application/json\n\n",
    "GET /api/v1/volumes/small/slices?axis=z&index=3&field=small HTTP/1.1\n\n",
    "GET /api/v1/volumes/small/expression?text=log(small) HTTP/1.1\n\n",
    "GET /api/v1/extract?volume=small&iso=4&format=ply&triangles=100 HTTP/1.1\nIf-None-Match: \"1\"\n\n",
    "POST /api/v1/extract HTTP/1.1\nContent-Type: application/json\n\n{\"volume\":\"small\",\"iso\":4,\"format\":\"stl\",\"error\":0.1}",
    "POST /api/v1/jobs HTTP/1.1\nContent-Type: application/json\nIdempotency-Key: 1\n\n{\"volume\":\"small\",\"extractions\":[{\"iso\":4,\"format\":\"ply\"}]}",
    "GET /api/v1/jobs HTTP/1.1\n\n",
    "GET /api/v1/jobs/1/results/0 HTTP/1.1\nRange: bytes=0-10\n\n",
    "GET /api/v1/jobs/1 HTTP/1.1\nLast-Event-ID: 3\n\n",
    "POST /api/v1/uploads HTTP/1.1\nContent-Type: application/json\n\n{\"name\":\"a.npy\",\"files\":[{\"name\":\"a.npy\",\"bytes\":100}]}",
    "PATCH /api/v1/uploads/1 HTTP/1.1\nUpload-Offset: 0\nContent-Type: application/octet-stream\n\n0123456789",
    "POST /api/v1/tickets HTTP/1.1\nOrigin: http://127.0.0.1\nContent-Type: application/json\n\n{}",
    "POST /api/v1/embed-tokens HTTP/1.1\nAuthorization: Bearer isop_1_2\nContent-Type: application/json\n\n{\"roles\":[\"view\"],\"seconds\":60}",
    "GET /api/v1/session HTTP/1.1\nCookie: isopeel=1\n\n",
    "GET /metrics HTTP/1.1\nAccept-Encoding: gzip\n\n",
    "GET /api/v1/openapi.json HTTP/1.1\n\n",
    "GET /docs/glossary.txt HTTP/1.1\nRange: bytes=0-1\n\n",
    "OPTIONS /api/v1/volumes HTTP/1.1\nOrigin: http://a.example\nAccess-Control-Request-Method: GET\n\n",
    UPGRADE,
];

/// Extreme values that replace numbers and words.
const EXTREMES: [&str; 14] = [
    "",
    "-1",
    "0",
    "1e308",
    "1e999",
    "NaN",
    "null",
    "18446744073709551616",
    "0.0000000000000000001",
    "[[[[[[[[",
    "\\u0000",
    "../../etc/passwd",
    "%00%ff",
    "\u{202e}\u{1f9e0}",
];

/// A text frame of a client, masked with zeros.
fn frame(message: &str) -> Vec<u8> {
    let length = message.len();
    let mut bytes = vec![0x81];
    match u8::try_from(length) {
        Ok(short @ ..=125) => bytes.push(0x80 | short),
        _ => {
            bytes.push(0x80 | 126);
            bytes.extend((length as u16).to_be_bytes());
        }
    }
    bytes.extend([0; 4]);
    bytes.extend(message.as_bytes());
    bytes
}

/// One of [`ASKED`], with `Host` and the length of its body.
fn request(asked: &str, address: SocketAddr) -> Vec<u8> {
    let (head, body) = asked.split_once("\n\n").expect("an empty line");
    let mut lines: Vec<_> = head.lines().map(str::to_owned).collect();
    lines.push(format!("Host: {address}"));
    if !body.is_empty() {
        lines.push(format!("Content-Length: {}", body.len()));
    }
    format!("{}\r\n\r\n{body}", lines.join("\r\n")).into_bytes()
}

/// Takes a word or a number out of a text and puts an extreme in its place.
fn replace_word(text: &mut Vec<u8>, random: &mut Rng) {
    let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b".-+".contains(byte);
    let start = random.usize(..=text.len());
    let Some(first) = text[start..].iter().position(is_word).map(|at| start + at) else {
        return;
    };
    let end = text[first..]
        .iter()
        .position(|byte| !is_word(byte))
        .map_or(text.len(), |n| first + n);
    let extreme = random.choice(EXTREMES).expect("some");
    text.splice(first..end, extreme.bytes());
}

/// One change of bytes.
fn mutate(bytes: &mut Vec<u8>, random: &mut Rng) {
    if bytes.is_empty() {
        return bytes.push(random.u8(..));
    }
    let at = random.usize(..bytes.len());
    let end = (at + random.usize(1..=24)).min(bytes.len());
    match random.u8(..7) {
        0 => bytes[at] = random.u8(..),
        1 => bytes[at] = random.choice([0, 0x7f, 0x80, 0xff]).expect("some"),
        2 => bytes[at] ^= 1 << random.u8(..8),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let part = bytes[at..end].to_vec();
            let to = random.usize(..=bytes.len());
            bytes.splice(to..to, part.repeat(random.usize(1..4)));
        }
        5 => bytes.truncate(at),
        _ => replace_word(bytes, random),
    }
}

/// The frames of one connection, half of them valid. In most others only the message is changed and its frame is intact.
fn frames(count: u64, random: &mut Rng) -> Vec<u8> {
    let mut bytes = Vec::new();
    for _ in 0..count {
        let message = random.choice(MESSAGES).expect("some");
        let (mut message, mut whole) = (message.as_bytes().to_vec(), frame(message));
        match random.u8(..32) {
            0 => mutate(&mut whole, random),
            1..16 => {
                (0..random.u8(1..3)).for_each(|_| replace_word(&mut message, random));
                whole = frame(&String::from_utf8_lossy(&message));
            }
            // Valid ones in between: many malformed ones in a row end the connection.
            _ => {}
        }
        bytes.extend(whole);
    }
    bytes
}

/// Checks what a server has sent, frame by frame; the last one may be cut off.
fn check_frames(mut bytes: &[u8]) {
    while let &[first, second, ..] = bytes {
        assert_eq!(first & 0x70, 0, "reserved bits");
        assert_eq!(second & 0x80, 0, "a server masks nothing");
        let (length, head) = match (second, &bytes[2..]) {
            (126, &[a, b, ..]) => (u64::from(u16::from_be_bytes([a, b])), 4),
            (127, rest) if rest.len() >= 8 => (u64::from_be_bytes(rest[..8].try_into().expect("eight")), 10),
            (126 | 127, _) => return,
            (short, _) => (u64::from(short), 2),
        };
        let Some(payload) = bytes.get(head..head + length as usize) else {
            return;
        };
        match first & 0x0f {
            1 => {
                let message: Value = serde_json::from_slice(payload).expect("JSON");
                let is_error = message["type"] == "error";
                assert!(message["type"].is_string(), "{message}");
                assert!(
                    !is_error || message["code"].is_string() && message["message"] != "",
                    "{message}"
                );
            }
            8 => {
                let code = payload.get(..2).map(|code| u16::from_be_bytes([code[0], code[1]]));
                // 1000 and others answer the client's.
                assert!(code.is_none_or(|code| (1000..5000).contains(&code)), "{code:?}");
            }
            2 | 9 | 10 => {}
            other => panic!("a frame of kind {other}"),
        }
        bytes = &bytes[head + length as usize..];
    }
}

/// Opens the volume on a connection and says all of this, and reads until the server ends it or is silent.
async fn converse(address: SocketAddr, said: Vec<u8>) {
    let mut socket = TcpStream::connect(address).await.expect("the server listens");
    let mut opening = request(UPGRADE, address);
    opening.extend(frame(MESSAGES[0]));
    socket.write_all(&opening).await.expect("it reads");
    let mut heard = Vec::new();
    while !heard.windows(8).any(|part| part == b"\"opened\"") {
        let read = timeout(PATIENCE, socket.read_buf(&mut heard)).await.expect("in time");
        assert!(read.expect("an answer") > 0, "{}", heard.escape_ascii());
    }
    let (mut from, mut to) = socket.into_split();
    let saying = tokio::spawn(async move {
        // It may have closed the connection meanwhile.
        let _ = to.write_all(&said).await;
        // Not dropped: that would end the stream, and so the connection.
        to
    });
    while let Ok(Ok(1..)) = timeout(SILENCE, from.read_buf(&mut heard)).await {}
    saying.abort();
    let head = heard.windows(4).position(|end| end == b"\r\n\r\n").expect("a head") + 4;
    check_frames(&heard[head..]);
}

/// Sends a request, and checks the head of the answer if there is one.
async fn ask(address: SocketAddr, asked: Vec<u8>) {
    let mut socket = TcpStream::connect(address).await.expect("the server listens");
    let _ = socket.write_all(&asked).await;
    let mut heard = Vec::new();
    while let Ok(Ok(1..)) = timeout(SILENCE, socket.read_buf(&mut heard)).await {
        if heard.windows(4).any(|end| end == b"\r\n\r\n") {
            break;
        }
    }
    let status = heard
        .get(9..12)
        .and_then(|status| std::str::from_utf8(status).ok()?.parse::<u16>().ok());
    let is_answer =
        heard.is_empty() || heard.starts_with(b"HTTP/1.") && status.is_some_and(|status| status < 500 || status == 503);
    assert!(is_answer, "{} answers {}", heard.escape_ascii(), asked.escape_ascii());
}

/// A server of a small volume that writes what goes wrong to `log`.
fn start(folder: &Path, log: &Path) -> Option<Process> {
    let volume = folder.join("small.npy");
    ball::write_field(&volume, [17, 16, 18], |at| {
        7.0 - at.iter().map(|x| (x - 8.0).powi(2)).sum::<f32>().sqrt()
    });
    let state = folder.join("state");
    let uploads = folder.join("uploads");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (state, uploads) = (text(&state), text(&uploads));
    let options = [
        "--no-auth",
        "--no-demo",
        "--rate-peer",
        "1000000",
        "--state-folder",
        &state,
        "--uploads",
        &uploads,
    ];
    Some(process::launch_logged(&[volume], &options, "error", log)?.0)
}

/// Runs `cases` cases, at most `AT_ONCE` tasks at a time. `case` takes a number of cases and returns the future that runs them.
async fn run<F>(name: &str, cases: u64, case: impl Fn(u64, &mut Rng) -> F)
where
    F: Future<Output = ()> + Send + 'static,
{
    let more: Option<u64> = std::env::var("ISOPEEL_MUTATIONS").ok().and_then(|n| n.parse().ok());
    let seed = more.map_or(SEED, |_| fastrand::u64(..));
    println!("{name}: seed {seed}");
    let (mut random, start, cases) = (Rng::with_seed(seed), Instant::now(), more.unwrap_or(cases));
    let mut running = JoinSet::new();
    let mut left = cases;
    while left > 0 {
        let count = FRAMES_OF_ONE.min(left);
        left -= count;
        running.spawn(case(count, &mut random));
        if running.len() >= AT_ONCE {
            running.join_next().await.expect("one").expect("no case fails");
        }
    }
    while let Some(ended) = running.join_next().await {
        ended.expect("no case fails");
    }
    println!(
        "{name}: {cases} cases, {:.0} a second",
        cases as f64 / start.elapsed().as_secs_f64()
    );
}

/// Checks that the server still works: it counts no viewer that has left, shows an edit, and has not panicked.
async fn check(server: &Process, log: &Path) {
    let begun = Instant::now();
    let viewers = || counted(&metrics_of(server.address), "isopeel_viewers", "");
    while viewers() > 0.0 {
        assert!(begun.elapsed() < PATIENCE, "{} viewers are left", viewers());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut viewer = Viewer::open(server.address, "small").await;
    let done = viewer.edit(json!({"iso": 3})).await;
    assert!(
        done["triangles"].as_u64().is_some_and(|triangles| triangles > 0),
        "{done}"
    );
    let said = read_to_string(log).expect("a log");
    assert!(!said.contains("panicked"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn changed_frames_are_answered_or_end_their_connection_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("log");
    let Some(server) = start(folder.path(), &log) else {
        return;
    };
    let address = server.address;
    run("frames", FRAMES, |count, random| {
        converse(address, frames(count, random))
    })
    .await;
    check(&server, &log).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn changed_requests_are_answered_or_end_their_connection_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("log");
    let Some(server) = start(folder.path(), &log) else {
        return;
    };
    let address = server.address;
    run("requests", REQUESTS, |count, random| {
        let asked: Vec<_> = (0..count)
            .map(|_| {
                let mut asked = request(random.choice(ASKED).expect("some"), address);
                (0..random.u8(1..4)).for_each(|_| match random.bool() {
                    true => replace_word(&mut asked, random),
                    false => mutate(&mut asked, random),
                });
                asked
            })
            .collect();
        async move {
            for asked in asked {
                ask(address, asked).await;
            }
        }
    })
    .await;
    check(&server, &log).await;
}
