//! Liveness and readiness probes, and memory statistics.

use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use isopeel_extraction::{MemoryUse, WorkError};

use super::ApiState;
use crate::problem::{ApiError, Problem};
use crate::service::{DeviceState, Preparation};

/// Time limit of the readiness check for the smallest device job, a read of one byte. Probes often have the same time-out.
const ANSWER_LIMIT: Duration = Duration::from_secs(5);

/// Whether the process answers.
#[utoipa::path(
    get,
    path = "/healthz",
    tag = "health",
    responses((status = 200, description = "The server is running", body = String, content_type = "text/plain")),
)]
pub async fn healthz() -> &'static str {
    "ok\n"
}

/// Whether the server accepts new requests: the device is open and reads a byte within five seconds, and the server is not shutting down.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "health",
    responses(
        (status = 200, description = "The device is ready", body = String, content_type = "text/plain"),
        (status = 503, description = "The device is being opened, could not be opened, or does not answer; or the server is shutting down", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn readyz(State(state): State<ApiState>) -> Result<&'static str, ApiError> {
    if state.is_draining.load(Ordering::Relaxed) {
        return Err(ApiError::busy(
            "the server is about to end, and answers those who have found it",
        ));
    }
    match state.worker.state() {
        DeviceState::Ready(_) if state.worker.answers_within(ANSWER_LIMIT).await => Ok("ready\n"),
        DeviceState::Ready(_) => Err(ApiError::busy(format!(
            "the device has not answered for {} s: its driver is stuck, or it has too much to do",
            ANSWER_LIMIT.as_secs()
        ))),
        DeviceState::Opening(Preparation { of: 0, .. }) => Err(ApiError::busy("the device is being opened")),
        DeviceState::Opening(Preparation { done, of }) => Err(ApiError::busy(format!(
            "the device is being prepared: {done} of {of} steps are done"
        ))),
        DeviceState::Lost | DeviceState::NeedsNewProcess => Err(WorkError::Reopening.into()),
        DeviceState::Failed(error) => Err(WorkError::NoDevice(error).into()),
    }
}

/// Use of the server's memory.
#[utoipa::path(
    get,
    path = "/api/v1/memory",
    operation_id = "show_memory",
    tag = "health",
    responses(
        (status = 200, description = "Bytes by use, as of the device's last job", body = MemoryUse),
        (status = 503, description = "The device could not be opened", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn memory(State(state): State<ApiState>) -> Result<Json<MemoryUse>, ApiError> {
    Ok(Json(state.worker.memory().await?))
}
