//! The whole server behind one listener: [`run`] takes the listener and a future that resolves at shutdown.

use std::time::Duration;

use axum::Router;
use axum::http::{Method, header};
use axum::serve::ListenerExt;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};
use tower_http::cors::{AllowOrigin, CorsLayer};
use tower_http::trace::TraceLayer;

use crate::access::AllowedOrigin;
use crate::extraction::{DeviceWorker, Extractor, WorkError};
use crate::rest::{self, ApiState};
use crate::stream::{self, Deadlines, Live, LiveOptions, StreamState};
use crate::volumes::SharedCatalog;
use crate::wire::encode::encoded_bytes;

/// Maximum time that a shutdown waits for running requests and for viewers' close handshakes.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(10);

/// Configuration of a server.
pub struct Config {
    /// The volumes.
    pub catalog: SharedCatalog,
    /// The device, which may still be opening.
    pub worker: DeviceWorker,
    /// Surfaces of more triangles are refused before they are made.
    pub ceiling_triangles: u64,
    /// How volumes with time steps are served.
    pub live: LiveOptions,
    /// Deadlines of viewers' connections.
    pub deadlines: Deadlines,
    /// Origins whose pages may use the server, beside its own.
    pub origins: Vec<AllowedOrigin>,
}

/// Why a server ended on its own.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The device could not be opened.
    #[error(transparent)]
    Device(#[from] WorkError),
    /// The listener failed.
    #[error("the listener failed")]
    Listener(#[from] std::io::Error),
}

/// Serves REST, the stream and the web client until `shutdown` resolves, then closes every connection and returns.
///
/// Answers at once; what needs the device waits until it is open (`GET /readyz`).
///
/// # Errors
/// [`ServeError`]; a device that cannot be opened ends the server.
pub async fn run(
    listener: TcpListener,
    config: Config,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let Config {
        catalog,
        worker,
        ceiling_triangles,
        live,
        deadlines,
        origins,
    } = config;
    let stop = CancellationToken::new();
    // Ends the viewers' tasks however this function ends.
    let _stop_viewers = stop.clone().drop_guard();
    let extractor = Extractor::new(worker.clone(), ceiling_triangles, encoded_bytes);
    let backend = Live::new(catalog.clone(), extractor.clone(), live);
    let viewers = StreamState::new(backend, deadlines, &origins, stop.clone());
    let app = app(ApiState::new(catalog, extractor), viewers.clone(), &origins);

    // Or a small text frame waits for the acknowledgement of the chunk before it.
    let listener = listener.tap_io(|connection| {
        if let Err(error) = connection.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
    });
    let server = axum::serve(listener, app).with_graceful_shutdown(stop.clone().cancelled_owned());
    let mut server = tokio::spawn(server.into_future());
    let opened = async {
        match worker.ready().await {
            Ok(device) => {
                tracing::info!(device = device.name, platform = device.platform, "device ready");
                std::future::pending().await
            }
            Err(error) => error,
        }
    };
    let outcome = tokio::select! {
        () = shutdown => Ok(()),
        error = opened => Err(error.into()),
        ended = &mut server => return Ok(ended.map_err(std::io::Error::other)??),
    };
    stop.cancel();
    let ended = tokio::time::timeout(SHUTDOWN_GRACE, async {
        viewers.closed().await;
        let _ = (&mut server).await;
    });
    if ended.await.is_err() {
        tracing::warn!(
            "connections still open after {} s are dropped",
            SHUTDOWN_GRACE.as_secs()
        );
        server.abort();
    }
    outcome
}

fn app(api: ApiState, viewers: StreamState<Live>, origins: &[AllowedOrigin]) -> Router {
    // gzip on meshes takes longer than it saves on the line.
    let compress = DefaultPredicate::new()
        .and(NotForContentType::const_new("model/"))
        .and(NotForContentType::const_new("application/octet-stream"));
    rest::router(api)
        .merge(stream::router(viewers))
        .layer(cross_origin(origins))
        .layer(CompressionLayer::new().compress_when(compress))
        .layer(CatchPanicLayer::new())
        // Failures are logged with their causes where the answer is made.
        .layer(TraceLayer::new_for_http().on_failure(()))
}

/// Lets pages of these origins read answers of REST; browsers keep all others from it.
fn cross_origin(origins: &[AllowedOrigin]) -> CorsLayer {
    let origins = origins.iter().map(AllowedOrigin::header);
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods([Method::GET, Method::POST])
        .allow_headers([header::CONTENT_TYPE])
        .expose_headers([rest::STATISTICS_HEADER, rest::SLICE_HEADER])
}
