//! Sessions of pages: exchanges a token for a cookie.

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::ApiState;
use crate::access::{Identity, Role};
use crate::problem::{ApiError, Problem};

/// Credentials with which a page signs in.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionRequest {
    /// The token that the server printed, or that its file has.
    token: String,
}

/// Exchanges the token for a cookie that scripts cannot read. Programs send `Authorization: Bearer TOKEN` instead.
#[utoipa::path(
    post,
    path = "/api/v1/session",
    operation_id = "begin_session",
    tag = "session",
    request_body = SessionRequest,
    responses(
        (status = 204, description = "The cookie, if the server requires authentication", headers(("set-cookie" = String, description = "`HttpOnly; SameSite=Lax`"))),
        (status = 400, description = "`bad-json`", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "`unauthorized`: the token is not valid", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "`foreign-origin`: a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn begin(
    State(state): State<ApiState>,
    body: Result<Json<SessionRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let Json(request) = body?;
    let mut response = StatusCode::NO_CONTENT.into_response();
    if let Some(cookie) = state.access.exchange(&request.token)? {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    // The audit log reads the identity from the response.
    if let Some(who) = state.access.who(&request.token) {
        response.extensions_mut().insert(who);
    }
    Ok(response)
}

/// What the client may do.
#[derive(Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct SessionInfo {
    /// Roles of the client, with those that they imply: `edit` implies `view`, and `admin` implies all.
    roles: Vec<Role>,
    /// Seconds until the client's token expires; `null`: it does not expire.
    expires_seconds: Option<u64>,
    /// Whether the client may submit batch jobs: the server runs them (`--state-folder`), and the client has the role `export`.
    jobs: bool,
    /// Whether the client may upload volumes: the server accepts them (`--uploads`), and the client has the role `upload`.
    uploads: bool,
}

/// Whether the client may use the server, with which roles, and for how long.
#[utoipa::path(
    get,
    path = "/api/v1/session",
    operation_id = "check_session",
    tag = "session",
    responses(
        (status = 200, description = "The client may use the server", body = SessionInfo),
        (status = 401, description = "`unauthorized`: no token, or one that is not valid", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn check(State(state): State<ApiState>, who: Identity) -> Response {
    let info = SessionInfo {
        roles: Role::ALL.into_iter().filter(|&role| who.may(role)).collect(),
        expires_seconds: who.expires_seconds(),
        jobs: state.jobs.is_some() && who.may(Role::Export),
        uploads: state.uploads.is_some() && who.may(Role::Upload),
    };
    ([(header::CACHE_CONTROL, "no-store")], Json(info)).into_response()
}
