//! Groups: followers are shown what another does, whoever may edit, and control is handed over.

use serde_json::{Value, json};
use tokio::sync::mpsc;

use super::super::Common;
use super::faults::holder;
use super::scripted::{Answer, shapes};
use super::viewer::Viewer;
use crate::access::{Identity, Role};

/// Messages about the group, in between others.
async fn group_message(viewer: &mut Viewer, name: &str) -> Value {
    viewer.until(name).await
}

/// Its surfaces are not measured while it rests, however slow the machine is that the test runs on.
fn unmeasured(mut viewer: Viewer) -> Viewer {
    let mut jobs = std::mem::replace(&mut viewer.measurements, mpsc::channel(1).1);
    tokio::spawn(async move {
        while let Some(job) = jobs.recv().await {
            let _ = job.reply.send(Ok(None));
        }
    });
    viewer
}

/// A leader who shows a surface of this isovalue, and its group.
async fn leader(common: &Common, iso: f32) -> (Viewer, String) {
    let leader = Viewer::among(common, Identity::without_token()).open().await;
    let mut leader = unmeasured(leader);
    leader.say(&json!({"type": "edit", "iso": iso}).to_string()).await;
    leader.step().await.answer(Answer::last(1, shapes(&[1])));
    leader.until("done").await;
    leader.say(r#"{"type":"lead"}"#).await;
    let group = group_message(&mut leader, "group").await;
    assert_eq!(
        (&group["you"], &group["control"], &group["followers"]),
        (&json!(0), &json!(0), &json!(0))
    );
    let id = group["group"].as_str().expect("an id").to_owned();
    assert_eq!(id.len(), 32, "128 random bits");
    (leader, id)
}

/// One who follows, with what is shown there on screen here.
async fn follower(common: &Common, who: Identity, group: &str, iso: f32) -> Viewer {
    let mut follower = unmeasured(Viewer::among(common, who));
    follower
        .say(&json!({"type": "join", "group": group, "name": "Ann"}).to_string())
        .await;
    let entered = group_message(&mut follower, "group").await;
    assert_eq!((&entered["control"], &entered["people"]), (&json!(0), &json!([])));
    let led = group_message(&mut follower, "led").await;
    assert_eq!(
        (&led["volume"], &led["surfaces"][0]["edit"]["iso"]),
        (&json!("head"), &json!(iso))
    );
    follower.opens.recv().await.expect("an open job").answer();
    follower.until("opened").await;
    follower.until("done").await;
    assert!(follower.steps.try_recv().is_err(), "made once for all");
    follower
}

/// What another member has done is shown here too, without a job of its own.
async fn follows(viewer: &mut Viewer, surface: usize, iso: f32) {
    while group_message(viewer, "led").await["surfaces"][surface]["edit"]["iso"] != json!(iso) {}
    viewer.until("done").await;
    assert!(viewer.steps.try_recv().is_err(), "made once for all");
}

/// A surface of this isovalue is made and shown.
async fn shown(viewer: &mut Viewer, iso: f32) {
    let job = viewer.step().await;
    assert_eq!(job.view.iso.expect("an isovalue").get(), iso);
    job.answer(Answer::last(1, shapes(&[1, 2])));
    viewer.until("done").await;
}

#[tokio::test]
async fn who_may_only_look_is_shown_what_the_leader_does() {
    let common = Common::new(1 << 20);
    let (mut leader, group) = leader(&common, 5.0).await;
    leader
        .say(
            r#"{"type":"pose","camera":{"position":[1,2,3],"target":[0,0,0],"projection":"perspective"},"page":"v=1"}"#,
        )
        .await;
    let (_folder, _, _watch, who) = holder(Role::View);
    let mut looks = follower(&common, who, &group, 5.0).await;
    let told = group_message(&mut leader, "group").await;
    assert_eq!(
        (&told["followers"], &told["people"]),
        (&json!(1), &json!([{"number": 1, "name": "Ann", "asks": false}]))
    );

    leader.say(r#"{"type":"edit","iso":6}"#).await;
    shown(&mut leader, 6.0).await;
    follows(&mut looks, 0, 6.0).await;
    // A surface more, and one less.
    leader.say(r#"{"type":"edit","surface":1,"iso":8,"beta":0.5}"#).await;
    shown(&mut leader, 8.0).await;
    follows(&mut looks, 1, 8.0).await;
    leader.say(r#"{"type":"remove","surface":1}"#).await;
    looks.until("removed").await;
    // Another volume, and a step of it.
    leader.say(r#"{"type":"open","volume":"other"}"#).await;
    leader.opens.recv().await.expect("an open job").answer();
    leader.until("opened").await;
    let job = looks.opens.recv().await.expect("an open job");
    assert_eq!(job.volume.dataset().id, "other");
    job.answer();
    looks.until("opened").await;
    leader.say(r#"{"type":"step","step":3}"#).await;
    assert_eq!(looks.until("stepped").await["step"], 3);

    // What it does itself changes nothing.
    for message in [
        r#"{"type":"edit","iso":9}"#,
        r#"{"type":"open","volume":"head"}"#,
        r#"{"type":"step","step":1}"#,
    ] {
        looks.say(message).await;
        assert_eq!(looks.until("error").await["code"], "not-in-control", "{message}");
    }
    looks.say(r#"{"type":"ask-control","asks":true}"#).await;
    assert_eq!(looks.until("error").await["code"], "forbidden");
    looks.say(r#"{"type":"lead"}"#).await;
    assert_eq!(looks.until("error").await["code"], "forbidden");
    // The leader goes, and with it the group.
    leader.inbox = None;
    assert_eq!(looks.until("left").await["reason"], "the leader has ended it");
    looks.say(&json!({"type": "join", "group": group}).to_string()).await;
    assert_eq!(looks.until("error").await["code"], "unknown-group");
}

#[tokio::test]
async fn a_camera_is_passed_on_the_newest_of_it() {
    let common = Common::new(1 << 20);
    let (leader, group) = leader(&common, 5.0).await;
    let pose = |x: u32| {
        format!(r#"{{"type":"pose","camera":{{"position":[{x},2,3],"target":[0,0,0],"projection":"orthographic"}}}}"#)
    };
    leader.say(r#"{"type":"pose","page":"v=1&volume=head"}"#).await;
    leader.say(&pose(1)).await;
    let mut follows = follower(&common, Identity::without_token(), &group, 5.0).await;
    for x in 2..=20 {
        leader.say(&pose(x)).await;
    }
    let mut poses = 0;
    loop {
        let posed = follows.until("posed").await;
        assert_eq!(posed["page"], "v=1&volume=head", "what is left out stays");
        poses += 1;
        if posed["camera"]["position"][0] == 20.0 {
            break;
        }
    }
    assert!(poses <= 5, "{poses} of 20 poses");
    follows.say(&pose(30)).await;
    assert_eq!(follows.until("error").await["code"], "not-in-control");
}

#[tokio::test]
async fn control_is_given_to_who_asks_and_comes_back() {
    let common = Common::new(1 << 20);
    let (mut leader, group) = leader(&common, 5.0).await;
    let mut ann = follower(&common, Identity::without_token(), &group, 5.0).await;
    leader.say(r#"{"type":"give-control","to":1}"#).await;
    assert_eq!(
        leader.until("error").await["code"],
        "not-in-control",
        "nobody has asked"
    );
    ann.say(r#"{"type":"give-control","to":1}"#).await;
    assert_eq!(
        ann.until("error").await["code"],
        "not-in-control",
        "only the leader gives it"
    );
    ann.say(r#"{"type":"ask-control","asks":true}"#).await;
    while group_message(&mut leader, "group").await["people"][0]["asks"] != true {}
    leader.say(r#"{"type":"give-control","to":1}"#).await;
    while group_message(&mut ann, "group").await["control"] != 1 {}

    ann.say(r#"{"type":"edit","iso":7}"#).await;
    shown(&mut ann, 7.0).await;
    follows(&mut leader, 0, 7.0).await;
    leader.say(r#"{"type":"edit","iso":9}"#).await;
    assert_eq!(leader.until("error").await["code"], "not-in-control");
    // Who has it leaves: it is the leader's again.
    ann.say(r#"{"type":"leave"}"#).await;
    assert_eq!(ann.until("left").await["reason"], "you have left it");
    while group_message(&mut leader, "group").await["control"] != 0 {}
    leader.say(r#"{"type":"edit","iso":9}"#).await;
    shown(&mut leader, 9.0).await;
    ann.quiet().await;
}

#[tokio::test]
async fn there_are_only_so_many_groups_and_followers() {
    use crate::stream::groups::{Groups, MAX_FOLLOWERS, MAX_GROUPS};
    let groups = Groups::default();
    let mut leaders: Vec<_> = (0..MAX_GROUPS)
        .map(|i| groups.lead(i.to_string()).expect("a group"))
        .collect();
    assert!(groups.lead("one more".into()).is_err());
    let followers: Vec<_> = (0..MAX_FOLLOWERS)
        .map(|_| groups.join("0", None, false).expect("a follower"))
        .collect();
    assert!(groups.join("0", None, false).is_err());
    assert!(groups.join("1", None, false).is_ok(), "of another group");
    drop(followers);
    assert!(groups.join("0", None, false).is_ok());
    leaders.remove(0);
    assert!(groups.join("0", None, false).is_err(), "its leader has gone");
    assert!(groups.lead("one more".into()).is_ok());
}
