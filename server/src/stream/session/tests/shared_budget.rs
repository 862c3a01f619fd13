//! The budget that several surfaces share.

use isopeel_extraction::{CutId, Shown, WorkError};
use isopeel_view::View;
use isopeel_view::quality::{Budget, TriangleBudget};

use super::scripted::{Answer, shapes};
use super::surfaces::iso;
use super::viewer::{Viewer, committed_of, prefix, prefix_of};

/// The budget of triangles in a view.
fn triangles(view: &View) -> u64 {
    match view.budget {
        Some(Budget::Triangles(TriangleBudget::AtMost(triangles))) => triangles,
        other => panic!("a number of triangles, found {other:?}"),
    }
}
/// Surface 0 has a budget of 1000 triangles to itself, of 4000 in full.
async fn with_budget() -> Viewer {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","iso":10,"triangles":1000}"#).await;
    let job = viewer.step().await;
    assert_eq!(triangles(&job.view), 1000, "nothing is counted for one surface");
    job.answer(Answer::last(1, shapes(&[1])).of_full(4000));
    viewer.until("done").await;
    viewer
}

#[tokio::test]
async fn a_budget_is_shared_in_proportion_to_full_surfaces_and_what_shrinks_is_shown_first() {
    let mut viewer = with_budget().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    assert_eq!(viewer.count(6000).await, 20.0);
    // The surface that was edited last comes first. It is small, so its first step is the final one.
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 600));
    job.answer(Answer::last(2, shapes(&[2])).of_full(6000));
    let job = viewer.step().await;
    assert_eq!(
        (iso(&job), triangles(&job.view), job.shown()),
        (10.0, 400, Shown::Cut(CutId::new(1)))
    );
    viewer.quiet().await;
    job.answer(Answer::last(3, shapes(&[3])).of_full(4000));
    viewer.expect(&prefix(3, 0, [1, 0, 1], true)).await;
    assert_eq!(viewer.until("done").await["surface"], 0);
    viewer.expect(&prefix_of(1, 2, 0, [1, 0, 1], true)).await;
    assert_eq!(viewer.until("done").await["surface"], 1);

    // An edit of α affects no other surface.
    viewer.say(r#"{"type":"edit","surface":1,"alpha":0.1}"#).await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 600));
    job.answer(Answer::last(4, shapes(&[4])).of_full(6000));
    viewer.until("done").await;
    viewer.quiet().await;

    // All surfaces share one budget: an edit of any surface changes it for all.
    viewer.say(r#"{"type":"edit","surface":1,"triangles":2000}"#).await;
    for (surface, cut) in [(20.0, 5), (10.0, 6)] {
        let job = viewer.step().await;
        assert_eq!(
            (iso(&job), triangles(&job.view)),
            (surface, if surface == 20.0 { 1200 } else { 800 })
        );
        let full = if surface == 20.0 { 6000 } else { 4000 };
        job.answer(Answer::last(cut, shapes(&[cut as i32])).of_full(full));
        viewer.until("done").await;
    }

    // A removed surface gives its part back.
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    assert_eq!(viewer.until("removed").await["surface"], 1);
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (10.0, 2000));
}

#[tokio::test]
async fn a_budget_that_is_dragged_down_shows_surfaces_on_the_way() {
    let mut viewer = with_budget().await;
    viewer.say(r#"{"type":"edit","triangles":900}"#).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"edit","triangles":800}"#).await;
    viewer.quiet().await;
    assert_eq!(triangles(&job.view), 900);
    job.answer(Answer::last(2, shapes(&[2])).of_full(4000));
    viewer.expect(&prefix(2, 0, [1, 0, 1], true)).await;
    assert_eq!(viewer.until("done").await["generation"], 2);
    assert_eq!(triangles(&viewer.step().await.view), 800);
}

#[tokio::test]
async fn a_surface_that_beta_or_an_error_decides_has_no_part_of_the_budget() {
    let mut viewer = with_budget().await;
    for fields in [r#""beta":0.1"#, r#""error":0.5"#] {
        viewer
            .say(&format!(r#"{{"type":"edit","surface":1,"iso":20,{fields}}}"#))
            .await;
        let job = viewer.step().await;
        assert_eq!((iso(&job), job.view.budget), (20.0, None), "nothing is counted");
        job.answer(Answer::last(2, shapes(&[2])).of_full(6000));
        viewer.until("done").await;
        viewer.quiet().await;
    }
    viewer.say(r#"{"type":"edit","surface":1,"triangles":500}"#).await;
    for (surface, part) in [(20.0, 300), (10.0, 200)] {
        let job = viewer.step().await;
        assert_eq!((iso(&job), triangles(&job.view)), (surface, part));
        let full = if surface == 20.0 { 6000 } else { 4000 };
        job.answer(Answer::last(3, shapes(&[3])).of_full(full));
    }
}

#[tokio::test]
async fn a_minimum_budget_is_one_for_all_surfaces() {
    let mut viewer = with_budget().await;
    viewer
        .say(r#"{"type":"edit","surface":1,"iso":20,"topology":"preserve"}"#)
        .await;
    viewer.count(1000).await;
    let error = WorkError::OverBudget {
        minimum: 250,
        budget: 200,
    };
    assert!(viewer.step().await.reply.send(Err(error)).is_ok());
    let error = viewer.text().await;
    assert_eq!(
        (&error["code"], &error["surface"], &error["suggestedTriangles"]),
        (&"over-budget".into(), &1.into(), &1250.into())
    );
    let message = error["message"].as_str().expect("a message");
    assert!(message.ends_with("ask for 1250 or more for all together"), "{message}");
    viewer
        .expect(r#"{"type":"superseded","surface":1,"generation":2}"#)
        .await;
    // A failed surface keeps its part: its failure changes no other surface.
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (10.0, 800));
    job.answer(Answer::last(2, shapes(&[2])).of_full(4000));
    viewer.until("done").await;
    viewer.say(r#"{"type":"edit","surface":1,"triangles":1250}"#).await;
    for (surface, part, full) in [(20.0, 250, 1000), (10.0, 1000, 4000)] {
        let job = viewer.step().await;
        assert_eq!((iso(&job), triangles(&job.view)), (surface, part));
        job.answer(Answer::last(3, shapes(&[3])).of_full(full));
        viewer.until("done").await;
    }
    viewer.quiet().await;
}

#[tokio::test]
async fn what_a_failed_surface_holds_goes_where_others_share_its_budget() {
    let mut viewer = Viewer::opened().await;
    viewer
        .say(r#"{"type":"edit","iso":10,"triangles":1000,"topology":"preserve"}"#)
        .await;
    let first = Answer::last(1, shapes(&[1])).of_full(4000).of_triangles(900);
    viewer.step().await.answer(first);
    viewer.until("done").await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    viewer.count(6000).await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 600));
    job.answer(Answer::last(2, shapes(&[2])).of_full(6000).of_triangles(600));
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (10.0, 400));
    let error = WorkError::OverBudget {
        minimum: 800,
        budget: 400,
    };
    assert!(job.reply.send(Err(error)).is_ok());
    // Its regions are removed before the other surface is sent, so that both together never exceed the budget.
    viewer.expect(&prefix_of(0, 3, 0, [1, 0, 0], false)).await;
    assert_eq!(viewer.chunk().await.header.vertex_count, 0);
    viewer.expect(&committed_of(0, 3, 0, false)).await;
    let error = viewer.text().await;
    assert_eq!(
        (&error["code"], &error["surface"], &error["suggestedTriangles"]),
        (&"over-budget".into(), &0.into(), &2000.into())
    );
    assert_eq!(viewer.until("done").await["surface"], 1);
    viewer.quiet().await;
    // An edit that does not change the failed surface's part does not retry it; removing the other surface does.
    viewer.say(r#"{"type":"edit","surface":1,"alpha":0.1}"#).await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 600));
    job.answer(Answer::last(4, shapes(&[4])).of_full(6000).of_triangles(600));
    viewer.until("done").await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (10.0, 1000));
}

#[tokio::test]
async fn a_surface_that_failed_alone_keeps_what_is_shown_until_others_share_its_budget() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","iso":10,"triangles":1000}"#).await;
    let first = Answer::last(1, shapes(&[1])).of_full(4000).of_triangles(900);
    viewer.step().await.answer(first);
    viewer.until("done").await;
    let over = |minimum, budget| WorkError::OverBudget { minimum, budget };
    viewer.say(r#"{"type":"edit","triangles":500}"#).await;
    assert!(viewer.step().await.reply.send(Err(over(700, 500))).is_ok());
    assert_eq!(viewer.error().await, ("over-budget".into(), true));
    viewer.until("superseded").await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    viewer.count(1000).await;
    for _ in 0..2 {
        let job = viewer.step().await;
        if iso(&job) == 20.0 {
            assert_eq!(triangles(&job.view), 100);
            job.answer(Answer::last(2, shapes(&[2])).of_full(1000));
            continue;
        }
        assert_eq!(triangles(&job.view), 400, "it is tried again with its part");
        assert!(job.reply.send(Err(over(700, 400))).is_ok());
    }
    let prefix = viewer.until("prefix").await;
    assert_eq!((&prefix["surface"], &prefix["triangles"]), (&0.into(), &0.into()));
    assert_eq!(viewer.until("error").await["suggestedTriangles"], 875);
    assert_eq!(viewer.until("done").await["surface"], 1);
    viewer.quiet().await;
}

/// The number of triangles of such a surface is not known.
#[tokio::test]
async fn a_surface_that_failed_uncounted_gets_a_part_when_others_come() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","iso":10,"triangles":500}"#).await;
    let over = |minimum, budget| WorkError::OverBudget { minimum, budget };
    assert!(viewer.step().await.reply.send(Err(over(700, 500))).is_ok());
    viewer.until("superseded").await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    let counts = [viewer.count(1000).await, viewer.count(1000).await];
    assert!(counts.contains(&10.0) && counts.contains(&20.0), "{counts:?}");
    for _ in 0..2 {
        let job = viewer.step().await;
        assert_eq!(triangles(&job.view), 250);
        match iso(&job) {
            20.0 => job.answer(Answer::last(2, shapes(&[2])).of_full(1000)),
            _ => assert!(job.reply.send(Err(over(700, 250))).is_ok()),
        }
    }
    assert_eq!(viewer.until("error").await["suggestedTriangles"], 1400);
}

#[tokio::test]
async fn a_count_of_another_mask_is_none() {
    let mut viewer = with_budget().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    viewer.count(1000).await;
    for surface in [20.0, 10.0] {
        let job = viewer.step().await;
        assert_eq!(iso(&job), surface);
        let full = if surface == 20.0 { 1000 } else { 4000 };
        job.answer(Answer::last(2, shapes(&[2])).of_full(full));
    }
    for _ in 0..2 {
        viewer.until("done").await;
    }
    viewer.say(r#"{"type":"edit","surface":1,"mask":"density>0"}"#).await;
    assert_eq!(viewer.count(4000).await, 20.0);
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 500));
}

#[tokio::test]
async fn a_failed_count_ends_its_generation_alone() {
    let mut viewer = with_budget().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    let job = viewer.counts.recv().await.expect("a count");
    viewer.say(r#"{"type":"edit","surface":0,"triangles":2000}"#).await;
    viewer.quiet().await;
    let error = WorkError::Device(isopeel_kernels::Error::NoDriver);
    assert!(job.reply.send(Err(error)).is_ok());
    assert_eq!(viewer.error().await, ("device".into(), true));
    viewer
        .expect(r#"{"type":"superseded","surface":1,"generation":2}"#)
        .await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (10.0, 2000), "all of the budget");
}

/// A count belongs to the generation that has begun, not to the newest edit: so a dragged slider shows some steps.
#[tokio::test]
async fn edits_while_a_surface_is_counted_still_let_it_commit_a_step() {
    let mut viewer = with_budget().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":20}"#).await;
    let job = viewer.counts.recv().await.expect("a count");
    viewer.say(r#"{"type":"edit","surface":1,"iso":21}"#).await;
    viewer.quiet().await;
    assert!(!job.token.is_cancelled());
    let count = isopeel_extraction::FullCount {
        triangles: 6000,
        ..Default::default()
    };
    assert!(job.reply.send(Ok(count)).is_ok());
    let job = viewer.step().await;
    assert_eq!((iso(&job), triangles(&job.view)), (20.0, 600));
    job.answer(Answer::prefix(2, shapes(&[2])).of_full(6000));
    assert_eq!(viewer.until("superseded").await["generation"], 2);
    // Surface 0 shrinks because surface 1 counts 6000 triangles, until the newer full surface of surface 1 is counted.
    loop {
        tokio::select! {
            job = viewer.steps.recv() => {
                let job = job.expect("a step");
                assert_eq!(iso(&job), 10.0);
                job.answer(Answer::last(3, shapes(&[3])).of_full(4000));
            }
            job = viewer.counts.recv() => {
                assert_eq!(job.expect("a count").view.iso.expect("an isovalue").get(), 21.0);
                break;
            }
        }
    }
}
