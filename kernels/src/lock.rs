//! Locks. They survive a panic, because what they guard is complete after each change. That of a kernel is held while its launch is
//! enqueued, the others for a moment; none is held in a pause of a job.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, even a poisoned one.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
