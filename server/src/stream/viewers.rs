//! Counts the connected viewers, and limits the bytes that are encoded ahead for each.

use crate::access::{Identity, NoSeat, Seat, SeatLimits, Seats};

/// Maximum number of viewers. One user can have half of them, one address three quarters, and the last ones are reserved for
/// administrators. A further connection is closed with 4002. Most viewers only look. Viewers who edit share the device's queue; when the
/// queue is full, further edits wait in order.
pub const MAX_VIEWERS: usize = 1024;

/// Bytes of surfaces that are encoded ahead for all viewers together.
const AHEAD_BYTES: usize = 256 << 20;
/// Maximum bytes that are encoded ahead for one viewer. The socket sends these bytes while the next batch is encoded.
const MAX_AHEAD_BYTES: usize = 4 << 20;
/// Bytes that are encoded ahead for one viewer if [`MAX_VIEWERS`] are connected: some chunks.
const MIN_AHEAD_BYTES: usize = AHEAD_BYTES / MAX_VIEWERS;

/// The connected viewers. Clones share the count.
#[derive(Clone)]
pub(super) struct Viewers(Seats);

impl Default for Viewers {
    fn default() -> Self {
        Self(Seats::new(SeatLimits {
            what: "viewers",
            all: MAX_VIEWERS,
            of_user: MAX_VIEWERS / 2,
            of_address: MAX_VIEWERS / 4 * 3,
            reserve: MAX_VIEWERS / 64,
        }))
    }
}

impl Viewers {
    /// Admits one more viewer. Dropping the returned seat frees the place.
    ///
    /// # Errors
    /// There is no seat for this user.
    pub fn enter(&self, who: &Identity) -> Result<Seat, NoSeat> {
        self.0.acquire(who.into())
    }

    /// Returns the number of bytes of surfaces in a viewer's outbox below which the viewer's next batch is encoded. The more viewers there
    /// are, the lower the number is, because all of them may stop reading.
    pub fn ahead_bytes(&self) -> usize {
        (AHEAD_BYTES / self.0.taken().max(1)).clamp(MIN_AHEAD_BYTES, MAX_AHEAD_BYTES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_more_viewers_the_less_is_encoded_ahead_for_each() {
        let (viewers, operator) = (Viewers::default(), Identity::without_token());
        assert_eq!(viewers.ahead_bytes(), MAX_AHEAD_BYTES);
        let entered: Vec<_> = (0..MAX_VIEWERS).map_while(|_| viewers.enter(&operator).ok()).collect();
        assert_eq!(entered.len(), MAX_VIEWERS);
        assert!(viewers.enter(&operator).is_err());
        assert_eq!(viewers.ahead_bytes() * MAX_VIEWERS, AHEAD_BYTES);
        drop(entered);
        assert!(viewers.enter(&operator).is_ok());
        assert_eq!(viewers.ahead_bytes(), MAX_AHEAD_BYTES);
    }
}
