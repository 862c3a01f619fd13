//! Targets of addresses: what requests are sent to.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use object_store::HeaderValue;
use percent_encoding::percent_decode_str;
use reqwest::Url;

const EXPECTED: &str = "expected https://host/path, http://host/path or s3://bucket/path";

/// Target of an address.
#[derive(Clone)]
pub(super) enum Target {
    Http {
        /// Without credentials.
        url: Url,
        authorization: Option<HeaderValue>,
    },
    S3 {
        bucket: String,
        /// Prefix of all keys of objects.
        prefix: String,
    },
}

impl Target {
    pub(super) fn of_s3(path: &str, query: &str) -> Result<Self, String> {
        let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
        if bucket.is_empty() || !query.is_empty() {
            return Err(EXPECTED.to_owned());
        }
        let (bucket, prefix) = (bucket.to_owned(), prefix.to_owned());
        Ok(Self::S3 { bucket, prefix })
    }

    pub(super) fn of_http(text: &str) -> Result<Self, String> {
        let mut url = Url::parse(text).map_err(|e| format!("{e}, {EXPECTED}"))?;
        let authorization = authorization(&url)?;
        // Neither can fail for a URL with a host.
        let _ = url.set_username("");
        let _ = url.set_password(None);
        url.set_fragment(None);
        Ok(Self::Http { url, authorization })
    }
}

/// Returns the `Authorization` header for `https://user:password@host`.
fn authorization(url: &Url) -> Result<Option<HeaderValue>, String> {
    if url.username().is_empty() && url.password().is_none() {
        return Ok(None);
    }
    let plain = |text| {
        let decoded = percent_decode_str(text).decode_utf8();
        decoded.map_err(|_| "credentials that are not text, expected user:password")
    };
    let (user, password) = (plain(url.username())?, plain(url.password().unwrap_or_default())?);
    let encoded = STANDARD.encode(format!("{user}:{password}"));
    let mut header = HeaderValue::from_str(&format!("Basic {encoded}")).map_err(|e| e.to_string())?;
    header.set_sensitive(true);
    Ok(Some(header))
}

#[cfg(test)]
mod tests {
    use super::super::Address;
    use super::*;

    #[test]
    fn credentials_become_a_header() {
        let (address, _) = Address::named("https://me:p%40ss@h.org/x.zarr?a=b#c").expect("an address");
        let Ok(Target::Http { url, authorization }) = address.target else {
            panic!("an address of HTTP");
        };
        assert_eq!(url.as_str(), "https://h.org/x.zarr?a=b");
        assert_eq!(authorization.expect("a header"), "Basic bWU6cEBzcw==");
    }
}
