//! A surface as a file.

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
use crate::export::{self, FileDigest, FileRequest, MadeFile, OtherVolumes, merged_schema};
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::service::DeviceWorker;
pub use spool::SpoolFolder;

/// Header that carries the statistics of `isopeel extract --stats`, JSON in ASCII.
pub const STATISTICS_HEADER: HeaderName = HeaderName::from_static("isopeel-statistics");

/// Maximum time for making an export: some ten times the time that the largest surfaces take.
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

/// Schema of a file's bytes.
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
    params(("accept-encoding" = Option<String>, Header, description = "`zstd` or `gzip`: the body is compressed")),
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
    // Checked first, so that an invalid request fails before it waits.
    file.surfaces(&volume, &others)?;
    let encoding = ContentEncoding::accepted(&headers);
    let source = Source { volume, others };
    source.made(state, &who, file).await?.whole(encoding)
}

/// The volumes that a file is made of.
struct Source {
    volume: VolumeStep,
    others: OtherVolumes,
}

impl Source {
    /// Makes a file once the queue admits it.
    async fn made(self, state: ApiState, who: &Identity, file: FileRequest) -> Result<Made, ApiError> {
        let others = self.others.values();
        let volumes: Vec<_> = once(self.volume.dataset()).chain(others).map(Arc::clone).collect();
        let made = Made::admitted(state.clone(), who, self, file).await;
        made.map_err(|error| state.failed(who, &volumes, error))
    }
}

/// Returns the volumes that surfaces name. The client must be allowed to see them.
fn other_volumes(state: &ApiState, who: &Identity, file: &FileRequest) -> Result<OtherVolumes, ApiError> {
    let find = |name: &str| Ok((name.to_owned(), Arc::clone(state.volume(who, name, 0)?.dataset())));
    file.other_volumes().map(find).collect()
}

/// An export that was made and is not sent yet.
struct Made {
    file: MadeFile,
    digest: FileDigest,
    permit: ExportPermit,
    spool: SpoolFolder,
}

impl Made {
    /// Makes a file once the queue admits it.
    async fn admitted(state: ApiState, who: &Identity, source: Source, request: FileRequest) -> Result<Self, ApiError> {
        let permit = state.exports.admit(who.user()).await?;
        // When the client disconnects, hyper drops this future, which cancels the token. The work holds its permit until it checks the
        // token and ends.
        let token = CancellationToken::new();
        let _cancel = token.clone().drop_guard();
        let worker = state.worker.charged_to(who.limited_user());
        let making = Self::make(worker, source, request, token, permit);
        let (making, spool) = (tokio::spawn(making), state.spool);
        let made = tokio::time::timeout(EXPORT_DEADLINE, making).await.map_err(|_| {
            let deadline = EXPORT_DEADLINE.as_secs();
            ApiError::busy(format!(
                "the export was not made within {deadline} s, the server has too much to do"
            ))
        })?;
        let (file, digest, permit) = made.map_err(ApiError::internal)??;
        Ok(Self {
            file,
            digest,
            permit,
            spool,
        })
    }

    async fn make(
        worker: DeviceWorker,
        source: Source,
        request: FileRequest,
        token: CancellationToken,
        permit: ExportPermit,
    ) -> Result<(MadeFile, FileDigest, ExportPermit), ApiError> {
        let file = export::make(&worker, &source.volume, &source.others, &request, &token).await?;
        let digested = pool::run_export(move || {
            let digest = file.digest(&|| token.is_cancelled())?;
            Ok::<_, export::ExportError>((file, digest))
        });
        let (file, digest) = digested.await.map_err(ApiError::internal)??;
        Ok((file, digest, permit))
    }

    /// Answers with the whole file.
    fn whole(self, encoding: ContentEncoding) -> Result<Response, ApiError> {
        let answer = self.answer()?;
        let answer = match encoding {
            ContentEncoding::Identity => answer.header(header::CONTENT_LENGTH, self.digest.bytes),
            _ => answer.header(header::CONTENT_ENCODING, encoding.name()),
        };
        let body = body::send(self.file, body::Part::Whole(encoding), self.permit, self.spool);
        answer.body(body).map_err(ApiError::internal)
    }

    /// Answers with a part of the bytes.
    fn range(self, part: Range<u64>) -> Result<Response, ApiError> {
        let range = content_range(&part, self.digest.bytes);
        let answer = self.answer()?.status(StatusCode::PARTIAL_CONTENT);
        let answer = answer
            .header(header::CONTENT_LENGTH, part.end - part.start)
            .header(header::CONTENT_RANGE, range);
        let body = body::send(
            self.file,
            body::Part::Range([part.start, part.end]),
            self.permit,
            self.spool,
        );
        answer.body(body).map_err(ApiError::internal)
    }

    /// Returns the headers that do not depend on which part of the file is sent.
    fn answer(&self) -> Result<response::Builder, ApiError> {
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
