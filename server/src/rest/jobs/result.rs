//! Downloads of the files of a batch job.

use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{self, HeaderMap};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use data_encoding::HEXLOWER;

use crate::access::Identity;
use crate::jobs::ResultInfo;
use crate::problem::{ApiError, Problem};
use crate::rest::ApiState;
use crate::rest::extract::File;
use crate::rest::ranges::{RequestedRange, content_range};

/// Header with the SHA-256 of a whole result, `Repr-Digest` (RFC 9530).
pub const DIGEST_HEADER: HeaderName = HeaderName::from_static("repr-digest");

/// The file of an extraction, or one range of it.
#[utoipa::path(
    get,
    path = "/api/v1/jobs/{id}/results/{extraction}",
    operation_id = "fetch_job_result",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "A job's id"),
        ("extraction" = u32, Path, description = "Number of the extraction, from 0"),
        ("range" = Option<String>, Header, description = "`bytes=FIRST-LAST`: the requested range of the file"),
    ),
    responses(
        (
            status = 200,
            description = "The file",
            body = File,
            content_type = "model/gltf-binary",
            headers(
                ("repr-digest" = String, description = "`sha-256=:BASE64:` of the whole file"),
                ("etag" = String, description = "SHA-256 of the file, in hexadecimal"),
            ),
        ),
        (status = 206, description = "The requested range of the file", body = File, content_type = "application/octet-stream"),
        (status = 304, description = "The client has the file already (`If-None-Match`)"),
        (status = 400, description = "`bad-request`: the path has no valid number of an extraction", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-job`, or `no-result`: it is not made yet, failed, or its surface is empty", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "`bad-range`: beyond the end of the file", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn result(
    State(state): State<ApiState>,
    who: Identity,
    path: Result<Path<(String, u32)>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let jobs = state.jobs()?;
    let Path((id, extraction)) = path?;
    let info = jobs.result(who.user(), &id, extraction).await?;
    let etag = etag(&info);
    if headers.get(header::IF_NONE_MATCH).is_some_and(|tag| *tag == *etag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, etag)]).into_response());
    }
    let range = match RequestedRange::from_headers(&headers, &etag, info.bytes) {
        RequestedRange::Whole => None,
        RequestedRange::Part(range) => Some(range),
        RequestedRange::NotSatisfiable(response) => return Ok(response),
    };
    let part = range.clone().unwrap_or(0..info.bytes);
    let body = Body::from_stream(jobs.read(&id, extraction, part.clone()).await?);
    let name = format!("attachment; filename=\"{}\"", download_name(extraction, &info));
    let response = Response::builder()
        .header(header::CONTENT_TYPE, info.format.content_type())
        .header(header::CONTENT_LENGTH, part.end - part.start)
        .header(header::CONTENT_DISPOSITION, name)
        .header(header::ACCEPT_RANGES, "bytes")
        .header(header::CACHE_CONTROL, "private, no-cache")
        .header(DIGEST_HEADER, format!("sha-256=:{}:", STANDARD.encode(info.checksum)))
        .header(header::ETAG, etag);
    let response = match range {
        None => response,
        Some(range) => response
            .status(StatusCode::PARTIAL_CONTENT)
            .header(header::CONTENT_RANGE, content_range(&range, info.bytes)),
    };
    response.body(body).map_err(ApiError::internal)
}

/// Returns the file name of a download, such as `00002-517.5.glb`: number of the extraction and isovalue.
fn download_name(extraction: u32, info: &ResultInfo) -> String {
    let iso = info.iso.map(|iso| format!("-{iso}")).unwrap_or_default();
    format!("{extraction:05}{iso}.{}", info.format.extension())
}

fn etag(info: &ResultInfo) -> String {
    format!("\"{}\"", HEXLOWER.encode(&info.checksum))
}
