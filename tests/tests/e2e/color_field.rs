//! A field for colours: its values at the vertices come with the chunks, and nothing else changes.

use std::net::SocketAddr;

use isopeel_client::{Chunk, Meshes};
use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, server};

/// A server of a ball, wrinkled on one side, with a field that is linear along the axes.
fn with_ball() -> Option<(server::Server, tempfile::TempDir)> {
    let folder = tempfile::tempdir().expect("a folder");
    let volume = folder.path().join("ball");
    std::fs::create_dir(&volume).expect("a folder");
    let dims = [60, 57, 54];
    ball::write_field(&volume.join("depth.npy"), dims, |at| {
        let [u, v, w] = [at[0] - 30.0, at[1] - 28.0, at[2] - 27.0];
        let wrinkles = if u > 0.0 {
            1.5 * (0.7 * u).sin() * (0.7 * v).sin() * (0.7 * w).sin()
        } else {
            0.0
        };
        20.0 + wrinkles - (u * u + v * v + w * w).sqrt()
    });
    ball::write_field(&volume.join("linear.npy"), dims, linear);
    Some((server::start_with_volumes(std::slice::from_ref(&volume))?, folder))
}

fn linear([x, y, z]: [f32; 3]) -> f32 {
    x + 0.5 * y - 0.25 * z
}

/// Opens the ball as a client that reads values.
async fn open(address: SocketAddr) -> Viewer {
    let mut viewer = Viewer::connect(address).await;
    viewer
        .send(json!({"type": "open", "volume": "ball", "codings": ["values"]}))
        .await;
    viewer.until_opened().await;
    viewer
}

/// Checks that each vertex has the value of the linear field at its position, which was rounded after that.
fn expect_linear(shown: &Meshes, on: &str) {
    for chunk in shown.values() {
        for (vertex, value) in (0..).zip(values(chunk)) {
            let expected = linear(chunk.position(vertex).map(|x| x as f32));
            assert!((value - expected).abs() < 0.02, "{on}: {value}, expected {expected}");
        }
    }
}

/// Checks that both have the same triangles with the same bits of vertices, whatever their values.
fn expect_same_chunks(found: &Meshes, expected: &Meshes, on: &str) {
    assert!(found.len() > 3, "{on}: {} regions", found.len());
    assert_eq!(found.len(), expected.len(), "{on}: regions");
    let without_values = |chunk: &Chunk| Chunk {
        values: None,
        ..chunk.clone()
    };
    for (region, chunk) in found {
        let [found, expected] = [chunk, &expected[region]].map(without_values);
        assert!(found.same_mesh(&expected), "{on}: the mesh of {region:?}");
        assert_eq!(found.vertices.len(), expected.vertices.len(), "{on}: {region:?}");
    }
}

fn values(chunk: &Chunk) -> &[f32] {
    let values = chunk.values.as_deref().expect("a chunk with values");
    assert_eq!(values.len(), chunk.vertices.len());
    values
}

async fn until_rest(viewer: &mut Viewer) {
    while !matches!(viewer.next().await, Frame::Measured { .. }) {}
}

fn statistics_of_cut(statistics: &Value) -> Vec<Value> {
    let names = [
        "triangles",
        "vertices",
        "tolerance",
        "beta",
        "leaves",
        "estimatedError",
        "isTreeCut",
        "fullTriangles",
    ];
    names.map(|name| statistics[name].clone()).to_vec()
}

#[tokio::test]
async fn a_field_for_colours_adds_values_and_changes_nothing_else() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = open(server.address).await;
    let base = json!({"iso": 0, "feature": "gradient-magnitude", "alpha": 0.5, "mask": null, "maxError": "auto", "topology": "auto"});
    let cuts = [
        json!({"triangles": {"share": 0.2}}),
        json!({"bytes": 20_000}),
        json!({"triangles": {"share": 0.2}, "minPart": 20}),
        json!({"beta": 0.02, "mask": "linear>30"}),
        json!({"beta": 0.02, "mesher": "marching-cubes"}),
    ];
    for cut in cuts {
        let mut view = base.clone();
        let on = cut.to_string();
        view.as_object_mut()
            .expect("an edit")
            .extend(cut.as_object().expect("an edit").clone());
        // What marching cubes make is not measured.
        let plain = match cut.get("mesher") {
            Some(_) => viewer.edit(view).await,
            None => viewer.edit_and_rest(view).await.pop().expect("statistics"),
        };
        let before = viewer.shown.clone();
        assert!(before.values().all(|chunk| chunk.values.is_none()), "{on}");

        let colored = viewer.edit(json!({"colorField": "linear"})).await;
        assert_eq!(statistics_of_cut(&colored), statistics_of_cut(&plain), "{on}");
        expect_same_chunks(&viewer.shown, &before, &on);
        expect_linear(&viewer.shown, &on);
        assert_eq!(viewer.surfaces[0].color_field(), Some("linear"), "{on}");

        viewer.edit(json!({"colorField": "depth*0 + 7"})).await;
        expect_same_chunks(&viewer.shown, &before, &on);
        assert!(
            viewer
                .shown
                .values()
                .flat_map(values)
                .all(|value| (value - 7.0).abs() < 1e-5),
            "{on}"
        );

        let without = viewer.edit(json!({"colorField": null})).await;
        assert_eq!(statistics_of_cut(&without), statistics_of_cut(&plain), "{on}");
        expect_same_chunks(&viewer.shown, &before, &on);
        assert!(viewer.shown.values().all(|chunk| chunk.values.is_none()), "{on}");
        assert_eq!(viewer.surfaces[0].color_field(), None, "{on}");
        viewer.edit(json!({"mesher": "dual", "minPart": 0})).await;
    }
    viewer.close().await;
}

/// A probe finds the value of a chunk at a vertex, that of an expression too.
#[tokio::test]
async fn probes_have_the_values_of_the_colours() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = open(server.address).await;
    let full = json!({"iso": 0, "feature": "none", "alpha": 0, "beta": -1, "maxError": null, "topology": "free", "colorField": "depth"});
    viewer.edit(full).await;
    let all: Vec<f32> = viewer.shown.values().flat_map(values).copied().collect();
    let largest = all.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
    assert!(
        all.len() > 5_000 && largest < 0.3,
        "{} values up to {largest}",
        all.len()
    );

    let expression = "linear*linear + 3";
    viewer.edit(json!({"colorField": expression})).await;
    // The vertex with the largest value, where the relative change by rounded positions is small.
    let vertices = viewer
        .shown
        .values()
        .flat_map(|chunk| (0..).zip(values(chunk)).map(move |value| (chunk, value)));
    let largest = vertices.max_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
    let (chunk, (vertex, &sent)) = largest.expect("a vertex");
    let (position, sent) = (chunk.position(vertex), f64::from(sent));
    let (_, answer) = viewer.ask(json!({"type": "probe", "position": position})).await;
    let probed = answer["values"].as_array().expect("values");
    assert_eq!(probed.len(), 3, "both fields and the expression: {answer}");
    assert_eq!(probed[2]["field"], expression, "{answer}");
    let found = probed[2]["value"].as_f64().expect("a number");
    assert!((found - sent).abs() < 0.001 * found, "{sent}, the probe has {found}");
    viewer.close().await;
}

#[tokio::test]
async fn steps_towards_a_surface_and_cameras_have_values_too() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = open(server.address).await;
    let opening = json!({"iso": 0, "alpha": 0.5, "triangles": {"share": 0.2}, "colorField": "linear"});
    viewer.edit_and_rest(opening).await;
    let all_have_values = |viewer: &Viewer, on: &str| {
        assert!(!viewer.shown.is_empty(), "{on}");
        expect_linear(&viewer.shown, on);
    };
    all_have_values(&viewer, "after the first edit");
    viewer.edit(json!({"alpha": 0.6})).await;
    all_have_values(&viewer, "after another weight");
    let camera = json!({"position": [30, -90, 30], "target": [30, 28, 27], "fov": 20, "viewport": [1280, 720]});
    viewer.send(json!({"type": "camera", "camera": camera})).await;
    viewer.until_done().await;
    all_have_values(&viewer, "with a camera");
    viewer.send(json!({"type": "edit", "colorField": "nothing"})).await;
    let message = loop {
        if let Frame::Error { code, message, .. } = viewer.next().await {
            assert_eq!(code, "bad-edit");
            break message;
        }
    };
    assert!(
        message.contains("colorField: \"nothing\", expected one of"),
        "{message}"
    );
    viewer.close().await;
}

#[tokio::test]
async fn clients_that_do_not_read_values_get_none() {
    let Some((server, _folder)) = with_ball() else { return };
    let address = server.address;
    let mut leader = open(address).await;
    let view = json!({"iso": 0, "alpha": 0.5, "triangles": {"share": 0.2}, "colorField": "linear"});
    leader.edit_and_rest(view).await;
    leader.send(json!({"type": "lead"})).await;
    let group = loop {
        if let Frame::Group(group) = leader.next().await {
            break group["group"].clone();
        }
    };
    let mut follower = Viewer::connect(address).await;
    follower.send(json!({"type": "join", "group": group})).await;
    until_rest(&mut follower).await;
    let mut reader = Viewer::connect(address).await;
    reader
        .send(json!({"type": "join", "group": group, "codings": ["values"]}))
        .await;
    until_rest(&mut reader).await;
    expect_same_chunks(&follower.shown, &leader.shown, "a follower");
    expect_same_chunks(&reader.shown, &leader.shown, "a follower that reads values");
    assert!(follower.shown.values().all(|chunk| chunk.values.is_none()));
    assert!(reader.shown.values().all(|chunk| chunk.values.is_some()));
    leader.close().await;
}
