//! Overviews: volumes at a low resolution.

use std::io;

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use isopeel_extraction::WorkError;
use isopeel_kernels::OverviewMode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::content_encoding::ContentEncoding;
use super::extract::File;
use super::slices::{ascii_header, field_of};
use super::{ApiState, whole_number};
use crate::access::{Identity, Occupant};
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::service::{DeviceError, DeviceWorker};

/// Header with the size and the range of an overview: an `OverviewInfo` as JSON in ASCII.
pub const OVERVIEW_HEADER: HeaderName = HeaderName::from_static("isopeel-overview");

/// What stands for the samples of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(default = "mean")]
pub enum Mode {
    /// Their mean.
    #[default]
    Mean,
    /// Their maximum.
    Maximum,
}

impl From<Mode> for OverviewMode {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Mean => Self::Mean,
            Mode::Maximum => Self::Maximum,
        }
    }
}

/// Query of a request for an overview.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct OverviewQuery {
    /// Time step.
    #[serde(default, deserialize_with = "whole_number")]
    step: u32,
    /// Name of a field, or an expression over fields. Default: the first field.
    field: Option<String>,
    /// What stands for the samples of a block.
    #[serde(default)]
    #[param(inline)]
    mode: Mode,
}

/// Why an overview is not made.
enum OverviewError {
    /// The device's error.
    Work(WorkError),
    /// Too many overviews are being made.
    Refused(ApiError),
}

impl From<WorkError> for OverviewError {
    fn from(error: WorkError) -> Self {
        Self::Work(error)
    }
}

impl From<OverviewError> for ApiError {
    fn from(error: OverviewError) -> Self {
        match error {
            OverviewError::Work(error) => error.into(),
            OverviewError::Refused(error) => error,
        }
    }
}

impl DeviceError for OverviewError {
    fn work_error(&self) -> Option<&WorkError> {
        match self {
            Self::Work(error) => Some(error),
            Self::Refused(_) => None,
        }
    }
}

/// Size and range of an overview.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
struct OverviewInfo<'a> {
    /// Name of the field.
    field: &'a str,
    /// What stands for the samples of a block.
    mode: Mode,
    /// Values along each axis, at most 128.
    dims: [u32; 3],
    /// Samples of a block along each axis. The last block along an axis may have fewer.
    factors: [u32; 3],
    /// Smallest and largest of the values.
    range: [f32; 2],
}

/// The volume at a low resolution: a byte for each block of samples, x fastest, at most 128 along each axis. 1 stands for the smallest value, 255 for
/// the largest, those between are linear, and 0 is a block whose samples are all missing or not finite; other blocks leave such samples out. The
/// header `isopeel-overview` of the answer has the range of the values, their number along each axis, and the samples of a block. Reads the
/// volume the first time.
#[utoipa::path(
    get,
    path = "/api/v1/volumes/{id}/overview",
    operation_id = "show_overview",
    tag = "volumes",
    params(("id" = String, Path, description = "A volume's id, as `GET /api/v1/volumes` lists it"), OverviewQuery),
    responses(
        (status = 200, description = "The values, one byte for each block", body = File, content_type = "application/octet-stream",
         headers(("isopeel-overview" = String, description = "Size and range, JSON in ASCII"))),
        (status = 400, description = "`bad-request`", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume`, `unknown-step` or `unknown-field`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`unreadable-volume`, of an upload", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume` or `device`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn overview(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    query: Result<Query<OverviewQuery>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let (Path(id), Query(query)) = (id?, query?);
    let volume = state.volume(&who, &id, query.step)?;
    let field = field_of(&volume, query.field.as_deref())?;
    let admit = || {
        let permit = state.overviews.acquire(Occupant::from(&who));
        permit.map_err(|error| OverviewError::Refused(ApiError::busy(error.to_string())))
    };
    let make = |worker: DeviceWorker| {
        let (volume, field, mode) = (&volume, &field.name, query.mode.into());
        async move { worker.overview(volume, field, mode, admit).await }
    };
    let overview = state.perform(&who, &volume, make).await;
    let overview = overview.map_err(|error| state.failed_on(&who, &volume, error))?;
    let info = ascii_header(&OverviewInfo {
        field: &field.name,
        mode: query.mode,
        dims: overview.dims,
        factors: overview.factors,
        range: overview.range,
    })?;
    let encoding = ContentEncoding::accepted(&headers);
    let body = pool::run(move || {
        let mut body = Vec::new();
        encoding
            .write(&mut body, |out| out.write_all(&overview.codes))
            .map(|()| body)
    });
    let body: io::Result<Vec<u8>> = body.await.map_err(ApiError::internal)?;
    let head = [
        (
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/octet-stream"),
        ),
        (header::VARY, HeaderValue::from_static("accept-encoding")),
        (OVERVIEW_HEADER, info),
    ];
    let mut response = (head, body.map_err(ApiError::internal)?).into_response();
    if encoding != ContentEncoding::Identity {
        let name = HeaderValue::from_static(encoding.name());
        response.headers_mut().insert(header::CONTENT_ENCODING, name);
    }
    Ok(response)
}
