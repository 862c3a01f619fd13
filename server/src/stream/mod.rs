//! One viewer: its session and its socket. Normative: `PROTOCOL.md`.
//!
//! In reading order:
//!
//! - `schedule`, `prefix`: which prefixes are made, and what of one changed.
//! - `backend`: what a viewer needs of catalog and device.
//! - `session`: the state of one viewer, in one task.
//! - `socket`: the tasks that read and write.

mod backend;
mod prefix;
mod schedule;
mod session;
mod socket;

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::any;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::access::{AllowedOrigin, origin};
use crate::extraction::QUEUED_JOBS;
use crate::problem::ApiError;
use crate::wire::messages::{CloseCode, MAX_MESSAGE_BYTES, SUBPROTOCOL};
pub use backend::{Backend, Live, Opening};
pub use socket::Deadlines;

/// Viewers at a time; one more is closed with 4002. Each may hold a surface, a batch of encoded frames and one device job:
/// half of the queue, the other half is for REST.
pub const MAX_VIEWERS: usize = QUEUED_JOBS / 2;

/// Longest message that is read at all, bytes. Above [`MAX_MESSAGE_BYTES`], so that a message which is somewhat too long is
/// answered with its close code; what is longer still ends the connection unread.
const MAX_READ_BYTES: usize = 16 * MAX_MESSAGE_BYTES;

/// What the connections share; clones are cheap.
#[derive(Clone)]
pub struct StreamState<B> {
    backend: B,
    deadlines: Deadlines,
    origins: Arc<[AllowedOrigin]>,
    viewers: Arc<Semaphore>,
    /// Every connection, so that a shutdown can wait for the last.
    tasks: TaskTracker,
    shutdown: CancellationToken,
}

impl<B: Backend> StreamState<B> {
    /// Pages of other origins than the server's own are served where `origins` has theirs. Connections end, with [`CloseCode::Shutdown`], when `shutdown` is cancelled.
    pub fn new(backend: B, deadlines: Deadlines, origins: &[AllowedOrigin], shutdown: CancellationToken) -> Self {
        Self {
            backend,
            deadlines,
            origins: origins.into(),
            viewers: Arc::new(Semaphore::new(MAX_VIEWERS)),
            tasks: TaskTracker::new(),
            shutdown,
        }
    }

    /// Waits until the last connection is gone. Call it after the shutdown was asked for.
    pub async fn closed(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }
}

/// The WebSocket at `/api/v1/stream`.
pub fn router<B: Backend>(state: StreamState<B>) -> Router {
    Router::new()
        .route("/api/v1/stream", any(upgrade::<B>))
        .with_state(state)
}

async fn upgrade<B: Backend>(
    State(state): State<StreamState<B>>,
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
        let message = format!("the subprotocol {SUBPROTOCOL:?} was not offered, this server speaks no other");
        return ApiError::new(StatusCode::BAD_REQUEST, "bad-request", message).into_response();
    }
    if let Err(origin) = origin::check(&headers, &state.origins) {
        let message =
            format!("a page of {origin:?} may not use this server, expected its own or one that --allow-origin names");
        return ApiError::new(StatusCode::FORBIDDEN, "foreign-origin", message).into_response();
    }
    let tasks = state.tasks.clone();
    socket
        .max_message_size(MAX_READ_BYTES)
        .max_frame_size(MAX_READ_BYTES)
        .on_upgrade(move |socket| {
            tasks.track_future(async move {
                let StreamState {
                    backend,
                    deadlines,
                    viewers,
                    shutdown,
                    ..
                } = state;
                match viewers.try_acquire_owned() {
                    Ok(_permit) => socket::serve(socket, backend, deadlines, shutdown).await,
                    Err(_) => socket::refuse(socket, CloseCode::TooManyViewers, deadlines).await,
                }
            })
        })
}
