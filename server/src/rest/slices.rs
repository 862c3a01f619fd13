//! Planes of samples: raw for a shader, or as a picture.

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use isopeel_kernels::{SampleType, Samples};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use crate::access::{Identity, Occupant};
use crate::extraction::Slice;
use crate::math::DVec3;
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::view::FeatureName;
use crate::volumes::{Field, VolumeStep};

/// Header that says what a slice's samples are and where they lie, JSON in ASCII ([`SliceInfo`]).
pub const SLICE_HEADER: HeaderName = HeaderName::from_static("isopeel-slice");

/// The axis across a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// First.
    X,
    /// Second.
    Y,
    /// Third.
    Z,
}

impl Axis {
    /// The plane's own axes: along its rows, and across them.
    fn others(self) -> [Self; 2] {
        match self {
            Self::X => [Self::Y, Self::Z],
            Self::Y => [Self::X, Self::Z],
            Self::Z => [Self::X, Self::Y],
        }
    }
}

/// What a slice comes as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum SliceFormat {
    /// The samples, little-endian.
    #[default]
    Raw,
    /// A grey picture.
    Png,
}

/// Which slice.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SliceQuery {
    /// Axis across the plane.
    #[param(inline)]
    axis: Axis,
    /// Which plane along it, from 0 on.
    index: u32,
    /// Time step.
    #[serde(default)]
    step: u32,
    /// Name of the field, or an expression over some; left out: the first.
    field: Option<String>,
    /// Raw samples, or a picture.
    #[serde(default)]
    #[param(inline)]
    format: SliceFormat,
    /// Of a picture: how many of the field's units there are between black and white. Left out: the field's range.
    window: Option<f32>,
    /// Of a picture: the value in the middle. Left out: the middle of the field's range.
    level: Option<f32>,
}

/// What a slice's samples are and where they lie.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SliceInfo<'a> {
    /// Name of the field.
    field: &'a str,
    /// Axis across the plane.
    axis: Axis,
    /// Which plane along it.
    index: u32,
    /// Axes of the plane: along its rows, and across them.
    axes: [Axis; 2],
    /// Samples along these.
    dims: [u32; 2],
    /// Type of the samples.
    #[serde(rename = "type")]
    sample_type: &'static str,
    /// Samples of this value are missing, and those that are no finite number.
    missing: Option<f32>,
    /// World position of the first sample.
    origin: [f64; 3],
    /// From a sample to the next along each of the axes, in the world.
    steps: [[f64; 3]; 2],
}

/// A plane of samples across an axis, row after row, the lower of the plane's axes fastest. `isopeel-slice` in the answer's headers says of
/// which type they are and where they lie. A picture has a pixel a sample, its first row at the top; missing samples are transparent.
/// Reads the volume the first time.
#[utoipa::path(
    get,
    path = "/api/v1/volumes/{id}/slices",
    operation_id = "show_slice",
    tag = "volumes",
    params(("id" = String, Path, description = "A volume's id, as `GET /api/v1/volumes` lists it"), SliceQuery),
    responses(
        (status = 200, description = "The samples, or a PNG file", content_type = "application/octet-stream",
         headers(("isopeel-slice" = String, description = "Type, size and place of the samples, JSON in ASCII"))),
        (status = 400, description = "`bad-request`", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume`, `unknown-step` or `unknown-field`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-slice`: no such plane, or a window that shows nothing", body = Problem, content_type = "application/problem+json"),
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
    check(&volume, &query)?;
    let seat = state.slices.take(Occupant::from(&who));
    let _seat = seat.map_err(|none| ApiError::busy(none.to_string()))?;
    let worker = state.extractor.worker();
    let slice = worker
        .slice(&volume, &field.name, query.axis as usize, query.index)
        .await?;
    let info = header_of(&info(&volume, &field, &query, slice.sample_type))?;
    let (content_type, body) = match query.format {
        SliceFormat::Raw => ("application/octet-stream", slice.bytes),
        SliceFormat::Png => {
            let range = match (query.window, query.level) {
                (Some(_), Some(_)) => [0.0, 0.0],
                _ => worker.histogram(&volume, &field.name, &FeatureName::None).await?.range,
            };
            let picture = Picture {
                dims: plane_dims(&volume, query.axis),
                missing: field.missing,
                window: query.window.unwrap_or(range[1] - range[0]),
                level: query.level.unwrap_or(0.5 * range[0] + 0.5 * range[1]),
            };
            let png = pool::run(move || picture.png(&slice))
                .await
                .map_err(ApiError::internal)?;
            ("image/png", png.map_err(ApiError::internal)?)
        }
    };
    let content_type = HeaderValue::from_static(content_type);
    Ok(([(header::CONTENT_TYPE, content_type), (SLICE_HEADER, info)], body).into_response())
}

fn field_of(volume: &VolumeStep, name: Option<&str>) -> Result<Field, ApiError> {
    let dataset = volume.dataset();
    let found = match name {
        None => dataset.fields.first().cloned(),
        Some(name) => dataset.field(name).cloned().or_else(|| dataset.computed_field(name)),
    };
    found.ok_or_else(|| {
        let (name, names) = (name.unwrap_or_default(), dataset.field_names());
        let message = format!(
            "volume {:?} has no field {name:?}, expected an expression or one of {names:?}",
            dataset.id
        );
        ApiError::new(StatusCode::NOT_FOUND, "unknown-field", message)
    })
}

/// # Errors
/// No such plane, or a window or level that is of no picture.
fn check(volume: &VolumeStep, query: &SliceQuery) -> Result<(), ApiError> {
    let refuse = |message: String| Err(ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, "bad-slice", message));
    let planes = volume.dataset().geometry.dims[query.axis as usize];
    if query.index >= planes {
        return refuse(format!("index: {}, expected 0 to {}", query.index, planes - 1));
    }
    if query.format == SliceFormat::Raw && (query.window.is_some() || query.level.is_some()) {
        return refuse("window and level are of pictures, expected format=png beside them".into());
    }
    match (query.window, query.level) {
        (Some(window), _) if !(window.is_finite() && window > 0.0) => {
            refuse(format!("window: {window}, expected a finite number above 0"))
        }
        (_, Some(level)) if !level.is_finite() => refuse(format!("level: {level}, expected a finite number")),
        _ => Ok(()),
    }
}

/// Samples along the axes of a plane.
fn plane_dims(volume: &VolumeStep, axis: Axis) -> [u32; 2] {
    axis.others().map(|axis| volume.dataset().geometry.dims[axis as usize])
}

fn info<'a>(volume: &VolumeStep, field: &'a Field, query: &SliceQuery, sample_type: SampleType) -> SliceInfo<'a> {
    let dataset = volume.dataset();
    let world = dataset.geometry.world_from_index();
    let mut first = DVec3::ZERO;
    first[query.axis as usize] = f64::from(query.index);
    let axes = query.axis.others();
    SliceInfo {
        field: &field.name,
        axis: query.axis,
        index: query.index,
        axes,
        dims: plane_dims(volume, query.axis),
        sample_type: sample_type.name(),
        missing: field.missing,
        origin: dataset.sample_space().world(first).to_array(),
        steps: axes.map(|axis| world.matrix3.col(axis as usize).to_array()),
    }
}

/// As a header's value: what is not ASCII is escaped.
fn header_of(info: &SliceInfo<'_>) -> Result<HeaderValue, ApiError> {
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

/// How a slice is drawn.
struct Picture {
    dims: [u32; 2],
    missing: Option<f32>,
    window: f32,
    level: f32,
}

impl Picture {
    /// Grey and whether the sample is there, a byte each.
    fn pixel(&self, value: f32) -> [u8; 2] {
        if value.is_nan() || Some(value) == self.missing {
            return [0, 0];
        }
        // Of a field of one value the window is empty.
        let share = if self.window > 0.0 {
            (f64::from(value) - f64::from(self.level)) / f64::from(self.window) + 0.5
        } else {
            0.5
        };
        [(share.clamp(0.0, 1.0) * 255.0).round() as u8, 255]
    }

    fn png(&self, slice: &Slice) -> Result<Vec<u8>, png::EncodingError> {
        let samples = samples_of(slice);
        let pixels: Vec<u8> = (0..samples.len()).flat_map(|i| self.pixel(samples.get(i))).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.dims[0], self.dims[1]);
        encoder.set_color(png::ColorType::GrayscaleAlpha);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&pixels)?;
        writer.finish()?;
        Ok(file)
    }
}

fn samples_of(slice: &Slice) -> Samples {
    let bytes = &slice.bytes;
    match slice.sample_type {
        SampleType::U8 => Samples::U8(bytes.clone()),
        SampleType::I8 => Samples::I8(bytes.iter().map(|byte| byte.cast_signed()).collect()),
        SampleType::U16 => Samples::U16(bytemuck::pod_collect_to_vec(bytes)),
        SampleType::I16 => Samples::I16(bytemuck::pod_collect_to_vec(bytes)),
        SampleType::F32 => Samples::F32(bytemuck::pod_collect_to_vec(bytes)),
    }
}

#[cfg(test)]
mod tests {
    use super::{Axis, Picture, Slice, header_of, samples_of};
    use isopeel_kernels::SampleType;

    fn picture(window: f32, level: f32) -> Picture {
        Picture {
            dims: [3, 2],
            missing: Some(-1.0),
            window,
            level,
        }
    }

    #[test]
    fn window_and_level_say_what_is_black_and_white() {
        let drawn = picture(100.0, 50.0);
        for (value, grey) in [
            (0.0, 0),
            (-40.0, 0),
            (50.0, 128),
            (100.0, 255),
            (1e30, 255),
            (f32::INFINITY, 255),
        ] {
            assert_eq!(drawn.pixel(value), [grey, 255], "{value}");
        }
        assert_eq!(drawn.pixel(-1.0), [0, 0], "missing");
        assert_eq!(drawn.pixel(f32::NAN), [0, 0]);
        assert_eq!(picture(0.0, 7.0).pixel(7.0), [128, 255], "a field of one value");
        assert_eq!(picture(f32::MAX, 0.0).pixel(f32::MAX), [255, 255]);
    }

    #[test]
    fn pictures_can_be_read_again() {
        let slice = Slice {
            sample_type: SampleType::I16,
            bytes: [0i16, 50, 100, -1, 25, 75]
                .into_iter()
                .flat_map(i16::to_le_bytes)
                .collect(),
        };
        assert_eq!(samples_of(&slice).get(3), -1.0);
        let file = picture(100.0, 50.0).png(&slice).expect("a picture");
        let mut reader = png::Decoder::new(std::io::Cursor::new(file))
            .read_info()
            .expect("a PNG file");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let frame = reader.next_frame(&mut pixels).expect("a frame");
        assert_eq!(
            (frame.width, frame.height, frame.color_type),
            (3, 2, png::ColorType::GrayscaleAlpha)
        );
        assert_eq!(pixels, [0, 255, 128, 255, 255, 255, 0, 0, 64, 255, 191, 255]);
    }

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
        let value = header_of(&info).expect("a header");
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
