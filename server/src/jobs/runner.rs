//! Makes the extractions of all jobs, one at a time. Users take turns; jobs of one user run in the order in which they were submitted. On
//! the device and on processors, viewers have priority over jobs, as they have over every export.
//!
//! Jobs survive the end of the process because of the order of an attempt: the attempt is counted, the file is made, the file and its name
//! are flushed to the disk, and only then does the store record that the extraction is done. If the process ends between two of these
//! steps, the extraction is made once more, and its file replaces the one that was left.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use tokio_util::sync::CancellationToken;

use super::error::StoreError;
use super::maker::{MakeFailure, Maker};
use super::results::{Results, WriteError};
use super::state::Cause;
use super::store::Store;
use super::store::work::{Outcome, Work};

/// State that the runner shares with the requests of clients.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// Notified when there may be work.
    pub wake: Notify,
    /// Notified whenever something has happened to a job.
    pub changes: watch::Sender<()>,
    /// The job whose extraction is being made. The lock is held while the next extraction is taken from the store, so that a request that
    /// cancels its job finds it here.
    current: tokio::sync::Mutex<Option<(String, CancellationToken)>>,
    paused: Mutex<Option<&'static str>>,
}

impl Signals {
    /// Cancels the extraction that is being made, if it belongs to this job.
    pub(super) async fn cancel(&self, job: &str) {
        match &*self.current.lock().await {
            Some((current, token)) if current == job => token.cancel(),
            _ => {}
        }
    }

    /// Returns the reason why the runner is paused; `None` if it is not.
    pub(super) fn paused(&self) -> Option<&'static str> {
        *self.paused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set_paused(&self, why: Option<&'static str>) {
        let before = std::mem::replace(&mut *self.paused.lock().unwrap_or_else(PoisonError::into_inner), why);
        if before != why {
            self.changes.send_replace(());
        }
    }
}

/// Back-off between attempts to write when the disk is full or fails: each wait is twice the one before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Backoff {
    /// First wait.
    pub first: Duration,
    /// Longest wait.
    pub longest: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self {
            first: Duration::from_secs(1),
            longest: Duration::from_secs(30),
        }
    }
}

/// The runner.
pub(super) struct Runner<M> {
    pub store: Store,
    pub results: Results,
    pub maker: M,
    pub signals: std::sync::Arc<Signals>,
    pub stop: CancellationToken,
    pub quota_bytes: u64,
    pub backoff: Backoff,
}

/// Why the runner has to wait before it continues.
enum Fault {
    Full(String),
    Other(String),
    /// The disk works, but the server has too much to do.
    Busy,
}

impl From<&StoreError> for Fault {
    fn from(error: &StoreError) -> Self {
        let why = crate::error::chain(error);
        if error.is_full() {
            Self::Full(why)
        } else {
            Self::Other(why)
        }
    }
}

impl<M: Maker> Runner<M> {
    /// Runs until it is stopped.
    pub(super) async fn run(self) {
        let mut wait = self.backoff.first;
        while !self.stop.is_cancelled() {
            match self.turn().await {
                Ok(true) => wait = self.backoff.first,
                Ok(false) => tokio::select! {
                    () = self.signals.wake.notified() => {}
                    () = self.stop.cancelled() => {}
                },
                Err(fault) => self.pause(&fault, &mut wait).await,
            }
        }
    }

    /// Makes one extraction; returns false if none is waiting.
    async fn turn(&self) -> Result<bool, Fault> {
        let Some((work, token)) = self.take().await? else {
            // No extraction is waiting, so the paused job was cancelled.
            self.signals.set_paused(None);
            return Ok(false);
        };
        let (outcome, fault) = self.attempt(&work, &token).await;
        *self.signals.current.lock().await = None;
        let is_done = matches!(outcome, Outcome::Done { .. });
        let wanted = self.note(&work, outcome).await;
        if wanted == Some(false) && is_done {
            self.results.remove((&work.job, work.extraction)).await;
        }
        match fault {
            Some(fault) => Err(fault),
            None => {
                self.signals.set_paused(None);
                Ok(true)
            }
        }
    }

    async fn take(&self) -> Result<Option<(Work, CancellationToken)>, Fault> {
        let mut current = self.signals.current.lock().await;
        let taken = self.store.begin().await.map_err(|error| Fault::from(&error))?;
        self.signals.changes.send_replace(());
        Ok(taken.map(|work| {
            let token = self.stop.child_token();
            *current = Some((work.job.clone(), token.clone()));
            (work, token)
        }))
    }

    /// Makes an extraction and puts its file on the disk.
    async fn attempt(&self, work: &Work, token: &CancellationToken) -> (Outcome, Option<Fault>) {
        let start = Instant::now();
        let file = match self.maker.make(work, token).await {
            Ok(file) => file,
            Err(failure) => return of_failure(failure, token),
        };
        let (triangles, error, notices) = (file.triangles(), file.error(), file.notices());
        let left = self.quota_bytes.saturating_sub(work.bytes_taken);
        let written = match self
            .results
            .write((&work.job, work.extraction), file, left, token)
            .await
        {
            Ok(written) => written,
            // The error is ignored: a cancelled job may have been deleted together with its folder.
            Err(_) if token.is_cancelled() => return (Outcome::GivenBack, None),
            Err(error) => return of_write_error(&error),
        };
        // Checks the input again, because a file may have changed while it was read.
        if let Err(failure) = self.maker.check(work).await {
            self.results.remove((&work.job, work.extraction)).await;
            return of_failure(failure, token);
        }
        let outcome = Outcome::Done {
            written,
            triangles,
            error,
            notices,
            seconds: start.elapsed().as_secs_f64(),
        };
        (outcome, None)
    }

    /// Stores the outcome of an attempt. Retries while the disk fails, so that the attempt is not lost. `None` if the server stops first.
    async fn note(&self, work: &Work, outcome: Outcome) -> Option<bool> {
        let mut wait = self.backoff.first;
        loop {
            match self.store.finish(work, outcome.clone()).await {
                Ok(wanted) => {
                    self.signals.changes.send_replace(());
                    return Some(wanted);
                }
                Err(_) if self.stop.is_cancelled() => return None,
                Err(error) => self.pause(&Fault::from(&error), &mut wait).await,
            }
        }
    }

    async fn pause(&self, fault: &Fault, wait: &mut Duration) {
        let (why, cause) = match fault {
            Fault::Full(cause) => (Some("disk-full"), cause.as_str()),
            Fault::Other(cause) => (Some("storage"), cause.as_str()),
            Fault::Busy => (None, ""),
        };
        if let Some(why) = why
            && self.signals.paused() != Some(why)
        {
            tracing::warn!(why, cause, "batch jobs pause, and go on by themselves");
        }
        self.signals.set_paused(why);
        let ended = tokio::time::timeout(*wait, self.stop.cancelled()).await;
        if ended.is_err() {
            *wait = (*wait * 2).min(self.backoff.longest);
        }
    }
}

fn of_failure(failure: MakeFailure, token: &CancellationToken) -> (Outcome, Option<Fault>) {
    match failure {
        _ if token.is_cancelled() => (Outcome::GivenBack, None),
        MakeFailure::Later => (Outcome::GivenBack, Some(Fault::Busy)),
        MakeFailure::Retry(cause) => (Outcome::Failed(cause), None),
        MakeFailure::Refused(cause) => (Outcome::Refused(cause), None),
        MakeFailure::Empty(cause) => (Outcome::Empty(cause), None),
        MakeFailure::JobFailed(cause) => (Outcome::JobFailed(cause), None),
    }
}

fn of_write_error(error: &WriteError) -> (Outcome, Option<Fault>) {
    let why = crate::error::chain(error);
    match error {
        WriteError::Full(_) => (Outcome::GivenBack, Some(Fault::Full(why))),
        WriteError::Storage(_) => (Outcome::GivenBack, Some(Fault::Other(why))),
        WriteError::Cancelled => (Outcome::GivenBack, None),
        WriteError::OverQuota { .. } => (refused("over-quota", why), None),
        WriteError::Export(_) => (refused("too-large", why), None),
    }
}

fn refused(code: &str, detail: String) -> Outcome {
    let code = code.into();
    Outcome::Refused(Cause { code, detail })
}

#[cfg(test)]
mod tests;
