//! Questions about the surface (`server/PROTOCOL.md`): probes at a position, the distribution of values, error against
//! triangles.

use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, demo, server};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number: {value}"))
}

/// A ball of radius 30 in a volume of its own, with a hole of missing samples far from its surface.
fn with_ball() -> Option<(server::Server, tempfile::TempDir)> {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ball.npy");
    ball::write_field(&file, [80, 72, 76], |at| {
        let radius = at.map(|x| (x - 36.0).powi(2)).iter().sum::<f32>().sqrt();
        if radius < 4.0 { f32::NAN } else { 30.0 - radius }
    });
    Some((server::start_with_volumes(std::slice::from_ref(&file))?, folder))
}

#[tokio::test]
async fn a_probe_says_what_is_at_a_position() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = Viewer::open(server.address, "ball").await;
    let (generation, before) = viewer.ask(json!({"type": "probe", "position": [36, 36, 50.5]})).await;
    assert_eq!(generation, 0, "nothing is shown");
    assert!((number(&before["values"][0]["value"]) - 15.5).abs() < 0.05, "{before}");
    assert!(before["nearest"].is_null(), "{before}");

    let statistics = viewer
        .edit_and_rest(json!({"iso": 0, "error": "0.1vx"}))
        .await
        .pop()
        .expect("statistics");
    assert_eq!(statistics["isTreeCut"], true);
    let (generation, on) = viewer
        .ask(json!({"type": "probe", "surface": 0, "position": [66, 36, 36]}))
        .await;
    assert_eq!(generation, 1);
    assert_eq!(
        (&on["inside"], &on["values"][0]["field"]),
        (&json!(true), &json!("ball"))
    );
    assert!(number(&on["values"][0]["value"]).abs() < 0.05, "{on}");
    let nearest = &on["nearest"];
    assert!(number(&nearest["distance"]) < 1.0, "{on}");
    for name in ["smoothness", "blended", "importance"] {
        assert!((0.0..=1.0).contains(&number(&nearest[name])), "{name}: {on}");
    }
    assert_eq!(nearest["leaf"]["kind"], "tree", "{on}");
    assert!(
        (0..=5).contains(&nearest["leaf"]["level"].as_i64().expect("a level")),
        "{on}"
    );
    // Of a sphere of radius 30.
    let area = number(&nearest["partArea"]);
    assert!((area / (4.0 * std::f64::consts::PI * 900.0) - 1.0).abs() < 0.01, "{on}");
    let error = number(&nearest["leaf"]["error"]);
    assert!((0.0..=number(&statistics["tolerance"])).contains(&error), "{on}");

    let (_, centre) = viewer.ask(json!({"type": "probe", "position": [36, 36, 36]})).await;
    let missing = json!([{"field": "ball", "value": null, "why": "missing"}]);
    assert_eq!(centre["values"], missing);
    assert!(centre["nearest"].is_null(), "no surface within two cells: {centre}");
    for outside in [[-0.5, 36.0, 36.0], [36.0, 71.5, 36.0], [1e300, 0.0, 0.0]] {
        let (_, outside) = viewer.ask(json!({"type": "probe", "position": outside})).await;
        assert_eq!(
            (&outside["inside"], &outside["values"], &outside["nearest"]),
            (&json!(false), &json!([]), &json!(null))
        );
    }
    // The volume's last sample is inside.
    let (_, corner) = viewer.ask(json!({"type": "probe", "position": [79, 71, 75]})).await;
    assert_eq!(corner["inside"], true);
    viewer.close().await;
}

#[tokio::test]
async fn a_probe_of_cubes_says_the_leaf_of_the_octree() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = Viewer::open(server.address, "ball").await;
    viewer
        .edit(json!({"iso": 0, "beta": 1, "maxLevel": 2, "topology": "free", "maxError": null}))
        .await;
    let (_, probed) = viewer.ask(json!({"type": "probe", "position": [66, 36, 36]})).await;
    assert!(
        probed["nearest"]["partArea"].is_null(),
        "cubes know of no parts: {probed}"
    );
    let leaf = &probed["nearest"]["leaf"];
    assert_eq!(
        (&leaf["kind"], &leaf["level"]),
        (&json!("cubes"), &json!(2)),
        "{probed}"
    );
    viewer.edit(json!({"beta": -1})).await;
    let (generation, probed) = viewer.ask(json!({"type": "probe", "position": [66, 36, 36]})).await;
    assert_eq!(
        (generation, &probed["nearest"]["leaf"]["level"]),
        (2, &json!(0)),
        "{probed}"
    );
}

#[tokio::test]
async fn a_distribution_counts_every_vertex_of_the_full_surface_once() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    let plain = json!({"iso": demo::ISO, "field": "t1", "feature": "none", "alpha": 0, "maxError": null, "topology": "free",
        "transferFunction": {"points": identity}});
    let mut full = plain.clone();
    full["beta"] = json!(-1);
    viewer.edit(full).await;
    let (_, of_full) = viewer.ask(json!({"type": "distribution", "bins": 16})).await;
    let counts =
        |answer: &Value, name: &str| -> Vec<u64> { serde_json::from_value(answer[name].clone()).expect("counts") };
    assert_eq!(counts(&of_full, "bins").len(), 16);
    assert_eq!(counts(&of_full, "bins").iter().sum::<u64>(), demo::ACTIVE_CELLS);
    assert_eq!(
        (&of_full["kind"], &of_full["coarseShare"]),
        (&json!("cubes"), &json!(0.0))
    );

    let mut half = plain;
    half["beta"] = json!(0.1);
    viewer.edit(half).await;
    let (generation, answer) = viewer.ask(json!({"type": "distribution", "bins": 10})).await;
    assert_eq!(generation, 2);
    let (all, coarse) = (counts(&answer, "bins"), counts(&answer, "coarse"));
    assert_eq!(all.iter().sum::<u64>(), demo::ACTIVE_CELLS);
    let share = coarse.iter().sum::<u64>() as f64 / demo::ACTIVE_CELLS as f64;
    assert!((number(&answer["coarseShare"]) - share).abs() < 1e-9, "{answer}");
    let fine = demo::ACTIVE_CELLS as f64 * (1.0 - share);
    assert!(
        (fine / demo::LEAVES_AT_0_1[0] as f64 - 1.0).abs() < 0.01,
        "cells that are leaves: {fine}"
    );
    // Smoothness alone decides, and up to 0.1 it is merged.
    assert_eq!(coarse[1..].iter().sum::<u64>(), 0, "{answer}");
    assert!(coarse[0] > 0 && coarse[0] <= all[0], "{answer}");
}

#[tokio::test]
async fn surfaces_are_where_the_curve_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("wrinkled.npy");
    ball::write(&file);
    let Some(server) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    let mut viewer = Viewer::open(server.address, "wrinkled").await;
    let done = viewer.edit_and_rest(json!({"iso": 0, "error": "0.1vx"})).await;
    let full = number(&done[0]["fullTriangles"]);
    let (generation, curve) = viewer.ask(json!({"type": "curve"})).await;
    assert_eq!(
        (generation, &curve["kind"], &curve["byError"]),
        (1, &json!("tree"), &json!(true))
    );
    let points = curve["points"].as_array().expect("points");
    assert!((16..=32).contains(&points.len()), "{curve}");
    assert!(
        (number(&points[0]["triangles"]) / full - 1.0).abs() < 0.02 && number(&points[0]["rms"]) == 0.0,
        "{curve}"
    );
    assert!(
        points.windows(2).all(|two| {
            number(&two[0]["triangles"]) > number(&two[1]["triangles"])
                && number(&two[0]["rms"]) <= number(&two[1]["rms"])
        }),
        "{curve}"
    );
    for share in [0.5, 0.25, 0.08] {
        let point = points
            .iter()
            .find(|point| number(&point["triangles"]) <= share * full)
            .expect("a cut as small");
        let done = viewer.edit(json!({"error": point["threshold"]})).await;
        let made = |name: &str| number(&done[name]) / number(&point[name]);
        assert!((made("triangles") - 1.0).abs() < 0.05, "{point}: {done}");
        let rms = number(&done["estimatedError"]["rms"]) / number(&point["rms"]);
        assert!((rms - 1.0).abs() < 0.2, "{point}: {done}");
    }
    // If β decides, the cut is one of cubes.
    viewer.edit(json!({"beta": 0.05})).await;
    let (_, curve) = viewer.ask(json!({"type": "curve"})).await;
    assert_eq!((&curve["kind"], &curve["byError"]), (&json!("cubes"), &json!(false)));
}

#[tokio::test]
async fn a_question_beside_an_edit_is_answered_for_that_edit_and_a_flood_holds_up_nothing() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let flood = (0..2000).map(|i| json!({"type": "probe", "position": [f64::from(i % 50), -20, 5]}));
    viewer
        .send_all(
            [json!({"type": "edit", "beta": 0.1, "iso": demo::ISO})]
                .into_iter()
                .chain(flood),
        )
        .await;
    let (mut done, mut answers) = (false, Vec::new());
    viewer.send(json!({"type": "probe", "position": [50, -20, 5]})).await;
    while !answers
        .last()
        .is_some_and(|(_, answer): &(u32, Value)| answer["position"][0] == json!(50.0))
    {
        match viewer.next().await {
            Frame::Done { .. } => done = true,
            Frame::Answer { generation, answer, .. } => answers.push((generation, answer)),
            Frame::Error { message, .. } => panic!("{message}"),
            _ => {}
        }
    }
    assert!(done, "the edit goes first");
    assert!(
        answers.len() < 2001 && answers.iter().all(|(generation, _)| *generation == 1),
        "{}",
        answers.len()
    );
    viewer.close().await;
}

#[tokio::test]
async fn questions_that_cannot_be_answered_are_refused() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::connect(address).await;
    let refused = async |viewer: &mut Viewer, question: &str| {
        viewer.send_raw(isopeel_client::Message::text(question)).await;
        match viewer.next().await {
            Frame::Error { code, open: true, .. } => code,
            other => panic!("{question}: expected `error`, got {other:?}"),
        }
    };
    assert_eq!(refused(&mut viewer, r#"{"type":"curve"}"#).await, "not-open");
    viewer.send(json!({"type": "open", "volume": demo::ID})).await;
    viewer.until_opened().await;
    for (question, code) in [
        (r#"{"type":"curve"}"#, "no-surface"),
        (r#"{"type":"distribution"}"#, "no-surface"),
        (r#"{"type":"distribution","bins":1000000000}"#, "bad-question"),
        (r#"{"type":"distribution","bins":0}"#, "bad-question"),
        (r#"{"type":"probe","surface":3,"position":[0,0,0]}"#, "unknown-surface"),
        (
            r#"{"type":"annotate","surface":3,"annotation":"error"}"#,
            "unknown-surface",
        ),
        (r#"{"type":"annotate","annotation":"error"}"#, "no-surface"),
        (r#"{"type":"probe","position":[NaN,0,0]}"#, "bad-message"),
        (r#"{"type":"probe","position":[1e999,0,0]}"#, "bad-message"),
        (r#"{"type":"probe","position":[0,0]}"#, "bad-message"),
    ] {
        assert_eq!(refused(&mut viewer, question).await, code, "{question}");
    }
    viewer.close().await;
}

/// Checks the distances of a surface that is a ball of this radius, for which the distance of each vertex is known.
async fn check_annotation(viewer: &mut Viewer, asked: u8, radius: f32) {
    let question = json!({"type": "annotate", "surface": asked, "annotation": "error"});
    let (generation, annotated) = viewer.ask(question).await;
    assert_eq!(
        (&annotated["surface"], &annotated["annotation"]),
        (&json!(asked), &json!("error"))
    );
    assert_eq!(generation, viewer.surfaces[usize::from(asked)].generation());
    let shown = &viewer.surfaces[usize::from(asked)].shown.clone();
    let regions = annotated["regions"].as_u64().expect("a count");
    assert_eq!(regions as usize, shown.len(), "every region that is shown");
    let mut largest = 0f32;
    for _ in 0..regions {
        let Frame::Errors {
            surface,
            region,
            distances,
            ..
        } = viewer.next().await
        else {
            panic!("expected errors, got {:?}", viewer.log.last())
        };
        assert_eq!(surface, asked);
        for (vertex, distance) in shown[&region].vertices.iter().zip(distances) {
            let at = |i: usize| region.coords[i] as f32 * 32.0 + f32::from(vertex.position[i]) / 64.0 - 36.0;
            let expected = ((0..3).map(|i| at(i).powi(2)).sum::<f32>().sqrt() - radius).abs();
            assert!(
                (distance - expected).abs() < 0.06 + 0.1 * expected,
                "{distance}, expected {expected}"
            );
            largest = largest.max(distance);
        }
    }
    assert!(largest > 0.0);
}

#[tokio::test]
async fn an_annotation_has_the_distance_of_every_vertex_that_is_shown() {
    let Some((server, _folder)) = with_ball() else { return };
    let mut viewer = Viewer::open(server.address, "ball").await;
    for edit in [
        json!({"iso": 0, "error": "0.3vx"}),
        json!({"beta": 1, "maxLevel": 3, "topology": "free", "maxError": null}),
    ] {
        viewer.edit_and_rest(edit).await;
        check_annotation(&mut viewer, 0, 30.0).await;
    }
    viewer
        .edit_and_rest(json!({"surface": 2, "iso": 12, "error": "0.3vx"}))
        .await;
    check_annotation(&mut viewer, 2, 18.0).await;
    check_annotation(&mut viewer, 0, 30.0).await;
    viewer.close().await;
}
