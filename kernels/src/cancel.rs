//! Work that its caller may no longer want.

use crate::{Error, Result};

/// Cancellation, polled between stages and between the launches of what takes long: every 50 ms or so.
pub trait Cancel {
    /// True when the result is no longer wanted. Others may use the engine before this returns.
    fn cancelled(&self) -> bool;
}

/// Never cancels.
pub struct Never;

impl Cancel for Never {
    fn cancelled(&self) -> bool {
        false
    }
}

/// Stops between two stages when the result is no longer wanted.
pub(crate) fn check(cancel: &dyn Cancel) -> Result<()> {
    if cancel.cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}
