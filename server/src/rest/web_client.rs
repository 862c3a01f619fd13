//! The web client, embedded in the binary as Vite built it, and served as static files.

use std::borrow::Cow;

use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
use rust_embed::RustEmbed;

use crate::problem::ApiError;

// Release builds embed the files, debug builds read the folder.
#[derive(RustEmbed)]
#[folder = "../web/dist"]
#[allow_missing = true]
struct Dist;

const INDEX: &str = "index.html";
/// The page of a binary that was compiled without the client.
const PLACEHOLDER: &str = include_str!("web_client/placeholder.html");

/// Vite puts a hash of the content into the names below `assets/`: such a file never changes.
const HASHED_FOLDER: &str = "assets/";
const FOREVER: &str = "public, max-age=31536000, immutable";
/// May be cached, but is requested again each time; the entity tag makes that a 304.
const REVALIDATE: &str = "no-cache";

/// Answers paths without a route of their own: a file of the client; the client's page for other paths without an extension, which are
/// addresses of the client; a problem 404 otherwise and below `/api/`.
pub async fn serve(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let path = uri.path().trim_start_matches('/');
    if path == "api" || path.starts_with("api/") {
        return ApiError::not_found(uri.path()).into_response();
    }
    if method != Method::GET && method != Method::HEAD {
        return ApiError::method_not_allowed(&method, uri.path(), "GET, HEAD").into_response();
    }
    let name = if path.is_empty() { INDEX } else { path };
    if let Some(file) = Dist::get(name) {
        return respond(name, file.data, file.metadata.sha256_hash(), &headers);
    }
    let last = path.rsplit('/').next().unwrap_or_default();
    if name != INDEX && last.contains('.') {
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

fn respond(name: &str, data: Cow<'static, [u8]>, hash: [u8; 32], request: &HeaderMap) -> Response {
    let tag = format!("\"{}\"", HEXLOWER.encode(&hash));
    let caching = if name.starts_with(HASHED_FOLDER) {
        FOREVER
    } else {
        REVALIDATE
    };
    let mut headers = HeaderMap::new();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
    if let Ok(value) = HeaderValue::from_str(&tag) {
        headers.insert(header::ETAG, value);
    }
    let known = request.get_all(header::IF_NONE_MATCH).iter().any(|value| {
        let tags = value.to_str().unwrap_or_default().split(',').map(str::trim);
        tags.into_iter().any(|t| t == "*" || t.trim_start_matches("W/") == tag)
    });
    if known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    if let Ok(value) = HeaderValue::from_str(&content_type(name)) {
        headers.insert(header::CONTENT_TYPE, value);
    }
    match data {
        Cow::Borrowed(bytes) => (headers, bytes).into_response(),
        Cow::Owned(bytes) => (headers, bytes).into_response(),
    }
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
    use super::*;

    async fn get(method: Method, path: &str) -> Response {
        serve(method, path.parse().unwrap(), HeaderMap::new()).await
    }

    fn file(name: &str, bytes: &'static [u8], request: &HeaderMap) -> Response {
        respond(name, Cow::Borrowed(bytes), [7; 32], request)
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
        let response = file("index.html", b"<!doctype html>", &request);
        assert_eq!(response.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(response.headers()[header::CACHE_CONTROL], REVALIDATE);

        request.insert(header::IF_NONE_MATCH, HeaderValue::from_static("\"other\""));
        let response = file("a.wasm", b"\0asm", &request);
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/wasm");
    }
}
