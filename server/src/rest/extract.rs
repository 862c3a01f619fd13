//! A surface as a file.

pub(super) mod address;

use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::Response;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use serde_json::Map;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio_util::sync::CancellationToken;
use utoipa::openapi::schema::{ObjectBuilder, SchemaFormat, Type};
use utoipa::openapi::{KnownFormat, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::{ApiState, CONCURRENT_EXTRACTS};
use crate::access::Identity;
use crate::export::{self, FileRequest, MadeFile, merged_schema};
use crate::extraction::Extractor;
use crate::pool;
use crate::problem::{ApiError, Problem};
use crate::volumes::VolumeStep;

/// Header that carries the statistics of `isopeel extract --stats`, JSON in ASCII.
pub const STATISTICS_HEADER: HeaderName = HeaderName::from_static("isopeel-statistics");

/// Bytes of a chunk of the body.
const CHUNK_BYTES: usize = 256 * 1024;
/// Chunks between writer and socket, 1 MiB: on a fast line neither waits for the other.
const QUEUED_CHUNKS: usize = 4;
/// Time after which a client that reads no chunk is disconnected, as on the WebSocket: its mesh takes memory.
const CHUNK_DEADLINE: Duration = Duration::from_secs(20);
/// Time after which an export is given up that is not made yet: some ten times what the largest surfaces take.
const EXPORT_DEADLINE: Duration = Duration::from_secs(600);

/// What `POST extract` asks for: volume and format, beside any of the edit's names. What is left out has the default of
/// the command line.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtractRequest {
    /// Id of the volume.
    pub volume: String,
    /// What of it.
    pub file: FileRequest,
}

/// The name that is not of the file's request.
#[derive(ToSchema)]
#[expect(dead_code, reason = "its schema alone is used")]
struct Place {
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
            [Place::schema(), FileRequest::schema()],
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
struct File;

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
    responses(
        (
            status = 200,
            description = "The surface. A GLB has the statistics and the view in `asset.extras` too.",
            content(
                (File = "model/gltf-binary"),
                (File = "application/octet-stream"),
                (File = "model/stl"),
            ),
            headers(("isopeel-statistics" = String, description = "The statistics, as JSON in ASCII")),
        ),
        (status = 400, description = "`bad-json`: not JSON, an unknown or a missing name, a wrong type", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-volume` or `unknown-step`", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "`body-too-large`: more than 64 KiB; or `too-large` for the host's memory", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported-media-type`: not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`bad-edit`: a value out of range; `empty-surface`: no triangles, and `allowEmpty` is not set; or `too-large`: more triangles than the server makes (`suggestedTriangles` says what it would), or than the format holds", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "`unreadable-volume`, `device` or `internal`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`, or `device`: there is none", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "`too-large` for the device", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn extract(
    State(state): State<ApiState>,
    who: Identity,
    body: Result<Json<ExtractRequest>, JsonRejection>,
) -> Result<Response, ApiError> {
    let Json(ExtractRequest { volume, file }) = body?;
    let volume = state.volume(&who, &volume, file.step)?;
    // Before it waits for anything.
    file.view(volume.dataset())?;
    answer(state, volume, file).await
}

/// Makes a file, unless too many are being made, and answers it.
async fn answer(state: ApiState, volume: VolumeStep, file: FileRequest) -> Result<Response, ApiError> {
    let permit = Arc::clone(&state.extracts).try_acquire_owned().map_err(|_| {
        ApiError::busy(format!(
            "{CONCURRENT_EXTRACTS} exports are under way, the most at a time, try again in a few seconds"
        ))
    })?;
    // When the client disconnects, hyper drops this future. The work then ends at its next look at the token, and holds its permit until
    // it has.
    let token = CancellationToken::new();
    let _cancel = token.clone().drop_guard();
    let making = tokio::spawn(make(state.extractor, volume, file, token, permit));
    let made = tokio::time::timeout(EXPORT_DEADLINE, making).await.map_err(|_| {
        let deadline = EXPORT_DEADLINE.as_secs();
        ApiError::busy(format!(
            "the export was not made within {deadline} s, the server has too much to do"
        ))
    })?;
    made.map_err(ApiError::internal)??.into_response()
}

/// An export that is made, not sent yet.
struct Made {
    file: MadeFile,
    bytes: u64,
    /// Id of the volume.
    volume: String,
    permit: OwnedSemaphorePermit,
}

async fn make(
    extractor: Extractor,
    volume: VolumeStep,
    request: FileRequest,
    token: CancellationToken,
    permit: OwnedSemaphorePermit,
) -> Result<Made, ApiError> {
    let id = volume.dataset().id.clone();
    let file = export::make(&extractor, volume, &request, &token).await?;
    let measured = pool::run_export(move || {
        let bytes = file.length(&|| token.is_cancelled())?;
        Ok::<_, export::ExportError>((file, bytes))
    });
    let (file, bytes) = measured.await.map_err(ApiError::internal)??;
    Ok(Made {
        file,
        bytes,
        volume: id,
        permit,
    })
}

impl Made {
    fn into_response(self) -> Result<Response, ApiError> {
        let format = self.file.format();
        let name = format!("{}.{}", self.volume, format.extension());
        let statistics = serde_json::to_string(&self.file.statistics).map_err(ApiError::internal)?;
        Response::builder()
            .header(header::CONTENT_TYPE, format.content_type())
            .header(header::CONTENT_LENGTH, self.bytes)
            .header(header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\""))
            .header(header::CACHE_CONTROL, HeaderValue::from_static("no-store"))
            .header(STATISTICS_HEADER, ascii(&statistics))
            .body(send(self.file, self.permit, CHUNK_DEADLINE))
            .map_err(ApiError::internal)
    }
}

/// The body: written on a blocking thread, as fast as the client reads.
fn send(file: MadeFile, permit: OwnedSemaphorePermit, deadline: Duration) -> Body {
    let (chunks, mut queue) = mpsc::channel(QUEUED_CHUNKS);
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || {
        // Until mesh and thread are released.
        let _permit = permit;
        let mut out = io::BufWriter::with_capacity(
            CHUNK_BYTES,
            ChunkWriter {
                chunks,
                runtime,
                deadline,
            },
        );
        let written = file.write(&mut out).and_then(|()| Ok(out.flush()?));
        if let Err(error) = written {
            tracing::debug!(
                cause = crate::error::chain(&error),
                "an export was not taken to its end"
            );
        }
        // Without a flush: after a failure it would wait for the client again.
        let _ = out.into_parts();
    });
    let chunks = futures_util::stream::poll_fn(move |context| {
        queue.poll_recv(context).map(|chunk| chunk.map(Ok::<_, io::Error>))
    });
    Body::from_stream(chunks)
}

/// Sends each write to the socket's task as one chunk.
struct ChunkWriter {
    chunks: mpsc::Sender<Bytes>,
    runtime: Handle,
    deadline: Duration,
}

impl Write for ChunkWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let part = &bytes[..bytes.len().min(CHUNK_BYTES)];
        let send = self.chunks.send_timeout(Bytes::copy_from_slice(part), self.deadline);
        match self.runtime.block_on(send) {
            Ok(()) => Ok(part.len()),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => Err(io::ErrorKind::TimedOut.into()),
            Err(mpsc::error::SendTimeoutError::Closed(_)) => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// JSON with everything but ASCII escaped, as headers need it.
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
    use futures_util::StreamExt;
    use tokio::sync::Semaphore;

    use super::*;
    use crate::export::{Format, Mesh};
    use crate::view::Edit;

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
            (r#"{"volume":"head","format":"obj"}"#, "unknown variant `obj`"),
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

    /// A file of some megabytes: more than the queue of chunks holds.
    fn large_file(format: Format) -> MadeFile {
        MadeFile::of_mesh(large_mesh(), format)
    }

    fn large_mesh() -> Mesh {
        let vertices = 200_000;
        Mesh {
            positions: vec![[1.0; 3]; vertices],
            normals: vec![[0.0, 0.0, 1.0]; vertices],
            smoothness: vec![0.0; vertices],
            feature: vec![0.0; vertices],
            colors: Vec::new(),
            triangles: vec![[0, 1, 2]; vertices],
            level_triangles: [vertices as u64, 0, 0, 0, 0, 0],
            ..Mesh::default()
        }
    }

    async fn permit_of(semaphore: &Arc<Semaphore>) -> OwnedSemaphorePermit {
        Arc::clone(semaphore).acquire_owned().await.unwrap()
    }

    #[tokio::test]
    async fn the_body_is_the_file_and_as_long_as_was_said() {
        let semaphore = Arc::new(Semaphore::new(1));
        for format in [Format::Glb, Format::Ply, Format::Stl] {
            let (made, mut file) = (large_file(format), Vec::new());
            made.write(&mut file).unwrap();
            assert_eq!(made.length(&|| false).unwrap(), file.len() as u64);
            assert!(made.length(&|| true).is_err(), "cancelled");
            let body = send(made, permit_of(&semaphore).await, CHUNK_DEADLINE);
            let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
            assert!(bytes == file, "{format:?}");
        }
    }

    #[tokio::test]
    async fn a_client_that_leaves_frees_the_mesh_and_its_permit() {
        let semaphore = Arc::new(Semaphore::new(1));
        let body = send(large_file(Format::Stl), permit_of(&semaphore).await, CHUNK_DEADLINE);
        let mut stream = body.into_data_stream();
        assert!(stream.next().await.unwrap().is_ok());
        drop(stream);
        // Comes back only when the writer has ended.
        drop(permit_of(&semaphore).await);
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_is_given_up() {
        let semaphore = Arc::new(Semaphore::new(1));
        let deadline = Duration::from_millis(20);
        let body = send(large_file(Format::Stl), permit_of(&semaphore).await, deadline);
        drop(permit_of(&semaphore).await);
        let mut stream = body.into_data_stream();
        let mut chunks = 0;
        while stream.next().await.is_some() {
            chunks += 1;
        }
        assert_eq!(chunks, QUEUED_CHUNKS);
    }
}
