//! Identifies an edit in the server's log.

use std::fmt;

use tracing::Instrument;

use crate::service::TRACE;

/// Id of a viewer's connection; random, so that ids of two runs of the server differ too.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionId(u32);

impl ConnectionId {
    pub(super) fn random() -> Self {
        // If the system has no random numbers, all connections share one id. That is harmless, because traces only help to read the log.
        Self(getrandom::u32().unwrap_or(0))
    }

    /// Returns the trace of a generation.
    pub(super) fn trace(self, generation: u32) -> Trace {
        Trace(self, generation)
    }
}

/// Id of an edit in `done` and in the log: 16 hexadecimal digits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trace(ConnectionId, u32);

impl Trace {
    /// Returns a future whose log lines have the trace, those of the device included.
    pub(super) fn follow<F: Future>(self, work: F) -> impl Future<Output = F::Output> {
        let span = tracing::info_span!("edit", trace = %self);
        TRACE.scope(self.to_string(), work.instrument(span))
    }
}

impl fmt::Display for Trace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(ConnectionId(connection), generation) = self;
        write!(f, "{connection:08x}{generation:08x}")
    }
}

#[cfg(test)]
mod tests {
    use super::ConnectionId;

    #[test]
    fn a_trace_is_16_digits_of_connection_and_generation() {
        assert_eq!(ConnectionId(0xab).trace(258).to_string(), "000000ab00000102");
    }
}
