//! The viewer in a frame of a page of another site: the origins that may embed it, and tokens for it.

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::ApiState;
use crate::access::{DEFAULT_LENT_SECONDS, DelegateError, Identity, Role};
use crate::problem::{ApiError, Problem};

/// Pages that may have the viewer in a frame.
#[derive(Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct EmbedInfo {
    /// Origins of pages that may, beside those of the server itself; they alone may hand a token to it.
    origins: Vec<String>,
}

/// The roles and the lifetime of a token for a frame.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EmbedTokenRequest {
    /// `view`, or `edit` too.
    #[serde(default = "default_roles")]
    #[schema(default = json!(["view"]), min_items = 1)]
    roles: Vec<Role>,
    /// 10 to 3600.
    #[serde(default = "default_seconds")]
    #[schema(default = 600, minimum = 10, maximum = 3600)]
    seconds: u64,
}

fn default_roles() -> Vec<Role> {
    vec![Role::View]
}

fn default_seconds() -> u64 {
    DEFAULT_LENT_SECONDS
}

/// A token for a frame.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct EmbedTokenInfo {
    /// For the frame, by `postMessage`, or for `Authorization: Bearer`.
    token: String,
    /// Its roles.
    roles: Vec<Role>,
    /// Seconds until it expires.
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
        (status = 400, description = "`bad-json`; `bad-embed-token`: roles or seconds that cannot be", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "`unauthorized`: no token, or another one", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "`forbidden`: the token is not for that, or is such a one itself; `foreign-origin`", body = Problem, content_type = "application/problem+json"),
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
