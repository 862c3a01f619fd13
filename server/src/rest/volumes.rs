//! Routes of volumes: the list, and the description of each volume.

use std::slice;
use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use isopeel_volumes::{Dataset, Unreadable, VolumeStep};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{ApiState, whole_number};
use crate::access::Identity;
use crate::problem::{ApiError, Problem};
use crate::service::{DeviceError, DeviceWorker, FieldInfo, Seat, VolumeInfo, describe, describe_expression};

/// Summary of a volume.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct VolumeSummary {
    /// Stable id in URLs and messages.
    pub id: String,
    /// Title for users.
    pub title: String,
    /// Samples along x, y, z.
    pub dims: [u32; 3],
    /// Time steps, at least 1.
    pub steps: u32,
    /// Names of the fields, the main one first.
    pub fields: Vec<String>,
    /// Notices to be shown with the data, one a line, as in the volume's description.
    pub notice: Option<String>,
    /// Name of the server that takes batch jobs and uploads, if there are several behind a proxy (`--job-server`); null: it is the one that
    /// answers.
    pub job_server: Option<String>,
}

impl VolumeSummary {
    fn new(dataset: &Dataset, job_server: Option<&str>) -> Self {
        Self {
            id: dataset.id.clone(),
            title: dataset.title.clone(),
            dims: dataset.geometry.dims,
            steps: dataset.steps,
            fields: dataset.fields.iter().map(|f| f.name.clone()).collect(),
            notice: dataset.notice(),
            job_server: job_server.map(str::to_owned),
        }
    }
}

/// The volumes that the user may see.
#[utoipa::path(
    get,
    path = "/api/v1/volumes",
    operation_id = "list_volumes",
    tag = "volumes",
    responses((status = 200, description = "All volumes, in the order they were given, the demo last, then what the user has uploaded", body = [VolumeSummary])),
)]
pub async fn list(State(state): State<ApiState>, who: Identity) -> Json<Vec<VolumeSummary>> {
    let datasets = state.catalog.list(who.reader());
    let job_server = state.job_server.as_deref();
    Json(datasets.iter().map(|d| VolumeSummary::new(d, job_server)).collect())
}

/// A path that the server was started with and that it cannot read.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct UnreadablePath {
    /// Name of the file or folder.
    pub name: String,
    /// What was found in it, and what was expected.
    pub reason: String,
}

/// The paths that the server was started with and that it cannot read.
#[utoipa::path(
    get,
    path = "/api/v1/unreadable",
    operation_id = "list_unreadable",
    tag = "volumes",
    responses((status = 200, description = "The paths, in the order they were given", body = [UnreadablePath])),
)]
pub async fn unreadable(State(state): State<ApiState>) -> Json<Vec<UnreadablePath>> {
    let catalog = state.catalog.now();
    let paths = catalog.unreadable().iter().cloned();
    Json(
        paths
            .map(|Unreadable { name, reason }| UnreadablePath { name, reason })
            .collect(),
    )
}

/// Query for a time step.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct StepQuery {
    /// Time step that ranges and histograms describe.
    #[serde(default, deserialize_with = "whole_number")]
    step: u32,
}

/// One volume: grid, fields and features with their histograms. Reads the volume the first time.
#[utoipa::path(
    get,
    path = "/api/v1/volumes/{id}",
    operation_id = "show_volume",
    tag = "volumes",
    params(("id" = String, Path, description = "A volume's id, as `GET /api/v1/volumes` lists it"), StepQuery),
    responses(
        (status = 200, description = "The volume", body = VolumeInfo),
        (status = 400, description = "`bad-request`", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`unreadable-volume`, of an upload", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume` or `device`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn show(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    query: Result<Query<StepQuery>, QueryRejection>,
) -> Result<Json<VolumeInfo>, ApiError> {
    let Path(id) = id?;
    let Query(StepQuery { step }) = query?;
    let volume = state.volume(&who, &id, step)?;
    let describe = |worker: DeviceWorker| {
        let volume = &volume;
        async move { describe(&worker, volume).await }
    };
    let described = state.perform(&who, &volume, describe).await;
    Ok(Json(described.map_err(|error| state.failed_on(&who, &volume, error))?))
}

/// Query for the field of an expression.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ExpressionQuery {
    /// An expression over the volume's fields, such as `log(rho)`, or a distance, such as `distance(labels==3)`.
    expression: String,
    /// Time step that range and histogram describe.
    #[serde(default, deserialize_with = "whole_number")]
    step: u32,
    /// Whether the user is typing the expression. If so, the response to a mistake is a problem document with status 200, which browsers do
    /// not log as an error.
    #[serde(default)]
    typed: bool,
}

/// The field that an expression over a volume's fields gives: range, histogram, and unit if that is known. A mistake in an expression is
/// reported with the position of its character. Reads the volume the first time.
#[utoipa::path(
    get,
    path = "/api/v1/volumes/{id}/expression",
    operation_id = "show_expression",
    tag = "volumes",
    params(("id" = String, Path, description = "A volume's id, as `GET /api/v1/volumes` lists it"), ExpressionQuery),
    responses(
        (status = 200, description = "The field; a problem document if `typed` and there is a mistake", content((FieldInfo = "application/json"), (Problem = "application/problem+json"))),
        (status = 400, description = "`bad-request`", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-edit`: what is wrong with the expression, and at which character; or `unreadable-volume`, of an upload", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume` or `device`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn expression(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    query: Result<Query<ExpressionQuery>, QueryRejection>,
) -> Result<Response, ApiError> {
    let Path(id) = id?;
    let Query(ExpressionQuery {
        expression,
        step,
        typed,
    }) = query?;
    let volume = state.volume(&who, &id, step)?;
    let describe = |worker: DeviceWorker| {
        let (volume, expression) = (&volume, &expression);
        async move { describe_expression(&worker, volume, expression).await }
    };
    let described = state.perform(&who, &volume, describe).await;
    match described.map_err(|error| state.failed_on(&who, &volume, error)) {
        Err(error) if typed && error.code() == "bad-edit" => {
            let mut response = error.into_response();
            *response.status_mut() = StatusCode::OK;
            Ok(response)
        }
        described => Ok(Json(described?).into_response()),
    }
}

impl ApiState {
    /// Returns a time step of a volume. For a volume that the user may not see, returns the same error as for an unknown one.
    pub(super) fn volume(&self, who: &Identity, id: &str, step: u32) -> Result<VolumeStep, ApiError> {
        let dataset = self.catalog.find(id, who.reader());
        Ok(VolumeStep::new(
            dataset.ok_or_else(|| ApiError::unknown_volume(id))?,
            step,
        )?)
    }

    /// Does work on a volume, on a device that has it or gets it. The device's time is charged to the user, unless the user is exempt from
    /// limits.
    pub(super) async fn perform<T, E: DeviceError, F>(
        &self,
        who: &Identity,
        volume: &VolumeStep,
        work: impl Fn(DeviceWorker) -> F + Send,
    ) -> Result<T, E>
    where
        F: Future<Output = Result<T, E>> + Send,
    {
        let devices = self.devices.charged_to(who.limited_user());
        devices.perform(&Seat::default(), volume, work).await
    }

    /// Converts an error of work on these volumes to a problem. An unreadable volume becomes an unknown volume if it was removed meanwhile.
    /// If it was uploaded, the status is 422 instead of 500, because the user has caused the error.
    pub(super) fn failed(&self, who: &Identity, volumes: &[Arc<Dataset>], error: impl Into<ApiError>) -> ApiError {
        let error = error.into();
        if error.code() != "unreadable-volume" {
            return error;
        }
        let is_gone = |volume: &&Arc<Dataset>| self.catalog.find(&volume.id, who.reader()).is_none();
        match volumes.iter().find(is_gone) {
            Some(volume) => ApiError::unknown_volume(&volume.id).because(error),
            None if volumes.iter().any(|volume| self.catalog.private().contains(&volume.id)) => {
                error.with_status(StatusCode::UNPROCESSABLE_ENTITY)
            }
            None => error,
        }
    }

    /// Converts an error as [`ApiState::failed`] does, for a single volume.
    pub(super) fn failed_on(&self, who: &Identity, volume: &VolumeStep, error: impl Into<ApiError>) -> ApiError {
        self.failed(who, slice::from_ref(volume.dataset()), error)
    }
}
