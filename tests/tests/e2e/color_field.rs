//! A field for colours: its values at the vertices come with the chunks, and nothing else changes.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use isopeel_client::{Chunk, Meshes};
use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, demo, server};

/// Opens the demo as a client that reads values.
async fn open(address: SocketAddr) -> Viewer {
    let mut viewer = Viewer::connect(address).await;
    viewer
        .send(json!({"type": "open", "volume": demo::ID, "codings": ["values"]}))
        .await;
    viewer.until_opened().await;
    viewer
}

/// Checks that both have the same triangles with the same bits of vertices, whatever their values.
fn expect_same_chunks(found: &Meshes, expected: &Meshes, on: &str) {
    assert!(found.len() > 5, "{on}: {} regions", found.len());
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

/// The value at each place. Vertices at one place have one value.
fn by_place(chunk: &Chunk) -> BTreeMap<[i16; 3], f32> {
    let positions = chunk.vertices.iter().map(|vertex| vertex.position);
    positions.zip(values(chunk).iter().copied()).collect()
}

fn values(chunk: &Chunk) -> &[f32] {
    let values = chunk.values.as_deref().expect("a chunk with values");
    assert_eq!(values.len(), chunk.vertices.len());
    values
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
    let Some(address) = server::shared() else { return };
    let mut viewer = open(address).await;
    let iso = demo::ISO + 21.0;
    let base = json!({"iso": iso, "feature": "gradient-magnitude", "alpha": 0.5, "mask": null, "maxError": "auto", "topology": "auto"});
    let cuts = [
        json!({"triangles": {"share": 0.1}}),
        json!({"bytes": 300_000}),
        json!({"triangles": {"share": 0.1}, "minPart": 200}),
        json!({"beta": 0.02, "mask": "gm>0"}),
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

        let colored = viewer.edit(json!({"colorField": "gm"})).await;
        assert_eq!(statistics_of_cut(&colored), statistics_of_cut(&plain), "{on}");
        expect_same_chunks(&viewer.shown, &before, &on);
        let gm = viewer.shown.clone();

        viewer.edit(json!({"colorField": "gm*2 + 1"})).await;
        expect_same_chunks(&viewer.shown, &before, &on);
        let mut largest = 0.0f32;
        for (region, chunk) in &gm {
            let doubled = by_place(&viewer.shown[region]);
            for (place, one) in by_place(chunk) {
                // Both are rounded to steps of their ranges.
                let two = doubled[&place];
                assert!((2.0 * one + 1.0 - two).abs() <= 0.05, "{on}: {two} of {one}");
                largest = largest.max(one);
            }
        }
        assert!(largest > 1.0, "{on}: {largest}");

        let without = viewer.edit(json!({"colorField": null})).await;
        assert_eq!(statistics_of_cut(&without), statistics_of_cut(&plain), "{on}");
        expect_same_chunks(&viewer.shown, &before, &on);
        assert!(viewer.shown.values().all(|chunk| chunk.values.is_none()), "{on}");
        viewer.edit(json!({"mesher": "dual", "minPart": 0})).await;
    }
    viewer.close().await;
}

/// A ball's field has the isovalue on its own surface, and a probe finds the same value at a vertex.
#[tokio::test]
async fn values_are_those_at_the_vertices() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ball.npy");
    ball::write_field(&file, [80, 72, 76], |at| {
        30.0 - at.map(|x| (x - 36.0).powi(2)).iter().sum::<f32>().sqrt()
    });
    let Some(own) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    let mut viewer = Viewer::connect(own.address).await;
    viewer
        .send(json!({"type": "open", "volume": "ball", "codings": ["values"]}))
        .await;
    viewer.until_opened().await;
    let full = json!({"iso": 0, "feature": "none", "alpha": 0, "beta": -1, "maxError": null, "topology": "free"});
    viewer.edit(full).await;
    viewer.edit(json!({"colorField": "ball"})).await;
    let all: Vec<f32> = viewer.shown.values().flat_map(values).copied().collect();
    let largest = all.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
    assert!(
        all.len() > 10_000 && largest < 0.05,
        "{} values up to {largest}",
        all.len()
    );

    viewer.edit(json!({"colorField": "ball*ball + 3"})).await;
    let close_to_3 = |value: &f32| (value - 3.0).abs() < 0.8;
    assert!(viewer.shown.values().flat_map(values).all(close_to_3));
    let chunk = viewer.shown.values().next().expect("a region").clone();
    let position = chunk.position(0);
    let (_, answer) = viewer.ask(json!({"type": "probe", "position": position})).await;
    let probed = answer["values"].as_array().expect("values");
    assert_eq!(probed.len(), 2, "the field and the expression: {answer}");
    assert_eq!(probed[1]["field"], "ball*ball + 3", "{answer}");
    let (found, sent) = (
        probed[1]["value"].as_f64().expect("a number"),
        f64::from(values(&chunk)[0]),
    );
    assert!((found - sent).abs() < 1e-3, "{sent}, the probe has {found}");
    viewer.close().await;
}

#[tokio::test]
async fn steps_towards_a_surface_and_cameras_have_values_too() {
    let Some(address) = server::shared() else { return };
    let mut viewer = open(address).await;
    let opening = json!({"iso": demo::ISO + 23.0, "alpha": 0.5, "triangles": {"share": 0.2}, "colorField": "gm"});
    viewer.edit_and_rest(opening).await;
    let all_have_values = |viewer: &Viewer, on: &str| {
        assert!(viewer.shown.values().all(|chunk| chunk.values.is_some()), "{on}");
    };
    all_have_values(&viewer, "after the first edit");
    viewer.edit(json!({"alpha": 0.6})).await;
    all_have_values(&viewer, "after another weight");
    let camera = json!({"position": [0, -300, 80], "target": [0, 0, 0], "fov": 20, "viewport": [1280, 720]});
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
    let Some(address) = server::shared() else { return };
    let mut leader = open(address).await;
    let view = json!({"iso": demo::ISO + 24.0, "alpha": 0.5, "triangles": 60_000, "colorField": "gm"});
    leader.edit_and_rest(view).await;
    leader.send(json!({"type": "lead"})).await;
    let group = loop {
        if let Frame::Group(group) = leader.next().await {
            break group["group"].clone();
        }
    };
    let mut follower = Viewer::connect(address).await;
    follower.send(json!({"type": "join", "group": group})).await;
    follower.until_done().await;
    let mut reader = Viewer::connect(address).await;
    reader
        .send(json!({"type": "join", "group": group, "codings": ["values"]}))
        .await;
    reader.until_done().await;
    expect_same_chunks(&follower.shown, &leader.shown, "a follower");
    expect_same_chunks(&reader.shown, &leader.shown, "a follower that reads values");
    assert!(follower.shown.values().all(|chunk| chunk.values.is_none()));
    assert!(reader.shown.values().all(|chunk| chunk.values.is_some()));
    leader.close().await;
}
