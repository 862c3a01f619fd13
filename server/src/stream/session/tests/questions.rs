//! Questions about the surface: bounded, answered for the surface that is shown, and never before an edit.

use std::time::Duration;

use isopeel_codec::chunk::{ChunkKind, decode_errors};
use isopeel_extraction::{Answer, Curve, CutId, LeafKind, Probe, Question, VertexErrors, WorkError};
use isopeel_kernels::DistanceOf;
use serde_json::json;

use super::scripted::{Answer as Made, shapes};
use super::viewer::Viewer;
use crate::stream::session::Outgoing;

impl super::scripted::Asked {
    fn answer(self) {
        let answer = match self.question {
            Question::Probe(position) => Answer::Probe(Probe {
                position,
                inside: false,
                values: Vec::new(),
                nearest: None,
            }),
            Question::VertexErrors(_) => Answer::VertexErrors(
                shapes(&[1, 5])
                    .into_iter()
                    .map(|region| VertexErrors {
                        region,
                        distances: vec![0.25, 0.5, 0.75],
                    })
                    .collect(),
            ),
            _ => Answer::Curve(Curve {
                kind: LeafKind::Tree,
                by_error: true,
                points: Vec::new(),
            }),
        };
        assert!(self.reply.send(Ok(answer)).is_ok(), "the session dropped its question");
    }

    fn x(&self) -> f64 {
        match self.question {
            Question::Probe([x, ..]) => x,
            other => panic!("expected a probe, found {other:?}"),
        }
    }
}

fn probe(x: f64) -> String {
    json!({"type": "probe", "position": [x, 0, 0]}).to_string()
}

/// Lets the session process all messages that it was sent.
async fn settle(viewer: &mut Viewer) {
    viewer.quiet().await;
}

#[tokio::test]
async fn a_question_is_answered_for_the_surface_that_is_shown() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(&probe(1.5)).await;
    let asked = viewer.questions.recv().await.expect("a question");
    let shown = asked.shown.as_ref().expect("a surface is shown");
    assert_eq!(shown.cut, CutId::new(2));
    asked.answer();
    viewer
        .expect(
            r#"{"type":"probed","surface":0,"generation":1,"position":[1.5,0.0,0.0],"inside":false,"values":[],"nearest":null}"#,
        )
        .await;
    viewer.say(r#"{"type":"curve","surface":0}"#).await;
    viewer.questions.recv().await.expect("a question").answer();
    viewer
        .expect(r#"{"type":"curve","surface":0,"generation":1,"kind":"tree","byError":true,"points":[]}"#)
        .await;
}

#[tokio::test]
async fn before_an_edit_a_probe_is_about_the_volume_alone() {
    let mut viewer = Viewer::opened().await;
    viewer.say(&probe(0.0)).await;
    let asked = viewer.questions.recv().await.expect("a question");
    assert!(asked.shown.is_none());
    asked.answer();
    assert_eq!(viewer.text().await["generation"], 0);
}

#[tokio::test]
async fn of_a_flood_of_probes_the_first_and_the_last_are_answered() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(&probe(0.0)).await;
    let first = viewer.questions.recv().await.expect("a question");
    for x in 1..=500 {
        viewer.say(&probe(f64::from(x))).await;
    }
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "one question at a time");
    first.answer();
    assert_eq!(viewer.text().await["position"][0], 0.0);
    let last = viewer.questions.recv().await.expect("a question");
    assert_eq!(last.x(), 500.0);
    last.answer();
    assert_eq!(viewer.text().await["position"][0], 500.0);
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "all others were replaced");
}

#[tokio::test]
async fn an_edit_goes_first_and_the_question_is_asked_again_of_its_surface() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(&probe(7.0)).await;
    let asked = viewer.questions.recv().await.expect("a question");
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    // Its step is queued although the cancelled question has not returned yet.
    let step = viewer.step().await;
    assert!(asked.token.is_cancelled(), "the device stops to work on the question");
    assert!(asked.reply.send(Err(WorkError::Cancelled)).is_ok());
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "questions wait for edits");
    step.answer(Made::last(3, shapes(&[1, 3])));
    viewer.until("done").await;
    let again = viewer.questions.recv().await.expect("a question");
    assert_eq!(
        (again.x(), again.shown.as_ref().expect("a surface").cut),
        (7.0, CutId::new(3))
    );
    again.answer();
    assert_eq!(viewer.until("probed").await["generation"], 2);
}

#[tokio::test]
async fn a_late_answer_of_an_overtaken_question_is_dropped() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(&probe(1.0)).await;
    let asked = viewer.questions.recv().await.expect("a question");
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let step = viewer.step().await;
    viewer.say(&probe(2.0)).await;
    asked.answer();
    step.answer(Made::last(3, shapes(&[4])));
    viewer.until("done").await;
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.x(), 2.0, "the newer one took its place");
    asked.answer();
    assert_eq!(viewer.until("probed").await["position"][0], 2.0);
}

#[tokio::test]
async fn rest_work_does_not_hold_up_a_question() {
    let mut viewer = Viewer::showing(&[1]).await;
    let _measurement = viewer.measurements.recv().await.expect("a measurement");
    viewer.say(&probe(1.0)).await;
    viewer.questions.recv().await.expect("a question").answer();
    assert_eq!(viewer.text().await["type"], "probed");
}

#[tokio::test]
async fn open_and_cancel_drop_questions() {
    for message in [r#"{"type":"open","volume":"other"}"#, r#"{"type":"cancel"}"#] {
        let mut viewer = Viewer::showing(&[1]).await;
        viewer.say(&probe(1.0)).await;
        let asked = viewer.questions.recv().await.expect("a question");
        viewer.say(&probe(2.0)).await;
        viewer.say(message).await;
        settle(&mut viewer).await;
        assert!(asked.token.is_cancelled(), "{message}");
        asked.answer();
        settle(&mut viewer).await;
        assert!(viewer.questions.try_recv().is_err(), "{message}");
    }
}

#[tokio::test]
async fn what_is_wrong_with_a_question_is_said_and_nothing_is_asked() {
    let mut viewer = Viewer::new();
    viewer.say(&probe(1.0)).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    let mut viewer = Viewer::showing(&[1]).await;
    for (message, code) in [
        (
            json!({"type": "probe", "surface": 1, "position": [0, 0, 0]}),
            "unknown-surface",
        ),
        (json!({"type": "curve", "surface": 4_000_000_000u32}), "unknown-surface"),
        (json!({"type": "distribution", "bins": 0}), "bad-question"),
        (json!({"type": "distribution", "bins": 257}), "bad-question"),
        (json!({"type": "distribution", "bins": -1}), "bad-message"),
        (json!({"type": "distribution", "bins": 1e18}), "bad-message"),
        (json!({"type": "probe", "position": [0, 0]}), "bad-message"),
        (json!({"type": "probe", "position": [0, 0, null]}), "bad-message"),
        (json!({"type": "probe"}), "bad-message"),
        (json!({"type": "curve", "points": 64}), "bad-message"),
    ] {
        viewer.say(&message.to_string()).await;
        assert_eq!(viewer.error().await, (code.into(), true), "{message}");
    }
    for text in [
        r#"{"type":"probe","position":[NaN,0,0]}"#,
        r#"{"type":"probe","position":[1e999,0,0]}"#,
        r#"{"type":"probe","position":[0,0,0],"position":[1,1,1]}"#,
    ] {
        viewer.say(text).await;
        assert_eq!(viewer.error().await, ("bad-message".into(), true), "{text}");
    }
    assert!(viewer.questions.try_recv().is_err());
}

#[tokio::test]
async fn a_device_that_fails_to_answer_is_said() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(r#"{"type":"distribution"}"#).await;
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.question, Question::Distribution(64));
    let error = WorkError::Device(isopeel_kernels::Error::NoDriver);
    let _: Result<(), _> = asked.reply.send(Err(error));
    assert_eq!(viewer.error().await, ("device".into(), true));
}

const ANNOTATE: &str = r#"{"type":"annotate","surface":0,"annotation":"error"}"#;

#[tokio::test]
async fn an_annotation_comes_at_rest_for_the_regions_that_the_client_holds() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(ANNOTATE).await;
    let measurement = viewer.measurements.recv().await.expect("a measurement");
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "after all other work");
    assert!(measurement.reply.send(Ok(None)).is_ok());
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.question, Question::VertexErrors(DistanceOf::Vertex));
    asked.answer();
    // The chunk of the second region is left out: its mesh is not the one that was made again.
    viewer
        .expect(r#"{"type":"annotated","surface":0,"generation":1,"annotation":"error","regions":1}"#)
        .await;
    let Outgoing::Binary(frame) = viewer.frame().await else {
        panic!("expected a chunk")
    };
    let (header, errors) = decode_errors(&frame).expect("a chunk of errors");
    assert_eq!(
        (header.prefix.kind, header.prefix.generation, header.region.coords),
        (ChunkKind::Error, 1, [0; 3])
    );
    assert_eq!(errors.len(), 3);
    settle(&mut viewer).await;
}

/// A client that asks for signs of life gets one at once, and others later.
#[tokio::test]
async fn a_heartbeat_comes_to_a_client_that_asks_for_it() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(r#"{"type":"heartbeat"}"#).await;
    for _ in 0..2 {
        viewer.expect(r#"{"type":"heartbeat","seconds":1.5}"#).await;
    }
}

/// Values around the vertices are another annotation, with a name of its own.
#[tokio::test]
async fn an_annotation_of_what_is_around_vertices_is_named_as_it_was_asked() {
    let mut viewer = Viewer::showing(&[1]).await;
    let measurement = viewer.measurements.recv().await.expect("a measurement");
    assert!(measurement.reply.send(Ok(None)).is_ok());
    viewer
        .say(r#"{"type":"annotate","surface":0,"annotation":"error-around"}"#)
        .await;
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.question, Question::VertexErrors(DistanceOf::Around));
    asked.answer();
    viewer
        .expect(r#"{"type":"annotated","surface":0,"generation":1,"annotation":"error-around","regions":1}"#)
        .await;
}

/// Surfaces 0 and 1 as `with_two` has them, and measured.
async fn two_at_rest() -> Viewer {
    let mut viewer = Viewer::with_two().await;
    for _ in 0..2 {
        let measurement = viewer.measurements.recv().await.expect("a measurement");
        assert!(measurement.reply.send(Ok(None)).is_ok());
    }
    viewer
}

#[tokio::test]
async fn an_annotation_is_of_its_surface_and_waits_until_all_rest() {
    let mut viewer = Viewer::with_two().await;
    viewer.say(&ANNOTATE.replace("\"surface\":0", "\"surface\":1")).await;
    for _ in 0..2 {
        let measurement = viewer.measurements.recv().await.expect("a measurement");
        settle(&mut viewer).await;
        assert!(viewer.questions.try_recv().is_err(), "after the work for both");
        assert!(measurement.reply.send(Ok(None)).is_ok());
    }
    let asked = viewer.questions.recv().await.expect("a question");
    assert_eq!(asked.shown.as_ref().expect("a surface is shown").cut, CutId::new(2));
    // The client does not hold this mesh of the last region.
    let errors = shapes(&[3, 0, 5]).into_iter().map(|region| VertexErrors {
        distances: vec![0.5; region.vertices.len()],
        region,
    });
    assert!(asked.reply.send(Ok(Answer::VertexErrors(errors.collect()))).is_ok());
    viewer
        .expect(r#"{"type":"annotated","surface":1,"generation":2,"annotation":"error","regions":1}"#)
        .await;
    let Outgoing::Binary(frame) = viewer.frame().await else {
        panic!("expected a chunk")
    };
    let (header, _) = decode_errors(&frame).expect("a chunk of errors");
    let prefix = header.prefix;
    assert_eq!(
        (prefix.surface, prefix.generation, header.region.coords),
        (1, 2, [0; 3])
    );
    settle(&mut viewer).await;
}

/// Requests an annotation, and waits until `annotated` and its chunk are queued for the viewer.
async fn annotated_unread(viewer: &mut Viewer) {
    viewer.say(ANNOTATE).await;
    viewer.questions.recv().await.expect("a question").answer();
    while viewer.frames.is_empty() {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[tokio::test]
async fn an_annotation_is_dropped_unsent_by_whatever_changes_a_surface() {
    for message in [
        r#"{"type":"edit","beta":0.5}"#,
        r#"{"type":"edit","surface":1,"beta":0.5}"#,
        r#"{"type":"edit","surface":2,"iso":5}"#,
        r#"{"type":"remove","surface":0}"#,
        r#"{"type":"remove","surface":1}"#,
        r#"{"type":"cancel"}"#,
        r#"{"type":"open","volume":"other"}"#,
    ] {
        let mut viewer = two_at_rest().await;
        annotated_unread(&mut viewer).await;
        viewer.say(message).await;
        // The session handles this message after the one above.
        viewer.say(r#"{"type":"drawn","generation":1}"#).await;
        assert_eq!(viewer.text().await["type"], "annotated");
        while let Ok(frame) = tokio::time::timeout(Duration::from_millis(50), viewer.frame()).await {
            assert!(!matches!(frame, Outgoing::Binary(_)), "{message}");
        }
        assert!(viewer.questions.try_recv().is_err(), "{message}");
    }
}

#[tokio::test]
async fn an_annotation_waits_until_the_one_before_is_read() {
    let mut viewer = two_at_rest().await;
    annotated_unread(&mut viewer).await;
    for _ in 0..100 {
        viewer.say(ANNOTATE).await;
    }
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert!(viewer.questions.try_recv().is_err(), "chunks of one wait at most");
    assert_eq!(viewer.text().await["type"], "annotated");
    assert!(matches!(viewer.frame().await, Outgoing::Binary(_)));
    viewer.questions.recv().await.expect("a question").answer();
    assert_eq!(viewer.text().await["type"], "annotated");
    assert!(matches!(viewer.frame().await, Outgoing::Binary(_)));
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "of a flood the last");
}

#[tokio::test]
async fn an_edit_drops_an_annotation() {
    let mut viewer = Viewer::showing(&[1]).await;
    let measurement = viewer.measurements.recv().await.expect("a measurement");
    assert!(measurement.reply.send(Ok(None)).is_ok());
    viewer.say(ANNOTATE).await;
    let asked = viewer.questions.recv().await.expect("a question");
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    viewer.step().await.answer(Made::last(3, shapes(&[4])));
    assert!(asked.token.is_cancelled());
    asked.answer();
    viewer.until("done").await;
    settle(&mut viewer).await;
    assert!(viewer.questions.try_recv().is_err(), "it is not asked again");
}
