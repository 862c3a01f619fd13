//! HTTP errors: `application/problem+json` (RFC 9457), each with a stable code.

use std::time::Duration;

use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::error::{self, BoxError};
use crate::metrics;

/// An error of a request: a message for users, a code for programs, and a cause that only the log contains.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ApiError {
    status: StatusCode,
    code: &'static str,
    message: String,
    #[source]
    cause: Option<BoxError>,
    /// A budget of triangles to try.
    suggested_triangles: Option<u64>,
    /// The methods that the path accepts, if the error is another method.
    allow: Option<&'static str>,
    /// Time to wait before a retry, if it is known.
    retry_after: Option<Duration>,
}

/// The code of a problem, attached to its HTTP response as an extension.
#[derive(Clone, Copy, Debug)]
pub struct ProblemCode(pub &'static str);

/// Body of every error answer.
#[derive(Debug, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Problem {
    /// URI of the kind of problem: `urn:isopeel:problem:` and the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The HTTP status in words.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// What was wrong and what was expected.
    pub detail: String,
    /// What programs tell problems apart by: `bad-edit`, `bad-job`, `bad-json`, `bad-range`, `bad-request`, `bad-slice`, `bad-upload`, `body-too-large`,
    /// `busy`, `device`, `disk-full`, `empty-surface`, `forbidden`, `foreign-host`, `foreign-origin`, `input-changed`, `internal`, `job-finished`, `job-not-finished`,
    /// `jobs-off`, `key-reused`, `method-not-allowed`, `no-result`, `not-found`, `over-budget`, `over-declared`, `over-quota`, `taken-over`, `too-large`, `too-many-jobs`,
    /// `too-many-requests`, `too-many-tickets`, `too-many-uploads`, `unauthorized`, `unknown-field`, `unknown-job`, `unknown-step`, `unknown-upload`,
    /// `unknown-volume`, `unreadable-volume`, `unsupported-media-type`, `unsupported-version`, `upload-finished`, `upload-incomplete`, `upload-locked`,
    /// `uploads-off` or `wrong-offset`.
    pub code: &'static str,
    /// If the surface has more triangles than a limit (`too-large`) or its budget (`over-budget`) allows: a budget (`triangles`) to try.
    #[cfg_attr(test, ts(optional))]
    #[serde(rename = "suggestedTriangles", skip_serializing_if = "Option::is_none")]
    pub suggested_triangles: Option<u64>,
}

/// Default `Retry-After` in seconds if the server is busy. A typical extraction takes less.
const RETRY_AFTER: HeaderValue = HeaderValue::from_static("2");

impl ApiError {
    /// Creates an error with a status, a stable code and a message.
    pub fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self {
            status,
            code,
            message: message.into(),
            cause: None,
            suggested_triangles: None,
            allow: None,
            retry_after: None,
        }
    }

    /// Adds the time to wait before a retry.
    #[must_use]
    pub fn retry_after(mut self, time: Duration) -> Self {
        self.retry_after = Some(time);
        self
    }

    /// Adds the cause, for the log.
    #[must_use]
    pub fn because(mut self, cause: impl Into<BoxError>) -> Self {
        self.cause = Some(cause.into());
        self
    }

    /// Adds a budget of triangles to try.
    #[must_use]
    pub fn suggesting(mut self, triangles: Option<u64>) -> Self {
        self.suggested_triangles = triangles;
        self
    }

    /// Returns the same error with another status.
    #[must_use]
    pub fn with_status(self, status: StatusCode) -> Self {
        Self { status, ..self }
    }

    /// Returns the error for an unknown path.
    pub fn not_found(path: &str) -> Self {
        let message = format!("nothing at {path:?}, /api/v1/openapi.json lists what there is");
        Self::new(StatusCode::NOT_FOUND, "not-found", message)
    }

    /// Returns the error for a method that a path does not accept. `allow` lists the accepted methods.
    pub fn method_not_allowed(method: &Method, path: &str, allow: &'static str) -> Self {
        Self {
            allow: Some(allow),
            ..Self::method_unknown(method, path)
        }
    }

    /// Returns the same error as [`ApiError::method_not_allowed`], for responses to which the router adds the header `Allow`.
    pub fn method_unknown(method: &Method, path: &str) -> Self {
        let message = format!("{path:?} does not know the method {method}");
        Self::new(StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed", message)
    }

    /// Returns the error for an unknown volume.
    pub fn unknown_volume(id: &str) -> Self {
        let message = format!(
            "no volume has the id {id:?}, /api/v1/volumes lists those there are{}",
            of_another_server(id)
        );
        Self::new(StatusCode::NOT_FOUND, "unknown-volume", message)
    }

    /// Returns the error for a temporary overload. The client may try again later.
    pub fn busy(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "busy", message)
    }

    /// Returns the error for a fault of the server. The log contains the cause, and the response does not.
    pub fn internal(cause: impl Into<BoxError>) -> Self {
        let message = "the server failed, its log says why";
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", message).because(cause)
    }

    /// Returns the HTTP status.
    pub fn status(&self) -> StatusCode {
        self.status
    }

    /// Returns the stable code.
    pub fn code(&self) -> &'static str {
        self.code
    }

    pub(crate) fn log(&self) {
        let why = error::chain(self);
        if self.status.is_server_error() && self.code != "busy" {
            tracing::error!(code = self.code, "{why}");
        } else {
            tracing::debug!(code = self.code, "{why}");
        }
    }
}

/// Returns what to add to a message about an unknown volume: if it was uploaded, one of several servers has it.
pub fn of_another_server(volume: &str) -> &'static str {
    match volume.starts_with("upload-") {
        true => "; an upload belongs to the server that took it",
        false => "",
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        self.log();
        metrics::problem(self.code);
        let problem = Problem {
            kind: format!("urn:isopeel:problem:{}", self.code),
            title: self.status.canonical_reason().unwrap_or("Error").to_owned(),
            status: self.status.as_u16(),
            detail: self.message,
            code: self.code,
            suggested_triangles: self.suggested_triangles,
        };
        let mut response = (self.status, axum::Json(problem)).into_response();
        response.extensions_mut().insert(ProblemCode(self.code));
        let headers = response.headers_mut();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/problem+json"),
        );
        if let Some(methods) = self.allow {
            headers.insert(header::ALLOW, HeaderValue::from_static(methods));
        }
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if let Some(time) = self.retry_after {
            // Whole seconds plus one, so that no client retries too early.
            headers.insert(header::RETRY_AFTER, (time.as_secs() + 1).into());
        } else if self.code == "busy" {
            headers.insert(header::RETRY_AFTER, RETRY_AFTER);
        }
        response
    }
}
