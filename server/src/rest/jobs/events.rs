//! Events of a batch job as server-sent events.

use std::collections::VecDeque;
use std::convert::Infallible;

use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use tokio::sync::watch;

use crate::access::{Identity, Occupant, Seat};
use crate::jobs::{JobEvent, Jobs};
use crate::problem::{ApiError, Problem};
use crate::rest::ApiState;

/// Header with the id of the last event that a client has seen. Browsers send it when they reconnect.
pub const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// What happens to a job, until it is finished: an event each time that its state changes or an extraction ends, from the first on, or
/// after the one that `Last-Event-ID` names. Each has the name of the job's state and an id that increases. While the disk is full or
/// fails, so that no results can be written, there is an event `paused` with the reason, and one with the state when the job goes on. These
/// two have no id. A client that connects during a pause gets `paused` at once.
#[utoipa::path(
    get,
    path = "/api/v1/jobs/{id}/events",
    operation_id = "follow_job",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "A job's id"),
        ("last-event-id" = Option<i64>, Header, description = "The id of the last event that was seen"),
    ),
    responses(
        (status = 200, description = "Server-sent events, the data of each as `JobEvent`", body = String, content_type = "text/event-stream"),
        (status = 204, description = "The job is finished and its last event was seen: browsers do not connect again"),
        (status = 400, description = "`bad-request`: a malformed id of an event", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "`unknown-job`", body = Problem, content_type = "application/problem+json"),
        (status = 501, description = "`jobs-off`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "`busy`: the maximum number of event streams is open", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn events(
    State(state): State<ApiState>,
    who: Identity,
    id: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let jobs = state.jobs()?.clone();
    let Path(id) = id?;
    let after = last_event_id(&headers)?;
    let permit = state.events.acquire(Occupant::from(&who));
    let permit = permit.map_err(|error| ApiError::busy(error.to_string()))?;
    let changes = jobs.changes();
    let (first_events, is_finished) = jobs.events(who.user(), &id, after).await?;
    if first_events.is_empty() && is_finished {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let event_stream = EventStream {
        after: first_events.last().and_then(|event| event.id).unwrap_or(after),
        unsent: first_events.into(),
        paused: None,
        jobs,
        who,
        id,
        changes,
        _permit: permit,
    };
    let events = futures_util::stream::unfold(event_stream, EventStream::next);
    Ok(Sse::new(events).keep_alive(KeepAlive::default()).into_response())
}

fn last_event_id(headers: &HeaderMap) -> Result<i64, ApiError> {
    let Some(text) = headers.get(LAST_EVENT_ID) else {
        return Ok(0);
    };
    let id = text.to_str().ok().and_then(|text| text.parse().ok());
    id.ok_or_else(|| {
        let message = format!("last-event-id: {text:?}, expected the number of an event");
        ApiError::new(StatusCode::BAD_REQUEST, "bad-request", message)
    })
}

/// State of the stream that sends the events of a job to a client.
struct EventStream {
    jobs: Jobs,
    who: Identity,
    id: String,
    /// Id of the last event that was read from the store.
    after: i64,
    /// Events that were read from the store, but not sent yet.
    unsent: VecDeque<JobEvent>,
    /// Reason of the pause in the last event about a pause; `None` if the job is not paused by this event, or if there was none.
    paused: Option<String>,
    changes: watch::Receiver<()>,
    _permit: Seat,
}

impl EventStream {
    /// Waits for the next event. Returns `None` if the job is finished or was deleted, the token of the client is no longer valid, or the
    /// server stops.
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        while self.unsent.is_empty() {
            self.changes.mark_unchanged();
            let (events, is_finished) = self.jobs.events(self.who.user(), &self.id, self.after).await.ok()?;
            if let Some(last) = events.last() {
                self.after = last.id.unwrap_or(self.after);
                self.unsent = events.into();
            } else if is_finished {
                return None;
            } else if let Some(event) = self.pause_event().await? {
                self.unsent.push_back(event);
            } else {
                tokio::select! {
                    changed = self.changes.changed() => changed.ok()?,
                    () = self.jobs.stopped() => return None,
                    () = self.who.ended() => return None,
                }
            }
        }
        let event = self.unsent.pop_front()?;
        let sent = Event::default().event(event.name());
        let sent = match event.id {
            Some(id) => sent.id(id.to_string()),
            None => sent,
        };
        Some((Ok(sent.json_data(&event).ok()?), self))
    }

    /// Returns an event if the job has been paused or resumed since the last such event. The outer `None` means that the job was deleted.
    async fn pause_event(&mut self) -> Option<Option<JobEvent>> {
        let event = self.jobs.pause(self.who.user(), &self.id, self.paused.as_deref());
        let event = event.await.ok()?;
        if let Some(event) = &event {
            self.paused.clone_from(&event.paused);
        }
        Some(event)
    }
}
