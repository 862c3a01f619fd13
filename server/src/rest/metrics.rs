//! The route `/metrics`, for Prometheus and compatible programs.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use isopeel_extraction::MemoryUse;

use super::ApiState;
use crate::metrics::{self, DeviceNumber};
use crate::problem::{ApiError, Problem};
use crate::service::{DevicePool, DeviceWorker};

/// Media type of the metrics, with the version of Prometheus' text format that `metrics::render` writes.
const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Counts and times of requests, viewers, edits, stages and jobs of the device, batch jobs, memory and errors, in Prometheus' text format. No
/// names of volumes are among them. Needs a token for `admin`; `--metrics-listen` serves it without one, on an address of its own.
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "show_metrics",
    tag = "health",
    responses(
        (status = 200, description = "The metrics", body = String, content_type = "text/plain"),
        (status = 401, description = "`unauthorized`: no token, or another one", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "`forbidden`: the token is not for `admin`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn show(State(state): State<ApiState>) -> Result<Response, ApiError> {
    state
        .devices
        .members()
        .iter()
        .for_each(|device| report_device(&state.devices, device));
    metrics::set_running_exports(state.exports.running_count());
    if let Some(jobs) = &state.jobs {
        for (state, count) in jobs.counts().await? {
            metrics::set_batch_jobs(state.name(), count);
        }
    }
    if let Some(uploads) = &state.uploads {
        let (counts, bytes) = uploads.counts();
        for (state, count) in counts {
            metrics::set_uploads(state.name(), count);
        }
        metrics::set_upload_bytes(bytes);
    }
    let text = metrics::render().ok_or_else(|| ApiError::internal("nothing is counted"))?;
    Ok(([(header::CONTENT_TYPE, CONTENT_TYPE)], text).into_response())
}

/// Sets the gauges of a device.
fn report_device(devices: &DevicePool, device: &DeviceWorker) {
    let (number, used) = (device.number(), device.memory_now());
    metrics::set_queued_jobs(number, device.queued());
    metrics::set_device(number, used.is_some(), devices.assigned(device));
    // A device that is not open has no memory to report.
    if let Some(used) = used {
        report_memory(number, &used);
    }
}

/// Sets the memory gauges of a device.
fn report_memory(device: DeviceNumber, used: &MemoryUse) {
    for (owner, bytes) in [
        ("volumes", used.volume_bytes),
        ("pyramids", used.pyramid_bytes),
        ("trees", used.tree_bytes),
        ("cuts", used.cut_bytes),
        ("device-other", used.other_device_bytes),
        ("device-idle", used.idle_bytes),
        ("surfaces", used.surface_bytes),
        ("program", used.program_bytes),
    ] {
        metrics::set_device_memory(device, owner, bytes);
    }
    metrics::set_resident_bytes(used.resident_bytes);
}
