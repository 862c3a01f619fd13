//! Bodies that never change. Each is compressed once for all requests, and has an entity tag.

use std::sync::OnceLock;

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::content_encoding::ContentEncoding;

/// Minimum bytes of a body that is compressed, because compressing a smaller one gains nothing.
const MIN_BYTES: usize = 1 << 10;

/// A body, and its encoded forms that were requested so far.
#[derive(Debug)]
pub(super) struct Precompressed {
    bytes: Bytes,
    /// Hash of the content, for the entity tag.
    hash: String,
    is_compressible: bool,
    gzip: OnceLock<Bytes>,
    zstd: OnceLock<Bytes>,
}

impl Precompressed {
    /// Creates a body. `hash` is a hash of `bytes`. A body that is not compressible, such as an image, is sent unencoded.
    pub(super) fn new(bytes: Bytes, hash: String, is_compressible: bool) -> Self {
        Self {
            is_compressible: is_compressible && bytes.len() >= MIN_BYTES,
            bytes,
            hash,
            gzip: OnceLock::new(),
            zstd: OnceLock::new(),
        }
    }

    /// Returns the response to a request, with `headers` and the entity tag of the encoding. Its status is 304 if the client has the body
    /// in any encoding.
    pub(super) fn respond(&self, request: &HeaderMap, mut headers: HeaderMap) -> Response {
        let encoding = match self.is_compressible {
            true => ContentEncoding::accepted(request),
            false => ContentEncoding::Identity,
        };
        if let Ok(value) = HeaderValue::from_str(&encoding.tag(&self.hash)) {
            headers.insert(header::ETAG, value);
        }
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        if ContentEncoding::is_known(request, &self.hash) {
            headers.remove(header::CONTENT_TYPE);
            return (StatusCode::NOT_MODIFIED, headers).into_response();
        }
        if encoding != ContentEncoding::Identity {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(encoding.name()));
        }
        (headers, Body::from(self.encoded(encoding))).into_response()
    }

    /// Returns the body in an encoding, compressed at the first call.
    fn encoded(&self, encoding: ContentEncoding) -> Bytes {
        let compressed = match encoding {
            ContentEncoding::Identity => return self.bytes.clone(),
            ContentEncoding::Gzip => &self.gzip,
            ContentEncoding::Zstd => &self.zstd,
        };
        let compress = || {
            let mut out = Vec::new();
            // Cannot fail, because it writes to a vector.
            let _ = encoding.write(&mut out, |body| body.write_all(&self.bytes));
            Bytes::from(out)
        };
        compressed.get_or_init(compress).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepting(encoding: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(encoding))])
    }

    #[tokio::test]
    async fn a_body_is_compressed_once_and_each_encoding_has_its_tag() {
        let text = "isopeel ".repeat(1_000);
        let body = Precompressed::new(text.clone().into(), "a1".into(), true);
        let mut tags = Vec::new();
        for (encoding, name) in [("identity", None), ("gzip", Some("gzip")), ("zstd, gzip", Some("zstd"))] {
            let answer = body.respond(&accepting(encoding), HeaderMap::new());
            let found = answer.headers().get(header::CONTENT_ENCODING);
            assert_eq!(found.map(|value| value.to_str().unwrap()), name, "{encoding}");
            assert_eq!(answer.headers()[header::VARY], "accept-encoding");
            tags.push(answer.headers()[header::ETAG].clone());
            let bytes = axum::body::to_bytes(answer.into_body(), usize::MAX).await.unwrap();
            match name {
                None => assert_eq!(bytes, text),
                Some(_) => assert!(bytes.len() < text.len() / 4, "{} bytes", bytes.len()),
            }
        }
        assert!(
            tags[0] != tags[1] && tags[1] != tags[2] && tags[0] != tags[2],
            "{tags:?}"
        );
        let same = [body.encoded(ContentEncoding::Gzip), body.encoded(ContentEncoding::Gzip)];
        assert_eq!(same[0].as_ptr(), same[1].as_ptr(), "it is made once");
        for known in ["\"a1\"", "W/\"a1-gzip\", \"b\"", "*"] {
            let mut request = accepting("zstd");
            request.insert(header::IF_NONE_MATCH, HeaderValue::from_static(known));
            assert_eq!(
                body.respond(&request, HeaderMap::new()).status(),
                StatusCode::NOT_MODIFIED
            );
        }
        let small = Precompressed::new("short".into(), "b".into(), true);
        let answer = small.respond(&accepting("gzip"), HeaderMap::new());
        assert!(answer.headers().get(header::CONTENT_ENCODING).is_none());
    }
}
