//! A viewer behind a line that needs a second for a surface: it soon gets a coarser surface, and finally the same one.

use std::net::SocketAddr;
use std::time::Duration;

use isopeel_client::{Prefix, RegionKey, Vertex, same_meshes};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Instant;

use crate::support::viewer::{Frame, Viewer};
use crate::support::{demo, mesh, server};

const BYTES_PER_SECOND: f64 = 750_000.0;

/// A line to a server: what it sends takes its time.
async fn slow_line(server: SocketAddr) -> TcpStream {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    tokio::spawn(async move {
        let (client, _) = listener.accept().await.expect("the viewer");
        let to_server = TcpStream::connect(server).await.expect("the server listens");
        for socket in [&client, &to_server] {
            socket.set_nodelay(true).expect("a socket");
        }
        let (mut from_client, mut to_client) = client.into_split();
        let (mut from_server, mut to_server) = to_server.into_split();
        tokio::spawn(async move { tokio::io::copy(&mut from_client, &mut to_server).await });
        let (mut bytes, mut free) = ([0; 4096], Instant::now());
        while let Ok(count @ 1..) = from_server.read(&mut bytes).await {
            free = free.max(Instant::now()) + Duration::from_secs_f64(count as f64 / BYTES_PER_SECOND);
            tokio::time::sleep_until(free).await;
            if to_client.write_all(&bytes[..count]).await.is_err() {
                return;
            }
        }
    });
    TcpStream::connect(address).await.expect("the relay listens")
}

/// The prefixes of the surface that is shown.
fn prefixes(viewer: &Viewer) -> Vec<Prefix> {
    let of_surface = |frame: &Frame| match frame {
        Frame::Prefix(prefix) if prefix.generation == viewer.generation() => Some(prefix.clone()),
        _ => None,
    };
    viewer.log.iter().filter_map(of_surface).collect()
}

fn last(mut done: Vec<serde_json::Value>) -> serde_json::Value {
    done.pop().expect("statistics of a surface")
}

#[tokio::test]
async fn a_slow_line_shows_a_coarser_cut_soon_and_the_same_surface_in_the_end() {
    let Some(address) = server::shared() else { return };
    let mut slow = Viewer::connect_on(slow_line(address).await, address).await;
    let codings = json!(["one of tomorrow", "predictive"]);
    slow.send(json!({"type": "open", "volume": demo::ID, "codings": codings}))
        .await;
    slow.until_opened().await;
    let opening = json!({"iso": demo::ISO, "alpha": 0.5, "triangles": 100_000});
    let done = slow.edit_and_rest(opening.clone()).await;
    assert_eq!(done[done.len() - 1]["isTreeCut"], true);

    let expected = last(slow.edit_and_rest(json!({"alpha": 0.8})).await);
    let of_slow = prefixes(&slow);
    let [first, .., end] = &of_slow[..] else {
        panic!("one step on a slow line: {of_slow:?}");
    };
    assert!(!first.is_final && end.is_final, "{of_slow:?}");
    assert!(4 * first.triangles < end.triangles, "{of_slow:?}");
    assert_eq!(
        mesh::open_edges(slow.shown.values(), demo::DIMS).len(),
        0,
        "edges that do not close"
    );

    let mut fast = Viewer::open(address, demo::ID).await;
    fast.edit_and_rest(opening).await;
    let found = last(fast.edit_and_rest(json!({"alpha": 0.8})).await);
    for name in ["triangles", "vertices", "tolerance", "mesherTriangles", "leaves"] {
        assert_eq!(found[name], expected[name], "{name}");
    }
    assert!(same_meshes(&fast.shown, &slow.shown));
    check_codings(&mut slow, &mut fast).await;
}

#[tokio::test]
async fn a_follower_on_a_slow_line_has_the_coding_that_takes_less() {
    let Some(address) = server::shared() else { return };
    let mut leader = Viewer::open(address, demo::ID).await;
    // A view of its own, because a surface that another viewer already has is sent in one step.
    let view = json!({"iso": demo::ISO + 5.0, "alpha": 0.5, "triangles": 90_000});
    leader.edit_and_rest(view).await;
    leader.send(json!({"type": "lead"})).await;
    let group = loop {
        if let Frame::Group(group) = leader.next().await {
            break group["group"].clone();
        }
    };
    let mut slow = Viewer::connect_on(slow_line(address).await, address).await;
    slow.send(json!({"type": "join", "group": group, "codings": ["predictive"]}))
        .await;
    slow.until_done().await;
    // The line is known by now.
    leader.edit_and_rest(json!({"alpha": 0.8})).await;
    slow.until_done().await;
    let coded = slow.shown.values().filter(|chunk| chunk.is_predictive).count();
    assert!(2 * coded > slow.shown.len(), "{coded} of {} chunks", slow.shown.len());
    // The leader ends the group.
    leader.close().await;
}

/// Checks that the slow line gets the smaller coding, and errors in the order of its vertices.
async fn check_codings(slow: &mut Viewer, fast: &mut Viewer) {
    let bytes = |viewer: &Viewer| viewer.shown.values().map(|chunk| chunk.frame_bytes).sum::<usize>();
    let coded = slow.shown.values().filter(|chunk| chunk.is_predictive).count();
    assert!(2 * coded > slow.shown.len(), "{coded} of {} chunks", slow.shown.len());
    assert!(
        3 * bytes(slow) < 2 * bytes(fast),
        "{} bytes, {} on a fast line",
        bytes(slow),
        bytes(fast)
    );
    let (of_slow, of_fast) = (errors(slow).await, errors(fast).await);
    assert_eq!(of_slow, of_fast);
}

/// All vertices that are shown, with their distances to the isosurface.
async fn errors(viewer: &mut Viewer) -> Vec<(RegionKey, Vertex, u32)> {
    let question = json!({"type": "annotate", "annotation": "error"});
    let (_, annotated) = viewer.ask(question).await;
    let mut errors = Vec::new();
    for _ in 0..annotated["regions"].as_u64().expect("a count") {
        let Frame::Errors { region, distances, .. } = viewer.next().await else {
            panic!("expected errors, got {:?}", viewer.log.last())
        };
        let vertices = viewer.shown[&region].vertices.iter().zip(distances);
        errors.extend(vertices.map(|(vertex, distance)| (region, *vertex, distance.to_bits())));
    }
    errors.sort_unstable();
    assert!(!errors.is_empty());
    errors
}
