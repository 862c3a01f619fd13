//! Clients that violate `server/PROTOCOL.md`, or stay silent.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use isopeel::stream::Deadlines;
use isopeel_client::{Connection, Message, request};
use serde_json::{Value, json};
use tokio::net::TcpSocket;

use crate::support::viewer::{Frame, Viewer, connect, status};
use crate::support::{demo, http, server};

async fn error_for(viewer: &mut Viewer, message: &str) -> (String, bool) {
    viewer.send_raw(Message::text(message)).await;
    loop {
        match viewer.next().await {
            Frame::Error {
                code, message, open, ..
            } => {
                assert!(!message.is_empty());
                return (code, open);
            }
            // Of the previous surface; may come at any time.
            Frame::Measured { .. } => {}
            other => panic!("{message}: expected `error`, got {other:?}"),
        }
    }
}

#[tokio::test]
async fn malformed_messages_are_refused_by_code_and_the_connection_lives_on() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    for message in [
        "",
        "{",
        "null",
        "[]",
        "42",
        "{}",
        r#"{"type":"close"}"#,
        r#"{"type":7}"#,
        r#"{"type":"open"}"#,
        r#"{"type":"open","volume":"mni152","steps":0}"#,
        r#"{"type":"open","volume":"mni152","step":-1}"#,
        r#"{"type":"cancel","generation":1}"#,
        r#"{"type":"cancel"} {}"#,
    ] {
        assert_eq!(
            error_for(&mut viewer, message).await,
            ("bad-message".to_owned(), true),
            "{message}"
        );
    }
    viewer.send(json!({"type": "open", "volume": demo::ID})).await;
    viewer.until_opened().await;
    for message in [
        r#"{"type":"edit","isovalue":7}"#,
        r#"{"type":"edit","iso":"100"}"#,
        r#"{"type":"edit","surface":-1}"#,
        r#"{"type":"edit","minPart":"5"}"#,
        r#"{"type":"edit","parts":{}}"#,
        r#"{"type":"edit","parts":{"hide":[[1,2]]}}"#,
        r#"{"type":"edit","parts":{"hide":[[1,2,3]],"keep":[[1,2,3]]}}"#,
        r#"{"type":"edit","beta":NaN}"#,
        r##"{"type":"edit","transferFunction":{"points":[{"x":0,"importance":0,"color":"#000000","alpha":1}]}}"##,
    ] {
        assert_eq!(
            error_for(&mut viewer, message).await,
            ("bad-message".to_owned(), true),
            "{message}"
        );
    }
    let done = viewer.edit(json!({"iso": 100, "beta": 0.1})).await;
    assert!(
        done["triangles"].as_u64().is_some_and(|triangles| triangles > 0),
        "the connection still works"
    );
}

#[tokio::test]
async fn values_out_of_range_leave_the_edit_unapplied() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let before = viewer.edit(json!({"iso": 100, "beta": 0.1})).await;
    let point = json!({"x": 0.5, "importance": 0.5, "color": "#808080"});
    let points = |count: usize| json!({"points": vec![point.clone(); count]});
    let with = |field: &str, value: Value| {
        let mut points = points(1);
        points["points"][0][field] = value;
        points
    };
    let sphere = |radius: f64| json!({"sphere": {"center": [0, 0, 0], "radius": radius}, "importance": 0.5});
    for (field, value) in [
        ("iso", json!(1e300)),
        ("field", json!("t2")),
        ("field", json!("log(t1")),
        ("feature", json!("curvature")),
        ("feature", json!("magnitude(t1, t2)")),
        ("featureRange", json!([5, 5])),
        ("featureRange", json!([9, 5])),
        ("alpha", json!(1.01)),
        ("alpha", json!(-0.01)),
        ("beta", json!(1e300)),
        ("maxLevel", json!(6)),
        ("surface", json!(4)),
        ("minPart", json!(-1)),
        ("minPart", json!(1e300)),
        // β decides.
        ("minPart", json!(1)),
        ("parts", json!({"hide": [[1, 2, 3]]})),
        ("parts", json!({"keep": []})),
        ("parts", json!({"keep": vec![[1, 2, 3]; 65]})),
        ("interest", json!(vec![sphere(1.0); 65])),
        ("interest", json!([sphere(-1.0)])),
        ("interest", json!([{"importance": 0.5}])),
        (
            "interest",
            json!([{"box": {"min": [0, 0, 5], "max": [1, 1, 4]}, "importance": 0.5}]),
        ),
        ("transferFunction", points(0)),
        ("transferFunction", points(65)),
        ("transferFunction", with("x", json!(1.5))),
        ("transferFunction", with("importance", json!(-1))),
        ("transferFunction", with("color", json!("red"))),
        ("transferFunction", with("color", json!("#12345"))),
    ] {
        // the good half of a bad edit must not be applied either
        let mut edit = json!({"type": "edit", "maxLevel": 3});
        edit[field] = value;
        let refused = error_for(&mut viewer, &edit.to_string()).await;
        assert_eq!(refused, ("bad-edit".to_owned(), true), "{edit}");
    }
    let frames = viewer.log.len();
    let after = viewer.edit(json!({})).await;
    assert_eq!(before["leaves"], after["leaves"], "a refused edit was applied in part");
    assert!(
        !viewer.log[frames..]
            .iter()
            .any(|frame| matches!(frame, Frame::Chunk { .. }))
    );
}

#[tokio::test]
async fn what_is_not_open_or_not_there_is_said_so() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    let refusals = [
        (json!({"type": "edit", "beta": 0.1}), "not-open"),
        (json!({"type": "open", "volume": "nothing"}), "unknown-volume"),
        (json!({"type": "open", "volume": "../../etc/passwd"}), "unknown-volume"),
        (json!({"type": "open", "volume": demo::ID, "step": 1}), "unknown-step"),
        (
            json!({"type": "open", "volume": demo::ID, "step": 4_294_967_295u32}),
            "unknown-step",
        ),
    ];
    for (message, code) in refusals {
        assert_eq!(
            error_for(&mut viewer, &message.to_string()).await,
            (code.to_owned(), true),
            "{message}"
        );
    }
}

/// Reads to the close frame; returns its code.
async fn close_code(viewer: &mut Viewer) -> Option<u16> {
    loop {
        if let Frame::Closed { code } = viewer.next().await {
            return code;
        }
    }
}

#[tokio::test]
async fn sixteen_malformed_messages_in_a_row_close_with_4000() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    for _ in 0..15 {
        assert!(error_for(&mut viewer, "{").await.1);
    }
    // a good message starts the count again
    viewer.send(json!({"type": "open", "volume": demo::ID})).await;
    viewer.until_opened().await;
    for _ in 0..15 {
        assert!(error_for(&mut viewer, "{").await.1);
    }
    viewer.send_raw(Message::text("{")).await;
    assert_eq!(close_code(&mut viewer).await, Some(4000));
}

#[tokio::test]
async fn a_binary_frame_closes_with_1003_and_a_message_too_long_with_1009() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    viewer.send_raw(Message::binary(vec![1, 2, 3])).await;
    assert_eq!(close_code(&mut viewer).await, Some(1003));

    let message = r#"{"type":"cancel","a":1}"#;
    let fits = message.to_owned() + &" ".repeat((64 << 10) - message.len());
    let mut viewer = Viewer::connect(address).await;
    assert_eq!(
        error_for(&mut viewer, &fits).await,
        ("bad-message".to_owned(), true),
        "64 KiB are allowed"
    );
    viewer.send_raw(Message::text(fits + " ")).await;
    assert_eq!(close_code(&mut viewer).await, Some(1009));
}

/// Long enough to fill all buffers between a server and a client that does not read: the server sends little ahead of pongs.
const ASKING: Duration = Duration::from_secs(32);

/// Opens the demo and requests surface after surface without reading: a client whose tab sleeps. Its receive buffer is
/// small, so that the network buffers little.
async fn ask_without_reading(address: SocketAddr, stop: Instant) -> Connection {
    let socket = TcpSocket::new_v4().expect("a socket");
    socket.set_recv_buffer_size(4096).expect("a small buffer");
    let tcp = socket.connect(address).await.expect("the server listens");
    let request = request(address, "", &[]).expect("a request");
    let connected = Connection::handshake(tcp, request, None).await;
    let mut connection = connected.expect("the handshake is accepted");
    let open = json!({"type": "open", "volume": demo::ID});
    connection.send(&open).await.expect("sent");
    let mut iso = 60.0;
    while Instant::now() < stop {
        let edit = json!({"type": "edit", "iso": iso, "beta": -1});
        // the server may have closed by then: its messages are read later
        if connection.send(&edit).await.is_err() {
            break;
        }
        iso = if iso > 120.0 { 60.0 } else { iso + 7.0 };
        // Long enough for the whole surface: without pongs the server waits 2 s before it sends more than two prefixes.
        tokio::time::sleep(Duration::from_secs(4)).await;
    }
    connection
}

/// The deadline is 2 s here instead of the page's 20 s, and the close frame has long enough to be seen by a client that
/// wakes up later: whether it still arrives after the page's times depends on the network between.
#[tokio::test]
async fn a_client_that_does_not_read_is_closed_and_holds_up_nobody() {
    assert_eq!(
        Deadlines::default().send,
        Duration::from_secs(20),
        "the page's deadline"
    );
    let deadlines = Deadlines {
        send: Duration::from_secs(2),
        close: Duration::from_secs(120),
        ..Deadlines::default()
    };
    let Some(own) = server::start_with(deadlines) else {
        return;
    };
    let address = own.address;
    let asking = tokio::spawn(ask_without_reading(address, Instant::now() + ASKING));
    // meanwhile another viewer is served as ever
    let mut served = 0;
    let mut longest = Duration::ZERO;
    while !asking.is_finished() {
        let start = Instant::now();
        let mut viewer = Viewer::open(address, demo::ID).await;
        viewer.edit(json!({"iso": 100, "feature": "none", "beta": 0.1})).await;
        viewer.close().await;
        longest = longest.max(start.elapsed());
        served += 1;
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    assert!(
        served >= 2,
        "{served} surfaces in {ASKING:?} beside a client that does not read"
    );
    assert!(longest < Duration::from_secs(10), "another viewer waited {longest:?}");

    let mut slow = asking.await.expect("the client ran");
    let code = tokio::time::timeout(Duration::from_secs(30), slow.close_code()).await;
    let code = code.expect("in time").expect("a close frame");
    assert_eq!(code, Some(4001), "close code of the client that did not read");
}

#[tokio::test]
async fn a_client_that_says_nothing_and_answers_no_ping_is_closed() {
    let deadlines = Deadlines {
        ping: Duration::from_millis(200),
        silence: Duration::from_secs(1),
        ..Deadlines::default()
    };
    let Some(own) = server::start_with(deadlines) else {
        return;
    };
    // a viewer that reads answers pings by itself and stays connected
    let mut alive = Viewer::open(own.address, demo::ID).await;
    let reading = tokio::spawn(async move { tokio::time::timeout(Duration::from_secs(3), alive.next()).await });
    let mut silent = connect(own.address).await;
    assert!(
        reading.await.expect("it ran").is_err(),
        "a viewer that answers pings heard something or was closed"
    );
    // three seconds later the other one finds pings and a close frame
    let code = tokio::time::timeout(Duration::from_secs(30), silent.close_code()).await;
    assert_eq!(code.expect("in time").expect("a close frame"), Some(4003));
}

#[tokio::test]
async fn clients_that_vanish_leave_the_server_as_it_was() {
    let Some(address) = server::shared() else { return };
    for wait_for_frame in [false, true, false, true] {
        let mut viewer = Viewer::open(address, demo::ID).await;
        viewer.send(json!({"type": "edit", "iso": 100, "beta": -1})).await;
        if wait_for_frame {
            viewer.next().await;
        }
        drop(viewer); // no close frame: the connection is just gone
    }
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.edit(json!({"beta": 0.1})).await;
    let ready = tokio::task::spawn_blocking(move || http::get(address, "/readyz").status).await;
    assert_eq!(ready.expect("an answer"), 200);
}

#[tokio::test]
async fn shutdown_closes_viewers_with_1001() {
    let Some(own) = server::start() else { return };
    let mut viewer = Viewer::open(own.address, demo::ID).await;
    let stopping = tokio::task::spawn_blocking(move || own.stop());
    assert_eq!(close_code(&mut viewer).await, Some(1001));
    let stopped = tokio::time::timeout(Duration::from_secs(30), stopping).await;
    stopped.expect("the server stops within 30 s").expect("and cleanly");
}

/// Another page that a user has open must not control the server, nor read its REST answers.
#[tokio::test]
async fn pages_of_other_origins_are_refused_unless_allowed() {
    let Some(address) = server::shared() else { return };
    let own = format!("http://{address}");
    for (origin, refused) in [
        (own.as_str(), None),
        (server::FRIEND, None),
        ("https://evil.example", Some(403)),
        ("http://localhost:1", Some(403)),
        ("null", Some(403)),
    ] {
        let connected = Connection::connect_with(address, "", &[("origin", origin)]).await;
        assert_eq!(status(connected), refused, "{origin}");
    }
    let readers = tokio::task::spawn_blocking(move || {
        ["https://evil.example", server::FRIEND].map(|origin| http::readable_by(address, "/api/v1/volumes", origin))
    });
    assert_eq!(readers.await.expect("answers"), [false, true]);
}
