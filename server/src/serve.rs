//! The whole server behind one listener: [`run`] takes the listener and a future that resolves at shutdown.

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
use crate::service::DeviceWorker;
use crate::stream::{self, Deadlines, LiveBackend, LiveOptions, StreamState};
use crate::uploads::Uploads;
pub use connections::ConnectionLimits;
pub use listener::{ListenAddress, Listener, SocketFile};
pub use tls::{Tls, TlsError};

/// Grace of a server that does not drain: the process ends within 2 s of the signal.
pub const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// Configuration of a server.
pub struct Config {
    /// The volumes.
    pub catalog: SharedCatalog,
    /// The device, which may still be opening.
    pub worker: DeviceWorker,
    /// Maximum triangles of a surface. Larger ones are refused before they are made.
    pub ceiling_triangles: u64,
    /// How viewers and volumes with time steps are served.
    pub live: LiveOptions,
    /// Deadlines of viewers' connections.
    pub deadlines: Deadlines,
    /// Who may use the server.
    pub access: Access,
    /// `None`: connections are not encrypted.
    pub tls: Option<Arc<Tls>>,
    /// Limits of connections.
    pub connections: ConnectionLimits,
    /// Listener that serves metrics without a token; `None`: metrics need a token with the role `admin`.
    pub metrics: Option<Listener>,
    /// Volumes that users have uploaded; `None`: uploads are refused.
    pub uploads: Option<Uploads>,
    /// Folder of batch jobs, and their limits; `None`: there are none.
    pub jobs: Option<(StateFolder, Limits)>,
    /// Folder in which exports wait for clients that read slowly; `None`: among temporary files.
    pub spool: Option<SpoolFolder>,
    /// Whether the server is about to end: it continues to serve, and `/readyz` says that clients should use another server.
    pub is_draining: Arc<AtomicBool>,
    /// Maximum time that a shutdown waits for running requests and for viewers' close handshakes. The rest is then cancelled.
    pub grace: Duration,
}

impl Config {
    /// Returns the defaults for a server of these volumes on this device: no limit of triangles, no TLS, no listener of its own for
    /// metrics, no jobs and no uploads.
    pub fn new(catalog: SharedCatalog, worker: DeviceWorker, access: Access) -> Self {
        Self {
            catalog,
            worker,
            ceiling_triangles: u64::MAX,
            live: LiveOptions::default(),
            deadlines: Deadlines::default(),
            access,
            tls: None,
            connections: ConnectionLimits::default(),
            metrics: None,
            uploads: None,
            jobs: None,
            spool: None,
            is_draining: Arc::default(),
            grace: SHUTDOWN_GRACE,
        }
    }
}

/// Why a server ended on its own.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The device could not be opened.
    #[error(transparent)]
    Device(#[from] WorkError),
    /// Only a new process can use the device.
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

/// Serves REST, the stream and the web client until `shutdown` resolves, then closes every connection and returns.
///
/// Serves at once; requests that need the device wait until it is open (`GET /readyz`).
///
/// # Errors
/// [`ServeError`]; a device that cannot be opened ends the server. After [`ServeError::NeedsNewProcess`] the caller must start another
/// process.
pub async fn run(
    listener: impl Into<Listener>,
    config: Config,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let Config {
        catalog,
        worker,
        ceiling_triangles,
        live,
        deadlines,
        access,
        tls,
        connections: limits,
        metrics: metrics_listener,
        jobs,
        uploads,
        spool,
        is_draining,
        grace,
    } = config;
    metrics::start()?;
    let stop = CancellationToken::new();
    // Ends the viewers' tasks on every return path of this function.
    let _stop_viewers = stop.clone().drop_guard();
    let worker = worker.with_ceiling(ceiling_triangles);
    let backend = LiveBackend::new(catalog.clone(), worker.clone(), live);
    let viewers = StreamState::new(backend, deadlines, stop.clone()).with_shared_bytes(live.shared_bytes);
    let jobs = match jobs {
        Some((folder, limits)) => {
            Some(Jobs::open(folder, limits, catalog.clone(), worker.clone(), stop.clone()).await?)
        }
        None => None,
    };
    let api = ApiState::new(catalog, worker.clone(), access.clone()).with_jobs(jobs.clone());
    let api = (api.with_uploads(uploads.clone()).with_spool(spool)).with_draining(is_draining);
    let proxies = Arc::clone(access.proxies());
    let _metrics = serve_metrics(metrics_listener, api.clone(), limits, stop.clone());
    let app = app(api, viewers.clone(), access);
    let _expiry = uploads.map(|uploads| AbortOnDropHandle::new(tokio::spawn(uploads.run(stop.clone()))));
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
        error = worker.unusable() => Err(error.map_or(ServeError::NeedsNewProcess, ServeError::Device)),
        ended = &mut server => return Ok(ended.map_err(std::io::Error::other)?),
    };
    stop.cancel();
    let ended = tokio::time::timeout(grace, async {
        viewers.closed().await;
        let _ = (&mut server).await;
        let _ = (&mut runner).await;
    });
    if ended.await.is_err() {
        tracing::warn!("connections still open after {} ms are dropped", grace.as_millis());
        server.abort();
        runner.abort();
    }
    outcome
}

/// Runs the upkeep of metrics, and serves them at an address of their own, until the returned guard is dropped.
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
        let served = async {
            match listener {
                None => std::future::pending().await,
                Some(listener) => {
                    let app = rest::metrics_router(api);
                    connections::serve(listener, app, limits, Arc::default(), None, stop).await;
                }
            }
        };
        tokio::join!(upkeep, served);
    }))
}

/// Counts the answers, by route.
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
    // Files of the page and unknown paths share one label.
    let route = route.as_ref().map_or("other", MatchedPath::as_str);
    metrics::answered(method, route, response.status().as_u16(), started.elapsed());
    response
}

/// Answers below this size are not compressed.
const MIN_COMPRESSED_BYTES: u64 = 1 << 10;

fn app(api: ApiState, viewers: StreamState<LiveBackend>, access: Access) -> Router {
    // Meshes are not compressed, because gzip takes longer than it saves in transfer. The same is true of answers that fit a packet, which
    // clients without a token may request.
    let compress = DefaultPredicate::new()
        .and(SizeAbove::new(MIN_COMPRESSED_BYTES))
        .and(NotForContentType::const_new("model/"))
        .and(NotForContentType::const_new("application/octet-stream"));
    let set = |name: HeaderName, value: HeaderValue| SetResponseHeaderLayer::overriding(name, value);
    rest::router(api)
        .merge(stream::router(viewers))
        .layer(middleware::from_fn_with_state(access.clone(), admit))
        // This layer is outside of `admit`, so that a page of an allowed origin can read why a request was refused.
        .layer(cross_origin(access.origins()))
        .layer(set(header::CONTENT_SECURITY_POLICY, content_security_policy(&access)))
        .layer(set(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")))
        .layer(set(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")))
        .layer(CompressionLayer::new().compress_when(compress))
        .layer(middleware::map_request(accept_plain))
        .layer(CatchPanicLayer::new())
        // No `on_failure` here: failures are logged with their causes when the answer is made.
        .layer(middleware::from_fn(count))
        .layer(TraceLayer::new_for_http().make_span_with(request_span).on_failure(()))
}

/// Adds `identity` as the last choice to `Accept-Encoding`. Otherwise the compression layer changes the status of an answer to 406 if the client
/// accepts none of its own encodings, also if the answer is already encoded as the client wants it.
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

/// Lets pages of these origins read answers of REST. Browsers do not let other pages read them.
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
