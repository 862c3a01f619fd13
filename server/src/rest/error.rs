//! Converts errors of other layers to problem documents.

use std::time::Duration;

use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection};
use axum::http::StatusCode;
use isopeel_extraction::WorkError;
use isopeel_view::EditError;
use isopeel_volumes::{IdentityError, UnknownStep};

use crate::export::{ExportError, MakeError};
use crate::jobs::JobError;
use crate::problem::ApiError;

impl From<WorkError> for ApiError {
    fn from(error: WorkError) -> Self {
        let status = match &error {
            WorkError::Busy
            | WorkError::HostBusy { .. }
            | WorkError::UserTime { .. }
            | WorkError::NoDevice(_)
            | WorkError::DeviceLost
            | WorkError::Reopening
            | WorkError::Cancelled => StatusCode::SERVICE_UNAVAILABLE,
            WorkError::Edit(_)
            | WorkError::TooManyTriangles { .. }
            | WorkError::OverBudget { .. }
            | WorkError::TookTooLong { .. }
            | WorkError::OverBytes { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            WorkError::TooLargeForHost { .. } => StatusCode::PAYLOAD_TOO_LARGE,
            WorkError::Unreadable(error) if error.is_of_space() => StatusCode::INSUFFICIENT_STORAGE,
            _ if error.code() == "too-large" => StatusCode::INSUFFICIENT_STORAGE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        let problem = Self::new(status, error.code(), error.public_message()).suggesting(error.suggested_triangles());
        match error {
            // The server tries to reopen the device every half second.
            WorkError::DeviceLost | WorkError::Reopening => problem.retry_after(Duration::from_secs(1)),
            WorkError::UserTime { wait, .. } => problem.retry_after(wait),
            _ => problem,
        }
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

impl From<MakeError> for ApiError {
    fn from(error: MakeError) -> Self {
        match error {
            MakeError::Work(error) => error.into(),
            MakeError::Edit(error) => error.into(),
            MakeError::Export(error) => error.into(),
            MakeError::NotClean(error) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, "not-clean", error.to_string()),
            MakeError::Empty(why) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, "empty-surface", why),
            MakeError::Panicked(error) => Self::internal(error),
        }
    }
}

impl From<JobError> for ApiError {
    fn from(error: JobError) -> Self {
        let message = error.to_string();
        let (status, code) = match error {
            JobError::UnknownVolume(id) => return Self::unknown_volume(&id),
            JobError::Work(error) => return error.into(),
            JobError::Busy => return Self::busy(message),
            JobError::Store(error) if error.is_full() => {
                let message = "the disk of the state folder is full";
                return Self::new(StatusCode::INSUFFICIENT_STORAGE, "disk-full", message).because(error);
            }
            JobError::Result(_) | JobError::Store(_) => return Self::internal(error),
            JobError::UnknownJob(_) => (StatusCode::NOT_FOUND, "unknown-job"),
            JobError::Step { .. } => (StatusCode::NOT_FOUND, "unknown-step"),
            JobError::NoResult { .. } => (StatusCode::NOT_FOUND, "no-result"),
            JobError::BadKey(_) => (StatusCode::BAD_REQUEST, "bad-request"),
            JobError::KeyReused { .. } => (StatusCode::CONFLICT, "key-reused"),
            JobError::NotFinished(_) => (StatusCode::CONFLICT, "job-not-finished"),
            JobError::Finished { .. } => (StatusCode::CONFLICT, "job-finished"),
            JobError::Edit { .. } => (StatusCode::UNPROCESSABLE_ENTITY, "bad-edit"),
            JobError::Extractions(_) => (StatusCode::UNPROCESSABLE_ENTITY, "bad-job"),
            JobError::TooMany { .. } => (StatusCode::TOO_MANY_REQUESTS, "too-many-jobs"),
            JobError::OverQuota { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "over-quota"),
            JobError::Input(IdentityError::Changed { .. }) => (StatusCode::CONFLICT, "input-changed"),
            JobError::Input(IdentityError::Unreadable { .. }) => {
                (StatusCode::INTERNAL_SERVER_ERROR, "unreadable-volume")
            }
            JobError::Input(IdentityError::Network(_) | IdentityError::TooManyFiles) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "bad-job")
            }
        };
        Self::new(status, code, message)
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
            // Invalid JSON and unexpected JSON have the same code, as on the WebSocket.
            _ => (StatusCode::BAD_REQUEST, "bad-json"),
        };
        Self::new(status, code, error.body_text())
    }
}
