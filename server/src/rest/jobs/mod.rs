//! Routes of batch jobs.

mod events;
mod result;

use axum::Json;
use axum::extract::rejection::{JsonRejection, PathRejection};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub use events::LAST_EVENT_ID;
pub use result::DIGEST_HEADER;

use super::ApiState;
use crate::access::Identity;
use crate::jobs::{JobInfo, JobRequest, Jobs, MAX_REQUEST_BYTES, ManifestEntry};
use crate::problem::{ApiError, Problem};

/// Header that identifies a request, so that a repeated request does not create another job.
pub const KEY_HEADER: HeaderName = HeaderName::from_static("idempotency-key");

/// Returns the routes of batch jobs.
pub(super) fn routed() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(submit, list))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .routes(routes!(show, remove))
        .routes(routes!(cancel))
        .routes(routes!(events::events))
        .routes(routes!(manifest))
        .routes(routes!(result::result))
}

impl ApiState {
    /// Returns the batch jobs, or an error if the server has no state folder for them.
    fn jobs(&self) -> Result<&Jobs, ApiError> {
        self.jobs.as_ref().ok_or_else(|| {
            let message = match &self.job_server {
                None => "this server keeps no batch jobs, expected one that was started with --state-folder DIR".into(),
                Some(name) => format!(
                    "this server keeps no batch jobs: of the servers behind this address, {name:?} takes them and has those there are"
                ),
            };
            ApiError::new(StatusCode::NOT_IMPLEMENTED, "jobs-off", message)
        })
    }
}

/// Accepts a batch job: 1 to 10,000 surfaces of one volume, which are made one after the other and kept until the job is deleted, also when
/// the server ends in between. What they take is estimated first.
#[utoipa::path(
    post,
    path = "/api/v1/jobs",
    operation_id = "submit_job",
    tag = "jobs",
    request_body = JobRequest,
    params(("idempotency-key" = Option<String>, Header, description = "1 to 255 visible ASCII characters: the same request with the same key makes one job")),
    responses(
        (
            status = 201,
            description = "The job, which is queued",
            body = JobInfo,
            headers(("location" = String, description = "Path of the job")),
            links(
                ("show_job" = (operation_id = "show_job", parameters(("id" = "$response.body#/id")))),
                ("show_job_results" = (operation_id = "show_job_results", parameters(("id" = "$response.body#/id")))),
                ("cancel_job" = (operation_id = "cancel_job", parameters(("id" = "$response.body#/id")))),
                ("remove_job" = (operation_id = "remove_job", parameters(("id" = "$response.body#/id")))),
            ),
        ),
        (status = 200, description = "The job that an earlier request with the same key and body created", body = JobInfo),
        (status = 400, description = "`bad-json`, or `bad-request`: a malformed key", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`key-reused`: the key belongs to another request; or `input-changed`: the files are not those that the server opened", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`body-too-large`: more than 8 MiB; `over-quota`; or `too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-job`: too many extractions, none, or a volume that cannot be pinned; `bad-edit`: a value out of range", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "`too-many-jobs`", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume`, `device` or `internal`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`: the server has no `--state-folder`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`disk-full`, or `too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn submit(
    State(state): State<ApiState>,
    who: Identity,
    headers: HeaderMap,
    body: Result<Json<JobRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let jobs = state.jobs()?;
    let Json(request) = body?;
    let key = headers
        .get(KEY_HEADER)
        .map(|key| String::from_utf8_lossy(key.as_bytes()).into_owned());
    let (job, is_new) = jobs.submit(who.reader(), key, request).await?;
    let location = format!("/api/v1/jobs/{}", job.id);
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, [(header::LOCATION, location)], Json(job)).into_response())
}

/// The batch jobs of the user, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/jobs",
    operation_id = "list_jobs",
    tag = "jobs",
    responses(
        (status = 200, description = "All jobs, without their failures", body = [JobInfo]),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn list(State(state): State<ApiState>, who: Identity) -> Result<Json<Vec<JobInfo>>, ApiError> {
    Ok(Json(state.jobs()?.list(who.user()).await?))
}

/// One batch job.
#[utoipa::path(
    get,
    path = "/api/v1/jobs/{id}",
    operation_id = "show_job",
    tag = "jobs",
    params(("id" = String, Path, description = "A job's id")),
    responses(
        (status = 200, description = "The job", body = JobInfo),
        (status = 404, description = "`unknown-job`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn show(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<JobInfo>, ApiError> {
    Ok(Json(state.jobs()?.get(who.user(), &id?.0).await?))
}

/// The manifest of a batch job: all extractions in their order, each with its file, triangles, measured error and checksum, or why there is
/// no file.
#[utoipa::path(
    get,
    path = "/api/v1/jobs/{id}/results",
    operation_id = "show_job_results",
    tag = "jobs",
    params(("id" = String, Path, description = "A job's id")),
    responses(
        (status = 200, description = "The manifest", body = [ManifestEntry]),
        (status = 404, description = "`unknown-job`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn manifest(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<Vec<ManifestEntry>>, ApiError> {
    Ok(Json(state.jobs()?.manifest(who.user(), &id?.0).await?))
}

/// Cancels a batch job that is queued or running. The results that it has made are kept.
#[utoipa::path(
    post,
    path = "/api/v1/jobs/{id}/cancel",
    operation_id = "cancel_job",
    tag = "jobs",
    params(("id" = String, Path, description = "A job's id")),
    responses(
        (status = 200, description = "The job, cancelled", body = JobInfo),
        (status = 404, description = "`unknown-job`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`job-finished`: the job is finished already", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn cancel(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<JobInfo>, ApiError> {
    Ok(Json(state.jobs()?.cancel(who.user(), &id?.0).await?))
}

/// Removes a finished batch job and its results.
#[utoipa::path(
    delete,
    path = "/api/v1/jobs/{id}",
    operation_id = "remove_job",
    tag = "jobs",
    params(("id" = String, Path, description = "A job's id")),
    responses(
        (status = 204, description = "The job is removed"),
        (status = 404, description = "`unknown-job`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`job-not-finished`: cancel it first", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn remove(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<StatusCode, ApiError> {
    state.jobs()?.delete(who.user(), &id?.0).await?;
    Ok(StatusCode::NO_CONTENT)
}
