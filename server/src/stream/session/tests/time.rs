//! Other time steps of the open volume.

use isopeel_extraction::{CutId, Shown, WorkError};

use super::scripted::{Answer, shapes};
use super::viewer::{Viewer, committed, prefix};

const TO_STEP_1: &str = r#"{"type":"step","step":1}"#;

#[tokio::test]
async fn another_step_sends_what_differs_in_one_commit() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    viewer.say(TO_STEP_1).await;
    viewer.expect(r#"{"type":"stepped","step":1,"label":null}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        (job.volume.step(), job.shown()),
        (1, Shown::Alike),
        "no coarse surface in between"
    );
    assert_eq!(job.view.iso.map(|iso| iso.get()), Some(100.0), "values in force stay");
    job.answer(Answer::last(3, shapes(&[1, 7, 3])));
    viewer.expect(&prefix(2, 0, [1, 2, 3], true)).await;
    assert_eq!(viewer.chunk().await.header.region.coords, [1, 0, 0]);
    viewer.until("done").await;
    // From here on edits apply to this step.
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    let job = viewer.step().await;
    assert_eq!((job.volume.step(), job.shown()), (1, Shown::Cut(CutId::new(3))));
}

/// Regions of the earlier step would otherwise look like regions of this step.
#[tokio::test]
async fn nothing_is_shown_of_a_surface_that_a_step_has_not() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(TO_STEP_1).await;
    viewer.until("stepped").await;
    let error = WorkError::OverBudget {
        minimum: 300,
        budget: 200,
    };
    assert!(viewer.step().await.reply.send(Err(error)).is_ok());
    viewer.expect(&prefix(2, 0, [2, 0, 0], false)).await;
    for region in 0..2 {
        let header = viewer.chunk().await.header;
        assert_eq!((header.region.coords, header.vertex_count), ([region, 0, 0], 0));
    }
    viewer.expect(&committed(2, 0, false)).await;
    assert_eq!(viewer.error().await, ("over-budget".into(), true));
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    viewer.say(r#"{"type":"edit","beta":0.7}"#).await;
    let job = viewer.step().await;
    assert_eq!((job.volume.step(), job.shown()), (1, Shown::Another));
    // A prefix that was sent before the failure has already replaced all regions of the other step.
    job.answer(Answer::prefix(7, shapes(&[5])));
    viewer.until("committed").await;
    let error = WorkError::OverBudget {
        minimum: 300,
        budget: 200,
    };
    assert!(viewer.step().await.reply.send(Err(error)).is_ok());
    assert_eq!(viewer.error().await, ("over-budget".into(), true));
}

#[tokio::test]
async fn a_step_is_described_when_the_viewer_rests() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(TO_STEP_1).await;
    viewer.until("stepped").await;
    viewer.step().await.answer(Answer::last(3, shapes(&[2])));
    viewer.until("done").await;
    viewer
        .expect(r#"{"type":"described","step":1,"volume":{"step":1}}"#)
        .await;
    viewer.quiet().await;
}

#[tokio::test]
async fn the_next_step_is_read_ahead_and_the_latest_is_made() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(TO_STEP_1).await;
    viewer.until("stepped").await;
    // Step 1 is overtaken before any surface was made of it.
    let late = viewer.step().await;
    viewer.say(r#"{"type":"step","step":2}"#).await;
    viewer.until("superseded").await;
    late.answer_cancelled().await;
    viewer.expect(r#"{"type":"stepped","step":2,"label":null}"#).await;
    let job = viewer.step().await;
    assert_eq!(job.volume.step(), 2);
    assert!(viewer.ahead.try_recv().is_err(), "surfaces come first");
    job.answer(Answer::last(3, shapes(&[2])));
    viewer.until("done").await;
    let ahead = viewer.ahead.recv().await.expect("a step read ahead");
    assert_eq!(ahead.volume.step(), 3);
    // The read-ahead goes on if the client goes to that step, and is cancelled if it goes to another one.
    viewer.say(r#"{"type":"step","step":3}"#).await;
    viewer.until("stepped").await;
    assert!(!ahead.token.is_cancelled());
    viewer.say(r#"{"type":"step","step":0}"#).await;
    viewer.until("stepped").await;
    ahead.token.cancelled().await;
}

#[tokio::test]
async fn nothing_is_read_ahead_for_a_viewer_that_is_gone() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(TO_STEP_1).await;
    viewer.until("stepped").await;
    viewer.step().await.answer(Answer::last(3, shapes(&[2])));
    viewer.until("done").await;
    let ahead = viewer.ahead.recv().await.expect("a step read ahead");
    viewer.inbox = None;
    ahead.token.cancelled().await;
}

#[tokio::test]
async fn steps_that_are_none_change_nothing() {
    let mut viewer = Viewer::new();
    viewer.say(TO_STEP_1).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let open = viewer.opens.recv().await.expect("an open job");
    viewer.say(TO_STEP_1).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    open.answer();
    viewer.until("opened").await;
    viewer.say(r#"{"type":"step","step":6}"#).await;
    assert_eq!(viewer.error().await, ("unknown-step".into(), true));
    viewer.say(TO_STEP_1).await;
    viewer.until("stepped").await;
    // Nothing was made before, so nothing is remade.
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    let job = viewer.step().await;
    assert_eq!((job.volume.step(), job.shown()), (1, Shown::Another));
}
