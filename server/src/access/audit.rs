//! The audit log: a JSON line for each sign-in, stream, export, job and upload, for each refused request, and for each token that appears
//! or is removed. Lines contain no secrets. They contain no names of volumes either, because these may be names of patients.

mod event;
mod refusals;
mod writer;

use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use axum::http::{Method, StatusCode};
use axum::response::Response;
use serde::Serialize;

pub(super) use event::Event;
use event::{created_id, event_of};
use refusals::{Kind, Refusals};
use writer::{Command, Writer};

use super::identity::Identity;
use super::named::NamedToken;
use super::peer::counted_as;
use crate::clock;
use crate::problem::ProblemCode;

/// Time over which repeated refusals of one kind are counted. Then one line states their number.
const COUNTING_PERIOD: Duration = Duration::from_secs(60);

/// Interval at which due counts are written.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum number of lines that wait for the disk, some 200 bytes each. If the queue is full, lines are dropped instead of delaying
/// requests, and a later line states their number.
const QUEUE: usize = 4_096;

/// Pause before a flush tries again to enter a full queue.
const FULL_QUEUE_PAUSE: Duration = Duration::from_millis(1);

/// The result of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Outcome {
    Ok,
    /// Authentication, authorization, the host check or a rate limit refused the request.
    Refused,
    Failed,
    /// The client disconnected before the response.
    Abandoned,
}

/// A line of the log.
#[derive(Debug, Serialize)]
struct Line<'a> {
    time: String,
    event: Event,
    result: Outcome,
    #[serde(skip_serializing_if = "Option::is_none")]
    status: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    user: Option<&'a str>,
    /// Id of the token.
    #[serde(skip_serializing_if = "Option::is_none")]
    token: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peer: Option<IpAddr>,
    /// Id of the job.
    #[serde(skip_serializing_if = "Option::is_none")]
    job: Option<&'a str>,
    /// Id of the upload.
    #[serde(skip_serializing_if = "Option::is_none")]
    upload: Option<&'a str>,
    /// Number of further refusals of this kind since the previous line of this kind.
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<u64>,
}

/// The audit log. Clones write to the same file.
#[derive(Clone, Debug)]
pub struct Audit(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    commands: SyncSender<Command>,
    side_channel: Arc<SideChannel>,
}

/// State that the writer reads beside its queue, which may be full.
#[derive(Debug, Default)]
struct SideChannel {
    /// Number of dropped lines that no line has stated yet.
    lost: AtomicU64,
    /// Whether the writer must open the file again.
    must_reopen: AtomicBool,
    refusals: Mutex<Refusals>,
}

/// Why the audit log cannot be opened.
#[derive(Debug, thiserror::Error)]
#[error("audit log {}", path.display())]
pub struct AuditError {
    path: PathBuf,
    source: io::Error,
}

impl Audit {
    /// Opens a log that appends to the file at `path`. If the file does not exist, creates it with access for the user of the server only.
    ///
    /// # Errors
    /// [`AuditError`].
    pub fn open(path: &Path) -> Result<Self, AuditError> {
        let fail = |source| AuditError {
            path: path.to_owned(),
            source,
        };
        let (commands, receiver) = mpsc::sync_channel(QUEUE);
        let side_channel = Arc::default();
        let writer = Writer::open(path, &side_channel).map_err(fail)?;
        let thread = std::thread::Builder::new().name("audit".into());
        thread.spawn(move || writer.run(&receiver)).map_err(fail)?;
        Ok(Self(Arc::new(Shared { commands, side_channel })))
    }

    /// Opens the file again before the next line, after log rotation has moved it away.
    pub fn reopen(&self) {
        self.0.side_channel.must_reopen.store(true, Ordering::Relaxed);
        // If the queue is full, the writer is awake.
        let _ = self.0.commands.try_send(Command::Wake);
    }

    /// Waits until all lines are in the file, but at most for `limit`.
    pub fn flush(&self, limit: Duration) {
        let end = Instant::now() + limit;
        let (done, flushed) = mpsc::sync_channel(1);
        let mut command = Command::Flush(done);
        while let Err(TrySendError::Full(unsent)) = self.0.commands.try_send(command) {
            if Instant::now() >= end {
                return;
            }
            std::thread::sleep(FULL_QUEUE_PAUSE);
            command = unsent;
        }
        let _ = flushed.recv_timeout(end.saturating_duration_since(Instant::now()));
    }

    fn write(&self, line: &Line<'_>) {
        if let Err(TrySendError::Full(_)) = self.0.commands.try_send(Command::Write(line.text())) {
            self.0.side_channel.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Writes a refusal, or only counts it if one of the same kind was written within [`COUNTING_PERIOD`]. So clients without a token
    /// cannot fill the disk.
    fn refused(&self, line: &Line<'_>) {
        let kind = Kind {
            event: line.event,
            status: line.status,
            code: line.code,
            who: line
                .user
                .zip(line.token)
                .map(|(user, token)| (user.into(), token.into())),
            peer: line.peer.map(counted_as),
        };
        let is_first = lock(&self.0.side_channel.refusals).count(kind, Instant::now());
        if is_first {
            self.write(line);
        }
    }

    /// Logs that a token has appeared in the state folder, or was removed from it.
    pub(super) fn token(&self, event: Event, token: &NamedToken) {
        self.write(&Line {
            time: now(),
            event,
            result: Outcome::Ok,
            status: None,
            code: None,
            user: Some(&token.user),
            token: Some(&token.id),
            peer: None,
            job: None,
            upload: None,
            count: None,
        });
    }

    /// Begins the log entry of a request.
    pub(super) fn begin(&self, method: &Method, path: &str, peer: Option<IpAddr>) -> Pending {
        let (event, id) = event_of(method, path);
        Pending {
            audit: self.clone(),
            event,
            id,
            peer,
            who: None,
            is_answered: false,
        }
    }
}

impl Line<'_> {
    fn text(&self) -> Vec<u8> {
        // Cannot fail: serde_json fails only for maps whose keys are not strings, and a line has no maps.
        let mut text = serde_json::to_vec(self).unwrap_or_default();
        text.push(b'\n');
        text
    }
}

fn lock(refusals: &Mutex<Refusals>) -> MutexGuard<'_, Refusals> {
    refusals.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A request without a response yet. If this value is dropped before the response, the client has disconnected, and the request is logged
/// as abandoned.
pub(super) struct Pending {
    audit: Audit,
    event: Event,
    id: Option<String>,
    peer: Option<IpAddr>,
    who: Option<Identity>,
    is_answered: bool,
}

impl Pending {
    pub(super) fn set_identity(&mut self, who: &Identity) {
        self.who = Some(who.clone());
    }

    /// Logs the response to the request.
    pub(super) fn answered(mut self, response: &Response) {
        self.is_answered = true;
        let status = response.status();
        let code = response.extensions().get().map(|&ProblemCode(code)| code);
        let result = match status {
            // A refused sign-in redirects the browser to the page, which shows the reason.
            _ if status.is_redirection() && code.is_some() => Outcome::Refused,
            StatusCode::UNAUTHORIZED
            | StatusCode::FORBIDDEN
            | StatusCode::MISDIRECTED_REQUEST
            | StatusCode::TOO_MANY_REQUESTS => Outcome::Refused,
            _ if status.is_client_error() || status.is_server_error() => Outcome::Failed,
            _ => Outcome::Ok,
        };
        // Other requests are logged only if they were refused, because they are many and change nothing.
        if self.event == Event::Request && result != Outcome::Refused {
            return;
        }
        if let Some(who) = response.extensions().get::<Identity>() {
            self.set_identity(who);
        }
        let id = self.id.take().or_else(|| created_id(response.headers()));
        self.write(result, Some(status.as_u16()), code, id.as_deref());
    }

    fn write(&self, result: Outcome, status: Option<u16>, code: Option<&'static str>, id: Option<&str>) {
        let is_upload = matches!(
            self.event,
            Event::UploadCreate | Event::UploadFinish | Event::UploadDelete
        );
        let line = Line {
            time: now(),
            event: self.event,
            result,
            status,
            code,
            user: self.who.as_ref().map(Identity::user),
            token: self.who.as_ref().map(Identity::token),
            peer: self.peer,
            job: id.filter(|_| !is_upload),
            upload: id.filter(|_| is_upload),
            count: None,
        };
        match result {
            Outcome::Refused => self.audit.refused(&line),
            Outcome::Ok | Outcome::Failed | Outcome::Abandoned => self.audit.write(&line),
        }
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if !self.is_answered && self.event != Event::Request {
            self.write(Outcome::Abandoned, None, None, self.id.as_deref());
        }
    }
}

fn now() -> String {
    clock::rfc3339_millis(SystemTime::now())
}

#[cfg(test)]
mod tests {
    use axum::http::header::LOCATION;
    use axum::response::IntoResponse;
    use serde_json::Value;

    use super::refusals::MAX_KINDS;
    use super::*;
    use crate::problem::ApiError;

    fn lines(path: &Path) -> Vec<Value> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn lines_say_who_has_done_what_and_no_names_of_volumes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit");
        let audit = Audit::open(&path).unwrap();
        let peer = Some([192, 0, 2, 1].into());
        let mut export = audit.begin(&Method::POST, "/api/v1/extract", peer);
        export.set_identity(&Identity::without_token());
        export.answered(&StatusCode::OK.into_response());
        audit
            .begin(&Method::GET, "/api/v1/volumes/MUSTERMANN-ERIKA", peer)
            .answered(&StatusCode::OK.into_response());
        let refused = ApiError::new(StatusCode::FORBIDDEN, "forbidden", "no").into_response();
        audit
            .begin(&Method::GET, "/api/v1/volumes/MUSTERMANN-ERIKA/slices", peer)
            .answered(&refused);
        let submitted = (StatusCode::CREATED, [(LOCATION, "/api/v1/jobs/a1")]).into_response();
        audit.begin(&Method::POST, "/api/v1/jobs", peer).answered(&submitted);
        let declared = (StatusCode::CREATED, [(LOCATION, "/api/v1/uploads/b2")]).into_response();
        audit.begin(&Method::POST, "/api/v1/uploads", peer).answered(&declared);
        // Parts of an upload are not logged: they are many, and no user sees a change before the upload is finished.
        let part = audit.begin(&Method::PATCH, "/api/v1/uploads/b2", peer);
        part.answered(&StatusCode::NO_CONTENT.into_response());
        let finished = audit.begin(&Method::POST, "/api/v1/uploads/b2/finish", peer);
        finished.answered(&StatusCode::OK.into_response());
        drop(audit.begin(&Method::DELETE, "/api/v1/uploads/b2", peer));
        drop(audit.begin(&Method::GET, "/api/v1/jobs/a1/results/0", peer));
        drop(audit.begin(&Method::GET, "/api/v1/jobs/MUSTERMANN%20/results/0", peer));
        audit.flush(Duration::from_secs(5));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(!text.contains("MUSTERMANN"), "{text}");
        let mut lines = lines(&path);
        for line in &mut lines {
            let time = line["time"].take();
            assert!(time.as_str().unwrap().ends_with('Z'), "{time}");
        }
        let expected = [
            serde_json::json!({"time": null, "event": "export", "result": "ok", "status": 200, "user": "operator", "token": "none", "peer": "192.0.2.1"}),
            serde_json::json!({"time": null, "event": "request", "result": "refused", "status": 403, "code": "forbidden", "peer": "192.0.2.1"}),
            serde_json::json!({"time": null, "event": "job-submit", "result": "ok", "status": 201, "peer": "192.0.2.1", "job": "a1"}),
            serde_json::json!({"time": null, "event": "upload-create", "result": "ok", "status": 201, "peer": "192.0.2.1", "upload": "b2"}),
            serde_json::json!({"time": null, "event": "upload-finish", "result": "ok", "status": 200, "peer": "192.0.2.1", "upload": "b2"}),
            serde_json::json!({"time": null, "event": "upload-delete", "result": "abandoned", "peer": "192.0.2.1", "upload": "b2"}),
            serde_json::json!({"time": null, "event": "job-result", "result": "abandoned", "peer": "192.0.2.1", "job": "a1"}),
            serde_json::json!({"time": null, "event": "job-result", "result": "abandoned", "peer": "192.0.2.1"}),
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn refusals_are_written_once_a_minute_and_kind_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit");
        let audit = Audit::open(&path).unwrap();
        let refuse = |peer: u32| {
            let refused = ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", "no").into_response();
            let peer = Some(std::net::Ipv4Addr::from_bits(peer).into());
            audit.begin(&Method::GET, "/api/v1/volumes", peer).answered(&refused);
        };
        (0..1_000).for_each(|_| refuse(1));
        (0..3).for_each(|_| refuse(2));
        audit.flush(Duration::from_secs(5));
        let written = lines(&path);
        let mut counts: Vec<_> = written.iter().map(|line| line["count"].as_u64()).collect();
        counts.sort_unstable();
        assert_eq!(counts, [None, None, Some(2), Some(999)], "{written:?}");
        // One client may use all addresses of an IPv6 network.
        for host in 0..3 {
            let refused = ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", "no").into_response();
            let peer = std::net::Ipv6Addr::from_bits((0x2001_0db8 << 96) + host);
            let request = audit.begin(&Method::GET, "/api/v1/volumes", Some(peer.into()));
            request.answered(&refused);
        }
        audit.flush(Duration::from_secs(5));
        let written = lines(&path);
        let of_network: Vec<_> = written.iter().filter(|line| line["peer"] == "2001:db8::").collect();
        assert_eq!(of_network.len(), 2, "{of_network:?}");
        assert_eq!(of_network[1]["count"], 2);
        // The number of lines is bounded, however many addresses there are.
        (0..50_000).for_each(|peer| refuse(0x0a00_0000 + peer));
        audit.flush(Duration::from_secs(5));
        let lines = lines(&path);
        assert!(lines.len() <= written.len() + MAX_KINDS + 2, "{} lines", lines.len());
        let counted: u64 = lines.iter().map(|line| line["count"].as_u64().unwrap_or(1)).sum();
        assert_eq!(counted, 51_006);
    }

    #[test]
    fn a_file_that_was_moved_away_is_made_anew_and_old_lines_stay() {
        let folder = tempfile::tempdir().unwrap();
        let [path, old] = ["audit", "audit.1"].map(|name| folder.path().join(name));
        let audit = Audit::open(&path).unwrap();
        let export = || {
            let pending = audit.begin(&Method::POST, "/api/v1/extract", None);
            pending.answered(&StatusCode::OK.into_response());
            audit.flush(Duration::from_secs(5));
        };
        export();
        std::fs::rename(&path, &old).unwrap();
        export();
        audit.reopen();
        export();
        assert_eq!((lines(&old).len(), lines(&path).len()), (2, 1));
        drop(Audit::open(&path).unwrap());
        assert_eq!(lines(&path).len(), 1, "it is not begun anew");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        }
        let none = Audit::open(folder.path()).unwrap_err();
        assert!(none.to_string().starts_with("audit log "), "{none}");
    }

    #[test]
    fn a_disk_that_is_slow_holds_up_nobody_and_what_is_lost_is_counted() {
        let (commands, received) = mpsc::sync_channel(2);
        let side_channel = Arc::<SideChannel>::default();
        let audit = Audit(Arc::new(Shared {
            commands,
            side_channel: Arc::clone(&side_channel),
        }));
        for _ in 0..5 {
            audit
                .begin(&Method::POST, "/api/v1/extract", None)
                .answered(&StatusCode::OK.into_response());
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit");
        let old = folder.path().join("audit.1");
        let writer = Writer::open(&path, &side_channel).unwrap();
        std::fs::rename(&path, &old).unwrap();
        // The queue is full.
        audit.reopen();
        let waiting = audit.clone();
        let flushed = std::thread::spawn(move || {
            let begun = Instant::now();
            waiting.flush(Duration::from_secs(60));
            begun.elapsed()
        });
        drop(audit);
        writer.run(&received);
        assert!(flushed.join().unwrap() < Duration::from_secs(60));
        assert!(lines(&old).is_empty());
        let lines = lines(&path);
        assert_eq!(lines.len(), 3, "{lines:?}");
        assert_eq!((&lines[0]["event"], &lines[0]["count"]), (&"lost".into(), &3.into()));
    }
}
