//! The leader of a group. If the leader's connection is lost, the group waits for the leader, who authenticates with a key.

use std::sync::Arc;
use std::time::Duration;

use subtle::ConstantTimeEq;
use tokio::time::{Instant, sleep};
use tokio_util::sync::CancellationToken;

use super::{Group, GroupError, Groups, LEADER, Member};
use crate::access::{Occupant, Seat, Share};

/// How long a group waits for a leader whose connection was lost. A page reconnects at least every eight seconds, so it has several tries.
pub(super) const LEADER_TIMEOUT: Duration = Duration::from_secs(30);

/// The leader of a group, independent of the connection.
#[derive(Clone, Debug)]
pub(in crate::stream) struct Leader {
    pub who: Occupant,
    /// Random secret that only the leader knows. A connection of the same user that has the key may resume the lead.
    pub key: String,
}

impl Groups {
    /// Takes a seat for a group of this leader. If no seat is free, ends one of the groups that share the exceeded limit, if the leader of
    /// one is away: the group whose leader has been away longest.
    ///
    /// # Errors
    /// [`GroupError::TooMany`] if no seat becomes free.
    pub(super) fn seat_for(&self, leader: &Leader) -> Result<Seat, GroupError> {
        let no_seat = match self.seats.acquire(leader.who.clone()) {
            Ok(seat) => return Ok(seat),
            Err(no_seat) => no_seat,
        };
        let groups: Vec<Arc<Group>> = self.lock().values().filter_map(|entry| entry.group.upgrade()).collect();
        let shares_limit = |other: &Occupant| match no_seat.share {
            Share::User => other.user == leader.who.user,
            Share::Address => other.address == leader.who.address,
            Share::All => true,
        };
        let away = groups
            .iter()
            .filter(|group| shares_limit(&group.leader.who))
            .filter_map(|group| Some((group.members.borrow().away_since?, group)));
        if let Some((_, group)) = away.min_by_key(|(since, _)| *since) {
            self.end(group);
        }
        self.seats.acquire(leader.who.clone()).map_err(GroupError::TooMany)
    }

    /// Resumes the lead of a group on a new connection.
    ///
    /// # Errors
    /// [`GroupError::Unknown`] if the group has ended, or `leader` is not its leader.
    pub(in crate::stream) fn resume(&self, id: &str, leader: &Leader) -> Result<Member, GroupError> {
        let group = self.group(id);
        let is_leader = |group: &Arc<Group>| {
            let has_key: bool = group.leader.key.as_bytes().ct_eq(leader.key.as_bytes()).into();
            has_key && group.leader.who.user == leader.who.user && !group.ended.is_cancelled()
        };
        let group = group.filter(is_leader).ok_or(GroupError::Unknown)?;
        let connection = CancellationToken::new();
        {
            let mut newest = group.lock_connection();
            newest.cancel();
            *newest = connection.clone();
            group
                .members
                .send_if_modified(|members| members.away_since.take().is_some());
        }
        Ok(Member::new(group, self.clone(), LEADER, connection))
    }
}

impl Member {
    /// Ends the group if the leader has left. If the leader's connection was lost, the group waits for the leader.
    pub(super) fn drop_leader(&self) {
        let (group, groups, connection) = (&self.group, &self.groups, &self.connection);
        let newest = group.lock_connection();
        if connection.is_cancelled() {
            return;
        }
        let runtime = tokio::runtime::Handle::try_current();
        let (false, Ok(runtime)) = (self.has_left, runtime) else {
            return groups.end(group);
        };
        group
            .members
            .send_modify(|members| members.away_since = Some(Instant::now()));
        drop(newest);
        let (group, groups, connection) = (Arc::clone(group), groups.clone(), connection.clone());
        // At most one such task per group: it ends with the group, or when the leader is back.
        runtime.spawn(async move {
            tokio::select! {
                () = connection.cancelled() => {}
                () = group.ended.cancelled() => {}
                () = sleep(groups.leader_timeout) => {
                    let newest = group.lock_connection();
                    if !connection.is_cancelled() {
                        groups.end(&group);
                    }
                    drop(newest);
                }
            }
        });
    }
}
