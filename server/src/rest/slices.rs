//! Slices: planes of samples as raw bytes, pictures, files with positions, or contours.

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use isopeel_extraction::fields;
use isopeel_kernels::SampleType;
use isopeel_view::FieldExpression;
use isopeel_volumes::{Field, VolumeStep};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::extract::File;
use super::{ApiState, whole_number};
use crate::access::{Identity, Occupant};
use crate::export::slice::{Axis, BadSlice, Plane, SliceFormat, SliceOptions, isovalues, load_slice};
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::service::DeviceWorker;

/// Header with type and positions of the samples of a slice: a [`SliceInfo`] as JSON in ASCII.
pub const SLICE_HEADER: HeaderName = HeaderName::from_static("isopeel-slice");

/// Query of a request for a slice.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SliceQuery {
    /// Axis that is perpendicular to the plane.
    #[param(inline)]
    axis: Axis,
    /// Index of the plane along this axis, from 0.
    #[serde(deserialize_with = "whole_number")]
    index: u32,
    /// Time step.
    #[serde(default, deserialize_with = "whole_number")]
    step: u32,
    /// Name of a field, or an expression over fields. Default: the first field.
    field: Option<String>,
    /// File format: raw samples, a picture, samples with their positions, or contours.
    #[serde(default)]
    #[param(inline)]
    format: SliceFormat,
    /// Isovalues of the contours, separated by commas; at most 64. Only for contours.
    iso: Option<String>,
    /// Width of the range of values between black and white, in the field's unit. Only for a picture. Default: the field's range.
    window: Option<f32>,
    /// Value halfway between black and white. Only for a picture. Default: the middle of the field's range.
    level: Option<f32>,
}

/// Type and positions of a slice's samples.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SliceInfo<'a> {
    /// Name of the field.
    field: &'a str,
    /// Axis that is perpendicular to the plane.
    axis: Axis,
    /// Index of the plane along this axis, from 0.
    index: u32,
    /// The two axes in the plane: that of its rows, then that of its columns.
    axes: [Axis; 2],
    /// Number of samples along each of the two axes.
    dims: [u32; 2],
    /// Type of the samples.
    #[serde(rename = "type")]
    sample_type: &'static str,
    /// Samples with this value count as missing. NaN and infinite samples always do.
    missing: Option<f32>,
    /// World position of the first sample.
    origin: [f64; 3],
    /// Vector in world coordinates from a sample to the next one along each of the two axes.
    steps: [[f64; 3]; 2],
}

/// A plane of samples perpendicular to an axis, row by row: the first of the plane's two axes, in the order x, y, z, varies fastest. The
/// header `isopeel-slice` of the answer has the type and the positions of the samples. A picture has a pixel for each sample, its first row
/// at the top; missing samples are transparent. Contours are the lines along which the surfaces of isovalues cross the plane, in an SVG or
/// as GeoJSON, whose coordinates are those of the volume's world. Reads the volume the first time.
#[utoipa::path(
    get,
    path = "/api/v1/volumes/{id}/slices",
    operation_id = "show_slice",
    tag = "volumes",
    params(("id" = String, Path, description = "A volume's id, as `GET /api/v1/volumes` lists it"), SliceQuery),
    responses(
        // A single content type for all formats. If several are declared, openapi-python-client uses the first that it supports
        // (application/geo+json) for every response.
        (status = 200, description = "The samples, a PNG, NRRD, NIfTI, SVG or GeoJSON file", body = File, content_type = "application/octet-stream",
         headers(("isopeel-slice" = String, description = "Type, size and place of the samples, JSON in ASCII"))),
        (status = 400, description = "`bad-request`", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume`, `unknown-step` or `unknown-field`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-slice`: the plane does not exist, the window is empty, or the isovalues are missing or invalid. `unreadable-volume`: an uploaded volume cannot be read", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume` or `device`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn slice(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    query: Result<Query<SliceQuery>, QueryRejection>,
) -> Result<Response, ApiError> {
    let (Path(id), Query(query)) = (id?, query?);
    let volume = state.volume(&who, &id, query.step)?;
    let field = field_of(&volume, query.field.as_deref())?;
    let plane = Plane::new(&volume, field, query.axis, query.index).map_err(bad_slice)?;
    let options = query.options()?;
    plane.check(&options).map_err(bad_slice)?;
    let permit = state.slices.acquire(Occupant::from(&who));
    let _permit = permit.map_err(|error| ApiError::busy(error.to_string()))?;
    let load = |worker: DeviceWorker| {
        let (volume, plane, options) = (&volume, &plane, &options);
        async move { load_slice(&worker, volume, plane, options).await }
    };
    let (slice, range) =
        (state.perform(&who, &volume, load).await).map_err(|error| state.failed_on(&who, &volume, error))?;
    let info = ascii_header(&info(&plane, slice.sample_type))?;
    let content_type = HeaderValue::from_static(options.format.content_type());
    let file = pool::run(move || plane.file(slice, &options, range)).await;
    let file = file.map_err(ApiError::internal)?.map_err(ApiError::internal)?;
    Ok(([(header::CONTENT_TYPE, content_type), (SLICE_HEADER, info)], file).into_response())
}

#[expect(clippy::needless_pass_by_value, reason = "`map_err` passes the error by value")]
fn bad_slice(error: BadSlice) -> ApiError {
    ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, "bad-slice", error.to_string())
}

impl SliceQuery {
    fn options(&self) -> Result<SliceOptions, ApiError> {
        Ok(SliceOptions {
            format: self.format,
            isovalues: isovalues(self.iso.as_deref().unwrap_or_default()).map_err(bad_slice)?,
            window: self.window,
            level: self.level,
        })
    }
}

/// Returns the field of a name or expression; without a name, the first field of the volume.
pub(super) fn field_of(volume: &VolumeStep, name: Option<&str>) -> Result<Field, ApiError> {
    let dataset = volume.dataset();
    let field = match name {
        None => dataset.fields.first().cloned(),
        Some(name) => fields::field_or_computed(dataset, name),
    };
    field.ok_or_else(|| {
        let (name, names) = (name.unwrap_or_default(), dataset.field_names());
        let mistake = match FieldExpression::may_be(name) {
            true => FieldExpression::parse(name, &names, "field").err(),
            false => None,
        };
        let mistake = mistake.map_or(String::new(), |error| format!(". As an expression: {}", error.why));
        let message = format!(
            "volume {:?} has no field {name:?}, expected an expression or one of {names:?}{mistake}",
            dataset.id
        );
        ApiError::new(StatusCode::NOT_FOUND, "unknown-field", message)
    })
}

fn info(plane: &Plane, sample_type: SampleType) -> SliceInfo<'_> {
    SliceInfo {
        field: &plane.field.name,
        axis: plane.axis,
        index: plane.index,
        axes: plane.axis.others(),
        dims: plane.dims,
        sample_type: sample_type.name(),
        missing: plane.field.missing,
        origin: plane.world([0.0; 2]).to_array(),
        steps: plane.steps(),
    }
}

/// Converts a value to JSON for a header. Escapes all characters that are not printable ASCII.
pub(super) fn ascii_header(info: &impl Serialize) -> Result<HeaderValue, ApiError> {
    let json = serde_json::to_string(info).map_err(ApiError::internal)?;
    let mut ascii = String::with_capacity(json.len());
    for unit in json.encode_utf16() {
        match char::from_u32(unit.into()).filter(|c| c.is_ascii() && !c.is_ascii_control()) {
            Some(character) => ascii.push(character),
            None => ascii.push_str(&format!("\\u{unit:04x}")),
        }
    }
    HeaderValue::from_str(&ascii).map_err(ApiError::internal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_any_alphabet_fit_a_header() {
        let info = super::SliceInfo {
            field: "Dichte ρ 🧠 \"\n",
            axis: Axis::Y,
            index: 3,
            axes: Axis::Y.others(),
            dims: [4, 5],
            sample_type: "u8",
            missing: None,
            origin: [0.0; 3],
            steps: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        };
        let value = ascii_header(&info).expect("a header");
        let text = value.to_str().expect("ASCII");
        let json: serde_json::Value = serde_json::from_str(text).expect("JSON");
        assert_eq!(json["field"], "Dichte ρ 🧠 \"\n");
        assert_eq!(
            (&json["axis"], &json["axes"]),
            (&"y".into(), &serde_json::json!(["x", "z"]))
        );
        assert_eq!([Axis::X, Axis::Y, Axis::Z].map(|axis| axis as usize), [0, 1, 2]);
    }
}
