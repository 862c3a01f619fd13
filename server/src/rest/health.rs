//! Liveness and readiness probes, and memory statistics.

use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use isopeel_extraction::{MemoryUse, WorkError};
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use crate::problem::{ApiError, Problem};
use crate::service::{DeviceState, DeviceWorker, Preparation};

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

/// Whether the server accepts new requests: a device is open and reads a byte within five seconds, and the server is not shutting down.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "health",
    responses(
        (status = 200, description = "A device is ready", body = String, content_type = "text/plain"),
        (status = 503, description = "No device is open yet, could be opened, or answers; or the server is shutting down", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn readyz(State(state): State<ApiState>) -> Result<&'static str, ApiError> {
    if state.is_draining.load(Ordering::Relaxed) {
        return Err(ApiError::busy(
            "the server is about to end, and answers those who have found it",
        ));
    }
    if state.devices.answers_within(ANSWER_LIMIT).await {
        return Ok("ready\n");
    }
    match state.devices.members() {
        [device] => Err(why_not_ready(device.state())),
        devices => {
            let why = devices.iter().map(|device| {
                let number = device.number().index();
                format!("device {number}: {}", why_not_ready(device.state()))
            });
            let why: Vec<_> = why.collect();
            Err(ApiError::busy(format!("no device is ready. {}", why.join(". "))))
        }
    }
}

/// Returns the error of a device that does not answer.
fn why_not_ready(state: DeviceState) -> ApiError {
    match state {
        DeviceState::Ready(_) => ApiError::busy(format!(
            "the device has not answered for {} s: its driver is stuck, or it has too much to do",
            ANSWER_LIMIT.as_secs()
        )),
        DeviceState::Opening(Preparation { of: 0, .. }) => ApiError::busy("the device is being opened"),
        DeviceState::Opening(Preparation { done, of }) => {
            ApiError::busy(format!("the device is being prepared: {done} of {of} steps are done"))
        }
        DeviceState::Lost | DeviceState::NeedsNewProcess => WorkError::Reopening.into(),
        DeviceState::Failed(error) => WorkError::NoDevice(error).into(),
    }
}

/// Use of the server's memory, summed over its devices.
#[utoipa::path(
    get,
    path = "/api/v1/memory",
    operation_id = "show_memory",
    tag = "health",
    responses(
        (status = 200, description = "Bytes by use, as of the last job of each device", body = MemoryUse),
        (status = 503, description = "No device could be opened", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn memory(State(state): State<ApiState>) -> Result<Json<MemoryUse>, ApiError> {
    state.devices.ready().await?;
    let open = state.devices.members().iter().filter_map(DeviceWorker::memory_now);
    let used = open.reduce(MemoryUse::with);
    // A device may have been lost since.
    Ok(Json(used.ok_or(WorkError::Reopening)?))
}

/// State of a device of the server.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct DeviceStatus {
    /// Number of the device among those of the server, from 0: the label `device` of metrics.
    device: usize,
    /// Name of the device, if it is open.
    name: Option<String>,
    /// Whether the device can be used.
    state: DeviceReadiness,
    /// Why the device cannot be used, or how far it is from being open.
    detail: Option<String>,
    /// Id of the process that uses the device, if it is one of its own.
    process: Option<u32>,
    /// Jobs that wait for the device.
    queued_jobs: usize,
    /// Volumes that are assigned to the device; 0 if the server has one device.
    volumes: usize,
    /// Use of memory, as of the device's last job, if it is open.
    memory: Option<MemoryUse>,
}

/// Whether a device can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum DeviceReadiness {
    /// The device is being opened.
    Opening,
    /// The device is open.
    Ready,
    /// The device was lost and is being opened again.
    Lost,
    /// The device could not be opened, or must not be used.
    Failed,
}

impl DeviceStatus {
    fn new(device: &DeviceWorker, volumes: usize) -> Self {
        let state = device.state();
        let (name, detail) = match &state {
            DeviceState::Ready(info) => (Some(info.name.clone()), None),
            _ => (None, Some(why_not_ready(state.clone()).to_string())),
        };
        Self {
            device: device.number().index(),
            name,
            state: match state {
                DeviceState::Opening(_) => DeviceReadiness::Opening,
                DeviceState::Ready(_) => DeviceReadiness::Ready,
                DeviceState::Lost | DeviceState::NeedsNewProcess => DeviceReadiness::Lost,
                DeviceState::Failed(_) => DeviceReadiness::Failed,
            },
            detail,
            process: device.process(),
            queued_jobs: device.queued(),
            volumes,
            memory: device.memory_now(),
        }
    }
}

/// The devices of the server: state, queue, volumes and memory of each.
#[utoipa::path(
    get,
    path = "/api/v1/devices",
    operation_id = "list_devices",
    tag = "health",
    responses((status = 200, description = "The devices, in the order of their numbers", body = [DeviceStatus])),
)]
pub async fn devices(State(state): State<ApiState>) -> Json<Vec<DeviceStatus>> {
    let devices = state.devices.members().iter();
    Json(
        devices
            .map(|device| DeviceStatus::new(device, state.devices.assigned(device)))
            .collect(),
    )
}
