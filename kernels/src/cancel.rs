//! Cancellation of work, and its pauses.

use crate::{Error, Result};

/// What long work asks between stages and between the launches of long stages: about every 50 ms.
pub trait Cancel {
    /// Whether the result is no longer wanted.
    fn is_cancelled(&self) -> bool;

    /// Called before each question. Other work may use the engine before this returns.
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
pub fn check(cancel: &dyn Cancel) -> Result<()> {
    cancel.pause();
    if cancel.is_cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}
