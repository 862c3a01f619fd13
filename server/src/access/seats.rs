//! Seats, whose number is limited: viewers, groups, streams of events. No user takes all of them, and some are left to administrators.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::Identity;
use super::role::Role;

/// How many there are.
#[derive(Clone, Copy, Debug)]
pub struct SeatLimits {
    /// All of them.
    pub all: usize,
    /// Those that one user may have at a time, administrators excepted.
    pub of_user: usize,
    /// Those that are left to administrators.
    pub reserve: usize,
}

/// Seats. Clones are of the same.
#[derive(Clone, Debug)]
pub struct Seats(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    limits: SeatLimits,
    taken: Mutex<Taken>,
}

/// Seats that are taken.
#[derive(Debug, Default)]
struct Taken {
    total: usize,
    by_user: HashMap<Arc<str>, usize>,
}

/// A seat; dropped, it is free again.
#[derive(Debug)]
pub struct Seat {
    seats: Seats,
    user: Arc<str>,
}

impl Seats {
    /// Seats within these limits, all of them free.
    pub fn new(limits: SeatLimits) -> Self {
        let taken = Mutex::default();
        Self(Arc::new(Shared { limits, taken }))
    }

    /// How many are taken.
    pub fn taken(&self) -> usize {
        self.lock().total
    }

    /// A seat for a user; `None` if all of them are taken, or all that this user may have.
    pub fn take(&self, who: &Identity) -> Option<Seat> {
        self.take_for(who.user(), who.may(Role::Admin))
    }

    fn take_for(&self, user: &str, is_admin: bool) -> Option<Seat> {
        let SeatLimits { all, of_user, reserve } = self.0.limits;
        let mut taken = self.lock();
        let (total, own) = (taken.total, taken.by_user.get(user).copied().unwrap_or_default());
        let fits = match is_admin {
            true => total < all,
            false => total + reserve < all && own < of_user,
        };
        fits.then(|| {
            let user = Arc::<str>::from(user);
            taken.total += 1;
            *taken.by_user.entry(Arc::clone(&user)).or_default() += 1;
            drop(taken);
            Seat {
                seats: self.clone(),
                user,
            }
        })
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut taken = self.seats.lock();
        taken.total -= 1;
        if let Some(count) = taken.by_user.get_mut(&self.user) {
            *count -= 1;
            if *count == 0 {
                taken.by_user.remove(&self.user);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_user_takes_all_places_and_administrators_find_one() {
        let seats = Seats::new(SeatLimits {
            all: 8,
            of_user: 4,
            reserve: 2,
        });
        let take_all =
            |user: &str, is_admin| -> Vec<Seat> { std::iter::from_fn(|| seats.take_for(user, is_admin)).collect() };
        let ann = take_all("ann", false);
        let bob = take_all("bob", false);
        assert_eq!((ann.len(), bob.len()), (4, 2));
        assert!(seats.take_for("eve", false).is_none());
        let root = take_all("root", true);
        assert_eq!((root.len(), seats.taken()), (2, 8));
        drop(ann);
        assert_eq!(
            take_all("eve", false).len(),
            2,
            "six are taken then, and two are left to administrators"
        );
        drop((bob, root));
        assert_eq!(seats.taken(), 0);
    }
}
