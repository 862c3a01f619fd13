//! `GET /api/v1/extract`: returns a surface as a file. The query string contains the whole request. The entity tag of the response is a
//! hash of the bytes, so that a client can revalidate a cached file or resume a partial download.

use std::num::NonZero;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
use lru::LruCache;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use super::{ApiState, ExtractRequest, File, Source, other_volumes};
use crate::access::Identity;
use crate::export::{FileDigest, FileRequest, FileSurface, Format};
use crate::problem::{ApiError, Problem};
use crate::rest::content_encoding::ContentEncoding;
use crate::rest::ranges::RequestedRange;

/// Query parameters whose values are strings, even if they look like numbers.
const TEXT_PARAMETERS: [&str; 9] = [
    "volume", "format", "field", "feature", "mask", "outward", "unit", "label", "compress",
];

/// Headers for caches: only the user's own cache may store the file, and it must revalidate the file each time, because the volume or the
/// user's access to it may have changed.
const CACHE_HEADERS: [(HeaderName, HeaderValue); 2] = [
    (header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache")),
    (
        header::VARY,
        HeaderValue::from_static("Authorization, Cookie, Origin, Accept-Encoding"),
    ),
];

/// Maximum number of remembered digests.
const MAX_KNOWN_DIGESTS: NonZero<usize> = NonZero::new(1024).expect("not 0");

/// Cache of digests by the keys of requests, so that a client can revalidate a file that the server does not have any more. Equal requests
/// give equal bytes, unless the volume changes; the key includes its identity.
#[derive(Clone, Debug)]
pub(in crate::rest) struct KnownDigests(Arc<Mutex<LruCache<RequestKey, FileDigest>>>);

impl Default for KnownDigests {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(LruCache::new(MAX_KNOWN_DIGESTS))))
    }
}

/// SHA-256 of all parts of a request that determine the bytes of the file.
type RequestKey = [u8; 32];

fn request_key(surfaces: &[FileSurface], file: &FileRequest) -> RequestKey {
    let text_of = |surface: &FileSurface| {
        let (volume, view) = (surface.volume.key(), &surface.view);
        format!("{volume:?} {} {view:?}", surface.request.is_colored())
    };
    let surfaces: Vec<String> = surfaces.iter().map(text_of).collect();
    Sha256::digest(format!("{:?} {surfaces:?}", file.options)).into()
}

impl KnownDigests {
    fn find(&self, key: &RequestKey) -> Option<FileDigest> {
        self.lock().get(key).copied()
    }

    fn insert(&self, key: RequestKey, digest: FileDigest) {
        self.lock().put(key, digest);
    }

    fn lock(&self) -> MutexGuard<'_, LruCache<RequestKey, FileDigest>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the hash for the entity tag of a file.
fn hash(digest: FileDigest) -> String {
    HEXLOWER.encode(&digest.hash.to_be_bytes())
}

/// Returns the strong entity tag of a file in this encoding.
fn tag(digest: FileDigest, encoding: ContentEncoding) -> String {
    encoding.tag(&hash(digest))
}

/// Whether `If-None-Match` states that the client has the file with this digest, in any encoding.
fn client_has(headers: &HeaderMap, digest: FileDigest) -> bool {
    ContentEncoding::is_known(headers, &hash(digest))
}

/// Extracts a surface and returns it as a file, as `POST` does. The query has the same names: numbers, and objects and lists as JSON.
/// `ETag` identifies the bytes, which are the same for the same request: a client that sends it in `If-None-Match` gets no body if it has
/// the file, and a client that has a part of the file requests the rest with `Range`.
#[utoipa::path(
    get,
    path = "/api/v1/extract",
    tag = "extract",
    params(
        ("volume" = String, Query, description = "Id of the volume, as `GET /api/v1/volumes` lists it"),
        ("format" = Format, Query, description = "File format"),
        ("step" = Option<u32>, Query, description = "Time step. Default: 0"),
        ("iso" = Option<f64>, Query, description = "The isovalue, and likewise any of the edit's names, each once: `alpha=0.5`, `triangles={\"share\":0.1}`"),
        ("if-none-match" = Option<String>, Header, description = "The `ETag` of a file that the client has"),
        ("range" = Option<String>, Header, description = "`bytes=FIRST-LAST`: a part of the file, which is not compressed"),
        ("if-range" = Option<String>, Header, description = "The `ETag` of the file of which the client has a part. If it differs, the response is the whole file"),
        ("accept-encoding" = Option<String>, Header, description = "`zstd` or `gzip`: the body is compressed"),
    ),
    responses(
        (
            status = 200,
            description = "The surface",
            body = File,
            content_type = "model/gltf-binary",
            headers(
                ("etag" = String, description = "Strong entity tag of the bytes"),
                ("isopeel-statistics" = String, description = "The statistics, as JSON in ASCII"),
            ),
        ),
        (status = 206, description = "The requested range of the file", body = File, content_type = "application/octet-stream"),
        (status = 304, description = "The client has the file already"),
        (status = 400, description = "`bad-request`: an unknown, missing or repeated name, or a value of the wrong type", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "`bad-range`: beyond the end of the file", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-edit`, `empty-surface`, `not-clean`, `too-large` or `unreadable-volume`, as of `POST`", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume`, `device` or `internal`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn extract_by_address(
    State(state): State<ApiState>,
    who: Identity,
    headers: HeaderMap,
    query: Result<Query<Vec<(String, String)>>, QueryRejection>,
) -> Result<Response, ApiError> {
    let Query(query) = query?;
    let refused = |message| ApiError::new(StatusCode::BAD_REQUEST, "bad-request", message);
    let ExtractRequest { volume, file } = parse_query(query).map_err(refused)?;
    // Checks access to the volume first: the response to a tag would reveal that the volume exists.
    let volume = state.volume(&who, &volume, file.step)?;
    let others = other_volumes(&state, &who, &file)?;
    let surfaces = file.surfaces(&volume, &others)?;
    // A file that is not reproducible is made for each request, and its digest is not remembered.
    let is_reproducible = file.options.is_reproducible();
    let (key, known) = (request_key(&surfaces, &file), state.known_digests.clone());
    let encoding = ContentEncoding::accepted(&headers);
    let unchanged = known
        .find(&key)
        .filter(|digest| is_reproducible && client_has(&headers, *digest));
    if let Some(digest) = unchanged {
        return not_modified(digest, encoding);
    }
    let made = Source { volume, others }.export(state, &who, file).await?;
    let digest = made.digest;
    if is_reproducible {
        known.insert(key, digest);
    }
    if client_has(&headers, digest) {
        return not_modified(digest, encoding);
    }
    let identity_tag = tag(digest, ContentEncoding::Identity);
    let mut response = match RequestedRange::from_headers(&headers, &identity_tag, digest.bytes) {
        RequestedRange::NotSatisfiable(response) => response,
        RequestedRange::Part(range) => with_tag(made.range(range)?, &identity_tag)?,
        RequestedRange::Whole => with_tag(made.whole(encoding)?, &tag(digest, encoding))?,
    };
    let ranges = HeaderValue::from_static("bytes");
    response.headers_mut().insert(header::ACCEPT_RANGES, ranges);
    Ok(response)
}

fn not_modified(digest: FileDigest, encoding: ContentEncoding) -> Result<Response, ApiError> {
    with_tag(StatusCode::NOT_MODIFIED.into_response(), &tag(digest, encoding))
}

/// Adds the entity tag and the headers for caches to a response.
fn with_tag(mut response: Response, tag: &str) -> Result<Response, ApiError> {
    let headers = response.headers_mut();
    headers.insert(header::ETAG, HeaderValue::from_str(tag).map_err(ApiError::internal)?);
    for (name, value) in CACHE_HEADERS {
        headers.insert(name, value);
    }
    Ok(response)
}

/// Parses the parameters of a query.
///
/// # Errors
/// A message for the client that says what is wrong with the query.
fn parse_query(query: Vec<(String, String)>) -> Result<ExtractRequest, String> {
    let mut fields = Map::new();
    for (name, text) in query {
        let value = match TEXT_PARAMETERS.contains(&name.as_str()) {
            true => Value::String(text),
            false => parse_value(&name, text)?,
        };
        if fields.insert(name.clone(), value).is_some() {
            return Err(format!("{name:?} is there twice, expected it once"));
        }
    }
    serde_json::from_value(Value::Object(fields)).map_err(|error| error.to_string())
}

/// Parses the value of a parameter as JSON. Text that is not JSON becomes a string. Invalid JSON that begins like an object or a list is an
/// error.
fn parse_value(name: &str, text: String) -> Result<Value, String> {
    match serde_json::from_str(&text) {
        Err(error) if text.starts_with(['{', '[']) => Err(format!("{name}: expected JSON, found {text:?}: {error}")),
        Err(_) => Ok(Value::String(text)),
        Ok(value) => Ok(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(query: &[(&str, &str)]) -> Result<ExtractRequest, String> {
        parse_query(
            query
                .iter()
                .map(|(name, text)| ((*name).into(), (*text).into()))
                .collect(),
        )
    }

    #[test]
    fn an_address_asks_for_what_a_body_asks_for() {
        let asked = request(&[
            ("volume", "12"),
            ("format", "ply"),
            ("iso", "-3.5"),
            ("field", "7"),
            ("error", "0.1vx"),
            ("triangles", r#"{"share":0.5}"#),
            ("cap", "true"),
            ("step", "2"),
        ]);
        let body = r#"{"volume":"12","format":"ply","iso":-3.5,"field":"7","error":"0.1vx","triangles":{"share":0.5},"cap":true,"step":2}"#;
        assert_eq!(asked.unwrap(), serde_json::from_str(body).unwrap());
    }

    #[test]
    fn what_is_wrong_with_an_address_is_named() {
        let complete = [("volume", "head"), ("format", "ply")];
        for (further, expected) in [
            (("isovalue", "1"), "unknown field `isovalue`"),
            (("iso", "much"), "invalid type: string \"much\""),
            (("step", "-1"), "invalid value: integer `-1`"),
            (("format", "ply"), "\"format\" is there twice"),
            (("triangles", "{"), "triangles: expected JSON, found \"{\""),
        ] {
            let error = request(&[complete[0], complete[1], further]).unwrap_err();
            assert!(error.contains(expected), "{further:?}: {error}");
        }
        assert!(request(&complete[..1]).unwrap_err().contains("missing field `format`"));
    }

    #[test]
    fn a_client_shows_one_tag_or_several() {
        let digest = FileDigest { bytes: 1, hash: 0xab };
        let whole = format!("{:032x}", 0xab);
        let shows = |tags: &[&str]| {
            let mut headers = HeaderMap::new();
            for tags in tags {
                headers.append(
                    header::IF_NONE_MATCH,
                    HeaderValue::from_str(&tags.replace("ab", &whole)).unwrap(),
                );
            }
            client_has(&headers, digest)
        };
        for tags in [
            &["\"ab\""][..],
            &["W/\"ab\""],
            &["\"ab-zstd\""],
            &["\"x\", \"ab-gzip\""],
            &["\"x\"", "\"ab\""],
            &["*"],
        ] {
            assert!(shows(tags), "{tags:?}");
        }
        assert!(!shows(&[]) && !shows(&["\"x\""]) && !shows(&["ab"]) && !shows(&["\"abc\""]));
    }

    #[test]
    fn a_range_of_another_file_is_none() {
        let digest = FileDigest { bytes: 9, hash: 0xab };
        let of = |if_range: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::RANGE, HeaderValue::from_static("bytes=1-"));
            if let Some(tag) = if_range {
                headers.insert(header::IF_RANGE, HeaderValue::from_str(tag).unwrap());
            }
            match RequestedRange::from_headers(&headers, &tag(digest, ContentEncoding::Identity), digest.bytes) {
                RequestedRange::Part(part) => Some(part),
                RequestedRange::Whole => None,
                RequestedRange::NotSatisfiable(_) => panic!("it begins in the file"),
            }
        };
        let same = tag(digest, ContentEncoding::Identity);
        assert_eq!(of(None), Some(1..9));
        assert_eq!(of(Some(&same)), Some(1..9));
        for other in ["\"x\"", &format!("W/{same}"), &tag(digest, ContentEncoding::Zstd)] {
            assert_eq!(of(Some(other)), None, "{other}");
        }
    }
}
