//! The prefixes of an edit, their order, and what of them is sent.

use std::time::{Duration, Instant};

use super::super::draw_pause::DRAW_PAUSE;
use super::super::open_volume::STARVATION_LIMIT;
use super::scripted::{TOO_FINE, shapes};
use super::viewer::{FIRST_PREFIX_TARGET, Viewer};

#[tokio::test]
async fn prefixes_come_coarse_first_and_end_with_the_statistics() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.job(4).await;
    assert_eq!((job.view.beta, job.view.iso.map(|iso| iso.get())), (0.5, Some(100.0)));
    job.answer(shapes(&[1]));
    viewer
        .expect(r#"{"type":"prefix","surface":0,"generation":1,"level":4,"kind":"cut","regions":1,"unchanged":0,"triangles":1,"final":false}"#)
        .await;
    let chunk = viewer.chunk().await;
    assert_eq!(
        (
            chunk.header.prefix.generation,
            chunk.header.prefix.level,
            chunk.header.region
        ),
        (1, 4, [0, 0, 0])
    );
    viewer
        .expect(r#"{"type":"committed","surface":0,"generation":1,"level":4,"final":false}"#)
        .await;
    viewer.job(0).await.answer(shapes(&[1, 2]));
    viewer
        .expect(r#"{"type":"prefix","surface":0,"generation":1,"level":0,"kind":"cut","regions":1,"unchanged":1,"triangles":2,"final":true}"#)
        .await;
    assert_eq!(viewer.chunk().await.header.region, [1, 0, 0]);
    viewer
        .expect(r#"{"type":"committed","surface":0,"generation":1,"level":0,"final":true}"#)
        .await;
    let done = viewer.text().await;
    assert_eq!((&done["type"], &done["generation"]), (&"done".into(), &1.into()));
    let mut names: Vec<_> = done["statistics"].as_object().expect("an object").keys().collect();
    names.sort();
    let mut expected = vec![
        "mesher",
        "beta",
        "maxError",
        "topology",
        "polished",
        "error",
        "estimatedError",
        "fullTriangles",
        "activeCells",
        "leaves",
        "triangles",
        "vertices",
        "lostCubes",
        "unpatchedVertices",
        "stagesMs",
        "wallMs",
        "deviceBytes",
        "volumeBytes",
        "device",
    ];
    expected.sort_unstable();
    assert_eq!(names, expected);
    assert_eq!(done["statistics"]["triangles"], 2);
    assert_eq!(done["statistics"]["wallMs"], 20.0, "both prefixes");
    assert_eq!(done["statistics"]["device"], "scripted");
    viewer.quiet().await;
}

#[tokio::test]
async fn the_device_works_on_the_next_prefix_while_this_one_is_sent() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[1, 2, 3, 4, 5, 6]));
    // Not one frame was read.
    viewer.job(0).await.answer(shapes(&[1]));
    let mut levels = Vec::new();
    loop {
        let (text, chunk) = viewer.text_or_chunk().await;
        levels.extend(chunk.map(|c| c.header.prefix.level));
        if text["type"] == "done" {
            break;
        }
    }
    assert_eq!(levels, [4, 4, 4, 4, 4, 4, 0, 0, 0, 0, 0], "six, then five removals");
}

#[tokio::test]
async fn only_what_changed_is_sent() {
    let mut viewer = Viewer::showing(&[1, 2, 3, 4, 5]).await;
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    // Same surface, other cut: straight to the final prefix. One region new, one gone, three as they were.
    viewer.job(0).await.answer(shapes(&[1, 7, 3, 0, 5]));
    viewer
        .expect(r#"{"type":"prefix","surface":0,"generation":2,"level":0,"kind":"cut","regions":2,"unchanged":3,"triangles":4,"final":true}"#)
        .await;
    let (changed, gone) = (viewer.chunk().await, viewer.chunk().await);
    assert_eq!((changed.header.region, changed.header.vertex_count), ([1, 0, 0], 3));
    assert_eq!((gone.header.region, gone.header.vertex_count), ([3, 0, 0], 0));
    viewer
        .expect(r#"{"type":"committed","surface":0,"generation":2,"level":0,"final":true}"#)
        .await;
    assert_eq!(viewer.text().await["type"], "done");

    viewer.say(r#"{"type":"edit","alpha":0.9}"#).await;
    viewer.job(0).await.answer(shapes(&[1, 7, 3, 0, 5]));
    viewer
        .expect(r#"{"type":"prefix","surface":0,"generation":3,"level":0,"kind":"cut","regions":0,"unchanged":4,"triangles":4,"final":true}"#)
        .await;
    viewer
        .expect(r#"{"type":"committed","surface":0,"generation":3,"level":0,"final":true}"#)
        .await;
    assert_eq!(viewer.text().await["type"], "done");
}

#[tokio::test]
async fn another_isovalue_starts_coarse_again() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","iso":5}"#).await;
    viewer.job(4).await.answer(shapes(&[3]));
}

#[tokio::test]
async fn the_first_prefix_waits_for_no_plan() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    // A plan of this is refused at once: the prefix was made before it.
    viewer
        .say(&format!(r#"{{"type":"edit","iso":5,"beta":{TOO_FINE}}}"#))
        .await;
    viewer.job(4).await.answer(shapes(&[3]));
    let error = loop {
        let (text, _) = viewer.text_or_chunk().await;
        if text["type"] == "error" {
            break text;
        }
    };
    assert_eq!(error["code"], "too-large");
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
}

#[tokio::test]
async fn a_slow_change_of_the_cut_begins_with_a_preview_and_a_drag_goes_on_with_it() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.job(4).await.answer(shapes(&[9]));
    viewer.job(0).await.answer_after(shapes(&[1]), 2 * FIRST_PREFIX_TARGET);
    while viewer.text_or_chunk().await.0["type"] != "done" {}
    for beta in [0.1, 0.2] {
        viewer.say(&format!(r#"{{"type":"edit","beta":{beta}}}"#)).await;
        viewer.job(2).await.answer(shapes(&[7]));
        while viewer.text_or_chunk().await.0["type"] != "committed" {}
        viewer.job(0).await.answer(shapes(&[4]));
        while viewer.text_or_chunk().await.0["type"] != "done" {}
        // Now the device is fast.
        viewer.say(r#"{"type":"edit","alpha":0.5}"#).await;
        viewer.job(0).await.answer_after(shapes(&[5]), 2 * FIRST_PREFIX_TARGET);
        while viewer.text_or_chunk().await.0["type"] != "done" {}
    }
    viewer.say(r#"{"type":"edit","beta":0.3}"#).await;
    viewer.job(2).await.answer(shapes(&[6]));
    while viewer.text_or_chunk().await.0["type"] != "committed" {}
    let overtaken = viewer.job(0).await;
    viewer.say(r#"{"type":"edit","beta":0.4}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":6}"#)
        .await;
    overtaken.answer_cancelled();
    viewer.job(2).await.answer(shapes(&[8]));
}

#[tokio::test]
async fn a_storm_without_commits_goes_coarse_first() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    viewer.say(r#"{"type":"edit","beta":0.1}"#).await;
    let first = viewer.job(0).await;
    tokio::time::sleep(STARVATION_LIMIT + Duration::from_millis(20)).await;
    viewer.say(r#"{"type":"edit","beta":0.2}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    first.answer_cancelled();
    viewer.job(2).await.answer(shapes(&[9]));
    while viewer.text_or_chunk().await.0["type"] != "committed" {}
    viewer.job(0).await.answer(shapes(&[1]));
}

/// With the first prefix of generation 2 committed, to a client that has said `drawn` before.
async fn waiting_for_drawn() -> Viewer {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"drawn","generation":1}"#).await;
    viewer.say(r#"{"type":"edit","iso":5}"#).await;
    viewer.job(4).await.answer(shapes(&[3]));
    while viewer.text_or_chunk().await.0["type"] != "committed" {}
    viewer
}

#[tokio::test]
async fn the_device_waits_until_the_first_prefix_is_drawn() {
    let mut viewer = waiting_for_drawn().await;
    viewer.say(r#"{"type":"drawn","generation":1}"#).await;
    viewer.quiet().await;
    let said = Instant::now();
    viewer.say(r#"{"type":"drawn","generation":2}"#).await;
    viewer.job(0).await.answer(shapes(&[1]));
    assert!(said.elapsed() < DRAW_PAUSE / 2, "the pause went on");
    while viewer.text_or_chunk().await.0["type"] != "done" {}
}

#[tokio::test]
async fn the_device_waits_for_a_picture_no_longer_than_the_pause() {
    let began = Instant::now();
    let mut viewer = waiting_for_drawn().await;
    viewer.job(0).await.answer(shapes(&[1]));
    assert!(began.elapsed() >= DRAW_PAUSE);
    while viewer.text_or_chunk().await.0["type"] != "done" {}
}

#[tokio::test]
async fn an_edit_waits_for_no_picture_of_the_one_before() {
    let mut viewer = waiting_for_drawn().await;
    let said = Instant::now();
    viewer.say(r#"{"type":"edit","iso":6}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    viewer.job(4).await.answer(shapes(&[4]));
    assert!(said.elapsed() < DRAW_PAUSE / 2, "the pause went on");
}
