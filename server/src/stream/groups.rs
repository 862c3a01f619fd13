//! Groups: the followers see the surfaces and the camera of the member in control.
//!
//! A group has a leader, who has started it, and followers. One member has control, at first the leader. The volume, views and camera of
//! that member are broadcast to the others; only the newest state is kept. When the leader leaves, the group ends. If the leader's
//! connection is lost, the group waits for the leader, who resumes with a secret key.

mod first_steps;
mod leader;

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

pub(super) use first_steps::FirstStep;
use first_steps::FirstSteps;
#[cfg(test)]
pub(super) use first_steps::LONGEST_WAIT;
use isopeel_view::{CameraJson, View};
use isopeel_volumes::VolumeStep;
use leader::LEADER_TIMEOUT;
pub(super) use leader::Leader;

use crate::access::{NoSeat, Seat, SeatLimits, Seats};
use crate::metrics;
use crate::wire::group::{Follower, LedSurface, Pose};
use crate::wire::messages::ServerMessage;

/// Maximum number of groups: one for every 16 viewers that the server admits.
pub(super) const MAX_GROUPS: usize = 64;
/// Maximum number of groups that one user may lead at a time.
pub(super) const MAX_GROUPS_OF_USER: usize = MAX_GROUPS / 4;
const SEATS: SeatLimits = SeatLimits {
    what: "groups",
    all: MAX_GROUPS,
    of_user: MAX_GROUPS_OF_USER,
    of_address: MAX_GROUPS / 2,
    reserve: MAX_GROUPS / 16,
};
/// Maximum number of followers of a group: enough for a lecture, and fewer than the viewers that the server admits.
pub(super) const MAX_FOLLOWERS: usize = 1000;
/// Maximum lifetime of a group, so that a forgotten group ends.
const MAX_AGE: Duration = Duration::from_secs(12 * 3600);

/// Maximum number of followers that are listed for the leader. Followers who ask for control come first.
const MAX_LISTED: usize = 32;

/// Minimum interval between two poses that are sent to a follower: short enough for smooth motion.
const POSE_INTERVAL: Duration = Duration::from_millis(50);
/// The interval between poses is at least this time multiplied by the number of followers, so that all followers together get at most 5,000
/// poses a second.
const POSE_INTERVAL_PER_FOLLOWER: Duration = Duration::from_micros(200);
/// Minimum interval between two messages to a member that list the members of the group.
const MEMBERS_INTERVAL: Duration = Duration::from_millis(250);

/// Number of the leader as a member. Followers have numbers from 1.
const LEADER: u32 = 0;

/// All groups, by their ids. Clones share them.
#[derive(Clone)]
pub(super) struct Groups {
    by_id: Arc<Mutex<HashMap<String, GroupEntry>>>,
    seats: Seats,
    /// How long a group waits for a leader whose connection was lost.
    leader_timeout: Duration,
}

impl Default for Groups {
    fn default() -> Self {
        Self::with_leader_timeout(LEADER_TIMEOUT)
    }
}

/// A group and its seat, which is freed when the entry is removed.
struct GroupEntry {
    group: Weak<Group>,
    _seat: Seat,
}

struct Group {
    id: String,
    leader: Leader,
    /// Token of the leader's newest connection. Cancelled when the leader resumes on another one.
    connection: Mutex<CancellationToken>,
    scene: watch::Sender<Option<Arc<Scene>>>,
    pose: watch::Sender<Option<Arc<Pose>>>,
    /// Camera for which the surfaces are made.
    camera: watch::Sender<Option<CameraJson>>,
    members: watch::Sender<Members>,
    first_steps: FirstSteps,
    expires: Instant,
    ended: CancellationToken,
}

/// The open volume and the shown surfaces: the number and view of each.
#[derive(Debug)]
pub(super) struct Scene {
    pub volume: VolumeStep,
    pub surfaces: Vec<(u8, View)>,
    /// The message for followers, serialised once for all of them.
    message: OnceLock<String>,
}

#[derive(Debug, Default)]
struct Members {
    /// Number of the member in control.
    control: u32,
    followers: BTreeMap<u32, FollowerState>,
    /// Number of the follower who joined last.
    last_number: u32,
    /// When the leader's connection was lost; `None` while the leader is connected.
    away_since: Option<Instant>,
}

#[derive(Debug)]
struct FollowerState {
    name: Option<String>,
    asks_control: bool,
    may_edit: bool,
}

/// Why a request about a group was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum GroupError {
    #[error("{0}")]
    TooMany(NoSeat),
    #[error("there is no such group, or it has ended: ask for a new link")]
    Unknown,
    #[error("the group has {MAX_FOLLOWERS} followers")]
    Full,
    #[error(
        "control can be given only by the leader, to a follower who asks for it, or given back to the leader, which is number 0"
    )]
    MayNotGive,
    #[error("another member of the group has control, expected `ask-control` or `leave` first")]
    NotInControl,
    #[error("this viewer is in no group, expected `lead` or `join` first")]
    NoMember,
}

impl GroupError {
    pub(super) fn code(self) -> &'static str {
        match self {
            Self::TooMany(_) => "busy",
            Self::Unknown => "unknown-group",
            Self::Full => "group-full",
            Self::MayNotGive | Self::NotInControl => "not-in-control",
            Self::NoMember => "no-group",
        }
    }
}

/// An event in a group.
#[derive(Debug, PartialEq)]
pub(super) enum GroupEvent {
    Scene,
    Pose(Arc<Pose>),
    Camera,
    Members,
    /// Why the group has ended.
    Ended(&'static str),
}

/// A viewer's membership of a group. Dropping the membership takes the viewer out of the group. If the leader's membership is dropped
/// without [`Member::leave`], the group waits for the leader.
pub(super) struct Member {
    /// Token of the viewer's connection. The token of a leader is cancelled when the leader resumes on another connection.
    connection: CancellationToken,
    /// Whether the viewer has left for good, so that the group does not wait for the viewer.
    has_left: bool,
    group: Arc<Group>,
    groups: Groups,
    number: u32,
    scene: watch::Receiver<Option<Arc<Scene>>>,
    pose: watch::Receiver<Option<Arc<Pose>>>,
    camera: watch::Receiver<Option<CameraJson>>,
    members: watch::Receiver<Members>,
    pose_due: Instant,
    camera_due: Instant,
    members_due: Instant,
}

impl Groups {
    pub(super) fn with_leader_timeout(leader_timeout: Duration) -> Self {
        Self {
            by_id: Arc::default(),
            seats: Seats::new(SEATS),
            leader_timeout,
        }
    }

    /// Locks the map of groups. Ignores poisoning: a panic leaves nothing half updated.
    fn lock(&self) -> MutexGuard<'_, HashMap<String, GroupEntry>> {
        self.by_id.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a group. `id` must be random, because it is the only secret that a viewer needs to join.
    ///
    /// # Errors
    /// [`GroupError::TooMany`] if there is no seat for another group.
    pub(super) fn lead(&self, id: String, leader: Leader) -> Result<Member, GroupError> {
        let seat = self.seat_for(&leader)?;
        let connection = CancellationToken::new();
        let group = Arc::new(Group {
            id: id.clone(),
            leader,
            connection: Mutex::new(connection.clone()),
            scene: watch::Sender::new(None),
            pose: watch::Sender::new(None),
            camera: watch::Sender::new(None),
            members: watch::Sender::new(Members::default()),
            first_steps: FirstSteps::default(),
            expires: Instant::now() + MAX_AGE,
            ended: CancellationToken::new(),
        });
        let entry = GroupEntry {
            group: Arc::downgrade(&group),
            _seat: seat,
        };
        let mut groups = self.lock();
        groups.insert(id, entry);
        metrics::groups(groups.len());
        drop(groups);
        Ok(Member::new(group, self.clone(), LEADER, connection))
    }

    /// Ends a group for all of its members.
    fn end(&self, group: &Group) {
        group.ended.cancel();
        let mut groups = self.lock();
        groups.remove(&group.id);
        metrics::groups(groups.len());
    }

    fn group(&self, id: &str) -> Option<Arc<Group>> {
        self.lock().get(id)?.group.upgrade()
    }

    /// Joins a group as a follower. `may_edit`: whether the follower can be given control.
    ///
    /// # Errors
    /// [`GroupError::Unknown`], or [`GroupError::Full`].
    pub(super) fn join(&self, id: &str, name: Option<String>, may_edit: bool) -> Result<Member, GroupError> {
        let group = self.group(id).filter(|group| !group.ended.is_cancelled());
        let group = group.ok_or(GroupError::Unknown)?;
        let mut number = None;
        group.members.send_if_modified(|members| {
            if members.followers.len() >= MAX_FOLLOWERS {
                return false;
            }
            members.last_number += 1;
            number = Some(members.last_number);
            let follower = FollowerState {
                name,
                asks_control: false,
                may_edit,
            };
            members.followers.insert(members.last_number, follower);
            true
        });
        let number = number.ok_or(GroupError::Full)?;
        metrics::follower(1.0);
        Ok(Member::new(group, self.clone(), number, CancellationToken::new()))
    }
}

impl Group {
    /// Locks the token of the leader's newest connection. Ignores poisoning, as for the map of groups.
    fn lock_connection(&self) -> MutexGuard<'_, CancellationToken> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Member {
    fn new(group: Arc<Group>, groups: Groups, number: u32, connection: CancellationToken) -> Self {
        let (mut scene, mut pose) = (group.scene.subscribe(), group.pose.subscribe());
        let mut members = group.members.subscribe();
        // A viewer who joins has not received the current values, so they count as changed.
        scene.mark_changed();
        pose.mark_changed();
        members.mark_changed();
        Self {
            connection,
            has_left: false,
            number,
            scene,
            pose,
            camera: group.camera.subscribe(),
            members,
            group,
            groups,
            pose_due: Instant::now(),
            camera_due: Instant::now(),
            members_due: Instant::now(),
        }
    }

    /// Leaves for good. If this is the leader, the group ends.
    pub(super) fn leave(mut self) {
        self.has_left = true;
    }

    /// Whether this member has control. False for a leader who has resumed on another connection.
    pub(super) fn has_control(&self) -> bool {
        !self.connection.is_cancelled() && self.members.borrow().control == self.number
    }

    /// Returns the number of followers. A follower that has control counts too.
    pub(super) fn follower_count(&self) -> u32 {
        self.members.borrow().followers.len() as u32
    }

    /// Waits for the next event. Scenes and poses are events of members without control only, because the member in control sends them.
    async fn next_event(&mut self) -> GroupEvent {
        let is_following = !self.has_control();
        tokio::select! {
            () = self.group.ended.cancelled() => GroupEvent::Ended("the leader has ended it, or has not come back"),
            () = self.connection.cancelled() => GroupEvent::Ended("you lead it on another connection"),
            () = sleep_until(self.group.expires) => GroupEvent::Ended("it is 12 hours old"),
            Ok(()) = self.scene.changed(), if is_following => GroupEvent::Scene,
            Ok(()) = changed_after(self.pose_due, &mut self.pose), if is_following => {
                self.pose_due = Instant::now() + self.pose_interval();
                GroupEvent::Pose(self.pose.borrow_and_update().clone().unwrap_or_default())
            }
            Ok(()) = changed_after(self.camera_due, &mut self.camera), if is_following => {
                self.camera_due = Instant::now() + self.pose_interval();
                GroupEvent::Camera
            }
            Ok(()) = changed_after(self.members_due, &mut self.members) => {
                self.members_due = Instant::now() + MEMBERS_INTERVAL;
                GroupEvent::Members
            }
        }
    }

    /// Minimum interval between two poses or cameras.
    fn pose_interval(&self) -> Duration {
        POSE_INTERVAL.max(POSE_INTERVAL_PER_FOLLOWER * self.follower_count())
    }

    /// Returns the camera of the member in control, as far as it was announced; `None` if that is this member.
    pub(super) fn led_camera(&self) -> Option<CameraJson> {
        let camera = self.camera.borrow().clone();
        camera.filter(|_| !self.has_control())
    }

    /// Broadcasts the camera for which surfaces are made, if this member has control.
    pub(super) fn broadcast_camera(&self, camera: Option<CameraJson>) {
        if self.has_control() {
            self.group.camera.send_if_modified(|current| {
                let is_new = *current != camera;
                *current = camera;
                is_new
            });
        }
    }

    /// Returns the scene of the member in control; `None` if that is this member.
    pub(super) fn scene(&mut self) -> Option<Arc<Scene>> {
        let scene = self.scene.borrow_and_update().clone();
        scene.filter(|_| !self.has_control())
    }

    /// Broadcasts the scene that is shown to this member, if this member has control.
    pub(super) fn broadcast_scene(&self, scene: Scene) {
        if self.has_control() {
            self.group.scene.send_if_modified(|current| {
                let is_new = current.as_ref().is_none_or(|current| !current.is_same(&scene));
                if is_new {
                    *current = Some(Arc::new(scene));
                }
                is_new
            });
        }
    }

    /// Broadcasts the pose of the member in control. Fields that `pose` leaves out keep their values.
    ///
    /// # Errors
    /// [`GroupError::NotInControl`] if this member has no control.
    pub(super) fn broadcast_pose(&self, pose: Pose) -> Result<(), GroupError> {
        if !self.has_control() {
            return Err(GroupError::NotInControl);
        }
        self.group.pose.send_modify(|current| {
            let before = current.as_deref().cloned().unwrap_or_default();
            *current = Some(Arc::new(Pose {
                camera: pose.camera.or(before.camera),
                page: pose.page.or(before.page),
            }));
        });
        Ok(())
    }

    /// Requests control, or withdraws the request.
    pub(super) fn request_control(&self, asks: bool) {
        self.group.members.send_if_modified(|members| {
            let Some(follower) = members.followers.get_mut(&self.number) else {
                return false;
            };
            std::mem::replace(&mut follower.asks_control, asks) != asks
        });
    }

    /// Gives control to the follower `to`, who must have asked for it and may edit, or back to the leader.
    ///
    /// # Errors
    /// [`GroupError::MayNotGive`] if this member may not give control to `to`.
    pub(super) fn give_control(&self, to: u32) -> Result<(), GroupError> {
        let mut is_allowed = false;
        self.group.members.send_if_modified(|members| {
            is_allowed = match members.followers.get_mut(&to) {
                Some(follower) if self.number == LEADER && follower.asks_control && follower.may_edit => {
                    follower.asks_control = false;
                    true
                }
                Some(_) => false,
                None => to == LEADER && (self.number == LEADER || members.control == self.number),
            };
            is_allowed && std::mem::replace(&mut members.control, to) != to
        });
        is_allowed.then_some(()).ok_or(GroupError::MayNotGive)
    }

    /// Returns the message for this member about the members of the group.
    pub(super) fn members_message(&self) -> ServerMessage {
        let members = self.members.borrow();
        let mut people: Vec<Follower> = Vec::new();
        if self.number == LEADER {
            people.extend(members.followers.iter().map(|(number, follower)| Follower {
                number: *number,
                name: follower.name.clone(),
                asks: follower.asks_control,
            }));
            people.sort_by_key(|follower| (!follower.asks, follower.name.is_none(), follower.number));
            people.truncate(MAX_LISTED);
        }
        ServerMessage::Group {
            group: self.group.id.clone(),
            you: self.number,
            control: members.control,
            followers: members.followers.len() as u32,
            asks: members
                .followers
                .get(&self.number)
                .is_some_and(|follower| follower.asks_control),
            leader_away: members.away_since.is_some(),
            key: (self.number == LEADER).then(|| self.group.leader.key.clone()),
            people,
        }
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        if self.number == LEADER {
            return self.drop_leader();
        }
        metrics::follower(-1.0);
        self.group.members.send_modify(|members| {
            members.followers.remove(&self.number);
            if members.control == self.number {
                members.control = LEADER;
            }
        });
    }
}

impl Scene {
    pub(super) fn new(volume: VolumeStep, surfaces: Vec<(u8, View)>) -> Self {
        Self {
            volume,
            surfaces,
            message: OnceLock::new(),
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        self.volume.key() == other.volume.key() && self.surfaces == other.surfaces
    }

    /// Returns the message about this scene for followers.
    pub(super) fn message(&self) -> &str {
        self.message.get_or_init(|| {
            let surfaces = self.surfaces.iter().map(|(surface, view)| LedSurface {
                surface: *surface,
                edit: view.to_edit(),
            });
            let message = ServerMessage::Led {
                volume: self.volume.dataset().id.clone(),
                step: self.volume.step(),
                surfaces: surfaces.collect(),
            };
            message.to_json()
        })
    }
}

/// Resolves when the watched value has changed, but not before `due`.
async fn changed_after<T>(due: Instant, value: &mut watch::Receiver<T>) -> Result<(), watch::error::RecvError> {
    sleep_until(due).await;
    value.changed().await
}

/// Waits for the next event of the group; for ever if the viewer is in none.
pub(super) async fn next_group_event(member: &mut Option<Member>) -> GroupEvent {
    match member {
        Some(member) => member.next_event().await,
        None => std::future::pending().await,
    }
}
