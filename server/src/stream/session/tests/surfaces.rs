//! Several surfaces: scheduling, and which messages end which work.

use std::time::Duration;

use isopeel_extraction::{CutId, MeasuredError, Measurement, Refinement, Shown, WorkError};
use isopeel_view::View;
use tokio::time::Instant;

use super::super::draw_pause::DRAW_PAUSE;
use super::super::rest::REST_AFTER;
use super::scripted::{Answer, Job, shapes};
use super::viewer::{Viewer, committed, committed_of, prefix, prefix_of};

pub(super) fn iso<T>(job: &Job<T>) -> f32 {
    job.view.iso.expect("an isovalue").get()
}

impl Viewer {
    /// Edits a surface, and answers its one step with these shapes.
    async fn show(&mut self, surface: u8, fields: &str, cut: u64, regions: &[i32]) {
        self.say(&format!(r#"{{"type":"edit","surface":{surface},{fields}}}"#))
            .await;
        self.step().await.answer(Answer::last(cut, shapes(regions)));
        assert_eq!(self.until("done").await["surface"], surface);
    }

    /// Waits for the next improvement, which must come [`REST_AFTER`] from now. Tokio's clock must be paused, so that it stands still while
    /// a task has work to do.
    async fn improvement_after_rest(&mut self) -> Job<Option<Refinement>> {
        let now = Instant::now();
        let job = self.improvements.recv().await.expect("an improvement");
        // Tokio's timers count whole milliseconds.
        let rested = now.elapsed();
        let range = REST_AFTER..=REST_AFTER + Duration::from_millis(1);
        assert!(range.contains(&rested), "{rested:?}");
        job
    }

    /// Surfaces 0 and 1 of isovalues 10 and 20, each with a final surface; β decides. Generations 1 and 2, cuts 1 and 2.
    pub(super) async fn with_two() -> Self {
        let mut viewer = Self::opened().await;
        viewer.show(0, r#""iso":10,"beta":0.1"#, 1, &[1, 2]).await;
        viewer.show(1, r#""iso":20,"beta":0.1"#, 2, &[3, 0, 4]).await;
        viewer
    }
}

#[tokio::test]
async fn each_surface_has_its_view_and_its_map() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":1,"alpha":0.25}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        (iso(&job), job.view.alpha, job.shown()),
        (20.0, 0.25, Shown::Cut(CutId::new(2)))
    );
    job.answer(Answer::last(3, shapes(&[3, 0, 5])));
    viewer.expect(&prefix_of(1, 3, 0, [1, 1, 2], true)).await;
    let chunk = viewer.chunk().await;
    assert_eq!(
        (chunk.header.prefix.surface, chunk.header.region.coords),
        (1, [2, 0, 0])
    );
    viewer.expect(&committed_of(1, 3, 0, true)).await;
    viewer.until("done").await;

    viewer.say(r#"{"type":"edit","beta":0.2}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        (iso(&job), job.view.alpha, job.shown()),
        (10.0, View::OPENING_ALPHA, Shown::Cut(CutId::new(1)))
    );
    job.answer(Answer::last(4, shapes(&[1, 7])));
    viewer.expect(&prefix(4, 0, [1, 1, 2], true)).await;
}

#[tokio::test]
async fn first_steps_come_before_further_ones_and_then_surfaces_take_turns() {
    let mut viewer = Viewer::opened().await;
    viewer.show(0, r#""iso":9,"beta":0.1"#, 100, &[9]).await;
    for surface in 0..3 {
        let iso = 10 * (surface + 1);
        viewer
            .say(&format!(
                r#"{{"type":"edit","surface":{surface},"iso":{iso},"beta":0.1}}"#
            ))
            .await;
        if surface == 0 {
            // The job of surface 0 is on the device when the other edits arrive.
            let job = viewer.step().await;
            viewer.say(r#"{"type":"edit","surface":1,"iso":20,"beta":0.1}"#).await;
            viewer.say(r#"{"type":"edit","surface":2,"iso":30,"beta":0.1}"#).await;
            viewer.quiet().await;
            assert!(!job.token.is_cancelled());
            job.answer(Answer::prefix(1, shapes(&[1])));
        }
    }
    // The first steps come in this order: the surface that was edited last, then the others. Then the same order is repeated.
    let mut order = Vec::new();
    let mut done = Vec::new();
    while done.len() < 3 {
        tokio::select! {
            job = viewer.steps.recv() => {
                let job = job.expect("a step");
                let iso = iso(&job);
                order.push(iso as u32);
                let made = order.iter().filter(|other| **other == iso as u32).count();
                let last = if iso == 10.0 { 2 } else { 3 };
                let cut = 10 * u64::from(iso as u32) + made as u64;
                job.answer(if made == last {
                    Answer::last(cut, shapes(&[made as i32]))
                } else {
                    Answer::prefix(cut, shapes(&[made as i32])).on_the_way()
                });
            }
            (text, _) = Box::pin(read(&mut viewer.frames, viewer.inbox.as_ref())) => {
                if text["type"] == "done" {
                    done.push(text["surface"].as_u64());
                }
            }
        }
    }
    assert_eq!(order[..2], [30, 20], "first steps: {order:?}");
    assert_eq!(order.len(), 8, "{order:?}");
}

/// As `Viewer::text_or_chunk`, for tests that wait for jobs at the same time.
async fn read(
    frames: &mut tokio::sync::mpsc::Receiver<super::super::Outgoing>,
    inbox: Option<&tokio::sync::mpsc::Sender<super::super::Incoming>>,
) -> (serde_json::Value, ()) {
    use super::super::{Incoming, Outgoing};
    let frame = frames.recv().await.expect("a frame");
    match frame {
        Outgoing::Text(text) => (serde_json::from_str(&text).expect("JSON"), ()),
        Outgoing::Ping(number) => {
            let inbox = inbox.expect("connected");
            inbox.send(Incoming::Pong(number)).await.expect("the session listens");
            (serde_json::Value::Null, ())
        }
        Outgoing::Binary(_) | Outgoing::Close(_) => (serde_json::Value::Null, ()),
    }
}

#[tokio::test]
async fn an_edit_ends_the_generation_of_its_surface_alone() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":0,"iso":11}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[5])));
    viewer.expect(&prefix(3, 4, [2, 0, 1], false)).await;
    viewer.until("committed").await;
    let further = viewer.step().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":21}"#).await;
    viewer.quiet().await;
    assert!(!further.token.is_cancelled(), "the other surface goes on");
    further.answer(Answer::last(4, shapes(&[6])).on_the_way());
    // The first step of the other surface is made while this one is sent.
    let first = viewer.step().await;
    assert_eq!(iso(&first), 21.0);
    viewer.expect(&prefix(3, 0, [1, 0, 1], false)).await;
    viewer.chunk().await;
    viewer.expect(&committed(3, 0, false)).await;
    viewer.say(r#"{"type":"edit","surface":0,"iso":12}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":3}"#)
        .await;
    assert!(!first.token.is_cancelled());
    first.answer(Answer::prefix(5, shapes(&[7])));
    viewer.expect(&prefix_of(1, 4, 4, [2, 0, 1], false)).await;
    assert_eq!(iso(&viewer.step().await), 12.0, "the first step of the newest edit");
}

#[tokio::test]
async fn a_surface_is_removed_while_its_job_runs() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":21}"#).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":1,"generation":3}"#)
        .await;
    viewer.expect(r#"{"type":"removed","surface":1}"#).await;
    viewer.quiet().await;
    job.answer_cancelled().await;
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    assert_eq!(viewer.error().await, ("unknown-surface".into(), true));

    // A surface that is added again begins with the opening view, and the server assumes that the client holds nothing of it.
    viewer.say(r#"{"type":"edit","surface":1,"beta":0.3}"#).await;
    let job = viewer.step().await;
    assert_eq!((iso(&job), job.shown()), (100.0, Shown::Another));
    job.answer(Answer::last(4, shapes(&[3])));
    viewer.expect(&prefix_of(1, 4, 0, [1, 0, 1], true)).await;
}

#[tokio::test]
async fn surface_0_can_be_removed_like_any_other() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"remove","surface":0}"#).await;
    viewer.expect(r#"{"type":"removed","surface":0}"#).await;
    viewer.say(r#"{"type":"remove","surface":0}"#).await;
    let error = viewer.text().await;
    assert_eq!(error["message"], "surface: 0 is not there, expected one of 1");
    viewer.say(r#"{"type":"edit","surface":1,"alpha":0.5}"#).await;
    assert_eq!(iso(&viewer.step().await), 20.0);
}

#[tokio::test]
async fn surfaces_that_were_never_made_are_said_so() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"remove","surface":0}"#).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    viewer.say(r#"{"type":"edit","surface":1}"#).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    for surface in [1, 4, 4_000_000_000_u32] {
        viewer.say(&format!(r#"{{"type":"remove","surface":{surface}}}"#)).await;
        assert_eq!(viewer.error().await, ("unknown-surface".into(), true));
    }
    viewer.say(r#"{"type":"edit","surface":4}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    // A bad edit makes no surface.
    viewer.say(r#"{"type":"edit","surface":3,"alpha":9}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.say(r#"{"type":"remove","surface":3}"#).await;
    assert_eq!(viewer.error().await, ("unknown-surface".into(), true));
    viewer.quiet().await;
}

#[tokio::test]
async fn an_open_leaves_surface_0_alone() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":5}"#).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"open","volume":"other"}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":1,"generation":3}"#)
        .await;
    job.answer_cancelled().await;
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    viewer.say(r#"{"type":"remove","surface":1}"#).await;
    assert_eq!(viewer.error().await, ("unknown-surface".into(), true));
    viewer.say(r#"{"type":"edit"}"#).await;
    assert_eq!(viewer.step().await.shown(), Shown::Another);
}

#[tokio::test]
async fn cancel_ends_the_work_of_all_surfaces() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":0,"iso":11}"#).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"edit","surface":1,"iso":21}"#).await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":3}"#)
        .await;
    job.answer_cancelled().await;
    viewer.quiet().await;
}

#[tokio::test]
async fn a_surface_that_waits_gets_a_turn_beside_others_that_are_dragged() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"edit","surface":0,"iso":11}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[5])));
    viewer.until("committed").await;
    let mut job = viewer.step().await;
    let mut edits = 30;
    for surface in [1, 2] {
        edits += 1;
        viewer
            .say(&format!(
                r#"{{"type":"edit","surface":{surface},"iso":{edits},"beta":0.1}}"#
            ))
            .await;
    }
    viewer.quiet().await;
    job.answer(Answer::last(4, shapes(&[6])).on_the_way());
    let mut others = 0;
    loop {
        job = viewer.step().await;
        if iso(&job) == 11.0 {
            break;
        }
        others += 1;
        // Each is overtaken before it commits its first step, so that both always have another first step.
        for surface in [1, 2] {
            edits += 1;
            viewer
                .say(&format!(r#"{{"type":"edit","surface":{surface},"iso":{edits}}}"#))
                .await;
        }
        job.answer(Answer::prefix(10 + others, shapes(&[others as i32])));
        while viewer.until("committed").await["surface"] == 0 {}
    }
    assert!((3..=6).contains(&others), "{others} jobs of others");
}

#[tokio::test]
async fn a_pause_to_draw_one_surface_does_not_delay_the_first_picture_of_another() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(r#"{"type":"drawn","generation":2}"#).await;
    viewer.say(r#"{"type":"edit","surface":0,"iso":11}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[5])));
    viewer.until("committed").await;
    let said = Instant::now();
    viewer.say(r#"{"type":"edit","surface":1,"iso":21}"#).await;
    let first = viewer.step().await;
    assert_eq!(iso(&first), 21.0);
    first.answer(Answer::prefix(4, shapes(&[6])));
    viewer.until("committed").await;
    assert!(said.elapsed() < DRAW_PAUSE / 2, "the pause held it up");
    viewer.quiet().await;
    viewer.say(r#"{"type":"drawn","generation":3}"#).await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"drawn","generation":4}"#).await;
    viewer.step().await;
    assert!(said.elapsed() < DRAW_PAUSE, "the pause went on");
}

/// Uses a paused clock, which advances only when all tasks are idle: a rest then lasts exactly its time, however busy the machine is.
#[tokio::test(start_paused = true)]
async fn each_surface_that_rests_is_improved_and_measured_and_an_edit_postpones_it() {
    let mut viewer = Viewer::opened().await;
    for (surface, cut) in [(0, 1), (1, 2)] {
        viewer
            .say(&format!(
                r#"{{"type":"edit","surface":{surface},"iso":{cut},"beta":0.1}}"#
            ))
            .await;
        viewer.step().await.answer(Answer::last(cut, shapes(&[1])).improvable());
        viewer.until("done").await;
    }
    // The surface that was edited last comes first.
    let job = viewer.improvement_after_rest().await;
    assert_eq!(iso(&job), 2.0);
    viewer.say(r#"{"type":"edit","surface":0,"alpha":0.1}"#).await;
    job.token.cancelled().await;
    assert!(job.reply.send(Err(WorkError::Cancelled)).is_ok());
    viewer.step().await.answer(Answer::last(3, shapes(&[2])));
    assert_eq!(viewer.until("done").await["surface"], 0);

    // The improvement starts again; a better surface comes before any measurement.
    let job = viewer.improvement_after_rest().await;
    assert_eq!(iso(&job), 2.0);
    assert!(!job.token.is_cancelled());
    let better = Answer::last(4, shapes(&[2])).refinement(&job.view);
    assert!(job.reply.send(Ok(Some(better))).is_ok());
    viewer.expect(&prefix_of(1, 2, 0, [1, 0, 1], true)).await;
    assert_eq!(viewer.until("done").await["generation"], 2);
    let error = MeasuredError { rms: 0.5, max: 2.0 };
    for (surface, generation) in [(0, 3), (1, 2)] {
        let job = viewer.measurements.recv().await.expect("a measurement");
        let measured = Measurement {
            whole: error,
            regions: Vec::new(),
        };
        assert!(job.reply.send(Ok(Some(measured))).is_ok());
        let measured = viewer.until("measured").await;
        assert_eq!(
            (&measured["surface"], &measured["generation"]),
            (&surface.into(), &generation.into())
        );
    }
    viewer.quiet().await;
}
