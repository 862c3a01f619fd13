//! Routes of uploads. Clients send parts by the core protocol of tus 1.0 (<https://tus.io/protocols/resumable-upload>), which has clients
//! in many languages. The requests that begin and finish an upload are specific to isopeel, because an upload has many files and becomes a
//! volume.

use std::time::Duration;

use axum::Json;
use axum::body::{Body, BodyDataStream};
use axum::extract::rejection::{JsonRejection, PathRejection};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::extract::File;
use super::{ApiState, KEY_HEADER};
use crate::access::Identity;
use crate::problem::{ApiError, Problem};
use crate::uploads::{MAX_REQUEST_BYTES, UploadError, UploadInfo, UploadList, UploadRequest, Uploads};

/// Header of tus: offset of a part in the upload, in bytes.
pub const OFFSET_HEADER: HeaderName = HeaderName::from_static("upload-offset");
/// Header of tus: bytes of the whole upload.
pub const LENGTH_HEADER: HeaderName = HeaderName::from_static("upload-length");
/// Header of tus: version of the protocol.
pub const TUS_HEADER: HeaderName = HeaderName::from_static("tus-resumable");
const TUS_VERSIONS_HEADER: HeaderName = HeaderName::from_static("tus-version");
const TUS_VERSION: &str = "1.0.0";
/// Media type of parts.
const PART_TYPE: &str = "application/offset+octet-stream";

/// Maximum bytes of a refused body that the server drains before it responds. If the server closed the connection without reading the body,
/// the connection would be reset, and the client could lose the response.
const MAX_DRAINED_BYTES: usize = 16 << 20;
/// Maximum time for draining a body.
const DRAIN_LIMIT: Duration = Duration::from_secs(5);

/// Returns the routes of uploads.
pub(super) fn routed() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(create, list))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .routes(routes!(show, remove, offset, send))
        .routes(routes!(finish))
}

impl ApiState {
    /// Returns the uploads, or an error if the server accepts none.
    fn uploads(&self) -> Result<&Uploads, ApiError> {
        self.uploads.as_ref().ok_or_else(|| {
            let message = match &self.job_server {
                None => "uploads are disabled on this server, expected one that was started with --uploads DIR".into(),
                Some(name) => format!(
                    "this server takes no uploads: of the servers behind this address, {name:?} takes them and has those there are"
                ),
            };
            ApiError::new(StatusCode::NOT_IMPLEMENTED, "uploads-off", message)
        })
    }
}

/// Declares the names and sizes of 1 to 20,000 files. The server stores nothing if they exceed a limit. The client then sends their bytes
/// by `PATCH`, one file after the other, and `POST finish` makes a volume of them, which only its owner and administrators see.
#[utoipa::path(
    post,
    path = "/api/v1/uploads",
    operation_id = "create_upload",
    tag = "uploads",
    request_body = UploadRequest,
    params(("idempotency-key" = Option<String>, Header, description = "1 to 255 visible ASCII characters: the same files with the same key make one upload")),
    responses(
        (
            status = 201,
            description = "The upload, which is ready to receive bytes",
            body = UploadInfo,
            headers(("location" = String, description = "Path of the upload")),
            links(
                ("show_upload" = (operation_id = "show_upload", parameters(("id" = "$response.body#/id")))),
                ("show_upload_offset" = (operation_id = "show_upload_offset", parameters(("id" = "$response.body#/id")))),
                ("send_upload_part" = (operation_id = "send_upload_part", parameters(("id" = "$response.body#/id")))),
                ("finish_upload" = (operation_id = "finish_upload", parameters(("id" = "$response.body#/id")))),
                ("remove_upload" = (operation_id = "remove_upload", parameters(("id" = "$response.body#/id")))),
            ),
        ),
        (status = 200, description = "The upload that an earlier request with the same key and files created", body = UploadInfo),
        (status = 400, description = "`bad-json`, or `bad-request`: a malformed key", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`key-reused`: the key belongs to other files", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`over-quota`, or `body-too-large`: more than 4 MiB", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-upload`: too many files, none, or a name that is not allowed", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "`too-many-uploads`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`uploads-off`: the server has no `--uploads`", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`disk-full`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn create(
    State(state): State<ApiState>,
    who: Identity,
    headers: HeaderMap,
    body: Result<Json<UploadRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let uploads = state.uploads()?;
    let Json(request) = body?;
    let key = headers.get(KEY_HEADER);
    let key = key.map(|key| String::from_utf8_lossy(key.as_bytes()).into_owned());
    let (upload, is_new) = uploads.create(who.reader(), key, request).await?;
    let location = format!("/api/v1/uploads/{}", upload.id);
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, [(header::LOCATION, location)], Json(upload)).into_response())
}

/// The uploads of the user, the latest first, and the rest of their quota. An administrator sees those of all users.
#[utoipa::path(
    get,
    path = "/api/v1/uploads",
    operation_id = "list_uploads",
    tag = "uploads",
    responses(
        (status = 200, description = "The uploads", body = UploadList),
        (status = 501, description = "`uploads-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn list(State(state): State<ApiState>, who: Identity) -> Result<Json<UploadList>, ApiError> {
    Ok(Json(state.uploads()?.list(who.reader())))
}

/// One upload.
#[utoipa::path(
    get,
    path = "/api/v1/uploads/{id}",
    operation_id = "show_upload",
    tag = "uploads",
    params(("id" = String, Path, description = "An upload's id")),
    responses(
        (status = 200, description = "The upload", body = UploadInfo),
        (status = 404, description = "`unknown-upload`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`uploads-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn show(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<UploadInfo>, ApiError> {
    Ok(Json(state.uploads()?.get(who.reader(), &id?.0)?))
}

/// Removes an upload, finished or not, and its volumes. Viewers of these volumes get an error.
#[utoipa::path(
    delete,
    path = "/api/v1/uploads/{id}",
    operation_id = "remove_upload",
    tag = "uploads",
    params(("id" = String, Path, description = "An upload's id")),
    responses(
        (status = 204, description = "The upload is removed"),
        (status = 404, description = "`unknown-upload`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`uploads-off`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn remove(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<StatusCode, ApiError> {
    state.uploads()?.delete(who.reader(), &id?.0).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The offset at which to continue, as tus 1.0 defines it. Ends a `PATCH` that is still in flight, so that the offset does not change
/// afterwards.
#[utoipa::path(
    head,
    path = "/api/v1/uploads/{id}",
    operation_id = "show_upload_offset",
    tag = "uploads",
    params(("id" = String, Path, description = "An upload's id")),
    responses(
        (status = 200, description = "The offset", headers(
            ("upload-offset" = u64, description = "Number of bytes that the server has received"),
            ("upload-length" = u64, description = "Total bytes, as declared"),
            ("tus-resumable" = String, description = "1.0.0"),
        )),
        (status = 404, description = "`unknown-upload`"),
        (status = 412, description = "`Tus-Resumable` is not 1.0.0"),
        (status = 423, description = "Another request is changing the upload"),
        (status = 501, description = "`uploads-off`"),
    ),
)]
async fn offset(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Response {
    let outcome = async {
        check_version(&headers)?;
        let (offset, length) = state.uploads()?.offset(who.reader(), &id?.0).await?;
        let headers = [
            (OFFSET_HEADER, HeaderValue::from(offset)),
            (LENGTH_HEADER, HeaderValue::from(length)),
            (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
        ];
        Ok(headers.into_response())
    };
    with_tus_headers(outcome.await)
}

/// Appends bytes to an upload, as tus 1.0 defines it. If the body ends too early, the server keeps the bytes that it has received. Ends
/// another `PATCH` for the same upload.
#[utoipa::path(
    patch,
    path = "/api/v1/uploads/{id}",
    operation_id = "send_upload_part",
    tag = "uploads",
    params(
        ("id" = String, Path, description = "An upload's id"),
        ("upload-offset" = u64, Header, description = "Number of bytes that the server has received, as `HEAD` returns it"),
        ("tus-resumable" = Option<String>, Header, description = "1.0.0"),
    ),
    request_body(content = File, content_type = "application/offset+octet-stream", description = "Any number of bytes, up to those that are missing"),
    responses(
        (status = 204, description = "All bytes of the body were received", headers(
            ("upload-offset" = u64, description = "Number of bytes that the server has received"),
            ("tus-resumable" = String, description = "1.0.0"),
        )),
        (status = 400, description = "`bad-request`: no offset, or a body that ended too early", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-upload`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`wrong-offset`, `upload-finished`, or `taken-over` by another request", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "`unsupported-version` of tus", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`over-declared`: more bytes than are missing", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/offset+octet-stream", body = Problem, content_type = "application/problem+json"),
        (status = 423, description = "`upload-locked`: another request is changing the upload", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`uploads-off`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`: the maximum number of requests is sending parts", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`disk-full`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn send(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    let mut body = body.into_data_stream();
    let received = receive(&state, &who, id, &headers, &mut body).await;
    if received.is_err() {
        let _ = tokio::time::timeout(DRAIN_LIMIT, drain(&mut body)).await;
    }
    with_tus_headers(
        received.map(|offset| (StatusCode::NO_CONTENT, [(OFFSET_HEADER, HeaderValue::from(offset))]).into_response()),
    )
}

/// Checks the headers of a part, and receives its body. Returns the new offset.
async fn receive(
    state: &ApiState,
    who: &Identity,
    id: Result<Path<String>, PathRejection>,
    headers: &HeaderMap,
    body: &mut BodyDataStream,
) -> Result<u64, ApiError> {
    check_version(headers)?;
    let uploads = state.uploads()?;
    if headers
        .get(header::CONTENT_TYPE)
        .is_none_or(|media_type| media_type != PART_TYPE)
    {
        let message = format!("expected Content-Type: {PART_TYPE}");
        return Err(ApiError::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported-media-type",
            message,
        ));
    }
    let number = |name: HeaderName| headers.get(name)?.to_str().ok()?.parse::<u64>().ok();
    let offset = number(OFFSET_HEADER).ok_or_else(|| {
        let message = "expected Upload-Offset, the number of bytes that are there, as HEAD says";
        ApiError::new(StatusCode::BAD_REQUEST, "bad-request", message)
    })?;
    let length = number(header::CONTENT_LENGTH);
    Ok(uploads.receive(who.reader(), &id?.0, offset, length, body).await?)
}

async fn drain(body: &mut BodyDataStream) {
    let mut drained = 0;
    while let Some(Ok(piece)) = body.next().await {
        drained += piece.len();
        if drained > MAX_DRAINED_BYTES {
            return;
        }
    }
}

fn check_version(headers: &HeaderMap) -> Result<(), ApiError> {
    match headers.get(TUS_HEADER) {
        Some(version) if version != TUS_VERSION => {
            let message = format!("Tus-Resumable is {version:?}, expected {TUS_VERSION}");
            Err(ApiError::new(
                StatusCode::PRECONDITION_FAILED,
                "unsupported-version",
                message,
            ))
        }
        _ => Ok(()),
    }
}

/// Adds the headers of tus to a response.
fn with_tus_headers(outcome: Result<Response, ApiError>) -> Response {
    let mut response = outcome.into_response();
    let headers = response.headers_mut();
    headers.insert(TUS_HEADER, HeaderValue::from_static(TUS_VERSION));
    headers.insert(TUS_VERSIONS_HEADER, HeaderValue::from_static(TUS_VERSION));
    response
}

/// Completes an upload of which all bytes were sent: reads the files as `isopeel serve` would, and offers their volumes to the user who
/// uploaded them. Repeating the request changes nothing.
#[utoipa::path(
    post,
    path = "/api/v1/uploads/{id}/finish",
    operation_id = "finish_upload",
    tag = "uploads",
    params(("id" = String, Path, description = "An upload's id")),
    responses(
        (status = 200, description = "The upload, with the ids of its volumes", body = UploadInfo),
        (status = 404, description = "`unknown-upload`", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`upload-incomplete`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`over-quota`: what is in a compressed file is more than the user may have", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`unreadable-volume`: what is wrong with the files", body = Problem, content_type = "application/problem+json"),
        (status = 423, description = "`upload-locked`: another request is changing the upload", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`uploads-off`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`: another one of the user, or others, are being read", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`disk-full`", body = Problem, content_type = "application/problem+json"),
    ),
)]
async fn finish(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<UploadInfo>, ApiError> {
    Ok(Json(state.uploads()?.finish(who.reader(), &id?.0).await?))
}

impl From<UploadError> for ApiError {
    fn from(error: UploadError) -> Self {
        let message = error.to_string();
        let (status, code) = match error {
            UploadError::Busy => return Self::busy(message),
            UploadError::Io(_) | UploadError::Panicked(_) => return Self::internal(error),
            UploadError::Unknown(_) => (StatusCode::NOT_FOUND, "unknown-upload"),
            UploadError::Files(_) => (StatusCode::UNPROCESSABLE_ENTITY, "bad-upload"),
            UploadError::BadKey(_) | UploadError::Interrupted { .. } => (StatusCode::BAD_REQUEST, "bad-request"),
            UploadError::KeyReused { .. } => (StatusCode::CONFLICT, "key-reused"),
            UploadError::TooMany => (StatusCode::TOO_MANY_REQUESTS, "too-many-uploads"),
            UploadError::OverQuota { .. } | UploadError::UnpacksOverQuota { .. } => {
                (StatusCode::PAYLOAD_TOO_LARGE, "over-quota")
            }
            UploadError::DiskFull(_) | UploadError::NoSpace(_) => (StatusCode::INSUFFICIENT_STORAGE, "disk-full"),
            UploadError::WrongOffset { .. } => (StatusCode::CONFLICT, "wrong-offset"),
            UploadError::TooLong { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "over-declared"),
            UploadError::TakenOver { .. } => (StatusCode::CONFLICT, "taken-over"),
            UploadError::Locked => (StatusCode::LOCKED, "upload-locked"),
            UploadError::Finished(_) => (StatusCode::CONFLICT, "upload-finished"),
            UploadError::Incomplete { .. } => (StatusCode::CONFLICT, "upload-incomplete"),
            UploadError::Unreadable(_) => (StatusCode::UNPROCESSABLE_ENTITY, "unreadable-volume"),
        };
        Self::new(status, code, message)
    }
}
