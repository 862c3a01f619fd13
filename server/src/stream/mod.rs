//! One viewer: protocol, session, encoder. Normative: `PROTOCOL.md`.

/// Viewers at a time; one more is closed with 4002. Each may hold a queue of encoded frames and one device job.
pub const MAX_VIEWERS: usize = 32;
