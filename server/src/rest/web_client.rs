//! Serves the web client: static files that Vite has built, and that are embedded in the binary.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
use rust_embed::RustEmbed;

use super::precompressed::Precompressed;
use crate::problem::ApiError;

// Release builds embed the files; debug builds read them from the folder.
#[derive(RustEmbed)]
#[folder = "../web/dist"]
#[allow_missing = true]
struct Dist;

const INDEX: &str = "index.html";
/// The page of a binary that was built without the web client.
const PLACEHOLDER: &str = include_str!("web_client/placeholder.html");

/// Folder of files that never change, because Vite puts a hash of the content into their names.
const HASHED_FOLDER: &str = "assets/";
/// `Cache-Control` of files that never change: caches may use them for a year without a request.
const FOREVER: &str = "public, max-age=31536000, immutable";
/// `Cache-Control` of other files: caches must revalidate them each time, by the entity tag.
const REVALIDATE: &str = "no-cache";

/// Maximum number of cached bodies. The web client has fewer files.
const MAX_BODIES: usize = 1_024;

/// Handles all paths without a route. A path of a file gets this file. Another path without an extension gets the page of the web client,
/// which interprets the path. Any other path, and any path below `/api/`, gets a problem with status 404.
pub async fn serve(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let path = uri.path().trim_start_matches('/');
    let first = path.split('/').next().unwrap_or_default();
    // The web client never interprets paths of the API, the metrics and the probes, even with additional leading slashes.
    if ["api", "metrics", "healthz", "readyz"].contains(&first) {
        return ApiError::not_found(uri.path()).into_response();
    }
    if method != Method::GET && method != Method::HEAD {
        return ApiError::method_not_allowed(&method, uri.path(), "GET, HEAD").into_response();
    }
    let name = if path.is_empty() { INDEX } else { path };
    if let Some(file) = Dist::get(name) {
        return respond(name, file.data, file.metadata.sha256_hash(), &headers);
    }
    let file_name = path.rsplit('/').next().unwrap_or_default();
    if name != INDEX && file_name.contains('.') {
        return ApiError::not_found(uri.path()).into_response();
    }
    match Dist::get(INDEX) {
        Some(file) => respond(INDEX, file.data, file.metadata.sha256_hash(), &headers),
        None => (
            [
                (header::CONTENT_TYPE, "text/html; charset=utf-8"),
                (header::CACHE_CONTROL, REVALIDATE),
            ],
            PLACEHOLDER,
        )
            .into_response(),
    }
}

/// Returns the response with a file of the web client, in an encoding that the request accepts.
fn respond(name: &str, data: Cow<'static, [u8]>, hash: [u8; 32], request: &HeaderMap) -> Response {
    let caching = if name.starts_with(HASHED_FOLDER) {
        FOREVER
    } else {
        REVALIDATE
    };
    let mut headers = HeaderMap::new();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
    let content_type = content_type(name);
    if let Ok(value) = HeaderValue::from_str(&content_type) {
        headers.insert(header::CONTENT_TYPE, value);
    }
    body(data, hash, &content_type).respond(request, headers)
}

/// Returns the body of a file with this hash from a cache, so that it is compressed once for all requests.
fn body(data: Cow<'static, [u8]>, hash: [u8; 32], content_type: &str) -> Arc<Precompressed> {
    static BODIES: Mutex<BTreeMap<[u8; 32], Arc<Precompressed>>> = Mutex::new(BTreeMap::new());
    let mut bodies = BODIES.lock().unwrap_or_else(PoisonError::into_inner);
    // Only a debug build can reach the limit, because the files in its folder change.
    if bodies.len() >= MAX_BODIES {
        bodies.clear();
    }
    let body = bodies.entry(hash).or_insert_with(|| {
        let bytes = match data {
            Cow::Borrowed(bytes) => Bytes::from_static(bytes),
            Cow::Owned(bytes) => bytes.into(),
        };
        let compressible = ["text/", "application/json", "application/wasm", "image/svg"];
        let is_compressible = compressible.iter().any(|kind| content_type.starts_with(kind));
        Arc::new(Precompressed::new(bytes, HEXLOWER.encode(&hash), is_compressible))
    });
    Arc::clone(body)
}

fn content_type(name: &str) -> String {
    let mime = mime_guess::from_path(name).first_or_octet_stream();
    match (mime.type_(), mime.subtype()) {
        (mime_guess::mime::TEXT, _) | (_, mime_guess::mime::JSON | mime_guess::mime::JAVASCRIPT) => {
            format!("{}; charset=utf-8", mime.essence_str())
        }
        _ => mime.essence_str().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;

    use super::*;

    async fn get(method: Method, path: &str) -> Response {
        serve(method, path.parse().unwrap(), HeaderMap::new()).await
    }

    fn file(name: &str, bytes: &'static [u8], request: &HeaderMap) -> Response {
        let mut hash = [7; 32];
        hash[..4].copy_from_slice(&(bytes.len() as u32).to_le_bytes());
        respond(name, Cow::Borrowed(bytes), hash, request)
    }

    #[tokio::test]
    async fn the_page_is_there_with_or_without_a_built_client() {
        for path in ["/", "/view/mni152"] {
            let response = get(Method::GET, path).await;
            assert_eq!(response.status(), StatusCode::OK, "{path}");
            assert_eq!(response.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
            assert_eq!(response.headers()[header::CACHE_CONTROL], REVALIDATE);
        }
    }

    #[tokio::test]
    async fn what_is_not_there_is_a_problem() {
        for (method, path, status) in [
            (Method::GET, "/missing.js", StatusCode::NOT_FOUND),
            (Method::GET, "/assets/../Cargo.toml", StatusCode::NOT_FOUND),
            (Method::GET, "/api/v2/volumes", StatusCode::NOT_FOUND),
            (Method::POST, "/", StatusCode::METHOD_NOT_ALLOWED),
        ] {
            let response = get(method, path).await;
            assert_eq!(response.status(), status, "{path}");
            assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
        }
    }

    #[test]
    fn hashed_files_are_kept_and_known_ones_not_sent_again() {
        let response = file("assets/index-d34db33f.js", b"let a", &HeaderMap::new());
        assert_eq!(response.headers()[header::CACHE_CONTROL], FOREVER);
        assert_eq!(
            response.headers()[header::CONTENT_TYPE],
            "text/javascript; charset=utf-8"
        );
        let tag = response.headers()[header::ETAG].clone();

        let mut request = HeaderMap::new();
        request.insert(header::IF_NONE_MATCH, tag);
        let response = file("index.html", b"let a", &request);
        assert_eq!(response.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(response.headers()[header::CACHE_CONTROL], REVALIDATE);

        request.insert(header::IF_NONE_MATCH, HeaderValue::from_static("\"other\""));
        let response = file("a.wasm", b"\0asm", &request);
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/wasm");
    }
}
