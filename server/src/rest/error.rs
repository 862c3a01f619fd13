//! The problem documents of other layers' errors.

use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection};
use axum::http::StatusCode;

use crate::export::ExportError;
use crate::extraction::WorkError;
use crate::problem::ApiError;
use crate::view::EditError;
use crate::volumes::UnknownStep;

impl From<WorkError> for ApiError {
    fn from(error: WorkError) -> Self {
        let status = match &error {
            WorkError::Busy | WorkError::HostBusy { .. } | WorkError::NoDevice(_) | WorkError::Cancelled => {
                StatusCode::SERVICE_UNAVAILABLE
            }
            WorkError::Edit(_)
            | WorkError::TooManyTriangles { .. }
            | WorkError::OverBudget { .. }
            | WorkError::OverBytes { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            WorkError::TooLargeForHost { .. } => StatusCode::PAYLOAD_TOO_LARGE,
            _ if error.code() == "too-large" => StatusCode::INSUFFICIENT_STORAGE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self::new(status, error.code(), error.public_message())
            .suggesting(error.suggested_triangles())
            .because(error)
    }
}

impl From<EditError> for ApiError {
    fn from(error: EditError) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, "bad-edit", error.to_string())
    }
}

impl From<UnknownStep> for ApiError {
    fn from(error: UnknownStep) -> Self {
        Self::new(StatusCode::NOT_FOUND, "unknown-step", error.to_string())
    }
}

impl From<ExportError> for ApiError {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::TooLarge { .. } | ExportError::OutOfRange(_) => {
                Self::new(StatusCode::UNPROCESSABLE_ENTITY, "too-large", error.to_string())
            }
            other => Self::internal(other),
        }
    }
}

impl From<PathRejection> for ApiError {
    fn from(error: PathRejection) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad-request", error.body_text())
    }
}

impl From<QueryRejection> for ApiError {
    fn from(error: QueryRejection) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad-request", error.body_text())
    }
}

impl From<JsonRejection> for ApiError {
    fn from(error: JsonRejection) -> Self {
        let status = error.status();
        let (status, code) = match status {
            StatusCode::UNSUPPORTED_MEDIA_TYPE => (status, "unsupported-media-type"),
            StatusCode::PAYLOAD_TOO_LARGE => (status, "body-too-large"),
            _ if matches!(error, JsonRejection::BytesRejection(_)) => (status, "bad-request"),
            // No JSON, or not the expected JSON: one code, as on the WebSocket.
            _ => (StatusCode::BAD_REQUEST, "bad-json"),
        };
        Self::new(status, code, error.body_text())
    }
}
