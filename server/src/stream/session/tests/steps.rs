//! The steps of an edit, their order, and the regions that are sent.

use std::time::Instant;

use isopeel_extraction::{CutId, MeasuredError, Measurement, Shown, WorkError};

use super::super::draw_pause::DRAW_PAUSE;
use super::super::rest::REST_AFTER;
use super::scripted::{Answer, shapes};
use super::viewer::{Viewer, committed, prefix};

#[tokio::test]
async fn steps_come_coarse_first_and_end_with_the_statistics() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.step().await;
    assert_eq!((job.view.beta, job.view.iso.map(|iso| iso.get())), (0.5, Some(100.0)));
    assert_eq!((job.shown(), job.made_triangles()), (Shown::Another, 0));
    job.answer(Answer::prefix(1, shapes(&[1])));
    viewer.expect(&prefix(1, 4, [1, 0, 1], false)).await;
    let chunk = viewer.chunk().await;
    assert_eq!(
        (
            chunk.header.prefix.generation,
            chunk.header.prefix.level,
            chunk.header.region.coords
        ),
        (1, 4, [0, 0, 0])
    );
    viewer.expect(&committed(1, 4, false)).await;
    let job = viewer.step().await;
    assert_eq!((job.shown(), job.made_triangles()), (Shown::Cut(CutId::new(1)), 1));
    job.answer(Answer::last(2, shapes(&[1, 2])));
    viewer.expect(&prefix(1, 0, [1, 1, 2], true)).await;
    assert_eq!(viewer.chunk().await.header.region.coords, [1, 0, 0]);
    viewer.expect(&committed(1, 0, true)).await;
    let done = viewer.text().await;
    assert_eq!((&done["type"], &done["generation"]), (&"done".into(), &1.into()));
    let mut names: Vec<_> = done["statistics"].as_object().expect("an object").keys().collect();
    names.sort();
    let mut expected = vec![
        "mesher",
        "beta",
        "maxError",
        "topology",
        "tolerance",
        "gaveWay",
        "isTreeCut",
        "error",
        "estimatedError",
        "featureRange",
        "fullTriangles",
        "mesherTriangles",
        "pixels",
        "removedParts",
        "removedTriangles",
        "unmatchedPositions",
        "vanishedParts",
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
    assert_eq!(done["statistics"]["wallMs"], 20.0, "both steps");
    assert_eq!(done["statistics"]["device"], "scripted");
    viewer.quiet().await;
}

#[tokio::test]
async fn the_device_works_on_the_next_step_while_this_one_is_sent() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::prefix(1, shapes(&[1, 2, 3])));
    viewer.until("committed").await;
    let job = viewer.step().await;
    job.answer(Answer::last(2, shapes(&[2, 3, 4, 5, 6, 7])).on_the_way());
    // The viewer has not read any frame of that step.
    viewer.step().await.answer(Answer::last(3, shapes(&[1])));
    let mut chunks = Vec::new();
    loop {
        let (text, chunk) = viewer.text_or_chunk().await;
        chunks.extend(chunk.map(|c| c.header.vertex_count));
        if text["type"] == "done" {
            break;
        }
    }
    assert_eq!(
        chunks,
        [3, 3, 3, 3, 3, 3, 3, 0, 0, 0, 0, 0],
        "six, then one and five removals"
    );
}

#[tokio::test]
async fn only_what_changed_is_sent() {
    let mut viewer = Viewer::showing(&[1, 2, 3, 4, 5]).await;
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        job.shown(),
        Shown::Cut(CutId::new(2)),
        "the same surface, cut otherwise"
    );
    // One region is new, one is gone, three are unchanged.
    job.answer(Answer::last(3, shapes(&[1, 7, 3, 0, 5])));
    viewer.expect(&prefix(2, 0, [2, 3, 4], true)).await;
    let (changed, gone) = (viewer.chunk().await, viewer.chunk().await);
    assert_eq!(
        (changed.header.region.coords, changed.header.vertex_count),
        ([1, 0, 0], 3)
    );
    assert_eq!((gone.header.region.coords, gone.header.vertex_count), ([3, 0, 0], 0));
    viewer.until("done").await;

    viewer.say(r#"{"type":"edit","alpha":0.9}"#).await;
    viewer.step().await.answer(Answer::last(4, shapes(&[1, 7, 3, 0, 5])));
    viewer.expect(&prefix(3, 0, [0, 4, 4], true)).await;
    viewer.expect(&committed(3, 0, true)).await;
    viewer.until("done").await;
}

#[tokio::test]
async fn regions_that_were_not_made_anew_stay() {
    let mut viewer = Viewer::showing(&[1, 2, 3, 4]).await;
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    // Of the remade regions 0, 1 and 3, region 0 changes, region 1 does not, and region 3 has no triangles any more.
    let regions = shapes(&[5, 2, 0, 0]);
    viewer
        .step()
        .await
        .answer(Answer::last(3, regions).of_regions(&[0, 1, 3]));
    viewer.expect(&prefix(2, 0, [2, 2, 2], true)).await;
    let (changed, gone) = (viewer.chunk().await, viewer.chunk().await);
    assert_eq!(
        (changed.header.region.coords, changed.header.vertex_count),
        ([0, 0, 0], 3)
    );
    assert_eq!((gone.header.region.coords, gone.header.vertex_count), ([3, 0, 0], 0));
    viewer.until("done").await;
}

#[tokio::test]
async fn what_is_shown_decides_how_an_edit_begins() {
    for (edit, shown) in [
        (r#"{"type":"edit","iso":5}"#, Shown::Another),
        (r#"{"type":"edit","feature":"none"}"#, Shown::Alike),
        (r#"{"type":"edit","featureRange":[3,4]}"#, Shown::Alike),
        (r#"{"type":"edit","colorField":"density"}"#, Shown::Alike),
        (r#"{"type":"edit","mesher":"marching-cubes"}"#, Shown::Alike),
        (r#"{"type":"edit","triangles":7}"#, Shown::Cut(CutId::new(2))),
    ] {
        let mut viewer = Viewer::showing(&[1, 2]).await;
        viewer.say(edit).await;
        assert_eq!(viewer.step().await.shown(), shown, "{edit}");
    }
}

#[tokio::test]
async fn a_drag_commits_a_step_of_every_edit_that_it_begins() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    for generation in [2, 4, 6] {
        viewer.say(&format!(r#"{{"type":"edit","beta":0.{generation}}}"#)).await;
        let job = viewer.step().await;
        // Further edits arrive faster than the device makes steps.
        for more in 0..3 {
            viewer
                .say(&format!(r#"{{"type":"edit","beta":0.{generation}{more}}}"#))
                .await;
        }
        assert!(!job.token.is_cancelled());
        job.answer(Answer::last(10 + generation, shapes(&[generation as i32 + 3])).on_the_way());
        assert_eq!(viewer.until("committed").await["generation"], generation);
        assert_eq!(viewer.until("superseded").await["generation"], generation);
        let next = viewer.step().await;
        assert_eq!(
            next.view.beta,
            format!("0.{generation}2").parse::<f32>().expect("a number")
        );
        assert_eq!(next.shown(), Shown::Cut(CutId::new(10 + generation)));
        viewer.say(r#"{"type":"cancel"}"#).await;
        viewer.until("superseded").await;
        next.answer_cancelled().await;
    }
}

/// Returns a viewer that has sent `drawn` before, and to which the first step of generation 2 is committed.
async fn waiting_for_drawn() -> Viewer {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"drawn","generation":1}"#).await;
    viewer.say(r#"{"type":"edit","iso":5}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[3])));
    viewer.until("committed").await;
    viewer
}

#[tokio::test]
async fn the_device_waits_until_the_first_step_is_drawn() {
    let mut viewer = waiting_for_drawn().await;
    viewer.say(r#"{"type":"drawn","generation":1}"#).await;
    viewer.quiet().await;
    let said = Instant::now();
    viewer.say(r#"{"type":"drawn","generation":2}"#).await;
    viewer.step().await.answer(Answer::last(4, shapes(&[1])));
    assert!(said.elapsed() < DRAW_PAUSE / 2, "the pause went on");
    viewer.until("done").await;
}

#[tokio::test]
async fn the_device_waits_for_a_picture_no_longer_than_the_pause() {
    let began = Instant::now();
    let mut viewer = waiting_for_drawn().await;
    viewer.step().await.answer(Answer::last(4, shapes(&[1])));
    assert!(began.elapsed() >= DRAW_PAUSE);
    viewer.until("done").await;
}

#[tokio::test]
async fn an_edit_waits_for_no_picture_of_the_one_before() {
    let mut viewer = waiting_for_drawn().await;
    let said = Instant::now();
    viewer.say(r#"{"type":"edit","iso":6}"#).await;
    assert_eq!(viewer.until("superseded").await["generation"], 2);
    viewer.step().await.answer(Answer::prefix(4, shapes(&[4])));
    assert!(said.elapsed() < DRAW_PAUSE / 2, "the pause went on");
}

#[tokio::test]
async fn a_surface_that_rests_is_measured() {
    let done = Instant::now();
    let mut viewer = Viewer::showing(&[1, 2]).await;
    let job = viewer.measurements.recv().await.expect("a measurement");
    assert!(done.elapsed() >= REST_AFTER);
    let error = MeasuredError { rms: 0.5, max: 2.0 };
    let measured = Measurement {
        whole: error,
        regions: vec![([1, 0, 0], error)],
    };
    assert!(job.reply.send(Ok(Some(measured))).is_ok());
    viewer
        .expect(
            r#"{"type":"measured","surface":0,"generation":1,"error":{"rms":0.5,"max":2.0},
                "regions":[{"region":[1,0,0],"rms":0.5,"max":2.0}]}"#,
        )
        .await;
    viewer.quiet().await;
}

#[tokio::test]
async fn an_edit_cancels_the_measurement() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    let job = viewer.measurements.recv().await.expect("a measurement");
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    job.token.cancelled().await;
    assert!(job.reply.send(Err(WorkError::Cancelled)).is_ok());
    viewer.step().await.answer(Answer::last(3, shapes(&[1, 2])));
    viewer.until("done").await;
}

/// Shows a surface of one region that a better one may follow.
async fn showing_what_can_improve() -> Viewer {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::last(1, shapes(&[1])).improvable());
    viewer.until("done").await;
    viewer
}

#[tokio::test]
async fn a_surface_that_rests_is_replaced_by_a_better_one_and_then_measured() {
    let mut viewer = showing_what_can_improve().await;
    let job = viewer.improvements.recv().await.expect("an improvement");
    let better = Answer::last(2, shapes(&[2])).refinement(&job.view);
    assert!(job.reply.send(Ok(Some(better))).is_ok());
    viewer.expect(&prefix(1, 0, [1, 0, 1], true)).await;
    viewer.chunk().await;
    viewer.expect(&committed(1, 0, true)).await;
    let done = viewer.text().await;
    assert_eq!((&done["type"], &done["generation"]), (&"done".into(), &1.into()));
    let job = viewer.measurements.recv().await.expect("a measurement");
    assert!(job.reply.send(Ok(None)).is_ok());
    viewer.quiet().await;
}

#[tokio::test]
async fn a_surface_that_cannot_be_improved_is_measured() {
    for failed in [false, true] {
        let mut viewer = showing_what_can_improve().await;
        let job = viewer.improvements.recv().await.expect("an improvement");
        let answer = if failed { Err(WorkError::Busy) } else { Ok(None) };
        assert!(job.reply.send(answer).is_ok());
        viewer.measurements.recv().await.expect("a measurement");
    }
}

#[tokio::test]
async fn parts_that_cannot_be_removed_are_an_error_and_the_view_before_comes_back() {
    for removal in [r#""minPart":5"#, r#""parts":{"hide":[[1,2,3]]}"#] {
        let mut viewer = Viewer::opened().await;
        viewer.say(&format!(r#"{{"type":"edit","error":0.1,{removal}}}"#)).await;
        let job = viewer.step().await;
        assert!(job.view.removes_parts());
        let error = WorkError::NoTree(isopeel_kernels::Error::NoDriver);
        assert!(job.reply.send(Err(error)).is_ok());
        let error = viewer.until("error").await;
        assert_eq!((&error["code"], &error["surface"]), (&"too-large".into(), &0.into()));
        let message = error["message"].as_str().expect("a message");
        assert!(
            message.starts_with("minPart, parts: parts are removed from the vertex tree"),
            "{message}"
        );
        viewer.until("superseded").await;
        viewer.quiet().await;
        viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
        let job = viewer.step().await;
        assert!(!job.view.removes_parts() && job.view.alpha == 0.25);
    }
}

#[tokio::test]
async fn an_edit_cancels_the_improvement() {
    let mut viewer = showing_what_can_improve().await;
    let job = viewer.improvements.recv().await.expect("an improvement");
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    job.token.cancelled().await;
    assert!(job.reply.send(Err(WorkError::Cancelled)).is_ok());
    viewer.step().await.answer(Answer::last(3, shapes(&[1])));
    assert_eq!(viewer.until("done").await["generation"], 2);
}
