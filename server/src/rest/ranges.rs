//! Parts of files: the header `Range`.

use axum::http::StatusCode;
use http_range_header::parse_range_header;

use crate::problem::ApiError;

/// The part that a `Range` asks for, from its first byte to the one behind its last; `None`: all of it, which answers several ranges and what
/// is no range too.
///
/// # Errors
/// It begins beyond the end.
pub(super) fn part(range: &str, bytes: u64) -> Result<Option<[u64; 2]>, ApiError> {
    let Ok(parsed) = parse_range_header(range) else {
        return Ok(None);
    };
    match parsed.validate(bytes).as_deref() {
        Ok([one]) => Ok(Some([*one.start(), *one.end() + 1])),
        Ok(_) => Ok(None),
        Err(_) => {
            let message = format!("range {range:?}, expected one in the {bytes} bytes of the file");
            Err(ApiError::new(StatusCode::RANGE_NOT_SATISFIABLE, "bad-range", message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_range_is_a_part() {
        for (range, expected) in [
            ("bytes=0-9", Some([0, 10])),
            ("bytes=90-", Some([90, 100])),
            ("bytes=-10", Some([90, 100])),
            ("bytes=90-1000", Some([90, 100])),
            ("bytes=0-0,5-9", None),
            ("lines=1-2", None),
            ("", None),
        ] {
            assert_eq!(part(range, 100).unwrap_or(Some([0, 0])), expected, "{range}");
        }
        let beyond = part("bytes=100-", 100).unwrap_err();
        assert_eq!(beyond.status(), StatusCode::RANGE_NOT_SATISFIABLE);
    }
}
