//! Cancellation and pauses of long work.

use crate::{Error, Result};

/// Cancellation and pauses of long work. [`check_cancelled`] calls `pause`, then `is_cancelled`, about every 50 ms: between stages, and
/// between the launches of long ones.
pub trait Cancel {
    /// Whether the result is no longer wanted.
    fn is_cancelled(&self) -> bool;

    /// Lets other work use the engine before it returns.
    fn pause(&self) {}
}

/// Never cancels.
pub struct Never;

impl Cancel for Never {
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Pauses, then returns [`Error::Cancelled`] if the result is no longer wanted.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn check_cancelled(cancel: &dyn Cancel) -> Result<()> {
    cancel.pause();
    if cancel.is_cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}
