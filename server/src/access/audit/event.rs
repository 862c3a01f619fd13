//! The events of the audit log, and the requests that cause them.

use axum::http::Method;
use axum::http::header::{HeaderMap, LOCATION};
use serde::Serialize;

/// Kind of an event. Its name is part of the log format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::access) enum Event {
    /// A token was exchanged for a cookie, or the browser has returned from an issuer.
    SignIn,
    /// A user has signed out.
    SignOut,
    /// A stream was opened.
    Stream,
    /// A ticket was requested.
    Ticket,
    /// A token for a frame was requested.
    EmbedToken,
    /// A surface was requested as a file.
    Export,
    /// A batch job was submitted.
    JobSubmit,
    /// A batch job was cancelled.
    JobCancel,
    /// A batch job was deleted.
    JobDelete,
    /// A result of a batch job was read.
    JobResult,
    /// Files of an upload were declared.
    UploadCreate,
    /// The files of an upload were read as a volume.
    UploadFinish,
    /// The files of an upload were deleted.
    UploadDelete,
    /// Any other request. Logged only if it was refused.
    Request,
    /// A token appeared in the state folder.
    TokenCreated,
    /// A token was removed from the state folder.
    TokenRevoked,
}

/// Maximum bytes of a logged id of a job or an upload. The ids that the server assigns are shorter.
const MAX_ID_BYTES: usize = 64;

/// Returns the event of a request, and the id of its job or upload.
pub(super) fn event_of(method: &Method, path: &str) -> (Event, Option<String>) {
    let parts: Vec<&str> = path.strip_prefix("/api/v1/").unwrap_or("").split('/').collect();
    let (event, id) = match (parts.as_slice(), method) {
        (["session"], &Method::POST) | (["oidc", "callback"], _) => (Event::SignIn, None),
        (["session"], &Method::DELETE) => (Event::SignOut, None),
        (["tickets"], &Method::POST) => (Event::Ticket, None),
        (["embed-tokens"], &Method::POST) => (Event::EmbedToken, None),
        (["stream"], _) => (Event::Stream, None),
        (["extract"], &Method::GET | &Method::POST) => (Event::Export, None),
        (["jobs"], &Method::POST) => (Event::JobSubmit, None),
        (["jobs", id, "cancel"], &Method::POST) => (Event::JobCancel, Some(*id)),
        (["jobs", id], &Method::DELETE) => (Event::JobDelete, Some(*id)),
        (["jobs", id, "results", _], &Method::GET) => (Event::JobResult, Some(*id)),
        (["uploads"], &Method::POST) => (Event::UploadCreate, None),
        (["uploads", id, "finish"], &Method::POST) => (Event::UploadFinish, Some(*id)),
        (["uploads", id], &Method::DELETE) => (Event::UploadDelete, Some(*id)),
        _ => (Event::Request, None),
    };
    // The server assigns short alphanumeric ids. Any other text comes from the client, and is not logged.
    let is_id = |id: &str| id.len() <= MAX_ID_BYTES && id.bytes().all(|byte| byte.is_ascii_alphanumeric());
    (event, id.filter(|id| is_id(id)).map(str::to_owned))
}

/// Returns the id of the job or upload that a request has created, from the header `Location` of the response.
pub(super) fn created_id(headers: &HeaderMap) -> Option<String> {
    let location = headers.get(LOCATION)?.to_str().ok()?;
    let path = location.strip_prefix("/api/v1/")?;
    Some(path.strip_prefix("jobs/").or(path.strip_prefix("uploads/"))?.to_owned())
}
