//! Surfaces that follow a camera.

use isopeel_extraction::{CutId, Refinement, Shown, WorkError};
use isopeel_view::CameraJson;

use super::super::Common;
use super::groups::{follower, leader};
use super::scripted::{Answer, Job, shapes};
use super::viewer::{Viewer, committed, prefix};
use crate::access::Identity;

fn message(x: f64) -> String {
    format!(r#"{{"type":"camera","camera":{{"position":[{x},0,0],"target":[0,0,0],"fov":30,"viewport":[640,480]}}}}"#)
}

/// Where the camera of a job is, along x.
fn place(job: &Job<Refinement>) -> Option<f64> {
    job.view.camera.as_deref().map(|camera: &CameraJson| camera.position[0])
}

/// A viewer with a camera at 1, which is shown a cut of the tree for it: generation 1.
async fn seeing(start: &[i32]) -> Viewer {
    let mut viewer = Viewer::opened().await;
    viewer.say(&message(1.0)).await;
    viewer.say(r#"{"type":"edit"}"#).await;
    let job = viewer.step().await;
    assert_eq!(place(&job), Some(1.0));
    job.answer(Answer::last(1, shapes(start)).of_tree());
    viewer.until("done").await;
    viewer
}

#[tokio::test]
async fn a_camera_that_moves_changes_the_regions_that_differ() {
    let mut viewer = seeing(&[1, 2, 3]).await;
    viewer.say(&message(2.0)).await;
    let job = viewer.step().await;
    let shown = Shown::AlikeCut(CutId::new(1));
    assert_eq!((place(&job), job.shown()), (Some(2.0), shown));
    job.answer(Answer::last(2, shapes(&[1, 2, 4])).of_tree());
    viewer.expect(&prefix(2, 0, [1, 2, 3], true)).await;
    viewer.chunk().await;
    viewer.expect(&committed(2, 0, true)).await;
    assert_eq!(viewer.text().await["type"], "done");
    // The same camera again is no change.
    viewer.say(&message(2.0)).await;
    viewer.quiet().await;
    // Without a camera the surface is made alike everywhere.
    viewer.say(r#"{"type":"camera","camera":null}"#).await;
    assert_eq!(place(&viewer.step().await), None);
}

#[tokio::test]
async fn cameras_replace_each_other_while_a_surface_is_made() {
    let mut viewer = seeing(&[1]).await;
    viewer.say(&message(2.0)).await;
    let job = viewer.step().await;
    for x in [3.0, 4.0, 5.0] {
        viewer.say(&message(x)).await;
    }
    assert!(viewer.steps.try_recv().is_err(), "one at a time");
    assert!(!job.token.is_cancelled(), "a camera that moves still shows something");
    job.answer(Answer::last(2, shapes(&[2])).of_tree());
    viewer.until("done").await;
    let job = viewer.step().await;
    assert_eq!(place(&job), Some(5.0));
    job.answer(Answer::last(3, shapes(&[3])).of_tree());
    viewer.until("done").await;
    viewer.quiet().await;
}

#[tokio::test]
async fn an_edit_ends_what_only_follows_a_camera() {
    let mut viewer = seeing(&[1]).await;
    viewer.say(&message(2.0)).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"edit","iso":7}"#).await;
    job.answer_cancelled().await;
    let job = viewer.step().await;
    assert_eq!((place(&job), job.view.iso.map(|iso| iso.get())), (Some(2.0), Some(7.0)));
    // An edit is not ended by a camera, which waits.
    viewer.say(&message(3.0)).await;
    job.answer(Answer::prefix(2, shapes(&[2])));
    viewer.until("committed").await;
    let job = viewer.step().await;
    assert_eq!(place(&job), Some(2.0));
    job.answer(Answer::last(3, shapes(&[3])).of_tree());
    viewer.until("done").await;
    assert_eq!(place(&viewer.step().await), Some(3.0));
}

#[tokio::test]
async fn cancel_ends_following_until_the_next_camera() {
    let mut viewer = seeing(&[1]).await;
    viewer.say(&message(2.0)).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    job.answer_cancelled().await;
    viewer.quiet().await;
    viewer.say(&message(3.0)).await;
    assert_eq!(place(&viewer.step().await), Some(3.0));
}

#[tokio::test]
async fn a_camera_for_which_there_is_no_surface_is_passed_over() {
    let mut viewer = seeing(&[1]).await;
    viewer.say(&message(2.0)).await;
    let job = viewer.step().await;
    let large = WorkError::TooManyTriangles {
        triangles: 9,
        ceiling: 8,
    };
    assert!(job.reply.send(Err(large)).is_ok());
    assert_eq!(viewer.error().await, ("too-large".into(), true));
    viewer.quiet().await;
    viewer.say(&message(3.0)).await;
    assert_eq!(place(&viewer.step().await), Some(3.0));
}

#[tokio::test]
async fn cuts_of_cubes_and_uniform_surfaces_do_not_follow() {
    for edit in [r#"{"type":"edit","detail":"uniform"}"#, r#"{"type":"edit","beta":0.1}"#] {
        let mut viewer = seeing(&[1]).await;
        viewer.say(edit).await;
        viewer.step().await.answer(Answer::last(2, shapes(&[2])).of_tree());
        viewer.until("done").await;
        viewer.say(&message(2.0)).await;
        viewer.quiet().await;
    }
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(&message(2.0)).await;
    viewer.quiet().await;
}

#[tokio::test]
async fn work_at_rest_makes_way_unless_it_makes_the_tree() {
    let mut viewer = seeing(&[1]).await;
    let measuring = viewer.measurements.recv().await.expect("a measurement");
    viewer.say(&message(2.0)).await;
    measuring.token.cancelled().await;
    drop(measuring);
    assert_eq!(place(&viewer.step().await), Some(2.0));

    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::last(1, shapes(&[1])).improvable());
    viewer.until("done").await;
    let improving = viewer.improvements.recv().await.expect("an improvement");
    viewer.say(&message(2.0)).await;
    viewer.quiet().await;
    assert!(!improving.token.is_cancelled());
    let made = Answer::last(2, shapes(&[2])).of_tree().refinement(&improving.view);
    assert!(improving.reply.send(Ok(Some(made))).is_ok());
    viewer.until("done").await;
    assert_eq!(place(&viewer.step().await), Some(2.0));
}

#[tokio::test]
async fn wrong_cameras_are_refused_and_another_volume_forgets_the_camera() {
    let mut viewer = seeing(&[1]).await;
    viewer.say(&message(0.0)).await;
    assert_eq!(viewer.error().await, ("bad-message".into(), true));
    let edit = message(5.0).replace("camera\",", "edit\",");
    viewer.say(&edit).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.say(r#"{"type":"open","volume":"other"}"#).await;
    viewer.opens.recv().await.expect("an open job").answer();
    viewer.until("opened").await;
    viewer.say(r#"{"type":"edit"}"#).await;
    assert_eq!(place(&viewer.step().await), None);
}

#[tokio::test]
async fn followers_see_the_leaders_cut_unless_they_have_a_camera_of_their_own() {
    let common = Common::new(1 << 20);
    let (mut leads, group) = leader(&common, 5.0).await;
    leads.say(&message(1.0)).await;
    leads.say(r#"{"type":"edit","iso":6}"#).await;
    let job = leads.step().await;
    assert_eq!(place(&job), Some(1.0));
    job.answer(Answer::last(1, shapes(&[1, 2])).of_tree());
    leads.until("done").await;
    let mut follows = follower(&common, Identity::without_token(), &group, 6.0).await;
    leads.say(&message(2.0)).await;
    leads.step().await.answer(Answer::last(2, shapes(&[1, 3])).of_tree());
    leads.until("done").await;
    follows.until("done").await;
    assert!(follows.steps.try_recv().is_err(), "made once for both");
    follows.say(&message(9.0)).await;
    let job = follows.step().await;
    assert_eq!(place(&job), Some(9.0));
    job.answer(Answer::last(3, shapes(&[1, 4])).of_tree());
    follows.until("done").await;
    follows.say(r#"{"type":"camera","camera":null}"#).await;
    // The leader's cut is cached.
    follows.until("done").await;
    assert!(follows.steps.try_recv().is_err());
}
