//! Times of day, which may be wrong: a machine's clock can be before 1970, or years ahead.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Seconds from 1970 to the last one that RFC 3339 can write, in the year 9999.
const LAST_SECOND: u64 = 253_402_300_799;

fn within(time: SystemTime) -> SystemTime {
    time.clamp(UNIX_EPOCH, UNIX_EPOCH + Duration::from_secs(LAST_SECOND))
}

/// Formats a time as in RFC 3339, to the second. A time that RFC 3339 cannot express becomes the nearest one that it can.
pub fn rfc3339_seconds(time: SystemTime) -> String {
    humantime::format_rfc3339_seconds(within(time)).to_string()
}

/// As [`rfc3339_seconds`], to the millisecond.
pub fn rfc3339_millis(time: SystemTime) -> String {
    humantime::format_rfc3339_millis(within(time)).to_string()
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
