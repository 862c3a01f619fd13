//! Exports: surfaces as files.

pub(super) mod address;
mod body;
mod spool;

use std::iter::once;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header, response};
use axum::response::Response;
use isopeel_volumes::VolumeStep;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use serde_json::Map;
use tokio_util::sync::CancellationToken;
use utoipa::openapi::schema::{ObjectBuilder, SchemaFormat, Type};
use utoipa::openapi::{KnownFormat, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::ApiState;
use super::content_encoding::ContentEncoding;
use super::export_queue::ExportPermit;
use super::ranges::content_range;
use crate::access::Identity;
use crate::export::{self, FileContent, FileDigest, FileRequest, OtherVolumes, merged_schema};
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::service::{DevicePool, DeviceWorker, Seat};
pub use spool::SpoolFolder;

/// Header with the statistics that `isopeel extract --stats` prints, as JSON in ASCII.
pub const STATISTICS_HEADER: HeaderName = HeaderName::from_static("isopeel-statistics");

/// Maximum time for making a file. The largest surfaces take a tenth of this.
const EXPORT_DEADLINE: Duration = Duration::from_secs(600);

/// Body of `POST extract`: volume and format, and any of the edit's names. Missing names have the defaults of the command line.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtractRequest {
    /// Id of the volume.
    pub volume: String,
    /// The requested file.
    pub file: FileRequest,
}

/// The name of the request that is not part of [`FileRequest`].
#[derive(ToSchema)]
#[expect(dead_code, reason = "its schema alone is used")]
struct VolumeName {
    /// Id of the volume, as `GET /api/v1/volumes` lists it.
    volume: String,
}

impl<'de> Deserialize<'de> for ExtractRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut object = Map::deserialize(deserializer)?;
        let volume = object.remove("volume");
        let volume = volume.ok_or_else(|| D::Error::missing_field("volume"))?;
        Ok(Self {
            volume: String::deserialize(volume).map_err(D::Error::custom)?,
            file: FileRequest::from_object(object)?,
        })
    }
}

impl PartialSchema for ExtractRequest {
    fn schema() -> RefOr<Schema> {
        merged_schema(
            [VolumeName::schema(), FileRequest::schema()],
            "Volume and format, beside any of the edit's names.",
        )
    }
}

impl ToSchema for ExtractRequest {
    fn name() -> std::borrow::Cow<'static, str> {
        "ExtractRequest".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        FileRequest::schemas(schemas);
    }
}

/// OpenAPI schema of a file: binary.
pub(super) struct File;

impl PartialSchema for File {
    fn schema() -> RefOr<Schema> {
        let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(format))
            .into()
    }
}

impl ToSchema for File {}

/// Extracts a surface and answers it as a file in world units. The work ends when the client leaves.
#[utoipa::path(
    post,
    path = "/api/v1/extract",
    tag = "extract",
    request_body = ExtractRequest,
    params(
        ("volume" = Option<String>, Query, description = "The volume of the body, by which a proxy of several servers chooses one; the server ignores it"),
        ("accept-encoding" = Option<String>, Header, description = "`zstd` or `gzip`: the body is compressed"),
    ),
    responses(
        (
            status = 200,
            description = "The surface. A GLB has the statistics and the view in `asset.extras` too.",
            body = File,
            content_type = "model/gltf-binary",
            headers(("isopeel-statistics" = String, description = "The statistics, as JSON in ASCII")),
        ),
        (status = 400, description = "`bad-json`: not JSON, an unknown or a missing name, a wrong type", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`body-too-large`: more than 64 KiB; or `too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-edit`: a value out of range; `empty-surface`: no triangles, and `allowEmpty` is not set; `not-clean`: triangles intersect, and `clean` is set; or `too-large`: more triangles than the server makes (`suggestedTriangles` says what it would), or than the format holds; or `unreadable-volume`, of an upload", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume`, `device` or `internal`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn extract(
    State(state): State<ApiState>,
    who: Identity,
    headers: HeaderMap,
    body: Result<Json<ExtractRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let Json(ExtractRequest { volume, file }) = body?;
    let volume = state.volume(&who, &volume, file.step)?;
    let others = other_volumes(&state, &who, &file)?;
    // Checks the request first, so that an invalid one fails without waiting in the queue.
    file.surfaces(&volume, &others)?;
    let encoding = ContentEncoding::accepted(&headers);
    let source = Source { volume, others };
    source.export(state, &who, file).await?.whole(encoding)
}

/// The volumes of an export.
struct Source {
    volume: VolumeStep,
    others: OtherVolumes,
}

impl Source {
    /// Makes a file after the queue has admitted the export. [`ApiState::failed`] converts errors.
    async fn export(self, state: ApiState, who: &Identity, file: FileRequest) -> Result<Made, ApiError> {
        let others = self.others.values();
        let volumes: Vec<_> = once(self.volume.dataset()).chain(others).map(Arc::clone).collect();
        let made = Made::admitted(state.clone(), who, self, file).await;
        made.map_err(|error| state.failed(who, &volumes, error))
    }
}

/// Returns the other volumes that surfaces of a request name. Fails if the client may not see one of them.
fn other_volumes(state: &ApiState, who: &Identity, file: &FileRequest) -> Result<OtherVolumes, ApiError> {
    let find = |name: &str| Ok((name.to_owned(), Arc::clone(state.volume(who, name, 0)?.dataset())));
    file.other_volumes().map(find).collect()
}

/// An export that is complete, but not sent yet.
struct Made {
    file: FileContent,
    digest: FileDigest,
    permit: ExportPermit,
    spool: SpoolFolder,
}

impl Made {
    /// Waits for admission, then makes a file.
    async fn admitted(state: ApiState, who: &Identity, source: Source, request: FileRequest) -> Result<Self, ApiError> {
        let permit = state.exports.admit(who.user()).await?;
        // If the client disconnects, hyper drops this future, and the guard cancels the token. The spawned task holds its permit until it
        // notices that and ends.
        let token = CancellationToken::new();
        let _cancel = token.clone().drop_guard();
        let devices = state.devices.charged_to(who.limited_user());
        let task = tokio::spawn(Self::make(devices, source, request, token, permit));
        let spool = state.spool;
        let outcome = tokio::time::timeout(EXPORT_DEADLINE, task).await.map_err(|_| {
            let deadline = EXPORT_DEADLINE.as_secs();
            ApiError::busy(format!(
                "the export was not made within {deadline} s, the server has too much to do"
            ))
        })?;
        let (file, digest, permit) = outcome.map_err(ApiError::internal)??;
        Ok(Self {
            file,
            digest,
            permit,
            spool,
        })
    }

    /// Makes a file and its digest.
    async fn make(
        devices: DevicePool,
        source: Source,
        request: FileRequest,
        token: CancellationToken,
        permit: ExportPermit,
    ) -> Result<(FileContent, FileDigest, ExportPermit), ApiError> {
        let (volume, others, request, made_token) = (&source.volume, &source.others, &request, &token);
        let make =
            |worker: DeviceWorker| async move { export::make(&worker, volume, others, request, made_token).await };
        let file = devices.perform(&Seat::default(), volume, make).await?;
        let digested = pool::run_export(move || {
            let digest = file.digest(&|| token.is_cancelled())?;
            Ok::<_, export::ExportError>((file, digest))
        });
        let (file, digest) = digested.await.map_err(ApiError::internal)??;
        Ok((file, digest, permit))
    }

    /// Returns the response with the whole file.
    fn whole(self, encoding: ContentEncoding) -> Result<Response, ApiError> {
        let response = self.response()?;
        let response = match encoding {
            ContentEncoding::Identity => response.header(header::CONTENT_LENGTH, self.digest.bytes),
            _ => response.header(header::CONTENT_ENCODING, encoding.name()),
        };
        let body = body::send(self.file, body::Part::Whole(encoding), self.permit, self.spool);
        response.body(body).map_err(ApiError::internal)
    }

    /// Returns the response with a range of the bytes.
    fn range(self, part: Range<u64>) -> Result<Response, ApiError> {
        let range = content_range(&part, self.digest.bytes);
        let response = self.response()?.status(StatusCode::PARTIAL_CONTENT);
        let response = response
            .header(header::CONTENT_LENGTH, part.end - part.start)
            .header(header::CONTENT_RANGE, range);
        let body = body::send(
            self.file,
            body::Part::Range([part.start, part.end]),
            self.permit,
            self.spool,
        );
        response.body(body).map_err(ApiError::internal)
    }

    /// Returns a response with the headers that do not depend on the range.
    fn response(&self) -> Result<response::Builder, ApiError> {
        let format = self.file.format();
        let name = self.file.file_name();
        let statistics = serde_json::to_string(&self.file.statistics).map_err(ApiError::internal)?;
        Ok(Response::builder()
            .header(header::CONTENT_TYPE, format.content_type())
            .header(header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\""))
            .header(header::CACHE_CONTROL, HeaderValue::from_static("no-store"))
            .header(STATISTICS_HEADER, ascii(&statistics)))
    }
}

/// Escapes all characters of a JSON text that are not ASCII, because headers are ASCII.
fn ascii(json: &str) -> String {
    let mut escaped = String::with_capacity(json.len());
    for c in json.chars() {
        if c.is_ascii() {
            escaped.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                escaped.push_str(&format!("\\u{unit:04x}"));
            }
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use isopeel_view::Edit;

    use super::*;
    use crate::export::Format;

    #[test]
    fn a_request_holds_volume_format_and_the_edits_names() {
        let json = r#"{"volume":"head","format":"ply","iso":-3.5,"featureRange":[0,1],"maxLevel":3}"#;
        let request: ExtractRequest = serde_json::from_str(json).unwrap();
        assert_eq!(
            (request.volume.as_str(), request.file.step, request.file.options.format),
            ("head", 0, Format::Ply)
        );
        let expected = Edit {
            iso: Some(-3.5),
            feature_range: Some([0.0, 1.0]),
            max_level: Some(3),
            ..Edit::default()
        };
        assert_eq!(request.file.edit, expected);
    }

    #[test]
    fn what_is_unknown_missing_or_of_a_wrong_type_is_refused_by_name() {
        for (json, expected) in [
            (
                r#"{"volume":"head","format":"ply","isovalue":1}"#,
                "unknown field `isovalue`",
            ),
            (r#"{"format":"ply"}"#, "missing field `volume`"),
            (r#"{"volume":"head"}"#, "missing field `format`"),
            (r#"{"volume":"head","format":"xyz"}"#, "unknown variant `xyz`"),
            (
                r#"{"volume":"head","format":"ply","step":-1}"#,
                "invalid value: integer `-1`",
            ),
            (
                r#"{"volume":"head","format":"ply","alpha":"much"}"#,
                "invalid type: string \"much\"",
            ),
            (
                r#"{"volume":"head","format":"ply","allowEmpty":1}"#,
                "invalid type: integer `1`, expected a boolean",
            ),
            ("[]", "invalid type: sequence"),
        ] {
            let error = serde_json::from_str::<ExtractRequest>(json).unwrap_err().to_string();
            assert!(error.contains(expected), "{json}: {error}");
        }
    }

    #[test]
    fn headers_hold_any_device_name() {
        let name = "Gerät™ 🜁";
        let escaped = ascii(&serde_json::to_string(name).unwrap());
        assert!(HeaderValue::from_str(&escaped).is_ok());
        assert_eq!(serde_json::from_str::<String>(&escaped).unwrap(), name);
    }
}
