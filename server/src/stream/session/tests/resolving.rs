//! Views and time steps come into force when they are resolved; invalid ones never do.

use isopeel_extraction::{Shown, WorkError};
use isopeel_view::quality::{Budget, TriangleBudget};
use isopeel_view::{EditError, View};
use serde_json::json;

use super::super::Common;
use super::scripted::{Answer, Job, resolved, shapes};
use super::viewer::Viewer;
use crate::access::Identity;

const FEATURE: &str = r#"{"type":"edit","feature":"mean-curvature"}"#;

/// Returns a viewer that is shown the final surface of the opening view.
async fn showing(common: &Common) -> Viewer {
    let mut viewer = Viewer::that_resolves(common).open().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::last(1, shapes(&[1])));
    viewer.until("done").await;
    viewer
}

impl Job<View> {
    fn resolve(self) {
        let view = resolved(&self.volume, &self.view);
        assert!(self.reply.send(Ok(view)).is_ok(), "the session dropped its job");
    }

    fn refuse(self) {
        let error = EditError {
            field: "feature",
            why: "holds at no sample".into(),
        };
        assert!(
            self.reply.send(Err(WorkError::Edit(error))).is_ok(),
            "the session dropped its job"
        );
    }
}

async fn resolution(viewer: &mut Viewer) -> Job<View> {
    viewer.resolutions.recv().await.expect("a view to resolve")
}

#[tokio::test]
async fn an_edit_that_turns_out_to_be_bad_changes_nothing() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(FEATURE).await;
    let job = resolution(&mut viewer).await;
    viewer.quiet().await;
    job.refuse();
    let error = viewer.text().await;
    assert_eq!((&error["code"], &error["surface"]), (&json!("bad-edit"), &json!(0)));
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        (job.view.feature.as_str(), job.view.alpha),
        ("gradient-magnitude", 0.25)
    );
}

/// A measurement would keep the device from resolving the edit.
#[tokio::test(start_paused = true)]
async fn work_at_rest_makes_way_for_an_edit_and_begins_again_if_that_is_bad() {
    let mut viewer = showing(&Common::new(0)).await;
    for message in [FEATURE, r#"{"type":"step","step":1}"#] {
        let measurement = viewer.measurements.recv().await.expect("a measurement");
        viewer.say(message).await;
        measurement.token.cancelled().await;
        assert!(measurement.reply.send(Err(WorkError::Cancelled)).is_ok());
        resolution(&mut viewer).await.refuse();
        let error = viewer.until("error").await;
        assert!(
            ["bad-edit", "step-failed"].contains(&error["code"].as_str().unwrap()),
            "{error}"
        );
    }
    viewer.measurements.recv().await.expect("a measurement");
}

#[tokio::test]
async fn edits_that_arrive_meanwhile_come_into_force_with_it() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(FEATURE).await;
    let job = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
    viewer.quiet().await;
    job.resolve();
    let job = viewer.step().await;
    assert_eq!((job.view.feature.as_str(), job.view.alpha), ("mean-curvature", 0.25));
    assert_eq!(job.view.feature_range, Some([-1.0, 0.0]));
    job.answer(Answer::last(2, shapes(&[2])));
    viewer.until("done").await;
    // An edit that changes values to be resolved is resolved itself.
    viewer.say(r#"{"type":"edit","feature":"local-variance"}"#).await;
    let late = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"edit","feature":"none"}"#).await;
    late.refuse();
    resolution(&mut viewer).await.resolve();
    assert_eq!(viewer.step().await.view.feature.as_str(), "none");
}

/// The result is the same as if each edit had arrived after the one before was resolved.
#[tokio::test]
async fn a_bad_edit_takes_no_other_one_with_it() {
    let mut viewer = showing(&Common::new(0)).await;
    // While an edit of another surface is being resolved, the following edits wait together.
    viewer.say(r#"{"type":"edit","surface":1,"feature":"none"}"#).await;
    let other = resolution(&mut viewer).await;
    for edit in [
        r#""iso":7,"mask":"density>0""#,
        r#""feature":"mean-curvature""#,
        r#""alpha":0.25"#,
    ] {
        viewer.say(&format!(r#"{{"type":"edit",{edit}}}"#)).await;
    }
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    tokio::task::yield_now().await;
    other.refuse();
    assert_eq!(viewer.until("error").await["surface"], 1);
    let all = resolution(&mut viewer).await;
    assert_eq!((all.view.alpha, all.view.feature.as_str()), (0.25, "mean-curvature"));
    all.refuse();
    // The edits are applied one by one: the mask is valid, the feature is not, and the others need no resolving.
    let first = resolution(&mut viewer).await;
    assert_eq!(
        (first.view.feature.as_str(), first.view.mask.is_some()),
        ("gradient-magnitude", true)
    );
    first.resolve();
    let rest = resolution(&mut viewer).await;
    assert_eq!(
        (rest.view.feature.as_str(), rest.view.alpha),
        ("mean-curvature", View::OPENING_ALPHA)
    );
    rest.refuse();
    assert_eq!(viewer.until("error").await["code"], "bad-edit");
    let job = viewer.step().await;
    assert_eq!(
        (job.view.feature.as_str(), job.view.alpha, job.view.beta),
        ("gradient-magnitude", 0.25, 0.5)
    );
    assert!(job.view.mask.is_some() && job.view.iso.is_some_and(|iso| iso.get() == 7.0));
}

#[tokio::test]
async fn a_question_waits_for_a_step_that_came_before_it() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"step","step":3}"#).await;
    let job = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"probe","position":[1,2,3]}"#).await;
    viewer.quiet().await;
    assert!(viewer.questions.try_recv().is_err(), "of the step before");
    job.resolve();
    viewer.until("stepped").await;
    viewer.step().await.answer(Answer::last(2, shapes(&[2])));
    viewer.until("done").await;
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.shown.expect("a surface").cut, isopeel_extraction::CutId::new(2));
}

#[tokio::test]
async fn values_that_an_edit_leaves_open_are_those_of_its_step() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(FEATURE).await;
    let job = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"step","step":3}"#).await;
    viewer.quiet().await;
    assert_eq!(job.volume.step(), 0);
    job.resolve();
    // The step comes into force after the edit, and is resolved with the edit applied.
    let job = resolution(&mut viewer).await;
    assert_eq!((job.volume.step(), job.view.feature_range), (3, Some([-1.0, 0.0])));
    job.resolve();
    viewer.until("stepped").await;
    loop {
        let job = viewer.step().await;
        if job.volume.step() == 3 {
            assert_eq!(job.view.feature_range, Some([-1.0, 0.0]));
            break;
        }
        job.answer_cancelled().await;
    }
}

#[tokio::test]
async fn a_cancelled_step_leaves_the_edits_behind_it_to_be_made() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"step","step":3}"#).await;
    let job = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
    let of_before = viewer.step().await;
    assert_eq!((of_before.volume.step(), of_before.view.alpha), (0, 0.25));
    job.resolve();
    viewer.until("stepped").await;
    of_before.answer_cancelled().await;
    let job = viewer.step().await;
    assert_eq!((job.volume.step(), job.view.alpha), (3, 0.25));

    // Without an edit after `cancel`, nothing is made of the step.
    job.answer(Answer::last(2, shapes(&[2])));
    viewer.until("done").await;
    viewer.say(r#"{"type":"step","step":4}"#).await;
    let job = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    tokio::task::yield_now().await;
    job.resolve();
    viewer.until("stepped").await;
    viewer.quiet().await;
    assert!(viewer.steps.try_recv().is_err(), "it was cancelled");
}

#[tokio::test]
async fn values_are_those_of_a_step_that_another_one_has_overtaken() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"step","step":3}"#).await;
    let _overtaken = resolution(&mut viewer).await;
    viewer.say(FEATURE).await;
    viewer.say(r#"{"type":"step","step":0}"#).await;
    tokio::task::yield_now().await;
    let job = resolution(&mut viewer).await;
    assert_eq!((job.volume.step(), job.view.feature_range), (3, None));
    job.resolve();
    // First the step is resolved, and then the samples that the view uses in it.
    resolution(&mut viewer).await.resolve();
    viewer.until("stepped").await;
    let there = resolution(&mut viewer).await;
    assert_eq!((there.volume.step(), there.view.feature_range), (0, Some([-1.0, 3.0])));
}

#[tokio::test]
async fn a_step_of_which_a_surface_cannot_be_made_is_refused() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"step","step":1}"#).await;
    let job = resolution(&mut viewer).await;
    assert_eq!(job.volume.step(), 1);
    viewer.quiet().await;
    job.refuse();
    let error = viewer.text().await;
    assert_eq!((&error["code"], &error["surface"]), (&json!("step-failed"), &json!(0)));
    let message = error["message"].as_str().expect("a message");
    assert!(message.starts_with("step 1 is not shown, step 0 stays: "), "{message}");
    viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
    assert_eq!(viewer.step().await.volume.step(), 0);
}

#[tokio::test]
async fn the_latest_step_is_the_one_that_is_checked() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"step","step":1}"#).await;
    let first = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"step","step":2}"#).await;
    let second = resolution(&mut viewer).await;
    assert!(first.token.is_cancelled() && second.volume.step() == 2);
    second.resolve();
    let stepped = viewer.until("stepped").await;
    assert_eq!(stepped["step"], 2);
}

#[tokio::test]
async fn what_fails_while_it_is_made_gives_way_to_what_was_shown() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(FEATURE).await;
    resolution(&mut viewer).await.resolve();
    let job = viewer.step().await;
    assert_eq!(job.view.feature.as_str(), "mean-curvature");
    let error = WorkError::TooLarge {
        needed_bytes: 2,
        limit_bytes: 1,
    };
    assert!(job.reply.send(Err(error)).is_ok());
    assert_eq!(viewer.until("error").await["surface"], 0);
    viewer.until("superseded").await;
    let job = viewer.step().await;
    assert_eq!(job.view.feature.as_str(), "gradient-magnitude");
}

#[tokio::test]
async fn a_surface_that_never_was_is_gone_with_its_bad_edit() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer
        .say(r#"{"type":"edit","surface":2,"feature":"mean-curvature"}"#)
        .await;
    resolution(&mut viewer).await.refuse();
    assert_eq!(viewer.until("error").await["surface"], 2);
    viewer.say(r#"{"type":"remove","surface":2}"#).await;
    assert_eq!(viewer.error().await, ("unknown-surface".into(), true));
    // After its removal surface 0 does not exist either.
    viewer.say(r#"{"type":"remove","surface":0}"#).await;
    viewer.until("removed").await;
    viewer.say(FEATURE).await;
    resolution(&mut viewer).await.refuse();
    assert_eq!(viewer.until("error").await["surface"], 0);
    viewer.say(r#"{"type":"remove","surface":0}"#).await;
    assert_eq!(viewer.error().await, ("unknown-surface".into(), true));
}

#[tokio::test]
async fn edits_before_opened_apply_to_the_values_that_it_states() {
    let mut viewer = Viewer::that_resolves(&Common::new(0));
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let open = viewer.opens.recv().await.expect("an open job");
    viewer.say(r#"{"type":"edit","alpha":0.25}"#).await;
    viewer
        .say(r#"{"type":"edit","surface":1,"feature":"mean-curvature"}"#)
        .await;
    tokio::task::yield_now().await;
    open.answer();
    viewer.until("opened").await;
    let job = viewer.step().await;
    assert_eq!((job.view.alpha, job.view.feature_range), (0.25, Some([0.0, 50.0])));
    let late = resolution(&mut viewer).await;
    assert_eq!(
        (late.view.feature.as_str(), late.view.feature_range),
        ("mean-curvature", None)
    );
}

#[tokio::test]
async fn followers_are_shown_what_has_come_into_force() {
    let common = Common::new(0);
    let mut leader = showing(&common).await;
    leader.say(r#"{"type":"lead"}"#).await;
    let group = leader.until("group").await["group"].clone();
    let mut follower = Viewer::among(&common, Identity::without_token());
    follower.say(&json!({"type": "join", "group": group}).to_string()).await;
    let led = follower.until("led").await;
    assert_eq!(led["surfaces"][0]["edit"]["featureRange"], json!([0.0, 50.0]));
    follower.opens.recv().await.expect("an open job").answer();
    follower.step().await.answer(Answer::last(1, shapes(&[1])));
    follower.until("done").await;

    leader.say(FEATURE).await;
    resolution(&mut leader).await.refuse();
    leader.until("error").await;
    leader.say(FEATURE).await;
    resolution(&mut leader).await.resolve();
    let led = follower.until("led").await;
    let edit = &led["surfaces"][0]["edit"];
    assert_eq!(
        (&edit["feature"], &edit["featureRange"]),
        (&json!("mean-curvature"), &json!([-1.0, 0.0])),
        "nothing of the edit that was refused"
    );
    // The leader and the follower wait for the same job.
    let job = leader.step().await;
    assert_eq!(job.view.feature_range, Some([-1.0, 0.0]));
    job.answer(Answer::last(2, shapes(&[2])));
    follower.until("done").await;
}

#[tokio::test]
async fn a_new_surface_has_the_budget_that_edits_left_in_force() {
    let opening = Budget::Triangles(TriangleBudget::Share(View::OPENING_BUDGET));
    for is_bad in [false, true] {
        let mut viewer = Viewer::that_resolves(&Common::new(0)).open().await;
        viewer.say(r#"{"type":"edit","triangles":77}"#).await;
        viewer.step().await.answer(Answer::last(1, shapes(&[1])));
        viewer.until("done").await;
        viewer.say(r#"{"type":"edit","beta":0.5,"feature":"none"}"#).await;
        let first = resolution(&mut viewer).await;
        viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
        tokio::task::yield_now().await;
        if is_bad {
            first.refuse();
            // Two surfaces share the budget.
            let job = viewer.counts.recv().await.expect("a count");
            assert_eq!(job.view.budget, Some(Budget::Triangles(TriangleBudget::AtMost(77))));
        } else {
            first.resolve();
            resolution(&mut viewer).await.resolve();
            viewer.step().await.answer(Answer::last(2, shapes(&[2])));
            viewer.until("done").await;
            assert_eq!(viewer.step().await.view.budget, Some(opening));
        }
    }
}

#[tokio::test]
async fn a_new_surface_does_not_have_the_budget_of_a_bad_new_one() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    viewer.step().await.answer(Answer::last(2, shapes(&[2])));
    viewer.until("done").await;
    let bad = naming_a_budget(&mut viewer).await;
    viewer.say(r#"{"type":"edit","surface":2,"iso":20}"#).await;
    tokio::task::yield_now().await;
    bad.refuse();
    viewer.until("error").await;
    let opening = Budget::Triangles(TriangleBudget::Share(View::OPENING_BUDGET));
    assert_eq!(viewer.step().await.view.budget, Some(opening), "not that of surface 1");
}

/// Edits surface 1 with a budget of 77 triangles, and returns the job that resolves the edit.
async fn naming_a_budget(viewer: &mut Viewer) -> Job<View> {
    let edit = r#"{"type":"edit","surface":1,"feature":"none","triangles":77}"#;
    viewer.say(edit).await;
    resolution(viewer).await
}

#[tokio::test]
async fn others_keep_a_budget_that_its_surface_gives_up_before_it_is_in_force() {
    let mut viewer = showing(&Common::new(0)).await;
    let first = naming_a_budget(&mut viewer).await;
    viewer.say(r#"{"type":"edit","surface":1,"beta":0.5}"#).await;
    tokio::task::yield_now().await;
    first.resolve();
    for budget in [None, Some(Budget::Triangles(TriangleBudget::AtMost(77)))] {
        let job = viewer.step().await;
        assert_eq!(job.view.budget, budget);
        job.answer(Answer::last(2, shapes(&[2])));
        viewer.until("done").await;
    }
}

#[tokio::test]
async fn a_budget_counts_when_a_later_edit_leaves_nothing_to_resolve() {
    let mut viewer = showing(&Common::new(0)).await;
    viewer
        .say(r#"{"type":"edit","surface":1,"iso":20,"mask":"density>0","triangles":77}"#)
        .await;
    let _mask = resolution(&mut viewer).await;
    viewer.say(r#"{"type":"edit","surface":1,"mask":null}"#).await;
    viewer.count(6000).await;
    viewer.step().await.answer(Answer::last(2, shapes(&[2])).of_full(6000));
    let job = viewer.step().await;
    let budget = job.view.budget.expect("a budget");
    assert!(
        matches!(budget, Budget::Triangles(TriangleBudget::AtMost(1..77))),
        "{budget:?}"
    );
}

#[tokio::test]
async fn a_budget_counts_when_its_surface_is_removed_before_it_is_in_force() {
    let mut viewer = Viewer::that_resolves(&Common::new(0)).open().await;
    viewer.say(r#"{"type":"edit","triangles":99}"#).await;
    viewer.step().await.answer(Answer::last(1, shapes(&[1])));
    viewer.until("done").await;
    let _mask = naming_a_budget(&mut viewer).await;
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    viewer.until("removed").await;
    let job = viewer.step().await;
    assert_eq!(job.view.budget, Some(Budget::Triangles(TriangleBudget::AtMost(77))));
}

#[tokio::test]
async fn the_budget_of_the_latest_edit_counts_whichever_comes_into_force_first() {
    let mut viewer = showing(&Common::new(0)).await;
    let first = naming_a_budget(&mut viewer).await;
    viewer.say(r#"{"type":"edit","triangles":99}"#).await;
    let budget = Some(Budget::Triangles(TriangleBudget::AtMost(99)));
    let job = viewer.step().await;
    assert_eq!(job.view.budget, budget);
    job.answer(Answer::last(2, shapes(&[2])));
    viewer.until("done").await;
    first.resolve();
    let job = viewer.counts.recv().await.expect("a count");
    assert_eq!(job.view.budget, budget);
}

#[tokio::test]
async fn another_mask_is_another_surface_which_comes_coarse_first() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","mask":"density>0"}"#).await;
    assert_eq!(viewer.step().await.shown(), Shown::Another);
}
