//! Up to four surfaces on one connection, which share its budget.

use isopeel_client::same_meshes;
use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{demo, mesh, server};

/// Isovalues of the demo with surfaces of different sizes.
const ISOS: [f64; 4] = [100.0, 95.0, 105.0, 115.0];

fn edit(surface: usize, decides: &Value) -> Value {
    let mut edit = json!({"surface": surface, "iso": ISOS[surface], "field": "t1", "feature": "none", "alpha": 0,
        "maxError": "auto", "topology": "auto"});
    for (name, value) in decides.as_object().expect("an object") {
        edit[name] = value.clone();
    }
    edit
}

/// Sends messages, and reads until generations that they cause are done, and these surfaces, of which `newer` have another generation,
/// are measured.
async fn settle(viewer: &mut Viewer, messages: Vec<Value>, surfaces: &[usize], newer: &[usize]) {
    let before: Vec<u32> = viewer.surfaces.iter().map(|surface| surface.generation()).collect();
    viewer.send_all(messages).await;
    let is_settled = |viewer: &Viewer| {
        surfaces.iter().all(|&surface| viewer.surfaces[surface].is_measured())
            && newer
                .iter()
                .all(|&surface| viewer.surfaces[surface].generation() > before[surface])
    };
    while !is_settled(viewer) {
        let frame = viewer.next().await;
        assert!(
            !matches!(frame, Frame::Error { .. } | Frame::Closed { .. }),
            "{frame:?}"
        );
    }
}

/// `edit` as a message.
fn message(surface: usize, decides: &Value) -> Value {
    let mut edit = edit(surface, decides);
    edit["type"] = json!("edit");
    edit
}

/// If the budget does not couple them, each surface has the same bytes as it has alone.
#[tokio::test]
async fn surfaces_are_what_they_are_alone() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    // At once, so that their steps come between each other.
    let decides = [json!({"beta": 0.02}), json!({"beta": 0.1}), json!({"error": "0.5vx"})];
    let edits = decides
        .iter()
        .enumerate()
        .map(|(surface, decides)| message(surface, decides));
    settle(&mut viewer, edits.collect(), &[0, 1, 2], &[0, 1, 2]).await;
    for (surface, decides) in decides.iter().enumerate() {
        let mut alone = Viewer::open(address, demo::ID).await;
        let mut edit = edit(surface, decides);
        edit["surface"] = json!(0);
        alone.edit_and_rest(edit).await;
        assert!(
            same_meshes(&viewer.surfaces[surface].shown, &alone.shown),
            "surface {surface}"
        );
        assert!(!alone.shown.is_empty());
    }
    // An edit of one leaves the others as they are.
    let before = viewer.surfaces[0].shown.clone();
    viewer.edit(json!({"surface": 1, "beta": 0.05})).await;
    assert!(same_meshes(&viewer.shown, &before));
}

#[tokio::test]
async fn a_budget_is_kept_and_filled_by_all_surfaces_together() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let budget = 60_000;
    let first = vec![message(0, &json!({ "triangles": budget })), message(1, &json!({}))];
    settle(&mut viewer, first, &[0, 1], &[0, 1]).await;
    // Those before follow with smaller parts.
    settle(&mut viewer, vec![message(2, &json!({}))], &[0, 1, 2], &[0, 1, 2]).await;
    settle(&mut viewer, vec![message(3, &json!({}))], &[0, 1, 2, 3], &[0, 1, 2, 3]).await;
    let counts: Vec<u64> = viewer
        .surfaces
        .iter()
        .map(|surface| surface.triangles() as u64)
        .collect();
    let sum: u64 = counts.iter().sum();
    assert!(sum <= budget && sum * 100 >= budget * 95, "{counts:?} of {budget}");
    for surface in &viewer.surfaces {
        assert_eq!(mesh::open_edges(surface.shown.values(), demo::DIMS).len(), 0);
    }
    assert_final_surfaces_keep(&viewer, budget);

    // If a surface is removed, the others get its share.
    let remove = vec![json!({"type": "remove", "surface": 0})];
    settle(&mut viewer, remove, &[1, 2, 3], &[1, 2, 3]).await;
    assert!(viewer.surfaces[0].shown.is_empty());
    let sum: u64 = viewer.surfaces.iter().map(|surface| surface.triangles() as u64).sum();
    assert!(sum <= budget && sum * 100 >= budget * 95, "{sum} of {budget}");
}

/// Checks that at no time the last committed final surfaces exceed this number of triangles together.
#[track_caller]
fn assert_final_surfaces_keep(viewer: &Viewer, budget: u64) {
    let mut last = [0; 4];
    for frame in &viewer.log {
        if let Frame::Prefix(prefix) = frame
            && prefix.is_final
        {
            last[usize::from(prefix.surface)] = prefix.triangles as u64;
            assert!(last.iter().sum::<u64>() <= budget, "{last:?} of {budget}");
        }
    }
}

#[tokio::test]
async fn a_budget_of_bytes_is_shared_too() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let budget = 400_000;
    let edits = (0..2).map(|surface| message(surface, &json!({ "bytes": budget })));
    settle(&mut viewer, edits.collect(), &[0, 1], &[0, 1]).await;
    let bytes = |surface: usize| {
        viewer.surfaces[surface]
            .shown
            .values()
            .map(|chunk| chunk.frame_bytes)
            .sum::<usize>()
    };
    let sum = bytes(0) + bytes(1);
    assert!(sum <= budget && sum * 100 >= budget * 85, "{sum} of {budget} bytes");
}
