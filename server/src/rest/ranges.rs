//! Parts of files: the headers `Range`, `If-Range` and `Content-Range`.

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::parse_range_header;

use crate::problem::ApiError;

/// The part of a file that a request asks for.
pub(super) enum Asked {
    Whole,
    /// The bytes from the first position up to but not including the second.
    Part([u64; 2]),
    /// The part begins beyond the end of the file; contains the answer for this case.
    Beyond(Response),
}

impl Asked {
    /// Returns the requested part of a file with this entity tag and length; the whole file if `If-Range` names another tag.
    pub(super) fn of(headers: &HeaderMap, tag: &str, bytes: u64) -> Self {
        let applies = headers.get(header::IF_RANGE).is_none_or(|shown| shown == tag);
        let range = headers.get(header::RANGE).filter(|_| applies);
        match range.map(|range| part(range.to_str().unwrap_or_default(), bytes)) {
            Some(Ok(Some(part))) => Self::Part(part),
            Some(Ok(None)) | None => Self::Whole,
            Some(Err(error)) => {
                let whole = format!("bytes */{bytes}");
                Self::Beyond(([(header::CONTENT_RANGE, whole)], error).into_response())
            }
        }
    }
}

/// Returns the value of `Content-Range` for a part of a file of `bytes` bytes.
pub(super) fn content_range([from, to]: [u64; 2], bytes: u64) -> String {
    format!("bytes {from}-{}/{bytes}", to - 1)
}

/// Returns the part that a `Range` requests: its first byte, and the byte after its last. `None` means the whole file, which is also the
/// answer to several ranges and to an invalid range.
///
/// # Errors
/// The range begins beyond the end.
fn part(range: &str, bytes: u64) -> Result<Option<[u64; 2]>, ApiError> {
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
