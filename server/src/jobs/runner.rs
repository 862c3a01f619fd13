//! Makes the extractions of all jobs, one at a time. Users take turns; the jobs of a user run in the order of their submission. Viewers
//! have priority over jobs on the device and on processors, as over every export.
//!
//! An attempt has four steps, so that jobs survive the end of the process:
//!
//! 1. The store counts the attempt.
//! 2. The maker makes the file.
//! 3. The file and its folder are flushed to the disk.
//! 4. The store records that the extraction is done.
//!
//! If the process ends before the last step, the next process repeats the attempt, and its file replaces the earlier one.

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

/// State that the runner shares with the handlers of requests.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// Wakes an idle runner after a job was submitted.
    pub wake: Notify,
    /// Notified of every change of a job.
    pub changes: watch::Sender<()>,
    /// Id of the job whose extraction is being made, and the token that cancels the attempt. The runner holds the lock from the start of
    /// the transaction that begins an attempt until this value is set, so that a request that cancels the job cannot miss the attempt.
    current: tokio::sync::Mutex<Option<(String, CancellationToken)>>,
    /// Reason of the pause, if the runner is paused.
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

    /// Returns the reason of the pause; `None` if the runner is not paused.
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

/// Exponential back-off while the disk is full or fails, or the server is busy. Each wait is twice as long as the previous one.
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

/// Runs all jobs of a store. `M` makes the files.
pub(super) struct Runner<M> {
    pub store: Store,
    pub results: Results,
    pub maker: M,
    pub signals: std::sync::Arc<Signals>,
    pub stop: CancellationToken,
    pub quota_bytes: u64,
    pub backoff: Backoff,
}

/// Why the runner waits before the next attempt. Strings are error chains for the log.
enum Fault {
    /// The disk is full.
    Full(String),
    /// The disk fails for another reason.
    Other(String),
    /// The server is busy; the disk works.
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
            match self.run_next().await {
                Ok(true) => wait = self.backoff.first,
                Ok(false) => tokio::select! {
                    () = self.signals.wake.notified() => {}
                    () = self.stop.cancelled() => {}
                },
                Err(fault) => self.pause(&fault, &mut wait).await,
            }
        }
    }

    /// Makes one extraction. Returns false if none is waiting.
    async fn run_next(&self) -> Result<bool, Fault> {
        let Some((work, token)) = self.begin_attempt().await? else {
            // Ends a pause too: no extraction is waiting, so the user has cancelled the job that was paused.
            self.signals.set_paused(None);
            return Ok(false);
        };
        let (outcome, fault) = self.attempt(&work, &token).await;
        *self.signals.current.lock().await = None;
        let is_done = matches!(outcome, Outcome::Done { .. });
        let is_recorded = self.record(&work, outcome).await;
        if is_recorded == Some(false) && is_done {
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

    /// Begins an attempt at the next extraction. Returns the extraction, and the token that cancels the attempt; `None` if no extraction is
    /// waiting.
    async fn begin_attempt(&self) -> Result<Option<(Work, CancellationToken)>, Fault> {
        let mut current = self.signals.current.lock().await;
        let next = self.store.begin_attempt().await.map_err(|error| Fault::from(&error))?;
        self.signals.changes.send_replace(());
        Ok(next.map(|work| {
            let token = self.stop.child_token();
            *current = Some((work.job.clone(), token.clone()));
            (work, token)
        }))
    }

    /// Makes the file of an extraction and writes it to the disk. Returns how the attempt ended, and the fault to wait for, if any.
    async fn attempt(&self, work: &Work, token: &CancellationToken) -> (Outcome, Option<Fault>) {
        let start = Instant::now();
        let file = match self.maker.make(work, token).await {
            Ok(file) => file,
            Err(failure) => return outcome_of_failure(failure, token),
        };
        let (triangles, error, notices) = (file.triangles(), file.error(), file.notices());
        let left = self.quota_bytes.saturating_sub(work.bytes_taken);
        let written = match self
            .results
            .write((&work.job, work.extraction), file, left, token)
            .await
        {
            Ok(written) => written,
            // An error is ignored, because the user may have deleted the cancelled job and its folder.
            Err(_) if token.is_cancelled() => return (Outcome::GivenBack, None),
            Err(error) => return outcome_of_write_error(&error),
        };
        // Checks the input again, because a file may have changed during the attempt.
        if let Err(failure) = self.maker.check(work).await {
            self.results.remove((&work.job, work.extraction)).await;
            return outcome_of_failure(failure, token);
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

    /// Records the outcome of an attempt in the store. Retries while the disk fails, so that the file is not lost. Returns false if the job
    /// was cancelled meanwhile, and `None` if the server stops before the store works again.
    async fn record(&self, work: &Work, outcome: Outcome) -> Option<bool> {
        let mut wait = self.backoff.first;
        loop {
            match self.store.finish(work, outcome.clone()).await {
                Ok(is_recorded) => {
                    self.signals.changes.send_replace(());
                    return Some(is_recorded);
                }
                Err(_) if self.stop.is_cancelled() => return None,
                Err(error) => self.pause(&Fault::from(&error), &mut wait).await,
            }
        }
    }

    /// Waits for `wait`, and doubles it for the next pause. Clients see a pause because of the disk, but not one because the server is
    /// busy.
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

fn outcome_of_failure(failure: MakeFailure, token: &CancellationToken) -> (Outcome, Option<Fault>) {
    match failure {
        _ if token.is_cancelled() => (Outcome::GivenBack, None),
        MakeFailure::Later => (Outcome::GivenBack, Some(Fault::Busy)),
        MakeFailure::Retry(cause) => (Outcome::Failed(cause), None),
        MakeFailure::Refused(cause) => (Outcome::Refused(cause), None),
        MakeFailure::Empty(cause) => (Outcome::Empty(cause), None),
        MakeFailure::JobFailed(cause) => (Outcome::JobFailed(cause), None),
    }
}

fn outcome_of_write_error(error: &WriteError) -> (Outcome, Option<Fault>) {
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
