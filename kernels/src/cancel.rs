//! Cancellation of work.

use crate::{Error, Result};

/// Cancellation, polled between stages and between the launches of long stages: about every 50 ms.
pub trait Cancel {
    /// Returns true if the result is no longer wanted. The implementation may yield the engine to other jobs before it returns.
    fn cancelled(&self) -> bool;
}

/// Never cancels.
pub struct Never;

impl Cancel for Never {
    fn cancelled(&self) -> bool {
        false
    }
}

/// Returns [`Error::Cancelled`] if the result is no longer wanted.
pub(crate) fn check(cancel: &dyn Cancel) -> Result<()> {
    if cancel.cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}
