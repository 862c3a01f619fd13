//! The course of one edit: checks every frame against `server/PROTOCOL.md` (the viewer does that while it reads), and the surface
//! against the check values.

use isopeel_client::{Connection, request};
use serde_json::json;
use tokio::net::TcpStream;

use crate::support::viewer::{Frame, Viewer, status};
use crate::support::{assert_leaves, ball, command, demo, demo_file, http, mesh, server};

/// An edit whose surface the check values know: feature off, importance is smoothness.
fn plain(beta: f64) -> serde_json::Value {
    json!({"iso": demo::ISO, "field": "t1", "feature": "none", "alpha": 0, "beta": beta, "maxError": null, "topology": "free", "maxLevel": 5, "transferFunction": identity()})
}

fn identity() -> serde_json::Value {
    json!({"points": [{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]})
}

#[tokio::test]
async fn the_full_surface_is_closed_and_counts_what_an_independent_program_counts() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut full = plain(-1.0);
    full["mesher"] = json!("marching-cubes");
    let statistics = viewer.edit(full).await;
    assert_eq!(statistics["fullTriangles"], demo::FULL_TRIANGLES);
    assert_eq!(statistics["triangles"], demo::FULL_TRIANGLES);
    assert_eq!(statistics["activeCells"], demo::ACTIVE_CELLS);
    assert_leaves(&statistics["leaves"], [demo::ACTIVE_CELLS, 0, 0, 0, 0, 0]);
    assert_eq!(
        (&statistics["lostCubes"], &statistics["unpatchedVertices"]),
        (&json!(0), &json!(0))
    );
    assert_eq!(
        mesh::open_edges(viewer.shown.values(), demo::DIMS).len(),
        0,
        "edges that do not close"
    );
    assert!(mesh::area_turned_right(viewer.shown.values()) > 0.99);
    for chunk in viewer.shown.values() {
        assert_eq!(
            chunk.triangles_of_level(0).len(),
            chunk.triangles.len(),
            "all triangles are of level 0"
        );
    }
    viewer.close().await;
}

#[tokio::test]
async fn a_decimated_surface_has_the_leaves_of_the_check_values() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut triangles_before = demo::FULL_TRIANGLES;
    for (beta, leaves) in [(0.02, demo::LEAVES_AT_0_02), (0.1, demo::LEAVES_AT_0_1)] {
        let statistics = viewer.edit(plain(beta)).await;
        assert_eq!(statistics["fullTriangles"], demo::FULL_TRIANGLES);
        assert_leaves(&statistics["leaves"], leaves);
        let triangles = statistics["triangles"].as_u64().expect("a count");
        assert!(
            triangles < triangles_before,
            "{triangles} triangles at β = {beta}, {triangles_before} before"
        );
        triangles_before = triangles;
        assert!(mesh::area_turned_right(viewer.shown.values()) > 0.97);
        // every level that has leaves shows triangles of that level
        for level in 0..4 {
            let shown: usize = viewer
                .shown
                .values()
                .map(|chunk| chunk.triangles_of_level(level).len())
                .sum();
            assert!(shown > 0, "no triangle of level {level}");
        }
    }
    let grey = json!({"feature": "gm", "featureRange": [0, 255], "alpha": 0.35, "beta": 0.15});
    let statistics = viewer.edit(grey).await;
    assert_leaves(&statistics["leaves"], demo::LEAVES_GREY_AT_0_15);
}

#[tokio::test]
async fn the_stream_and_extract_make_the_same_surface() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let streamed = viewer.edit(plain(0.02)).await;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("out.stl");
    let extracted = command::extract_to(&demo_file(), "--iso 100 --beta 0.02", &file);
    for count in [
        "fullTriangles",
        "activeCells",
        "leaves",
        "triangles",
        "vertices",
        "lostCubes",
        "unpatchedVertices",
    ] {
        assert_eq!(streamed[count], extracted[count], "{count}");
    }
    let names = |statistics: &serde_json::Value| -> Vec<String> {
        let names = statistics.as_object().expect("an object").keys();
        // Of files alone.
        names.filter(|name| *name != "shape").cloned().collect()
    };
    assert_eq!(
        names(&streamed),
        names(&extracted),
        "`done` carries what `--stats` prints"
    );
    for value in ["stagesMs", "wallMs", "deviceBytes", "volumeBytes", "device"] {
        assert!(!extracted[value].is_null(), "--stats prints {value}");
    }
}

#[tokio::test]
async fn the_first_prefix_is_small_and_whole_and_each_is_finer_than_the_one_before() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    // what the demo opens with: what a first page shows
    viewer.send(json!({"type": "edit"})).await;
    let (mut prefixes, mut extents, mut bytes) = (Vec::new(), Vec::new(), 0);
    loop {
        match viewer.next().await {
            Frame::Prefix(_) => bytes = 0,
            Frame::Chunk { bytes: more, .. } => bytes += more,
            Frame::Committed { level, .. } => {
                let triangles: usize = viewer.shown.values().map(|chunk| chunk.triangles.len()).sum();
                prefixes.push((level, bytes, triangles));
                extents.push(mesh::extent(viewer.shown.values()));
            }
            Frame::Done { .. } => break,
            other => panic!("unexpected {other:?}"),
        }
    }
    assert!(prefixes.len() >= 2, "coarse before fine: {prefixes:?}");
    let first = prefixes[0];
    let last_bytes: usize = viewer.shown.values().map(|chunk| chunk.frame_bytes).sum();
    assert!(first.2 > 0, "the first prefix shows something");
    assert!(
        first.1 * 10 < last_bytes,
        "first prefix {} bytes, the last surface {last_bytes} bytes",
        first.1
    );
    assert!(
        prefixes.windows(2).all(|pair| pair[0].2 < pair[1].2),
        "triangles grow: {prefixes:?}"
    );
    // whole: the coarsest surface reaches as far as the final one, within one cube of its own level
    let (coarse, fine) = (extents[0], extents[extents.len() - 1]);
    let cube = f64::from(1 << first.0);
    for axis in 0..3 {
        assert!(
            (coarse[0][axis] - fine[0][axis]).abs() <= cube,
            "low end of axis {axis}: {coarse:?}, {fine:?}"
        );
        assert!(
            (coarse[1][axis] - fine[1][axis]).abs() <= cube,
            "high end of axis {axis}: {coarse:?}, {fine:?}"
        );
    }
}

#[tokio::test]
async fn opened_says_what_rest_says_and_every_value_in_force() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    viewer
        .send(json!({"type": "open", "volume": demo::ID, "step": 0}))
        .await;
    let Frame::Opened {
        volume,
        step,
        edit,
        device,
        capabilities,
    } = viewer.until_opened().await
    else {
        panic!("expected `opened`, got {:?}", viewer.log)
    };
    let path = format!("/api/v1/volumes/{}", demo::ID);
    let described = tokio::task::spawn_blocking(move || http::get(address, &path).json())
        .await
        .expect("an answer");
    assert_eq!(volume, described);
    assert_eq!(step, 0);
    assert!(!device.is_null(), "the device has a name");
    let expected = json!({"surfaces": 4, "chunkKinds": ["cut", "error"], "measuredError": true, "steps": true, "watches": false, "groups": true, "questions": ["probe", "distribution", "curve", "annotate"]});
    assert_eq!(capabilities, expected);
    let names = [
        "alpha",
        "cap",
        "colorField",
        "detail",
        "error",
        "feature",
        "featureRange",
        "field",
        "interest",
        "iso",
        "mask",
        "maxError",
        "maxLevel",
        "mesher",
        "minPart",
        "parts",
        "topology",
        "transferFunction",
        "triangles",
    ];
    let found: Vec<&str> = edit
        .as_object()
        .expect("an object")
        .keys()
        .map(String::as_str)
        .collect();
    assert_eq!(found, names, "`edit` holds every value in force");
    let empty: Vec<&str> = names.into_iter().filter(|&name| edit[name].is_null()).collect();
    assert_eq!(empty, ["colorField", "mask", "parts"], "all is shown: {edit}");
}

/// Air, a head of soft tissue, and in it bone from 900 HU at its surface to 1500 in the middle.
fn head_in_hounsfield_units(at: [f32; 3]) -> f32 {
    let radius = at.map(|x| (x - 20.0).powi(2)).iter().sum::<f32>().sqrt();
    // No two samples alike, as in a scanner.
    let noise = 20.0 * (at[0] * 12.9 + at[1] * 78.2 + at[2] * 37.7).sin();
    match radius {
        17.0.. => -1000.0 + noise,
        8.0..17.0 => 40.0 + noise,
        _ => 1500.0 - 75.0 * radius,
    }
}

#[tokio::test]
async fn a_volume_opens_with_the_isovalue_that_opened_explains() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("head.npy");
    ball::write_field(&file, [41; 3], head_in_hounsfield_units);
    let Some(own) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    let mut viewer = Viewer::connect(own.address).await;
    viewer.send(json!({"type": "open", "volume": "head"})).await;
    let Frame::Opened { volume, edit, .. } = viewer.until_opened().await else {
        panic!("expected `opened`, got {:?}", viewer.log)
    };
    let opening = &volume["fields"][0]["openingIso"];
    assert_eq!((&opening["reason"], &opening["iso"]), (&json!("bone"), &json!(300.0)));
    assert!(
        opening["explanation"]
            .as_str()
            .is_some_and(|why| why.contains("Hounsfield")),
        "{opening}"
    );
    assert_eq!(edit["iso"], opening["iso"]);
    assert!(volume["opening"].is_null(), "the file brings no view along");
    // The surface of the bone alone: a sphere of radius 8 has some 1200 triangles, one of radius 17 five times as many.
    let full = viewer.edit(json!({"beta": -1})).await["fullTriangles"]
        .as_u64()
        .expect("a count");
    assert!((500..3000).contains(&full), "{full} triangles");
    let described = command::run(["info".as_ref(), "--json".as_ref(), file.as_os_str()]);
    let described: serde_json::Value = serde_json::from_slice(&described.stdout).expect("JSON");
    assert_eq!(&described["fields"][0]["openingIso"], opening, "without a device");
}

#[tokio::test]
async fn colours_are_returned_and_change_nothing() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.edit(plain(0.1)).await;
    let frames = viewer.log.len();
    let mut recoloured = identity();
    recoloured["points"][0]["color"] = json!("#ff0000");
    viewer.edit(json!({"transferFunction": recoloured})).await;
    let sent = viewer.log[frames..]
        .iter()
        .filter(|frame| matches!(frame, Frame::Chunk { .. }))
        .count();
    assert_eq!(sent, 0, "chunks sent for a change of colour alone");
}

#[tokio::test]
async fn a_handshake_without_the_subprotocol_is_refused() {
    let Some(address) = server::shared() else { return };
    for subprotocol in [None, Some("isopeel.v0"), Some("chat")] {
        let mut request = request(address, "", &[]).expect("a request");
        let headers = request.headers_mut();
        headers.remove("sec-websocket-protocol");
        if let Some(name) = subprotocol {
            headers.insert("sec-websocket-protocol", name.parse().expect("a header"));
        }
        let tcp = TcpStream::connect(address).await.expect("the server listens");
        let connected = Connection::handshake(tcp, request, None).await;
        assert_eq!(status(connected), Some(400), "{subprotocol:?}");
    }
}

#[tokio::test]
async fn open_again_empties_the_servers_picture_of_the_client() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let first = viewer.edit(plain(0.1)).await;
    viewer.send(json!({"type": "open", "volume": demo::ID})).await;
    viewer.until_opened().await;
    // the viewer forgot its map at `opened`: `done` holds only if everything comes again
    let second = viewer.edit(plain(0.1)).await;
    assert_eq!(first["triangles"], second["triangles"]);
}
