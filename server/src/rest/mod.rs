//! The REST API below `/api/v1`. `/api/v1/openapi.json` describes it.
//!
//! A handler checks the request, calls another layer, and converts the outcome to a response. Every error is an [`ApiError`]: a problem
//! document with a stable code.

mod content_encoding;
mod description;
mod embed;
mod error;
mod export_queue;
mod extract;
mod health;
mod jobs;
mod metrics;
mod oidc;
mod overview;
mod precompressed;
mod ranges;
mod session;
mod slices;
mod tickets;
mod uploads;
mod volumes;
mod web_client;

#[cfg(test)]
mod tests;

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use isopeel_volumes::SharedCatalog;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::timeout::RequestBodyTimeoutLayer;
use utoipa::{Modify, OpenApi};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub use embed::EmbedInfo;
pub use extract::{ExtractRequest, STATISTICS_HEADER, SpoolFolder};
pub use jobs::{DIGEST_HEADER, KEY_HEADER, LAST_EVENT_ID};
pub use overview::OVERVIEW_HEADER;
pub use session::SessionInfo;
pub use slices::SLICE_HEADER;
pub use uploads::{LENGTH_HEADER, OFFSET_HEADER, TUS_HEADER};
pub use volumes::{UnreadablePath, VolumeSummary};

use crate::access::{Access, SeatLimits, Seats};
use crate::jobs::Jobs;
use crate::problem::{ApiError, Problem};
use crate::service::DevicePool;
use crate::uploads::Uploads;
use export_queue::{ExportQueue, QueueLimits};
use extract::address::KnownDigests;
use precompressed::Precompressed;

/// Maximum bytes of a request body, as of a message on the WebSocket. An edit with 64 control points takes about 4 KiB.
const MAX_BODY_BYTES: usize = 64 * 1024;

/// Maximum time between two parts of a request body. The head of a request has the same limit.
const BODY_PAUSE: Duration = Duration::from_secs(10);

/// Limits of exports. A running export holds a mesh in memory until its bytes are sent or spooled: some 100 MB for a million triangles,
/// together with the regions of the surface. A waiting export holds a connection.
const EXPORTS: QueueLimits = QueueLimits {
    max_running: 4,
    max_running_of_user: 3,
    max_waiting: 32,
    max_waiting_of_user: 8,
    max_wait: Duration::from_secs(60),
};

/// Limits of concurrent slices. Each takes some megabytes for a plane of samples. A viewer drags up to three planes at the same time.
const SLICES: SeatLimits = SeatLimits {
    what: "slices that are being made",
    all: 8,
    of_user: 6,
    of_address: 7,
    reserve: 1,
};

/// Limits of concurrent overviews. Each takes up to 24 MiB until it is complete, and equal requests share one. A viewer that steps through
/// time requests one after another.
const OVERVIEWS: SeatLimits = SeatLimits {
    what: "overviews that are being made",
    all: 6,
    of_user: 3,
    of_address: 5,
    reserve: 1,
};

/// Limits of concurrent event streams of jobs. Each holds a connection.
const EVENT_STREAMS: SeatLimits = SeatLimits {
    what: "streams of events",
    all: 64,
    of_user: 32,
    of_address: 48,
    reserve: 4,
};

/// State that all handlers share. Clones are cheap.
#[derive(Clone)]
pub struct ApiState {
    catalog: SharedCatalog,
    devices: DevicePool,
    exports: ExportQueue,
    known_digests: KnownDigests,
    slices: Seats,
    overviews: Seats,
    events: Seats,
    spool: SpoolFolder,
    access: Access,
    /// `None` if the server has no batch jobs.
    jobs: Option<Jobs>,
    /// `None` if the server does not accept uploads.
    uploads: Option<Uploads>,
    /// Name of the server that takes batch jobs and uploads, if there are several behind a proxy.
    job_server: Option<Arc<str>>,
    /// Whether the server will shut down soon.
    is_draining: Arc<AtomicBool>,
}

impl ApiState {
    /// Creates the state of a server that offers the volumes of a catalog to users whom `access` authorizes.
    pub fn new(catalog: SharedCatalog, devices: impl Into<DevicePool>, access: Access) -> Self {
        Self {
            catalog,
            devices: devices.into(),
            exports: ExportQueue::new(EXPORTS),
            known_digests: KnownDigests::default(),
            slices: Seats::new(SLICES),
            overviews: Seats::new(OVERVIEWS),
            events: Seats::new(EVENT_STREAMS),
            spool: SpoolFolder::default(),
            access,
            jobs: None,
            uploads: None,
            job_server: None,
            is_draining: Arc::default(),
        }
    }

    /// Adds batch jobs.
    #[must_use]
    pub fn with_jobs(self, jobs: Option<Jobs>) -> Self {
        Self { jobs, ..self }
    }

    /// Names the server that takes batch jobs and uploads, in lists of volumes and in errors.
    #[must_use]
    pub fn with_job_server(self, job_server: Option<Arc<str>>) -> Self {
        Self { job_server, ..self }
    }

    /// Spools exports of slow clients to this folder, instead of the folder for temporary files.
    #[must_use]
    pub fn with_spool(self, folder: Option<SpoolFolder>) -> Self {
        Self {
            spool: folder.unwrap_or_default(),
            ..self
        }
    }

    /// Uses this flag, which the shutdown sets, so that the readiness probe fails from then on.
    #[must_use]
    pub fn with_draining(self, is_draining: Arc<AtomicBool>) -> Self {
        Self { is_draining, ..self }
    }

    /// Adds uploads.
    #[must_use]
    pub fn with_uploads(self, uploads: Option<Uploads>) -> Self {
        Self { uploads, ..self }
    }
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "isopeel",
        description = "Isosurfaces, decimated by importance before they are made. Live viewing goes over the WebSocket at \
                       /api/v1/stream, subprotocol isopeel.v3, specified in PROTOCOL.md. Every error answer is an \
                       application/problem+json document.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    components(schemas(Problem, isopeel_extraction::ExtractionStatistics, crate::jobs::JobEvent))
)]
struct Doc;

/// Returns all routes with their descriptions.
fn routed() -> OpenApiRouter<ApiState> {
    OpenApiRouter::with_openapi(Doc::openapi())
        .routes(routes!(volumes::list))
        .routes(routes!(volumes::show))
        .routes(routes!(volumes::expression))
        .routes(routes!(volumes::unreadable))
        .routes(routes!(slices::slice))
        .routes(routes!(overview::overview))
        .routes(routes!(extract::extract, extract::address::extract_by_address))
        .merge(jobs::routed())
        .merge(uploads::routed())
        .routes(routes!(session::begin, session::check, oidc::sign_out))
        .routes(routes!(oidc::show))
        .routes(routes!(oidc::login))
        .routes(routes!(oidc::callback))
        .routes(routes!(tickets::issue))
        .routes(routes!(embed::show))
        .routes(routes!(embed::lend))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::memory))
        .routes(routes!(health::devices))
        .routes(routes!(metrics::show))
}

/// Returns the OpenAPI 3.1 description of this API.
pub fn openapi() -> utoipa::openapi::OpenApi {
    described(routed().into_openapi())
}

fn described(mut openapi: utoipa::openapi::OpenApi) -> utoipa::openapi::OpenApi {
    description::Completed.modify(&mut openapi);
    openapi
}

/// Serializes the description for all requests.
fn precompressed_description(description: &utoipa::openapi::OpenApi) -> Arc<Precompressed> {
    // Cannot fail: serde_json fails only for maps whose keys are not strings, and the description has no such maps.
    let text = serde_json::to_vec(description).unwrap_or_default();
    let hash = format!("{:032x}", xxhash_rust::xxh3::xxh3_128(&text));
    Arc::new(Precompressed::new(text.into(), hash, true))
}

/// Returns the router of the REST API, and of the web client on all other paths.
pub fn router(state: ApiState) -> Router {
    let (router, description) = routed().split_for_parts();
    let description = precompressed_description(&described(description));
    let serve_description = async move |request: HeaderMap| {
        let json = HeaderValue::from_static("application/json");
        description.respond(&request, HeaderMap::from_iter([(header::CONTENT_TYPE, json)]))
    };
    router
        .route("/api/v1/openapi.json", get(serve_description))
        .method_not_allowed_fallback(method_not_allowed)
        .fallback(web_client::serve)
        .layer(CatchPanicLayer::custom(panicked))
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(RequestBodyTimeoutLayer::new(BODY_PAUSE))
        .with_state(state)
}

/// Returns a router with only metrics and probes, for a separate address. It requires no token and no TLS, which probes rarely support.
pub fn metrics_router(state: ApiState) -> Router {
    Router::new()
        .route("/metrics", get(metrics::show))
        .route("/healthz", get(health::healthz))
        .route("/readyz", get(health::readyz))
        .with_state(state)
}

/// Deserializes a whole number of a query. The message of the error names the expected range.
fn whole_number<'de, D: Deserializer<'de>>(from: D) -> Result<u32, D::Error> {
    let text = String::deserialize(from)?;
    text.parse()
        .map_err(|_| D::Error::custom(format!("{text:?}, expected a whole number, 0 to {}", u32::MAX)))
}

/// Returns the response to a request whose handler panicked.
fn panicked(panic: Box<dyn Any + Send>) -> Response {
    let message = (panic.downcast_ref::<String>().map(String::as_str)).or(panic.downcast_ref::<&str>().copied());
    ApiError::internal(message.unwrap_or("a handler panicked")).into_response()
}

async fn method_not_allowed(method: Method, uri: Uri) -> Response {
    ApiError::method_unknown(&method, uri.path()).into_response()
}
