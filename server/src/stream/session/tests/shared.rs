//! Viewers of equal views: one job of one device, the same bytes for all.

use super::super::{Common, Outgoing};
use super::scripted::{Answer, shapes};
use super::viewer::Viewer;
use crate::access::Identity;

/// Viewers of one server, each with a device of its own, so that tests see which of them has the job.
async fn viewers(count: usize, common: &Common) -> Vec<Viewer> {
    let mut viewers = Vec::new();
    for _ in 0..count {
        viewers.push(Viewer::among(common, Identity::without_token()).open().await);
    }
    viewers
}

/// All frames up to `done`, without the trace, which differs between connections.
async fn frames_to_done(viewer: &mut Viewer) -> Vec<Outgoing> {
    let mut frames = Vec::new();
    loop {
        let frame = viewer.frame().await;
        match &frame {
            Outgoing::Text(text) if text.contains(r#""type":"done""#) => return frames,
            _ => frames.push(frame),
        }
    }
}

#[tokio::test]
async fn who_asks_for_the_same_gets_the_same_of_one_job() {
    let common = Common::new(1 << 20);
    let mut viewers = viewers(8, &common).await;
    for viewer in &viewers {
        viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    }
    let [first, others @ ..] = &mut viewers[..] else {
        panic!("eight")
    };
    first.step().await.answer(Answer::last(1, shapes(&[1, 2, 3])));
    let alone = frames_to_done(first).await;
    assert_eq!(alone.len(), 5, "prefix, three chunks, committed");
    for other in others {
        assert_eq!(frames_to_done(other).await, alone);
        assert!(other.steps.try_recv().is_err(), "a job of its own");
        // The surface is measured only once, too.
        assert!(other.measurements.try_recv().is_err());
    }
}

#[tokio::test]
async fn who_comes_later_is_sent_what_was_kept() {
    let common = Common::new(1 << 20);
    let mut viewers = viewers(5, &common).await;
    let [first, later, colours, other, elsewhere] = &mut viewers[..] else {
        panic!("five")
    };
    first.say(r#"{"type":"edit"}"#).await;
    first.step().await.answer(Answer::prefix(1, shapes(&[9])));
    first.until("committed").await;
    first.step().await.answer(Answer::last(2, shapes(&[1, 2])));
    first.until("done").await;

    later.say(r#"{"type":"edit"}"#).await;
    later.until("done").await;
    assert!(later.steps.try_recv().is_err());
    // Colours do not make another view, because clients apply them. But the chunks carry the number of this viewer's own generation.
    colours.say(r##"{"type":"edit","transferFunction":{"points":[{"x":0,"importance":0,"color":"#ffffff"},{"x":1,"importance":1,"color":"#000000"}]}}"##).await;
    colours.until("done").await;
    assert!(colours.steps.try_recv().is_err());
    colours.say(r#"{"type":"edit","beta":0.1}"#).await;
    colours.step().await.answer(Answer::last(3, shapes(&[1, 4])));
    colours.until("prefix").await;
    assert_eq!(colours.chunk().await.header.prefix.generation, 2);
    // Another view is made, and so is the same view of another volume.
    other.say(r#"{"type":"edit","beta":0.7}"#).await;
    other.step().await.answer(Answer::last(4, shapes(&[5])));
    other.until("done").await;
    elsewhere.say(r#"{"type":"open","volume":"other"}"#).await;
    elsewhere.opens.recv().await.expect("an open job").answer();
    elsewhere.say(r#"{"type":"edit"}"#).await;
    elsewhere.step().await.answer(Answer::last(5, shapes(&[1, 2])));
    elsewhere.until("done").await;
}

#[tokio::test]
async fn a_job_goes_on_for_those_who_stay() {
    let common = Common::new(0);
    let mut viewers = viewers(3, &common).await;
    for viewer in &viewers {
        viewer.say(r#"{"type":"edit"}"#).await;
        // All viewers have joined the job before the first one leaves.
        tokio::task::yield_now().await;
    }
    let [first, second, third] = &mut viewers[..] else {
        panic!("three")
    };
    let job = first.step().await;
    second.quiet().await;
    // One viewer cancels, another one disconnects.
    second.say(r#"{"type":"cancel"}"#).await;
    second.until("superseded").await;
    first.inbox = None;
    (&mut first.session).await.expect("ends");
    assert!(!job.token.is_cancelled());
    job.answer(Answer::last(1, shapes(&[1])));
    third.until("done").await;
    assert!(third.steps.try_recv().is_err());

    third.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = third.step().await;
    third.inbox = None;
    (&mut third.session).await.expect("ends");
    assert!(job.token.is_cancelled(), "nobody waits for it");
}

/// A job that fails fails for all its waiters and is not cached: the next request retries it.
#[tokio::test]
async fn an_error_is_for_all_who_wait_and_is_not_kept() {
    let common = Common::new(1 << 20);
    let mut viewers = viewers(2, &common).await;
    for viewer in &viewers {
        viewer.say(r#"{"type":"edit"}"#).await;
        tokio::task::yield_now().await;
    }
    let [first, second] = &mut viewers[..] else {
        panic!("two")
    };
    let job = first.step().await;
    second.quiet().await;
    assert!(job.reply.send(Err(isopeel_extraction::WorkError::Stopped)).is_ok());
    for viewer in [&mut *first, &mut *second] {
        assert_eq!(viewer.error().await, ("device".into(), true));
        viewer.until("superseded").await;
    }
    second.say(r#"{"type":"edit"}"#).await;
    second.step().await.answer(Answer::last(1, shapes(&[1])));
    second.until("done").await;
}
