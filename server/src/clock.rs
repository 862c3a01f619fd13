//! Formats times of the wall clock. The clock of a machine may be wrong: before 1970, or many years ahead.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Seconds from 1970 to the last second that RFC 3339 can express, in the year 9999.
const LAST_SECOND: u64 = 253_402_300_799;

/// Returns the nearest time that RFC 3339 can express, from 1970 on.
fn clamped(time: SystemTime) -> SystemTime {
    time.clamp(UNIX_EPOCH, UNIX_EPOCH + Duration::from_secs(LAST_SECOND))
}

/// Formats a time as in RFC 3339, with seconds. A time before 1970, or after the year 9999, becomes the nearest time in between.
pub fn rfc3339_seconds(time: SystemTime) -> String {
    humantime::format_rfc3339_seconds(clamped(time)).to_string()
}

/// Formats a time as [`rfc3339_seconds`] does, but with milliseconds.
pub fn rfc3339_millis(time: SystemTime) -> String {
    humantime::format_rfc3339_millis(clamped(time)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_cannot_be_written_are_the_nearest_that_can() {
        let day = Duration::from_secs(86_400);
        assert_eq!(rfc3339_seconds(UNIX_EPOCH + day), "1970-01-02T00:00:00Z");
        assert_eq!(rfc3339_millis(UNIX_EPOCH - day), "1970-01-01T00:00:00.000Z");
        assert_eq!(rfc3339_seconds(UNIX_EPOCH + day * 10_000_000), "9999-12-31T23:59:59Z");
    }
}
