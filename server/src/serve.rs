//! The whole server behind one listener. [`run`] serves until a future resolves.

mod connections;
mod listener;
mod read_pace;
mod tls;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Body;
use axum::extract::MatchedPath;
use axum::http::{HeaderName, HeaderValue, Method, Request, header};
use axum::middleware;
use axum::response::Response;
use isopeel_extraction::WorkError;
use isopeel_volumes::SharedCatalog;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate, SizeAbove};
use tower_http::cors::{AllowOrigin, CorsLayer};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::trace::TraceLayer;

use crate::access::gate::admit;
use crate::access::{Access, AllowedOrigin, content_security_policy};
use crate::jobs::{Jobs, Limits, OpenError, StateFolder};
use crate::metrics;
use crate::rest::{self, ApiState, SpoolFolder};
use crate::service::DevicePool;
use crate::stream::{self, Deadlines, LiveBackend, LiveOptions, StreamState};
use crate::uploads::Uploads;
pub use connections::ConnectionLimits;
pub use listener::{ListenAddress, Listener, SocketFile};
pub use tls::{Tls, TlsError};

/// Default of [`Config::grace`]. The process then ends within 2 s after the signal.
pub const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// Configuration of a server.
pub struct Config {
    /// Volumes that the server offers.
    pub catalog: SharedCatalog,
    /// The devices, which may still be opening.
    pub devices: DevicePool,
    /// Maximum number of triangles of a surface. A larger surface is refused before it is made.
    pub ceiling_triangles: u64,
    /// Caches, and whether time steps may appear.
    pub live: LiveOptions,
    /// Deadlines of the connections of viewers.
    pub deadlines: Deadlines,
    /// Authentication and authorization.
    pub access: Access,
    /// Certificate and key; `None`: connections are not encrypted.
    pub tls: Option<Arc<Tls>>,
    /// Limits of connections.
    pub connections: ConnectionLimits,
    /// Additional listener that serves metrics and probes without a token; `None`: metrics require a token with the role `admin`.
    pub metrics: Option<Listener>,
    /// Uploads; `None`: the server accepts no uploads.
    pub uploads: Option<Uploads>,
    /// Folder and limits of batch jobs; `None`: the server has no batch jobs.
    pub jobs: Option<(StateFolder, Limits)>,
    /// Name of the server that takes batch jobs and uploads, if there are several behind a proxy.
    pub job_server: Option<Arc<str>>,
    /// Folder for spooled exports of slow clients; `None`: the folder for temporary files.
    pub spool: Option<SpoolFolder>,
    /// Set before the shutdown. The server then still answers requests, but `/readyz` reports that clients should use another server.
    pub is_draining: Arc<AtomicBool>,
    /// Maximum time that a shutdown waits for running requests and for the close handshakes of viewers. Then it cancels them.
    pub grace: Duration,
}

impl Config {
    /// Returns the default configuration: no limit of triangles, no TLS, no additional listener, no batch jobs and no uploads.
    pub fn new(catalog: SharedCatalog, devices: impl Into<DevicePool>, access: Access) -> Self {
        Self {
            catalog,
            devices: devices.into(),
            ceiling_triangles: u64::MAX,
            live: LiveOptions::default(),
            deadlines: Deadlines::default(),
            access,
            tls: None,
            connections: ConnectionLimits::default(),
            metrics: None,
            uploads: None,
            jobs: None,
            job_server: None,
            spool: None,
            is_draining: Arc::default(),
            grace: SHUTDOWN_GRACE,
        }
    }
}

/// Why a server ended without a shutdown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// No device could be opened.
    #[error(transparent)]
    Device(#[from] WorkError),
    /// This process cannot use the device any more, but a new process can.
    #[error("this process cannot use the device any more; a new one can")]
    NeedsNewProcess,
    /// Batch jobs cannot be stored.
    #[error(transparent)]
    Jobs(#[from] OpenError),
    /// Metrics cannot be recorded.
    #[error(transparent)]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
    /// The listener failed.
    #[error("the listener failed")]
    Listener(#[from] std::io::Error),
}

/// Serves REST, the stream and the web client until `shutdown` resolves, then closes all connections and returns.
///
/// Accepts requests at once. Requests that need a device wait until it is open (`GET /readyz`).
///
/// # Errors
/// [`ServeError`]. After [`ServeError::NeedsNewProcess`], the caller must start another process.
pub async fn run(
    listener: impl Into<Listener>,
    config: Config,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let Config {
        catalog,
        devices,
        ceiling_triangles,
        live,
        deadlines,
        access,
        tls,
        connections: limits,
        metrics: metrics_listener,
        jobs,
        job_server,
        uploads,
        spool,
        is_draining,
        grace,
    } = config;
    metrics::start()?;
    let stop = CancellationToken::new();
    // Ends the tasks of viewers, jobs and uploads when this function returns, also after an error.
    let _stop_guard = stop.clone().drop_guard();
    let devices = devices.with_ceiling(ceiling_triangles);
    let backend = LiveBackend::new(catalog.clone(), devices.clone(), live);
    let viewers = StreamState::new(backend, deadlines, stop.clone()).with_shared_bytes(live.shared_bytes);
    let jobs = match jobs {
        Some((folder, limits)) => {
            Some(Jobs::open(folder, limits, catalog.clone(), devices.clone(), stop.clone()).await?)
        }
        None => None,
    };
    let api = ApiState::new(catalog, devices.clone(), access.clone()).with_jobs(jobs.clone());
    let api = api.with_job_server(job_server);
    let api = (api.with_uploads(uploads.clone()).with_spool(spool)).with_draining(is_draining);
    let proxies = Arc::clone(access.proxies());
    let _metrics_task = serve_metrics(metrics_listener, api.clone(), limits, stop.clone());
    let app = app(api, viewers.clone(), access);
    let _expiry_task = uploads.map(|uploads| AbortOnDropHandle::new(tokio::spawn(uploads.run(stop.clone()))));
    let mut runner = tokio::spawn(async move {
        if let Some(jobs) = jobs {
            jobs.run().await;
        }
    });

    let mut server = tokio::spawn(connections::serve(
        listener.into(),
        app,
        limits,
        proxies,
        tls,
        stop.clone(),
    ));
    let outcome = tokio::select! {
        () = shutdown => Ok(()),
        error = devices.unusable() => Err(error.map_or(ServeError::NeedsNewProcess, ServeError::Device)),
        joined = &mut server => return Ok(joined.map_err(std::io::Error::other)?),
    };
    stop.cancel();
    let all_ended = tokio::time::timeout(grace, async {
        viewers.closed().await;
        let _ = (&mut server).await;
        let _ = (&mut runner).await;
    });
    if all_ended.await.is_err() {
        tracing::warn!("connections still open after {} ms are dropped", grace.as_millis());
        server.abort();
        runner.abort();
    }
    outcome
}

/// Runs the upkeep of metrics, and serves metrics on the additional listener, if there is one. Dropping the returned handle ends both.
fn serve_metrics(
    listener: Option<Listener>,
    api: ApiState,
    limits: ConnectionLimits,
    stop: CancellationToken,
) -> AbortOnDropHandle<()> {
    AbortOnDropHandle::new(tokio::spawn(async move {
        let upkeep = async {
            let mut interval = tokio::time::interval(metrics::UPKEEP);
            loop {
                interval.tick().await;
                metrics::upkeep();
            }
        };
        let serve = async {
            match listener {
                None => std::future::pending().await,
                Some(listener) => {
                    let app = rest::metrics_router(api);
                    connections::serve(listener, app, limits, Arc::default(), None, stop).await;
                }
            }
        };
        tokio::join!(upkeep, serve);
    }))
}

/// Records each request and its response in the metrics.
async fn count(request: Request<Body>, next: middleware::Next) -> Response {
    let started = Instant::now();
    let method = match *request.method() {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::PATCH => "PATCH",
        Method::POST => "POST",
        Method::DELETE => "DELETE",
        Method::OPTIONS => "OPTIONS",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().cloned();
    let response = next.run(request).await;
    // Paths without a route, which are files of the page and unknown paths, share one label.
    let route = route.as_ref().map_or("other", MatchedPath::as_str);
    metrics::answered(method, route, response.status().as_u16(), started.elapsed());
    response
}

/// Minimum bytes of a response that is compressed.
const MIN_COMPRESSED_BYTES: u64 = 1 << 10;

fn app(api: ApiState, viewers: StreamState<LiveBackend>, access: Access) -> Router {
    // Does not compress meshes, because compression takes longer than it saves in transfer. The same holds for responses that fit in one
    // packet, whose cost matters because clients without a token can request them.
    let compress = DefaultPredicate::new()
        .and(SizeAbove::new(MIN_COMPRESSED_BYTES))
        .and(NotForContentType::const_new("model/"))
        .and(NotForContentType::const_new("application/octet-stream"));
    let set = |name: HeaderName, value: HeaderValue| SetResponseHeaderLayer::overriding(name, value);
    rest::router(api)
        .merge(stream::router(viewers))
        .layer(middleware::from_fn_with_state(access.clone(), admit))
        // Outside `admit`, so that a page of an allowed origin can read why a request was refused.
        .layer(cross_origin(access.origins()))
        .layer(set(header::CONTENT_SECURITY_POLICY, content_security_policy(&access)))
        .layer(set(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")))
        .layer(set(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")))
        .layer(CompressionLayer::new().compress_when(compress))
        .layer(middleware::map_request(accept_plain))
        .layer(CatchPanicLayer::new())
        // No `on_failure`, because `ApiError` logs failures with their causes.
        .layer(middleware::from_fn(count))
        .layer(TraceLayer::new_for_http().make_span_with(request_span).on_failure(()))
}

/// Adds `identity` to `Accept-Encoding` with the lowest weight. Otherwise the compression layer changes the status of a response to 406 if
/// the client accepts none of the layer's encodings, even if the response already has an encoding that the client accepts.
async fn accept_plain(mut request: Request<Body>) -> Request<Body> {
    let headers = request.headers_mut();
    if headers.contains_key(header::ACCEPT_ENCODING) {
        headers.append(header::ACCEPT_ENCODING, HeaderValue::from_static("identity;q=0.001"));
    }
    request
}

/// Returns the tracing span of a request, without the query, which may contain a ticket.
fn request_span(request: &Request<Body>) -> tracing::Span {
    tracing::debug_span!("request", method = %request.method(), path = request.uri().path())
}

/// Returns the CORS layer. It lets pages of these origins read responses of REST.
fn cross_origin(origins: &[AllowedOrigin]) -> CorsLayer {
    let origins = origins.iter().map(AllowedOrigin::header);
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::PATCH, Method::DELETE])
        .allow_headers([
            header::CONTENT_TYPE,
            header::AUTHORIZATION,
            header::RANGE,
            header::IF_RANGE,
            header::IF_NONE_MATCH,
            header::CACHE_CONTROL,
            rest::LAST_EVENT_ID,
            rest::KEY_HEADER,
            rest::OFFSET_HEADER,
            rest::TUS_HEADER,
        ])
        .expose_headers([
            rest::STATISTICS_HEADER,
            rest::SLICE_HEADER,
            rest::OVERVIEW_HEADER,
            rest::DIGEST_HEADER,
            header::RETRY_AFTER,
            header::ACCEPT_RANGES,
            header::CONTENT_DISPOSITION,
            header::CONTENT_RANGE,
            header::ETAG,
            header::LOCATION,
            rest::OFFSET_HEADER,
            rest::LENGTH_HEADER,
            rest::TUS_HEADER,
        ])
}
