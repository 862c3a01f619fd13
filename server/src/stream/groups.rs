//! Groups: the followers see the surfaces and the camera of the member in control.
//!
//! A group has a leader, who has started it, and followers. One member has control, at first the leader. The volume, edits and camera of
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
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
pub(super) use leader::Leader;
use leader::PAUSE;

use crate::access::{NoSeat, Seat, SeatLimits, Seats};
use crate::metrics;
use crate::wire::group::{Follower, LedSurface, Pose};
use crate::wire::messages::ServerMessage;

/// Maximum groups: one for every 16 of the maximum viewers.
pub(super) const MAX_GROUPS: usize = 64;
/// Maximum groups that one user may lead at a time.
pub(super) const MAX_GROUPS_OF_USER: usize = MAX_GROUPS / 4;
const SEATS: SeatLimits = SeatLimits {
    what: "groups",
    all: MAX_GROUPS,
    of_user: MAX_GROUPS_OF_USER,
    of_address: MAX_GROUPS / 2,
    reserve: MAX_GROUPS / 16,
};
/// Maximum followers of a group: enough for a lecture, with some of the server's viewers left.
pub(super) const MAX_FOLLOWERS: usize = 1000;
/// Lifetime of a group, so that a forgotten one ends.
const MAX_AGE: Duration = Duration::from_secs(12 * 3600);

/// Maximum followers that are listed for the leader. Followers who ask for control come first.
const MAX_LISTED: usize = 32;

/// Minimum interval between two poses that a follower is sent, short enough for a smooth picture.
const POSE_INTERVAL: Duration = Duration::from_millis(50);
/// The interval is at least this multiplied by the number of followers, so that all followers together get at most 5,000 poses a second.
const POSE_INTERVAL_EACH: Duration = Duration::from_micros(200);
/// Minimum interval between two messages that list the members of the group.
const MEMBERS_INTERVAL: Duration = Duration::from_millis(250);

/// Number of the leader.
const LEADER: u32 = 0;

/// All groups, by their ids. Clones share them.
#[derive(Clone)]
pub(super) struct Groups {
    all: Arc<Mutex<HashMap<String, Seated>>>,
    seats: Seats,
    /// How long a group waits for its leader.
    leader_pause: Duration,
}

impl Default for Groups {
    fn default() -> Self {
        Self::with_pause(PAUSE)
    }
}

/// A group with its seat, which is freed when the group is removed from the list.
struct Seated {
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
    members: watch::Sender<Members>,
    first_steps: FirstSteps,
    expires: Instant,
    ended: CancellationToken,
}

/// The open volume and the surfaces shown, with the views in force.
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
    followers: BTreeMap<u32, Followed>,
    last: u32,
    /// When the leader's connection was lost; `None` while the leader is connected.
    away: Option<Instant>,
}

#[derive(Debug)]
struct Followed {
    name: Option<String>,
    asks: bool,
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
    #[error("only the leader gives control, to a follower who asks for it; who has it gives it back, to 0")]
    NotYours,
    #[error("another member of the group has control, expected `ask-control` or `leave` first")]
    NotInControl,
    #[error("in no group, expected `lead` or `join` first")]
    NoMember,
}

impl GroupError {
    pub(super) fn code(self) -> &'static str {
        match self {
            Self::TooMany(_) => "busy",
            Self::Unknown => "unknown-group",
            Self::Full => "group-full",
            Self::NotYours | Self::NotInControl => "not-in-control",
            Self::NoMember => "no-group",
        }
    }
}

/// An event in a group.
#[derive(Debug, PartialEq)]
pub(super) enum GroupEvent {
    Scene,
    Pose(Arc<Pose>),
    Members,
    /// Why the group has ended.
    Ended(&'static str),
}

/// A viewer's membership of a group. Dropping it takes the viewer out of the group. If the leader's is dropped without `leave`, the group
/// waits for the leader.
pub(super) struct Member {
    /// Token of the viewer's connection. If the viewer is the leader, it is cancelled when the leader resumes on another connection.
    connection: CancellationToken,
    /// Whether the viewer has left for good, so that the group does not wait for it.
    has_left: bool,
    group: Arc<Group>,
    groups: Groups,
    number: u32,
    scene: watch::Receiver<Option<Arc<Scene>>>,
    pose: watch::Receiver<Option<Arc<Pose>>>,
    members: watch::Receiver<Members>,
    pose_due: Instant,
    members_due: Instant,
}

impl Groups {
    pub(super) fn with_pause(leader_pause: Duration) -> Self {
        Self {
            all: Arc::default(),
            seats: Seats::new(SEATS),
            leader_pause,
        }
    }

    /// Locks the list. Ignores poisoning: a panic leaves nothing half updated.
    fn all(&self) -> MutexGuard<'_, HashMap<String, Seated>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a group. `id` is random: it is the only secret that a viewer needs to join.
    pub(super) fn lead(&self, id: String, leader: Leader) -> Result<Member, GroupError> {
        let seat = self.seat_for(&leader)?;
        let mut all = self.all();
        let connection = CancellationToken::new();
        let group = Arc::new(Group {
            id: id.clone(),
            leader,
            connection: Mutex::new(connection.clone()),
            scene: watch::Sender::new(None),
            pose: watch::Sender::new(None),
            members: watch::Sender::new(Members::default()),
            first_steps: FirstSteps::default(),
            expires: Instant::now() + MAX_AGE,
            ended: CancellationToken::new(),
        });
        let seated = Seated {
            group: Arc::downgrade(&group),
            _seat: seat,
        };
        all.insert(id, seated);
        metrics::groups(all.len());
        drop(all);
        Ok(Member::new(group, self.clone(), LEADER, connection))
    }

    /// Ends a group for all of its members.
    fn end(&self, group: &Group) {
        group.ended.cancel();
        let mut all = self.all();
        all.remove(&group.id);
        metrics::groups(all.len());
    }

    fn group(&self, id: &str) -> Option<Arc<Group>> {
        self.all().get(id)?.group.upgrade()
    }

    /// Joins a group as a follower.
    pub(super) fn join(&self, id: &str, name: Option<String>, may_edit: bool) -> Result<Member, GroupError> {
        let group = self.group(id);
        let group = group
            .filter(|group| !group.ended.is_cancelled())
            .ok_or(GroupError::Unknown)?;
        let mut number = None;
        group.members.send_if_modified(|members| {
            if members.followers.len() >= MAX_FOLLOWERS {
                return false;
            }
            members.last += 1;
            number = Some(members.last);
            let followed = Followed {
                name,
                asks: false,
                may_edit,
            };
            members.followers.insert(members.last, followed);
            true
        });
        let number = number.ok_or(GroupError::Full)?;
        metrics::follower(1.0);
        Ok(Member::new(group, self.clone(), number, CancellationToken::new()))
    }
}

impl Group {
    /// Locks the token. Ignores poisoning, as for the list of groups.
    fn connection(&self) -> MutexGuard<'_, CancellationToken> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Member {
    fn new(group: Arc<Group>, groups: Groups, number: u32, connection: CancellationToken) -> Self {
        let (mut scene, mut pose) = (group.scene.subscribe(), group.pose.subscribe());
        let mut members = group.members.subscribe();
        // A viewer who joins has not seen the present scene, so it counts as changed.
        scene.mark_changed();
        pose.mark_changed();
        members.mark_changed();
        Self {
            connection,
            has_left: false,
            number,
            scene,
            pose,
            members,
            group,
            groups,
            pose_due: Instant::now(),
            members_due: Instant::now(),
        }
    }

    /// Leaves for good. If this is the leader, the group ends.
    pub(super) fn leave(mut self) {
        self.has_left = true;
    }

    /// Whether this member has control, so that the others follow it.
    pub(super) fn controls(&self) -> bool {
        !self.connection.is_cancelled() && self.members.borrow().control == self.number
    }

    /// The number of followers, whether or not one of them has control.
    pub(super) fn followers(&self) -> u32 {
        self.members.borrow().followers.len() as u32
    }

    /// Waits for the next event. Members without control also get scenes and poses, which the member in control sends.
    async fn event(&mut self) -> GroupEvent {
        let follows = !self.controls();
        tokio::select! {
            () = self.group.ended.cancelled() => GroupEvent::Ended("the leader has ended it, or has not come back"),
            () = self.connection.cancelled() => GroupEvent::Ended("you lead it on another connection"),
            () = sleep_until(self.group.expires) => GroupEvent::Ended("it is 12 hours old"),
            Ok(()) = self.scene.changed(), if follows => GroupEvent::Scene,
            Ok(()) = changed_from(&mut self.pose, self.pose_due), if follows => {
                self.pose_due = Instant::now() + POSE_INTERVAL.max(POSE_INTERVAL_EACH * self.followers());
                GroupEvent::Pose(self.pose.borrow_and_update().clone().unwrap_or_default())
            }
            Ok(()) = changed_from(&mut self.members, self.members_due) => {
                self.members_due = Instant::now() + MEMBERS_INTERVAL;
                GroupEvent::Members
            }
        }
    }

    /// The scene of the member in control; `None` if that is this member.
    pub(super) fn scene(&mut self) -> Option<Arc<Scene>> {
        let scene = self.scene.borrow_and_update().clone();
        scene.filter(|_| !self.controls())
    }

    /// Broadcasts the scene that this member is shown, if it has control.
    pub(super) fn show(&self, scene: Scene) {
        if self.controls() {
            self.group.scene.send_if_modified(|before| {
                let is_new = before.as_ref().is_none_or(|before| !before.is_same(&scene));
                if is_new {
                    *before = Some(Arc::new(scene));
                }
                is_new
            });
        }
    }

    /// Broadcasts the pose of the member in control. Parts that `pose` leaves out keep their values.
    pub(super) fn pose(&self, pose: Pose) -> Result<(), GroupError> {
        if !self.controls() {
            return Err(GroupError::NotInControl);
        }
        self.group.pose.send_modify(|before| {
            let kept = before.as_deref().cloned().unwrap_or_default();
            *before = Some(Arc::new(Pose {
                camera: pose.camera.or(kept.camera),
                page: pose.page.or(kept.page),
            }));
        });
        Ok(())
    }

    /// Requests control, or withdraws the request.
    pub(super) fn ask(&self, asks: bool) {
        self.group.members.send_if_modified(|members| {
            let Some(own) = members.followers.get_mut(&self.number) else {
                return false;
            };
            std::mem::replace(&mut own.asks, asks) != asks
        });
    }

    /// Gives control to a follower who has asked for it and may edit, or back to the leader (0).
    ///
    /// # Errors
    /// [`GroupError::NotYours`] if this member may not give it.
    pub(super) fn give(&self, to: u32) -> Result<(), GroupError> {
        let mut may = false;
        self.group.members.send_if_modified(|members| {
            may = match members.followers.get_mut(&to) {
                Some(follower) if self.number == LEADER && follower.asks && follower.may_edit => {
                    follower.asks = false;
                    true
                }
                Some(_) => false,
                None => to == LEADER && (self.number == LEADER || members.control == self.number),
            };
            may && std::mem::replace(&mut members.control, to) != to
        });
        may.then_some(()).ok_or(GroupError::NotYours)
    }

    /// The message for this member about the members of the group.
    pub(super) fn members(&self) -> ServerMessage {
        let members = self.members.borrow();
        let mut people: Vec<Follower> = Vec::new();
        if self.number == LEADER {
            let all = members.followers.iter().map(|(number, follower)| Follower {
                number: *number,
                name: follower.name.clone(),
                asks: follower.asks,
            });
            people.extend(all);
            people.sort_by_key(|follower| (!follower.asks, follower.name.is_none(), follower.number));
            people.truncate(MAX_LISTED);
        }
        ServerMessage::Group {
            group: self.group.id.clone(),
            you: self.number,
            control: members.control,
            followers: members.followers.len() as u32,
            asks: members.followers.get(&self.number).is_some_and(|own| own.asks),
            leader_away: members.away.is_some(),
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

    /// The message about this scene for followers.
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
async fn changed_from<T>(watched: &mut watch::Receiver<T>, due: Instant) -> Result<(), watch::error::RecvError> {
    sleep_until(due).await;
    watched.changed().await
}

/// Waits for the next event of the group; for ever if the viewer is in none.
pub(super) async fn group_event(member: &mut Option<Member>) -> GroupEvent {
    match member {
        Some(member) => member.event().await,
        None => std::future::pending().await,
    }
}
