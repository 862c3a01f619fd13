//! A surface as a file, by an address that says all of it. The answer has a tag, so that a client which has kept the file learns that it is still the same
//! before anything is made.

use std::hash::{BuildHasher, RandomState};

use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use super::{ApiState, ExtractRequest, answer};
use crate::access::Identity;
use crate::export::{FileRequest, Format};
use crate::problem::{ApiError, Problem};
use crate::view::View;
use crate::volumes::VolumeStep;

/// Names whose values are text, also where they look like numbers.
const TEXTS: [&str; 5] = ["volume", "format", "field", "feature", "mask"];

/// A cache asks again each time, whoever has asked before: what a volume is may change, and so may who sees it.
const CACHED: [(HeaderName, HeaderValue); 2] = [
    (header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache")),
    (header::VARY, HeaderValue::from_static("Authorization, Cookie, Origin")),
];

/// What no other process has: a tag names a volume by its id, which another file may have once the server starts again.
#[derive(Clone, Copy)]
pub(in crate::rest) struct TagSeed(u64);

impl TagSeed {
    pub(in crate::rest) fn random() -> Self {
        Self(RandomState::new().hash_one(()))
    }

    /// The same for what makes the same surface in the same format.
    fn tag(self, volume: &VolumeStep, view: &View, file: &FileRequest) -> String {
        let (options, colored) = (&file.options, file.is_colored());
        let what = format!("{} {:?} {options:?} {colored} {view:?}", self.0, volume.key());
        // Weak: a file says how long it took to make.
        format!("W/\"{}\"", HEXLOWER.encode(&Sha256::digest(what)[..16]))
    }
}

/// Extracts a surface and answers it as a file, as `POST` does. The query has the same names: numbers, and objects and lists as JSON. `ETag` is the same for as long as the
/// server runs and the volume is what it is; a client that shows it in `If-None-Match` is answered at once.
#[utoipa::path(
    get,
    path = "/api/v1/extract",
    tag = "extract",
    params(
        ("volume" = String, Query, description = "Id of the volume, as `GET /api/v1/volumes` lists it"),
        ("format" = Format, Query, description = "File format"),
        ("step" = Option<u32>, Query, description = "Time step; 0 where it is left out"),
        ("iso" = Option<f64>, Query, description = "The isovalue, and likewise any of the edit's names, each once: `alpha=0.5`, `triangles={\"share\":0.1}`"),
        ("if-none-match" = Option<String>, Header, description = "The `ETag` of a file that the client has"),
    ),
    responses(
        (
            status = 200,
            description = "The surface",
            content_type = "model/gltf-binary",
            headers(
                ("etag" = String, description = "Of what the address asks for; weak"),
                ("isopeel-statistics" = String, description = "The statistics, as JSON in ASCII"),
            ),
        ),
        (status = 304, description = "The client has it"),
        (status = 400, description = "`bad-request`: an unknown or a missing name, one that is there twice, a wrong type", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-edit`, `empty-surface` or `too-large`, as of `POST`", body = Problem, content_type = "application/problem+json"),
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
    let ExtractRequest { volume, file } = request_of(query).map_err(refused)?;
    // Whether the client may see the volume comes before what it has of it.
    let volume = state.volume(&who, &volume, file.step)?;
    let view = file.view(volume.dataset())?;
    let tag = state.tag_seed.tag(&volume, &view, &file);
    let mut response = match has(&headers, &tag) {
        true => StatusCode::NOT_MODIFIED.into_response(),
        false => answer(state, volume, file).await?,
    };
    let answered = response.headers_mut();
    answered.insert(header::ETAG, HeaderValue::from_str(&tag).map_err(ApiError::internal)?);
    for (name, value) in CACHED {
        answered.insert(name, value);
    }
    Ok(response)
}

/// Whether a client says that it has the file of this tag, or any.
fn has(headers: &HeaderMap, tag: &str) -> bool {
    let opaque = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    let shown = headers.get_all(header::IF_NONE_MATCH).iter();
    let mut tags = shown
        .filter_map(|tags| tags.to_str().ok())
        .flat_map(|tags| tags.split(','));
    tags.any(|shown| shown.trim() == "*" || opaque(shown) == opaque(tag))
}

/// What a query asks for, or what is wrong with it.
fn request_of(query: Vec<(String, String)>) -> Result<ExtractRequest, String> {
    let mut fields = Map::new();
    for (name, text) in query {
        let value = match TEXTS.contains(&name.as_str()) {
            true => Value::String(text),
            false => value_of(&name, text)?,
        };
        if fields.insert(name.clone(), value).is_some() {
            return Err(format!("{name:?} is there twice, expected it once"));
        }
    }
    serde_json::from_value(Value::Object(fields)).map_err(|error| error.to_string())
}

/// A number, an object, a list, true, false or null as JSON has it; else a text.
fn value_of(name: &str, text: String) -> Result<Value, String> {
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
        request_of(
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
        let shows = |tags: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for tags in tags {
                headers.append(header::IF_NONE_MATCH, HeaderValue::from_static(tags));
            }
            has(&headers, "W/\"ab\"")
        };
        assert!(
            shows(&["W/\"ab\""])
                && shows(&["\"ab\""])
                && shows(&["\"x\", W/\"ab\""])
                && shows(&["\"x\"", "\"ab\""])
                && shows(&["*"])
        );
        assert!(!shows(&[]) && !shows(&["\"x\""]) && !shows(&["ab"]) && !shows(&["\"abc\""]));
    }
}
