//! Limits the number of concurrent operations of a kind, in total and for each user.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::error::UploadError;

/// Slots for concurrent operations.
pub(super) struct Slots {
    /// Free slots.
    free: Arc<Semaphore>,
    /// Maximum number of slots of one user.
    of_user: usize,
    /// Number of slots that each user occupies.
    users: Arc<Mutex<HashMap<String, usize>>>,
}

/// Guard of an occupied slot. Dropping the guard frees the slot.
pub(super) struct Slot {
    _permit: OwnedSemaphorePermit,
    users: Arc<Mutex<HashMap<String, usize>>>,
    user: String,
}

impl Slots {
    pub(super) fn new(total: usize, of_user: usize) -> Self {
        Self {
            free: Arc::new(Semaphore::new(total)),
            of_user,
            users: Arc::default(),
        }
    }

    /// Occupies a slot for a user.
    ///
    /// # Errors
    /// [`UploadError::Busy`] if all slots, or all slots of this user, are occupied.
    pub(super) fn enter(&self, user: &str) -> Result<Slot, UploadError> {
        let permit = Arc::clone(&self.free)
            .try_acquire_owned()
            .map_err(|_| UploadError::Busy)?;
        let mut users = self.users.lock().unwrap_or_else(PoisonError::into_inner);
        let count = users.entry(user.to_owned()).or_default();
        if *count >= self.of_user {
            return Err(UploadError::Busy);
        }
        *count += 1;
        Ok(Slot {
            _permit: permit,
            users: Arc::clone(&self.users),
            user: user.to_owned(),
        })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut users = self.users.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = users.get_mut(&self.user) {
            *count -= 1;
            if *count == 0 {
                users.remove(&self.user);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_leaves_slots_to_others() {
        let slots = Slots::new(3, 2);
        let is_full = |user: &str| matches!(slots.enter(user), Err(UploadError::Busy));
        let (first, _second) = (slots.enter("ann").unwrap(), slots.enter("ann").unwrap());
        assert!(is_full("ann"));
        let bob = slots.enter("bob").unwrap();
        assert!(is_full("bob"), "three in all");
        drop((first, bob));
        let _third = slots.enter("ann").unwrap();
        assert!(is_full("ann") && !is_full("bob"));
    }
}
