//! The viewer in a frame of a page of another site: the origins that may embed it, and tokens for it.

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::ApiState;
use crate::access::{DEFAULT_DELEGATED_SECONDS, DelegateError, Identity, Role};
use crate::problem::{ApiError, Problem};

/// Pages that may embed the viewer in a frame.
#[derive(Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct EmbedInfo {
    /// Origins of these pages, in addition to the server's own. Only they may pass a token to the viewer.
    origins: Vec<String>,
}

/// The roles and the lifetime of a token for a frame.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EmbedTokenRequest {
    /// Roles of the token: `view`, `edit` or both.
    #[serde(default = "default_roles")]
    #[schema(default = json!(["view"]), min_items = 1)]
    roles: Vec<Role>,
    /// Seconds until the token expires, 10 to 3600.
    #[serde(default = "default_seconds")]
    #[schema(default = 600, minimum = 10, maximum = 3600)]
    seconds: u64,
}

fn default_roles() -> Vec<Role> {
    vec![Role::View]
}

fn default_seconds() -> u64 {
    DEFAULT_DELEGATED_SECONDS
}

/// A token for a frame.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct EmbedTokenInfo {
    /// The token. The page passes it to the frame by `postMessage`; other clients send it as `Authorization: Bearer`.
    token: String,
    /// Roles of the token.
    roles: Vec<Role>,
    /// Seconds until the token expires.
    expires_seconds: u64,
}

/// Origins whose pages may have the viewer in a frame, as the policy of each answer has them (`--embed-origin`, `--allow-origin`).
#[utoipa::path(
    get,
    path = "/api/v1/embed",
    operation_id = "show_embed",
    tag = "session",
    responses((status = 200, description = "The origins", body = EmbedInfo)),
)]
pub async fn show(State(state): State<ApiState>) -> Json<EmbedInfo> {
    let origins = state.access.frame_origins().map(ToString::to_string).collect();
    Json(EmbedInfo { origins })
}

/// Makes a token for the viewer in a frame of another site's page. That site's server requests it with a token of its own, and the page
/// hands it to the frame. The new token allows no more than the one that requested it and ends with it. It is accepted in `Authorization:
/// Bearer` alone: it cannot be exchanged for a cookie, nor be used to make further tokens.
#[utoipa::path(
    post,
    path = "/api/v1/embed-tokens",
    operation_id = "lend_embed_token",
    tag = "session",
    request_body = EmbedTokenRequest,
    responses(
        (status = 201, description = "The token", body = EmbedTokenInfo),
        (status = 400, description = "`bad-json`; `bad-embed-token`: invalid roles or seconds", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "`unauthorized`: no token, or one that is not valid", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "`forbidden`: the token lacks a role, or is a delegated one itself; `foreign-origin`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`no-auth`: the server runs without authentication", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "`too-many-embed-tokens`: the maximum of delegated tokens is valid", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn lend(
    State(state): State<ApiState>,
    who: Identity,
    body: Result<Json<EmbedTokenRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let Json(EmbedTokenRequest { roles, seconds }) = body?;
    let token = state.access.lend(&who, roles.clone(), seconds).map_err(refusal)?;
    let info = EmbedTokenInfo {
        token: token.text().to_owned(),
        roles,
        expires_seconds: who.expires_seconds().map_or(seconds, |own| own.min(seconds)),
    };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(info)).into_response())
}

fn refusal(error: DelegateError) -> ApiError {
    let refuse = |status, code| ApiError::new(status, code, error.to_string());
    match &error {
        DelegateError::NoAuth => refuse(StatusCode::CONFLICT, "no-auth"),
        DelegateError::Delegated | DelegateError::NotOwn(..) => refuse(StatusCode::FORBIDDEN, "forbidden"),
        DelegateError::Role(_) | DelegateError::NoRoles | DelegateError::Seconds(_) => {
            refuse(StatusCode::BAD_REQUEST, "bad-embed-token")
        }
        DelegateError::TooMany { wait, .. } => {
            refuse(StatusCode::TOO_MANY_REQUESTS, "too-many-embed-tokens").retry_after(*wait)
        }
        DelegateError::Random(_) => ApiError::internal(error),
    }
}
