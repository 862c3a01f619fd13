//! Range requests: the headers `Range`, `If-Range` and `Content-Range`.

use std::ops::Range;

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::parse_range_header;

use crate::problem::ApiError;

/// The requested part of a file.
pub(super) enum RequestedRange {
    Whole,
    Part(Range<u64>),
    /// The range begins beyond the end of the file. Contains the response with status 416.
    NotSatisfiable(Response),
}

impl RequestedRange {
    /// Returns the requested part of a file with this entity tag and `bytes` bytes. Returns the whole file if `If-Range` names another tag.
    pub(super) fn from_headers(headers: &HeaderMap, tag: &str, bytes: u64) -> Self {
        let applies = headers.get(header::IF_RANGE).is_none_or(|other| other == tag);
        let range = headers.get(header::RANGE).filter(|_| applies);
        match range.map(|range| parse_range(range.to_str().unwrap_or_default(), bytes)) {
            Some(Ok(Some(part))) => Self::Part(part),
            Some(Ok(None)) | None => Self::Whole,
            Some(Err(error)) => {
                let length = format!("bytes */{bytes}");
                Self::NotSatisfiable(([(header::CONTENT_RANGE, length)], error).into_response())
            }
        }
    }
}

/// Returns the value of `Content-Range` for a part of a file of `bytes` bytes. The part must not be empty.
pub(super) fn content_range(part: &Range<u64>, bytes: u64) -> String {
    format!("bytes {}-{}/{bytes}", part.start, part.end - 1)
}

/// Parses the value of `Range` for a file of `bytes` bytes. Returns `None`, which means the whole file, for an invalid value and for
/// several ranges.
///
/// # Errors
/// The range begins beyond the end of the file.
fn parse_range(range: &str, bytes: u64) -> Result<Option<Range<u64>>, ApiError> {
    let Ok(parsed) = parse_range_header(range) else {
        return Ok(None);
    };
    match parsed.validate(bytes).as_deref() {
        Ok([range]) => Ok(Some(*range.start()..*range.end() + 1)),
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
            ("bytes=0-9", Some(0..10)),
            ("bytes=90-", Some(90..100)),
            ("bytes=-10", Some(90..100)),
            ("bytes=90-1000", Some(90..100)),
            ("bytes=0-0,5-9", None),
            ("lines=1-2", None),
            ("", None),
        ] {
            assert_eq!(parse_range(range, 100).unwrap_or(Some(0..0)), expected, "{range}");
        }
        let beyond = parse_range("bytes=100-", 100).unwrap_err();
        assert_eq!(beyond.status(), StatusCode::RANGE_NOT_SATISFIABLE);
    }
}
