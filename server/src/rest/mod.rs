//! REST under `/api/v1`, described at `/api/v1/openapi.json`.
//!
//! Handlers check the request, call catalog or extraction, and make the answer. Every error is an [`ApiError`], a problem document with
//! a stable code.

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
use crate::service::DeviceWorker;
use crate::uploads::Uploads;
use export_queue::{ExportQueue, QueueLimits};
use extract::address::KnownDigests;
use precompressed::Precompressed;

/// Maximum bytes of a request body, the same as of a message on the WebSocket. 64 control points take about 4 KiB.
const MAX_BODY_BYTES: usize = 64 * 1024;

/// Maximum time between two parts of a request's body, as for its head.
const BODY_PAUSE: Duration = Duration::from_secs(10);

/// Limits of exports. Each running export holds a mesh in memory until its client has read it or timed out: with the regions it was made
/// from, some 100 MB for a million triangles. A waiting export holds a connection.
const EXPORTS: QueueLimits = QueueLimits {
    running: 4,
    running_of_user: 3,
    waiting: 32,
    waiting_of_user: 8,
    wait: Duration::from_secs(60),
};

/// Limits of slices that are made at a time: planes of samples, some megabytes each. A viewer drags up to three at once.
const SLICES: SeatLimits = SeatLimits {
    what: "slices that are being made",
    all: 8,
    of_user: 6,
    of_address: 7,
    reserve: 1,
};

/// Limits of overviews that are made at a time. Each takes up to 24 MiB until it is complete, and equal requests share one. A viewer that
/// steps through time requests one after another.
const OVERVIEWS: SeatLimits = SeatLimits {
    what: "overviews that are being made",
    all: 6,
    of_user: 3,
    of_address: 5,
    reserve: 1,
};

/// Limits of streams of jobs' events, each of which holds a connection.
const EVENT_STREAMS: SeatLimits = SeatLimits {
    what: "streams of events",
    all: 64,
    of_user: 32,
    of_address: 48,
    reserve: 4,
};

/// State of all handlers; clones are cheap.
#[derive(Clone)]
pub struct ApiState {
    catalog: SharedCatalog,
    worker: DeviceWorker,
    exports: ExportQueue,
    known_digests: KnownDigests,
    slices: Seats,
    overviews: Seats,
    events: Seats,
    spool: SpoolFolder,
    access: Access,
    /// `None`: the server has no batch jobs.
    jobs: Option<Jobs>,
    /// `None`: the server does not accept uploads.
    uploads: Option<Uploads>,
    /// Whether the server is about to end.
    is_draining: Arc<AtomicBool>,
}

impl ApiState {
    /// Serves the volumes of a catalog, and surfaces of them, to users whom `access` authorizes.
    pub fn new(catalog: SharedCatalog, worker: DeviceWorker, access: Access) -> Self {
        Self {
            catalog,
            worker,
            exports: ExportQueue::new(EXPORTS),
            known_digests: KnownDigests::default(),
            slices: Seats::new(SLICES),
            overviews: Seats::new(OVERVIEWS),
            events: Seats::new(EVENT_STREAMS),
            spool: SpoolFolder::default(),
            access,
            jobs: None,
            uploads: None,
            is_draining: Arc::default(),
        }
    }

    /// Adds batch jobs.
    #[must_use]
    pub fn with_jobs(self, jobs: Option<Jobs>) -> Self {
        Self { jobs, ..self }
    }

    /// Spools exports that clients read slowly to this folder, instead of that of temporary files.
    #[must_use]
    pub fn with_spool(self, folder: Option<SpoolFolder>) -> Self {
        Self {
            spool: folder.unwrap_or_default(),
            ..self
        }
    }

    /// Reads from this flag whether the server is draining.
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
                       /api/v1/stream, subprotocol isopeel.v2, specified in PROTOCOL.md. Every error answer is an \
                       application/problem+json document.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    components(schemas(Problem, isopeel_extraction::ExtractionStatistics, crate::jobs::JobEvent))
)]
struct Doc;

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
        .routes(routes!(metrics::show))
}

/// The description of this API, OpenAPI 3.1.
pub fn openapi() -> utoipa::openapi::OpenApi {
    described(routed().into_openapi())
}

fn described(mut openapi: utoipa::openapi::OpenApi) -> utoipa::openapi::OpenApi {
    description::Completed.modify(&mut openapi);
    openapi
}

/// Returns the description as it is sent. It is serialized once.
fn described_once(description: &utoipa::openapi::OpenApi) -> Arc<Precompressed> {
    // Cannot fail: all keys of its maps are strings.
    let text = serde_json::to_vec(description).unwrap_or_default();
    let hash = format!("{:032x}", xxhash_rust::xxh3::xxh3_128(&text));
    Arc::new(Precompressed::new(text.into(), hash, true))
}

/// REST, and the web client on all other paths.
pub fn router(state: ApiState) -> Router {
    let (router, description) = routed().split_for_parts();
    let description = described_once(&described(description));
    let answer_description = async move |request: HeaderMap| {
        let json = HeaderValue::from_static("application/json");
        description.respond(&request, HeaderMap::from_iter([(header::CONTENT_TYPE, json)]))
    };
    router
        .route("/api/v1/openapi.json", get(answer_description))
        .method_not_allowed_fallback(method_not_allowed)
        .fallback(web_client::serve)
        .layer(CatchPanicLayer::custom(panicked))
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(RequestBodyTimeoutLayer::new(BODY_PAUSE))
        .with_state(state)
}

/// Returns a router for metrics and health alone, for an address of their own. It needs no token, and no TLS, which probes rarely support.
pub fn metrics_router(state: ApiState) -> Router {
    Router::new()
        .route("/metrics", get(metrics::show))
        .route("/healthz", get(health::healthz))
        .route("/readyz", get(health::readyz))
        .with_state(state)
}

/// Reads a whole number of a query.
fn whole_number<'de, D: Deserializer<'de>>(from: D) -> Result<u32, D::Error> {
    let text = String::deserialize(from)?;
    text.parse()
        .map_err(|_| D::Error::custom(format!("{text:?}, expected a whole number, 0 to {}", u32::MAX)))
}

/// The answer to a request whose handler panicked.
fn panicked(panic: Box<dyn Any + Send>) -> Response {
    let words = (panic.downcast_ref::<String>().map(String::as_str)).or(panic.downcast_ref::<&str>().copied());
    ApiError::internal(words.unwrap_or("a handler panicked")).into_response()
}

async fn method_not_allowed(method: Method, uri: Uri) -> Response {
    ApiError::method_unknown(&method, uri.path()).into_response()
}
