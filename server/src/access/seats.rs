//! Limits the number of concurrent viewers, groups and event streams. Each of them occupies a seat. A single user or address cannot occupy
//! all seats, and some seats are reserved for administrators.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::Identity;
use super::role::Role;

/// Limits of one kind of seats.
#[derive(Clone, Copy, Debug)]
pub struct SeatLimits {
    /// Name of this kind in the plural, for messages.
    pub what: &'static str,
    /// Number of all seats, including the reserve.
    pub all: usize,
    /// Maximum number of seats of one user. Administrators are exempt.
    pub of_user: usize,
    /// Maximum number of seats of all users at one address. Administrators are exempt.
    pub of_address: usize,
    /// Number of seats that are reserved for administrators.
    pub reserve: usize,
}

/// The user of a seat.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Occupant {
    /// Name of the user.
    pub user: Arc<str>,
    /// Address of the user, if it is known. An IPv6 address is replaced by its /64 network.
    pub address: Option<IpAddr>,
    /// Whether the user is an administrator, who is exempt from the limits per user and per address.
    pub is_admin: bool,
}

impl From<&Identity> for Occupant {
    fn from(who: &Identity) -> Self {
        Self {
            user: who.user().into(),
            address: who.address(),
            is_admin: who.may(Role::Admin),
        }
    }
}

/// A limit of seats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Share {
    /// The limit per user.
    User,
    /// The limit per address.
    Address,
    /// The limit of all users. It excludes the reserve, unless the user is an administrator.
    All,
}

/// A seat was refused, because a limit is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{taken} {what} {}, expected fewer than {limit}: end one of them, or try again later",
    match share { Share::User => "of this user", Share::Address => "of this address", Share::All => "of all users" }
)]
pub struct NoSeat {
    what: &'static str,
    taken: usize,
    limit: usize,
    /// The limit that is reached.
    pub share: Share,
}

/// The seats of one kind. Clones share them.
#[derive(Clone, Debug)]
pub struct Seats(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    limits: SeatLimits,
    taken: Mutex<Taken>,
}

/// Numbers of occupied seats.
#[derive(Debug, Default)]
struct Taken {
    total: usize,
    by_user: HashMap<Arc<str>, usize>,
    by_address: HashMap<IpAddr, usize>,
}

/// Guard of an occupied seat. Dropping the guard frees the seat.
#[derive(Debug)]
pub struct Seat {
    seats: Seats,
    occupant: Occupant,
}

impl Seats {
    /// Creates free seats with these limits.
    pub fn new(limits: SeatLimits) -> Self {
        let taken = Mutex::default();
        Self(Arc::new(Shared { limits, taken }))
    }

    /// Returns the number of occupied seats.
    pub fn taken(&self) -> usize {
        self.lock().total
    }

    /// Occupies a seat.
    ///
    /// # Errors
    /// The limit of all users, of this user or of this address is reached.
    pub fn acquire(&self, occupant: Occupant) -> Result<Seat, NoSeat> {
        let mut taken = self.lock();
        taken.admit(&self.0.limits, &occupant)?;
        taken.total += 1;
        *taken.by_user.entry(Arc::clone(&occupant.user)).or_default() += 1;
        if let Some(address) = occupant.address {
            *taken.by_address.entry(address).or_default() += 1;
        }
        drop(taken);
        let seats = self.clone();
        Ok(Seat { seats, occupant })
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Taken {
    /// Checks the limits for a new occupant.
    fn admit(&self, limits: &SeatLimits, occupant: &Occupant) -> Result<(), NoSeat> {
        let all = (Share::All, self.total, limits.all);
        let of_user = self.by_user.get(&occupant.user).copied().unwrap_or_default();
        let of_address = occupant.address.and_then(|address| self.by_address.get(&address));
        let for_others = [
            (Share::User, of_user, limits.of_user),
            (
                Share::Address,
                of_address.copied().unwrap_or_default(),
                limits.of_address,
            ),
            (Share::All, self.total, limits.all - limits.reserve),
        ];
        let checked = if occupant.is_admin { &[all][..] } else { &for_others };
        match checked.iter().find(|(_, taken, limit)| taken >= limit) {
            None => Ok(()),
            Some(&(share, taken, limit)) => Err(NoSeat {
                what: limits.what,
                taken,
                limit,
                share,
            }),
        }
    }
}

/// Decrements the count of a key, and removes the key at 0.
fn release<K: Hash + Eq>(counts: &mut HashMap<K, usize>, key: &K) {
    if let Some(count) = counts.get_mut(key) {
        *count -= 1;
        if *count == 0 {
            counts.remove(key);
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut taken = self.seats.lock();
        taken.total -= 1;
        release(&mut taken.by_user, &self.occupant.user);
        if let Some(address) = &self.occupant.address {
            release(&mut taken.by_address, address);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: SeatLimits = SeatLimits {
        what: "seats",
        all: 8,
        of_user: 3,
        of_address: 5,
        reserve: 2,
    };

    fn take_all(seats: &Seats, user: &str, address: u8, is_admin: bool) -> Vec<Seat> {
        let occupant = Occupant {
            user: user.into(),
            address: Some([192, 0, 2, address].into()),
            is_admin,
        };
        std::iter::from_fn(|| seats.acquire(occupant.clone()).ok()).collect()
    }

    fn refused(seats: &Seats, user: &str, address: u8) -> String {
        let occupant = Occupant {
            user: user.into(),
            address: Some([192, 0, 2, address].into()),
            is_admin: false,
        };
        seats.acquire(occupant).expect_err("no seat").to_string()
    }

    #[test]
    fn no_user_takes_all_places_and_administrators_find_one() {
        let seats = Seats::new(LIMITS);
        let (ann, bob) = (take_all(&seats, "ann", 1, false), take_all(&seats, "bob", 2, false));
        assert_eq!((ann.len(), bob.len()), (3, 3));
        assert!(refused(&seats, "ann", 3).starts_with("3 seats of this user, expected fewer than 3"));
        assert!(refused(&seats, "eve", 3).starts_with("6 seats of all users, expected fewer than 6"));
        let root = take_all(&seats, "root", 1, true);
        assert_eq!((root.len(), seats.taken()), (2, 8));
        drop(ann);
        let eve = take_all(&seats, "eve", 3, false);
        assert_eq!(eve.len(), 1, "two are left to administrators, as many as root has");
        drop((bob, root, eve));
        assert_eq!(seats.taken(), 0);
        let taken = seats.lock();
        assert!(taken.by_user.is_empty() && taken.by_address.is_empty());
    }

    #[test]
    fn users_of_one_address_leave_places_to_others() {
        let seats = Seats::new(LIMITS);
        let (ann, bob) = (take_all(&seats, "ann", 1, false), take_all(&seats, "bob", 1, false));
        assert_eq!((ann.len(), bob.len()), (3, 2));
        assert!(refused(&seats, "eve", 1).starts_with("5 seats of this address, expected fewer than 5"));
        assert_eq!(take_all(&seats, "eve", 2, false).len(), 1);
        drop(ann);
        assert_eq!(take_all(&seats, "joe", 1, false).len(), 3);
    }
}
