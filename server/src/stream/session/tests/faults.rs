//! Faults: bad messages, a failing device, clients that do not read or that disconnect, and the shutdown.

use std::time::Duration;

use isopeel_extraction::WorkError;
use isopeel_view::View;

use super::super::{HIGH_WATER, Incoming, Outgoing};
use super::scripted::{Answer, shapes};
use super::viewer::{Viewer, prefix};
use crate::access::{Access, Identity, NewToken, Role, Token, TokenFile, TokenWatch};
use crate::wire::messages::CloseCode;

#[tokio::test]
async fn faults_are_said_and_the_connection_lives_on() {
    let mut viewer = Viewer::new();
    viewer.say(r#"{"type":"edit"}"#).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    viewer.say(r#"{"type":"open","volume":"heart"}"#).await;
    assert_eq!(viewer.error().await, ("unknown-volume".into(), true));
    viewer.say(r#"{"type":"open","volume":"head","step":6}"#).await;
    assert_eq!(viewer.error().await, ("unknown-step".into(), true));
    viewer.say("[1").await;
    assert_eq!(viewer.error().await, ("bad-message".into(), true));
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    viewer.say(r#"{"type":"edit","alpha":2}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.say(r#"{"type":"edit","surface":4,"beta":0.5}"#).await;
    let error = viewer.text().await;
    assert_eq!(
        (&error["code"], &error["message"]),
        (
            &"bad-edit".into(),
            &"surface: 4, this server has 4 a connection, expected 0 to 3".into()
        )
    );
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","beta":0.125}"#).await;
    let job = viewer.step().await;
    assert_eq!(
        (job.view.alpha, job.view.beta),
        (View::OPENING_ALPHA, 0.125),
        "the bad edit was not applied"
    );
}

#[tokio::test]
async fn a_failing_device_ends_the_generation_alone() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    let job = viewer.step().await;
    let error = WorkError::Device(isopeel_kernels::Error::NoDriver);
    assert!(job.reply.send(Err(error)).is_ok());
    assert_eq!(viewer.error().await, ("device".into(), true));
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    viewer.say(r#"{"type":"edit"}"#).await;
    viewer.step().await.answer(Answer::last(3, shapes(&[1, 3])));
    viewer.expect(&prefix(3, 0, [1, 1, 2], true)).await;
}

#[tokio::test]
async fn what_is_too_large_is_refused_before_it_is_made_and_a_budget_offered() {
    let mut viewer = Viewer::showing(&[1, 2]).await;
    viewer.say(r#"{"type":"edit","beta":0}"#).await;
    let error = WorkError::TooManyTriangles {
        triangles: 30,
        ceiling: 20,
    };
    assert!(viewer.step().await.reply.send(Err(error)).is_ok());
    let error = viewer.text().await;
    assert_eq!(
        (
            &error["type"],
            &error["code"],
            &error["open"],
            &error["suggestedTriangles"]
        ),
        (&"error".into(), &"too-large".into(), &true.into(), &20.into())
    );
    viewer
        .expect(r#"{"type":"superseded","surface":0,"generation":2}"#)
        .await;
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","cap":true}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit","triangles":20,"beta":0.5}"#).await;
    assert_eq!(viewer.error().await, ("bad-edit".into(), true));
}

#[tokio::test]
async fn sixteen_malformed_messages_in_a_row_close() {
    let mut viewer = Viewer::new();
    for _ in 0..15 {
        viewer.say("{").await;
        assert_eq!(viewer.error().await, ("bad-message".into(), true));
    }
    viewer.say(r#"{"type":"cancel"}"#).await;
    for _ in 0..15 {
        viewer.say("{").await;
        assert_eq!(viewer.error().await, ("bad-message".into(), true));
    }
    viewer.say("{").await;
    assert_eq!(viewer.error().await, ("bad-message".into(), false));
    assert_eq!(viewer.frame().await, Outgoing::Close(CloseCode::Malformed));
    viewer.session.await.expect("ends");
}

#[tokio::test]
async fn a_client_that_talks_and_does_not_read_fills_no_memory() {
    let viewer = Viewer::new();
    let inbox = viewer.inbox.clone().expect("connected");
    let mut taken = 0;
    while tokio::time::timeout(
        Duration::from_millis(100),
        inbox.send(Incoming::Text(r#"{"type":"edit"}"#.into())),
    )
    .await
    .is_ok()
    {
        taken += 1;
        // Each answer takes some hundred bytes of the limit.
        assert!(taken < HIGH_WATER / 64, "every message is taken");
    }
    assert!(taken > HIGH_WATER / 1024, "{taken}");
}

#[tokio::test]
async fn a_shutdown_says_so_and_cancels_the_work() {
    let mut viewer = Viewer::opened().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    let job = viewer.step().await;
    viewer.shutdown.cancel();
    assert_eq!(viewer.frame().await, Outgoing::Close(CloseCode::Shutdown));
    viewer.session.await.expect("ends");
    assert!(job.token.is_cancelled());
}

#[tokio::test]
async fn a_client_that_vanishes_leaves_nothing_behind() {
    let mut viewer = Viewer::showing(&[1]).await;
    viewer.say(r#"{"type":"edit","beta":0.5}"#).await;
    viewer.step().await.answer(Answer::prefix(3, shapes(&[2; 64])));
    viewer.frame().await;
    let job = viewer.step().await;
    // The connection breaks during a step: 64 chunks wait. First only the writer ends, as when the network fails.
    viewer.frames.close();
    viewer.session.await.expect("ends");
    assert!(job.token.is_cancelled());
    assert!(job.reply.is_closed());
    assert!(viewer.steps.recv().await.is_none(), "the backend's handles are gone");

    let mut viewer = Viewer::opened().await;
    viewer.inbox = None;
    viewer.session.await.expect("ends when the reader goes, too");
}

/// A file with a token for a role, and its owner.
pub(super) fn holder(role: Role) -> (tempfile::TempDir, TokenFile, TokenWatch, Identity) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = TokenFile::in_folder(folder.path());
    let new = NewToken {
        user: "ann".into(),
        roles: vec![role].into(),
        lifetime: None,
    };
    let (token, _) = file.create(new).expect("a token");
    let watch = TokenWatch::open(file.clone()).expect("tokens");
    let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[])
        .with_token(&Token::random().expect("random"))
        .with_named(&watch);
    let who = access.who(token.text()).expect("it was made");
    (folder, file, watch, who)
}

#[tokio::test]
async fn who_may_only_look_changes_nothing() {
    let (_folder, _, _watch, who) = holder(Role::View);
    let mut viewer = Viewer::with_token_of(who);
    viewer.say(r#"{"type":"open","volume":"head"}"#).await;
    viewer.opens.recv().await.expect("an open job").answer();
    assert_eq!(viewer.text().await["type"], "opened");
    for change in [
        r#"{"type":"edit","alpha":0.25}"#,
        r#"{"type":"edit","surface":1,"iso":9}"#,
        r#"{"type":"remove","surface":0}"#,
    ] {
        viewer.say(change).await;
        assert_eq!(viewer.error().await, ("forbidden".into(), true), "{change}");
    }
    viewer.quiet().await;
    viewer.say(r#"{"type":"edit"}"#).await;
    let job = viewer.step().await;
    assert_eq!(job.view.alpha, View::OPENING_ALPHA, "nothing was changed");
    job.answer(Answer::last(1, shapes(&[1])));
    viewer.until("done").await;
}

#[tokio::test]
async fn a_token_that_is_revoked_ends_the_connection() {
    let (_folder, file, watch, who) = holder(Role::Edit);
    let id = who.token().to_owned();
    let mut viewer = Viewer::with_token_of(who);
    let looking = tokio::spawn(watch.run());
    viewer.say(r#"{"type":"edit"}"#).await;
    assert_eq!(viewer.error().await, ("not-open".into(), true));
    let start = std::time::Instant::now();
    file.revoke(&id).expect("revoked");
    assert_eq!(viewer.error().await, ("unauthorized".into(), false));
    assert_eq!(viewer.frame().await, Outgoing::Close(CloseCode::TokenEnded));
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    looking.abort();
}
