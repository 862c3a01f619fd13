//! The stream: a WebSocket connection and a session for each viewer. Normative: `PROTOCOL.md`.
//!
//! - `socket`: the tasks that read and write a connection.
//! - `session`: the state of one viewer and its surfaces, in one task.
//! - `prefix`: compares surfaces, and encodes the regions that have changed as frames.
//! - `shared`: single-flight and cache of surfaces for viewers of equal views.
//! - `groups`: viewers who follow the one in control.
//! - `backend`: catalog and device, which tests replace.
//! - `viewers`: limits on viewers and on the bytes that wait for them.

mod backend;
mod groups;
mod prefix;
mod session;
mod shared;
mod socket;
mod viewers;

use axum::Router;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::any;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::access::Identity;
use crate::metrics::ConnectedViewer;
use crate::problem::ApiError;
use crate::wire::messages::{CloseCode, MAX_MESSAGE_BYTES, SUBPROTOCOL};
pub use backend::{Backend, LiveBackend, LiveOptions, Opening, SHARED_BYTES};
use groups::Groups;
pub use session::StepTimes;
use shared::Shared;
pub use socket::Deadlines;
pub use viewers::MAX_VIEWERS;
use viewers::Viewers;

/// Maximum bytes of a message that is read. It is above [`MAX_MESSAGE_BYTES`], so that the server can answer a message slightly over that
/// limit with the right close code. A message over this limit ends the connection.
const MAX_READ_BYTES: usize = 16 * MAX_MESSAGE_BYTES;

/// Size of a connection's read buffer. It is small, because edits have some hundred bytes and the library fills the buffer with zeros
/// before each read. The library's default of 128 KiB is for servers that receive large messages.
const READ_BUFFER_BYTES: usize = 4 << 10;

/// State that the sessions of all viewers share: count of viewers, cached surfaces, and groups. Clones are cheap.
#[derive(Clone)]
struct Common {
    viewers: Viewers,
    shared: Shared,
    groups: Groups,
}

impl Common {
    /// `shared_bytes`: capacity of the cache of chunks.
    fn new(shared_bytes: u64) -> Self {
        Self {
            viewers: Viewers::default(),
            shared: Shared::new(shared_bytes),
            groups: Groups::default(),
        }
    }
}

/// State of the route `/stream`, one for all connections. Clones are cheap.
#[derive(Clone)]
pub struct StreamState<B> {
    backend: B,
    deadlines: Deadlines,
    common: Common,
    /// Tasks of all connections, so that a shutdown can wait for the last one.
    tasks: TaskTracker,
    shutdown: CancellationToken,
}

impl<B: Backend> StreamState<B> {
    /// Creates the state, with a cache of the default size. Cancelling `shutdown` ends the connections with [`CloseCode::Shutdown`].
    pub fn new(backend: B, deadlines: Deadlines, shutdown: CancellationToken) -> Self {
        Self {
            backend,
            deadlines,
            common: Common::new(SHARED_BYTES),
            tasks: TaskTracker::new(),
            shutdown,
        }
    }

    /// Sets the capacity of the cache of chunks for viewers of equal views.
    #[must_use]
    pub fn with_shared_bytes(mut self, bytes: u64) -> Self {
        self.common = Common::new(bytes);
        self
    }

    /// Waits until the last connection has ended. Call this after `shutdown` was cancelled.
    pub async fn closed(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }
}

/// Returns the router of the WebSocket at `/api/v1/stream`. [`crate::access::gate`] checks authorization before, because browsers let any
/// page open a WebSocket to any server.
pub fn router<B: Backend>(state: StreamState<B>) -> Router {
    Router::new()
        .route("/api/v1/stream", any(upgrade::<B>))
        .with_state(state)
}

/// Upgrades a request to a WebSocket, if the client offers the subprotocol.
async fn upgrade<B: Backend>(
    State(state): State<StreamState<B>>,
    who: Identity,
    headers: HeaderMap,
    socket: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let socket = match socket {
        Ok(socket) => socket.protocols([SUBPROTOCOL]),
        Err(rejection) => {
            return ApiError::new(rejection.status(), "bad-request", rejection.body_text()).into_response();
        }
    };
    if socket.selected_protocol().is_none() {
        return wrong_subprotocol(&headers).into_response();
    }
    let tasks = state.tasks.clone();
    socket
        .max_message_size(MAX_READ_BYTES)
        .max_frame_size(MAX_READ_BYTES)
        .read_buffer_size(READ_BUFFER_BYTES)
        .on_upgrade(move |socket| tasks.track_future(serve_viewer(socket, state, who)))
}

/// Serves a viewer until the connection ends. Refuses the viewer if there are too many.
async fn serve_viewer<B: Backend>(socket: WebSocket, state: StreamState<B>, who: Identity) {
    let StreamState {
        backend,
        deadlines,
        common,
        shutdown,
        ..
    } = state;
    match common.viewers.enter(&who) {
        Ok(_seat) => {
            let _connected = ConnectedViewer::enter();
            socket::serve(socket, backend.charged_to(&who), common, who, deadlines, shutdown).await;
        }
        Err(no_seat) => {
            tracing::debug!("a viewer is refused: {no_seat}");
            ConnectedViewer::refused();
            socket::refuse(socket, CloseCode::TooManyViewers, deadlines).await;
        }
    }
}

/// Returns the error for a client that does not offer [`SUBPROTOCOL`].
fn wrong_subprotocol(headers: &HeaderMap) -> ApiError {
    let offered = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).iter();
    let offered: Vec<_> = offered.map(|value| value.to_str().unwrap_or("?")).collect();
    let message = format!(
        "the client offers the subprotocols {:?}, but isopeel {} supports only {SUBPROTOCOL:?}: use a client of the same version, or \
         reload the page",
        offered.join(", "),
        env!("CARGO_PKG_VERSION")
    );
    ApiError::new(StatusCode::BAD_REQUEST, "bad-request", message)
}
