//! Tickets for the stream.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use crate::access::{Identity, TICKET_LIFETIME};
use crate::problem::{ApiError, Problem};

/// A ticket.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct TicketInfo {
    /// The ticket, for a single use in `/api/v1/stream?ticket=`.
    ticket: String,
    /// Seconds until the ticket expires.
    expires_seconds: u64,
}

/// Makes a ticket with which a page of another origin (`--allow-origin`) opens a stream: browsers let such a page send neither a header nor
/// a cookie. A ticket is valid once, and only for pages of the origin that requested it. When the token ends, so does the stream.
#[utoipa::path(
    post,
    path = "/api/v1/tickets",
    operation_id = "issue_ticket",
    tag = "session",
    params(("volume" = Option<String>, Query, description = "The volume of the stream, so that a proxy of several servers requests the ticket of the one that gets the stream; the server ignores it")),
    responses(
        (status = 201, description = "The ticket", body = TicketInfo),
        (status = 401, description = "`unauthorized`: no token, or another one", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "`forbidden`: the token is not for looking; `foreign-origin`", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "`too-many-tickets`: too many were not used", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn issue(State(state): State<ApiState>, who: Identity, headers: HeaderMap) -> Result<Response, ApiError> {
    let info = TicketInfo {
        ticket: state.access.issue_ticket(&who, headers.get(header::ORIGIN))?,
        expires_seconds: TICKET_LIFETIME.as_secs(),
    };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(info)).into_response())
}
