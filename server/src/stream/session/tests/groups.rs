//! Groups: followers are shown what the member in control does, whether or not they may edit, and control is handed over.

use std::time::{Duration, Instant};

use isopeel_extraction::Refinement;
use serde_json::{Value, json};
use tokio::sync::mpsc;

use super::super::Common;
use super::faults::holder;
use super::scripted::{Answer, Job, shapes};
use super::viewer::Viewer;
use crate::access::{Identity, Occupant, Role};
use crate::stream::groups::{Groups, LONGEST_WAIT, Leader, MAX_FOLLOWERS, MAX_GROUPS, MAX_GROUPS_OF_USER};

/// Reads on to the next message of this name about the group.
async fn group_message(viewer: &mut Viewer, name: &str) -> Value {
    viewer.until(name).await
}

/// Answers all measurements at rest with nothing, so that a slow machine does not add messages.
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
pub(super) async fn leader(common: &Common, iso: f32) -> (Viewer, String) {
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

/// A follower that has received the leader's surface of this isovalue.
pub(super) async fn follower(common: &Common, who: Identity, group: &str, iso: f32) -> Viewer {
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

/// Expects that an edit of another member is shown here too, without a job of its own.
async fn follows(viewer: &mut Viewer, surface: usize, iso: f32) {
    while group_message(viewer, "led").await["surfaces"][surface]["edit"]["iso"] != json!(iso) {}
    viewer.until("done").await;
    assert!(viewer.steps.try_recv().is_err(), "made once for all");
}

/// Makes a surface of this isovalue and shows it to the viewer.
async fn shown(viewer: &mut Viewer, iso: f32) {
    let job = viewer.step().await;
    shown_by(viewer, job, iso).await;
}

/// As [`shown`], for a job that was received already.
async fn shown_by(viewer: &mut Viewer, job: Job<Refinement>, iso: f32) {
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
    // Followers get an added surface, and its removal.
    leader.say(r#"{"type":"edit","surface":1,"iso":8,"beta":0.5}"#).await;
    shown(&mut leader, 8.0).await;
    follows(&mut looks, 1, 8.0).await;
    leader.say(r#"{"type":"remove","surface":1}"#).await;
    looks.until("removed").await;
    // Followers get another volume, and another time step of it.
    leader.say(r#"{"type":"open","volume":"other"}"#).await;
    leader.opens.recv().await.expect("an open job").answer();
    leader.until("opened").await;
    let job = looks.opens.recv().await.expect("an open job");
    assert_eq!(job.volume.dataset().id, "other");
    job.answer();
    looks.until("opened").await;
    leader.say(r#"{"type":"step","step":3}"#).await;
    assert_eq!(looks.until("stepped").await["step"], 3);

    // The follower's own messages are refused.
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
    // The group ends when the leader leaves.
    leader.say(r#"{"type":"leave"}"#).await;
    assert_eq!(
        looks.until("left").await["reason"],
        "the leader has ended it, or has not come back"
    );
    looks.say(&json!({"type": "join", "group": group}).to_string()).await;
    assert_eq!(looks.until("error").await["code"], "unknown-group");
}

#[tokio::test]
async fn further_steps_of_followers_come_after_the_first_of_all() {
    let common = Common::new(1 << 20);
    let (mut leader, group) = leader(&common, 5.0).await;
    let mut follows = follower(&common, Identity::without_token(), &group, 5.0).await;
    let other = common.groups.join(&group, None, false).expect("space");
    let mut waits = Some(other.first_step());
    for iso in [6, 7] {
        let began = Instant::now();
        leader.say(&json!({"type": "edit", "iso": iso}).to_string()).await;
        leader.step().await.answer(Answer::prefix(1, shapes(&[iso])));
        // The member in control gets its surface at once.
        leader.step().await.answer(Answer::last(2, shapes(&[iso, iso])));
        leader.until("done").await;
        follows.until("committed").await;
        follows.until("done").await;
        assert!(follows.steps.try_recv().is_err(), "made once for all");
        // A follower whose first step is never made delays the others by `LONGEST_WAIT` at most.
        assert!(waits.is_none() || began.elapsed() >= LONGEST_WAIT);
        waits = None;
    }
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
    // If the follower in control leaves, the leader has control again.
    ann.say(r#"{"type":"leave"}"#).await;
    assert_eq!(ann.until("left").await["reason"], "you have left it");
    while group_message(&mut leader, "group").await["control"] != 0 {}
    leader.say(r#"{"type":"edit","iso":9}"#).await;
    shown(&mut leader, 9.0).await;
    ann.quiet().await;
}

/// A leader with this user name.
fn key_of(user: &str) -> Leader {
    Leader {
        who: Occupant {
            user: user.into(),
            address: None,
            is_admin: user == "root",
        },
        key: "k".repeat(32),
    }
}

#[tokio::test]
async fn a_leader_whose_connection_was_lost_comes_back() {
    let common = Common::new(1 << 20);
    let leads = Viewer::among(&common, Identity::without_token()).open().await;
    let mut leads = unmeasured(leads);
    leads.say(r#"{"type":"edit","iso":5}"#).await;
    leads.step().await.answer(Answer::last(1, shapes(&[1])));
    leads.until("done").await;
    leads.say(r#"{"type":"lead"}"#).await;
    let told = group_message(&mut leads, "group").await;
    let (group, key) = (told["group"].clone(), told["key"].clone());
    assert_eq!(key.as_str().map(str::len), Some(32), "128 random bits");
    assert_ne!(group, key);
    let mut looks = follower(&common, Identity::without_token(), group.as_str().expect("an id"), 5.0).await;
    leads.inbox = None;
    let waits = loop {
        let told = group_message(&mut looks, "group").await;
        if told["leaderAway"] == true {
            break told;
        }
    };
    assert_eq!(
        (&waits["control"], waits.get("key")),
        (&json!(0), None),
        "nobody else has the key"
    );

    // A viewer with the group's id and a wrong key, or another user with the right key, cannot resume the lead.
    let resume = |key: &Value| json!({"type": "lead", "resume": {"group": group, "key": key}}).to_string();
    looks.say(&resume(&json!("0".repeat(32)))).await;
    assert_eq!(looks.until("error").await["code"], "unknown-group");
    let (_folder, _, _watch, who) = holder(Role::Edit);
    let other = Viewer::among(&common, who);
    let mut other = unmeasured(other);
    other.say(&resume(&key)).await;
    assert_eq!(other.until("error").await["code"], "unknown-group");

    // The attempt of `looks` to resume has made it leave the group, as `lead` does. So another follower joins.
    let mut looks = follower(&common, Identity::without_token(), group.as_str().expect("an id"), 5.0).await;
    let mut again = unmeasured(Viewer::among(&common, Identity::without_token()).open().await);
    again.say(r#"{"type":"edit","iso":5}"#).await;
    again.until("done").await;
    again.say(&resume(&key)).await;
    let told = group_message(&mut again, "group").await;
    assert_eq!(
        (
            &told["group"],
            &told["you"],
            &told["control"],
            &told["leaderAway"],
            &told["followers"]
        ),
        (&group, &json!(0), &json!(0), &json!(false), &json!(1))
    );
    while group_message(&mut looks, "group").await["leaderAway"] == true {}
    again.say(r#"{"type":"edit","iso":6}"#).await;
    // The leader's device may still be busy with a measurement: then the follower's session starts the job.
    let job = tokio::select! {
        job = again.step() => job,
        job = looks.step() => job,
    };
    shown_by(&mut again, job, 6.0).await;
    follows(&mut looks, 0, 6.0).await;

    // The leader resumes on a third connection. The second one, still open, no longer leads, and its end does not end the group.
    let mut third = unmeasured(Viewer::among(&common, Identity::without_token()));
    third.say(&resume(&key)).await;
    assert_eq!(group_message(&mut third, "group").await["you"], 0);
    assert_eq!(again.until("left").await["reason"], "you lead it on another connection");
    again.inbox = None;
    third.say(r#"{"type":"leave"}"#).await;
    let reason = looks.until("left").await;
    assert_eq!(reason["reason"], "the leader has ended it, or has not come back");
}

#[tokio::test]
async fn a_leader_is_waited_for_and_not_for_ever() {
    let groups = Groups::with_leader_timeout(Duration::from_millis(600));
    let (ann, bob) = (key_of("ann"), key_of("bob"));
    let leads = groups.lead("0".into(), ann.clone()).expect("a group");
    let follows = groups.join("0", None, true).expect("a follower");
    drop(leads);
    assert!(groups.resume("0", &bob).is_err(), "the key is another user's");
    let wrong = Leader {
        key: "x".repeat(32),
        ..ann.clone()
    };
    assert!(groups.resume("0", &wrong).is_err());
    let leads = groups.resume("0", &ann).expect("it is ann's");
    assert!(leads.has_control());
    // The earlier absence does not count any more.
    tokio::time::sleep(Duration::from_millis(900)).await;
    assert!(groups.join("0", None, true).is_ok());
    drop(leads);
    let gone = async {
        while groups.join("0", None, true).is_ok() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), gone)
        .await
        .expect("it ends");
    assert!(groups.resume("0", &ann).is_err());
    drop(follows);
}

#[tokio::test]
async fn there_are_only_so_many_groups_and_followers() {
    let (groups, ann) = (Groups::default(), key_of("root"));
    let mut leaders: Vec<_> = (0..MAX_GROUPS)
        .map(|i| groups.lead(i.to_string(), ann.clone()).expect("a group"))
        .collect();
    assert!(groups.lead("one more".into(), ann.clone()).is_err());
    let followers: Vec<_> = (0..MAX_FOLLOWERS)
        .map(|_| groups.join("0", None, false).expect("a follower"))
        .collect();
    assert!(groups.join("0", None, false).is_err());
    assert!(groups.join("1", None, false).is_ok(), "of another group");
    drop(followers);
    assert!(groups.join("0", None, false).is_ok());
    leaders.remove(0).leave();
    assert!(groups.join("0", None, false).is_err(), "its leader has gone");
    let last = groups.lead("one more".into(), ann.clone()).expect("a group");
    // Groups whose leaders are away make space; the one whose leader left first ends first.
    drop(leaders.remove(4));
    tokio::time::sleep(Duration::from_millis(2)).await;
    drop(leaders.remove(7));
    assert!(groups.join("5", None, false).is_ok() && groups.join("9", None, false).is_ok());
    let another = groups.lead("another".into(), ann.clone()).expect("a group");
    assert!(groups.join("5", None, false).is_err() && groups.join("9", None, false).is_ok());
    drop((last, another));
}

#[tokio::test]
async fn no_user_leads_all_groups_and_administrators_find_a_place() {
    let groups = Groups::default();
    let lead_all = |user: &str| -> Vec<_> {
        let leader = key_of(user);
        let lead = |i: usize| groups.lead(format!("{user} {i}"), leader.clone()).ok();
        (0..MAX_GROUPS).map_while(lead).collect()
    };
    let mut leaders = lead_all("ann");
    assert_eq!(leaders.len(), MAX_GROUPS_OF_USER);
    for user in ["bob", "eve", "joe", "lea"] {
        leaders.extend(lead_all(user));
    }
    assert!(leaders.len() < MAX_GROUPS && groups.lead("one more".into(), key_of("sue")).is_err());
    // If a user leads too many groups, the one whose leader is away ends.
    drop(leaders.remove(3));
    assert!(groups.join("ann 3", None, false).is_ok());
    let again = groups.lead("again".into(), key_of("ann")).expect("a group");
    assert!(groups.join("ann 3", None, false).is_err());
    leaders.push(again);
    leaders.extend(lead_all("root"));
    assert_eq!(leaders.len(), MAX_GROUPS);
}
