//! Edits that supersede each other, `cancel`, and `open` between them.

use isopeel_extraction::{CutId, Shown};

use super::scripted::{Answer, shapes};
use super::viewer::{Viewer, committed, prefix};
use crate::service::{OpeningProgress, Preparation};

#[tokio::test]
async fn edits_coalesce_while_the_first_step_of_one_is_made() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit","beta":0.1}"#).await;
    let first = viewer.step().await;
    for beta in [0.2, 0.3, 0.4] {
        viewer.say(&format!(r#"{{"type":"edit","beta":{beta}}}"#)).await;
    }
    viewer.say(r#"{"type":"edit","alpha":1}"#).await;
    viewer.quiet().await;
    first.answer(Answer::prefix(1, shapes(&[1])));
    viewer.expect(&prefix(1, 4, [1, 0, 1], false)).await;
    viewer.chunk().await;
    viewer.expect(&committed(1, 4, false)).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":1}"#)
        .await;
    let job = viewer.step().await;
    assert_eq!((job.view.beta, job.view.alpha), (0.4, 1.0));
    job.answer(Answer::last(2, shapes(&[1])));
    viewer.expect(&prefix(2, 0, [0, 1, 1], true)).await;
}

#[tokio::test]
async fn an_edit_ends_a_generation_of_which_something_was_committed() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::prefix(1, shapes(&[1])));
    viewer.until("committed").await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"edit","beta":0.2}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":1}"#)
        .await;
    viewer.quiet().await;
    job.answer_cancelled().await;
    assert_eq!(viewer.step().await.view.beta, 0.2);
}

#[tokio::test]
async fn nothing_of_an_older_generation_follows_the_newer() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::prefix(1, shapes(&[1])));
    viewer.until("committed").await;
    viewer
        .step()
        .await
        .answer(Answer::last(2, shapes(&[2; 40])).on_the_way());
    viewer.expect(&prefix(1, 0, [40, 0, 40], false)).await;
    viewer.chunk().await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    // A late result is dropped.
    let late = viewer.step().await;
    late.answer(Answer::last(3, shapes(&[3; 40])));
    let mut chunks = 0;
    loop {
        let (text, chunk) = viewer.text_or_chunk().await;
        match chunk {
            Some(chunk) => assert_eq!(chunk.header.prefix.generation, 1),
            None => {
                assert_eq!(text["type"], "superseded");
                break;
            }
        }
        chunks += 1;
    }
    assert!(chunks < 38, "{chunks} chunks came though the edit was there");
    // The client committed one region of generation 1, so all others go.
    let job = viewer.step().await;
    assert_eq!(job.shown(), Shown::Cut(CutId::new(1)));
    job.answer(Answer::prefix(4, shapes(&[1; 40])));
    viewer.expect(&prefix(2, 4, [39, 1, 40], false)).await;
    for _ in 0..39 {
        assert_eq!(viewer.chunk().await.header.prefix.generation, 2);
    }
    viewer.expect(&committed(2, 4, false)).await;
}

#[tokio::test]
async fn cancel_ends_the_generation_and_keeps_what_was_committed() {
    let mut viewer = Viewer::showing(&[1, 2, 3]).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.step().await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    job.answer_cancelled().await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"cancel"}"#).await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::last(3, shapes(&[1, 2, 4])));
    viewer.expect(&prefix(3, 0, [1, 2, 3], true)).await;
}

#[tokio::test]
async fn edits_while_a_volume_opens_are_kept() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"open","volume":"head","step":1}"#).await;
    viewer.say(r#"{"type":"edit","beta":0.25}"#).await;
    let open = viewer.opens.recv().await.expect("an open job");
    assert_eq!(open.volume.step(), 1);
    open.answer();
    let opened = viewer.text().await;
    assert_eq!((&opened["type"], &opened["step"]), (&"opened".into(), &1.into()));
    assert_eq!(opened["edit"]["iso"], 100.0);
    assert_eq!(opened["device"], "scripted");
    assert_eq!(
        opened["capabilities"],
        serde_json::json!({ "surfaces": 4, "chunkKinds": ["cut", "error"], "measuredError": true, "steps": true, "watches": false, "groups": true, "questions": ["probe", "distribution", "curve", "annotate"] })
    );
    let job = viewer.step().await;
    assert_eq!((job.view.beta, job.view.iso.map(|iso| iso.get())), (0.25, Some(100.0)));
}

#[tokio::test]
async fn another_open_replaces_the_first() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let first = viewer.opens.recv().await.expect("an open job");
    viewer.say(r#"{"type":"open","volume":"other"}"#).await;
    first.token.cancelled().await;
    first.answer();
    viewer.opens.recv().await.expect("an open job").answer();
    let opened = viewer.text().await;
    assert_eq!(opened["volume"]["id"], "other");
    // The server no longer assumes that the client holds any region.
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[1, 2])));
    viewer.expect(&prefix(2, 4, [2, 0, 2], false)).await;
}

#[tokio::test]
async fn how_far_a_volume_is_is_said_until_it_is_open() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let open = viewer.opens.recv().await.expect("an open job");
    let progress = open.progress.clone().expect("a channel");
    progress.send_replace(OpeningProgress {
        device: Some(Preparation { done: 12, of: 34 }),
        ..OpeningProgress::default()
    });
    viewer
        .expect(r#"{"type":"opening","bytes":0,"totalBytes":0,"device":{"done":12,"of":34}}"#)
        .await;
    let at = |bytes| OpeningProgress {
        bytes,
        total_bytes: 100,
        ..OpeningProgress::default()
    };
    progress.send_replace(at(30));
    viewer.expect(r#"{"type":"opening","bytes":30,"totalBytes":100}"#).await;
    for bytes in 31..=90 {
        progress.send_replace(at(bytes));
        tokio::task::yield_now().await;
    }
    // A viewer that did not read meanwhile gets at most two messages: one that was on its way, and the newest.
    let mut last = viewer.text().await;
    if last["bytes"] != 90 {
        last = viewer.text().await;
    }
    assert_eq!(last["bytes"], 90);
    progress.send_replace(at(100));
    open.answer();
    let mut next = viewer.text().await;
    if next["type"] == "opening" {
        next = viewer.text().await;
    }
    assert_eq!(next["type"], "opened");
    // Progress that arrives late is ignored, because the volume is open.
    progress.send_replace(at(101));
    viewer.quiet().await;
}

#[tokio::test]
async fn how_far_a_volume_is_that_another_one_replaced_is_not_said() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    let first = viewer.opens.recv().await.expect("an open job");
    viewer.say(r#"{"type":"open","volume":"other"}"#).await;
    first.token.cancelled().await;
    let progress = first.progress.clone().expect("a channel");
    progress.send_replace(OpeningProgress {
        bytes: 1,
        total_bytes: 2,
        ..OpeningProgress::default()
    });
    first.answer();
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    viewer.quiet().await;
}
