//! Origins whose pages may use the server. Browsers let any page open a WebSocket to any server, and state the origin of the page. Without
//! this check, any page could use a server on the same machine.

use std::str::FromStr;

use axum::http::header::{HOST, HeaderMap, ORIGIN};
use axum::http::{HeaderValue, Uri};

use super::Access;

/// An origin whose pages may use the server, in addition to the server's own: `https://viewer.example`, as browsers send it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AllowedOrigin(HeaderValue);

impl FromStr for AllowedOrigin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || format!("{text:?}, expected scheme://host[:port], such as https://viewer.example");
        let uri: Uri = text.parse().map_err(|_| refuse())?;
        // `Uri` parses an empty path as `/`, so the text is checked too.
        let has_no_path = !text.ends_with('/') && uri.path_and_query().is_none_or(|path| path == "/");
        match (uri.scheme_str(), uri.authority()) {
            (Some("http" | "https"), Some(authority)) if has_no_path && !authority.as_str().contains('@') => {
                HeaderValue::from_str(&text.to_ascii_lowercase())
                    .map(Self)
                    .map_err(|_| refuse())
            }
            _ => Err(refuse()),
        }
    }
}

impl std::fmt::Display for AllowedOrigin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Cannot fail: the value was parsed from text.
        f.write_str(self.0.to_str().unwrap_or_default())
    }
}

impl AllowedOrigin {
    /// Returns the origin as browsers send it.
    pub fn header(&self) -> HeaderValue {
        self.0.clone()
    }
}

/// Checks that a request comes from a page of the server, from a page of an allowed origin, or from no page. Call this only after `host`
/// has accepted the header `Host`.
///
/// # Errors
/// The origin, if it is not allowed.
pub(super) fn check(headers: &HeaderMap, access: &Access) -> Result<(), String> {
    // Clients other than browsers send no origin.
    let Some(origin) = headers.get(ORIGIN) else {
        return Ok(());
    };
    let allowed = access.origins.iter().any(|AllowedOrigin(allowed)| allowed == origin);
    if allowed || is_own(origin, headers, access) {
        return Ok(());
    }
    Err(String::from_utf8_lossy(origin.as_bytes()).into_owned())
}

/// Whether an origin is the server's own: the host of the request, or an origin of `--public-url`.
fn is_own(origin: &HeaderValue, headers: &HeaderMap, access: &Access) -> bool {
    let is_host = || Some(authority(origin.to_str().ok()?)? == headers.get(HOST)?.to_str().ok()?.to_ascii_lowercase());
    let mut public = access.public_origins.iter();
    public.any(|AllowedOrigin(public)| public == origin) || is_host() == Some(true)
}

/// Returns host and port of an origin as in the header `Host`. Ignores the scheme, because a proxy may add TLS.
fn authority(origin: &str) -> Option<String> {
    let (_, authority) = origin.split_once("://")?;
    Some(authority.to_ascii_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(origin: Option<&str>, host: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().expect("a header"));
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().expect("a header"));
        }
        headers
    }

    #[test]
    fn own_pages_allowed_ones_and_programs_pass_and_no_others() {
        let allowed = ["https://Viewer.example".parse().expect("an origin")];
        let public = "https://volumes.example/isopeel".parse().expect("a URL");
        let access = Access::new(([127, 0, 0, 1], 8417).into(), &[public], &allowed);
        for (origin, host, passes) in [
            (None, "localhost:8417", true),
            (Some("http://localhost:8417"), "localhost:8417", true),
            (Some("http://[::1]:8417"), "[::1]:8417", true),
            (Some("https://volumes.example"), "Volumes.example", true),
            (Some("https://viewer.example"), "localhost:8417", true),
            (Some("https://volumes.example"), "localhost:8417", true),
            (Some("http://volumes.example"), "localhost:8417", false),
            (Some("http://viewer.example"), "localhost:8417", false),
            (Some("http://localhost:3000"), "localhost:8417", false),
            (Some("http://localhost"), "localhost:8417", false),
            (Some("http://127.0.0.1:8417"), "localhost:8417", false),
            (Some("https://evil.example"), "localhost:8417", false),
            (Some("null"), "localhost:8417", false),
            (Some(""), "", false),
        ] {
            assert_eq!(
                check(&headers(origin, host), &access).is_ok(),
                passes,
                "{origin:?} at {host}"
            );
        }
    }

    #[test]
    fn origins_are_written_as_browsers_send_them() {
        for text in [
            "",
            "*",
            "viewer.example",
            "https://viewer.example/",
            "https://a.example/path",
            "ftp://a.example",
            "https://me@a.example",
        ] {
            let error = text.parse::<AllowedOrigin>().expect_err(text);
            assert!(error.contains("expected scheme://host[:port]"), "{error}");
        }
    }
}
