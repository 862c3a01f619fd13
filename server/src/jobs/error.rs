//! Errors of requests about batch jobs.

use isopeel_extraction::WorkError;
use isopeel_view::EditError;
use isopeel_volumes::{IdentityError, UnknownStep};

use super::MAX_EXTRACTIONS;
use super::results::ReadResultError;

/// Why a request about batch jobs fails. Each variant needs a different response of the caller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// The owner has no such job.
    #[error(
        "no job of yours has the id {0:?} on this server, /api/v1/jobs lists those there are; a job belongs to the server that took it"
    )]
    UnknownJob(String),
    /// The server has no such volume.
    #[error("no volume has the id {0:?}, /api/v1/volumes lists those there are")]
    UnknownVolume(String),
    /// An extraction asks for a time step that the volume does not have.
    #[error("extraction {extraction}: {source}")]
    Step {
        /// Number of the extraction, from 0.
        extraction: usize,
        /// The unknown step.
        source: UnknownStep,
    },
    /// A value of an extraction is out of its range.
    #[error("extraction {extraction}: {source}")]
    Edit {
        /// Number of the extraction, from 0.
        extraction: usize,
        /// The invalid value.
        source: EditError,
    },
    /// Too many extractions, or none.
    #[error("{0} extractions, expected 1 to {MAX_EXTRACTIONS}")]
    Extractions(usize),
    /// The key is too long, or not ASCII.
    #[error("an idempotency key of {0} bytes, expected 1 to 255 visible ASCII characters")]
    BadKey(usize),
    /// The key belongs to another request.
    #[error(
        "the idempotency key {key:?} was used for another request, which is job {job}: expected a new key, or the same request"
    )]
    KeyReused {
        /// The idempotency key.
        key: String,
        /// Id of the job that the first request with this key created.
        job: String,
    },
    /// The owner has too many unfinished jobs, or too many jobs in all.
    #[error("there are {found} {which}, the limit is {limit}: {advice}")]
    TooMany {
        /// Number of jobs.
        found: u64,
        /// Kind of jobs that the limit counts.
        which: &'static str,
        /// Maximum number of such jobs.
        limit: u64,
        /// Advice to the user.
        advice: &'static str,
    },
    /// The results of the job may exceed the rest of the quota.
    #[error(
        "the results may take up to {estimated} bytes, {left} of the quota of {quota} are left: ask for a budget (`triangles`) or for fewer extractions, or delete jobs"
    )]
    OverQuota {
        /// Estimated bytes of the results.
        estimated: u64,
        /// Bytes that are left of the quota.
        left: u64,
        /// Bytes of the whole quota.
        quota: u64,
    },
    /// The identity of the job's input files cannot be determined.
    #[error(transparent)]
    Input(#[from] IdentityError),
    /// The server is estimating other jobs.
    #[error("other jobs are being accepted, try again in a few seconds")]
    Busy,
    /// The volume cannot be read, or the device does not work.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// A job cannot be deleted before it is finished.
    #[error("job {0} is not finished, expected it to be: cancel it first")]
    NotFinished(String),
    /// A finished job cannot be cancelled.
    #[error("job {job} is {state}, expected one that is queued or running")]
    Finished {
        /// Id of the job.
        job: String,
        /// State of the job.
        state: &'static str,
    },
    /// An extraction has no result.
    #[error("extraction {extraction} of job {job} {why}")]
    NoResult {
        /// Id of the job.
        job: String,
        /// Number of the extraction, from 0.
        extraction: u32,
        /// Why there is no result.
        why: String,
    },
    /// The result's file cannot be read.
    #[error(transparent)]
    Result(#[from] ReadResultError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The store of jobs failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// SQLite failed.
    #[error("the job store failed")]
    Sqlite(#[from] rusqlite::Error),
    /// A newer version of this program has written the store.
    #[error(
        "the job store has version {found}, this program knows those up to {known}: start a newer one, or name another state folder"
    )]
    Newer {
        /// Version of the store.
        found: i64,
        /// Newest version that this program knows.
        known: i64,
    },
    /// A row has an invalid value.
    #[error("the job store holds {0}, which this program did not write")]
    Malformed(String),
    /// The thread that uses the store panicked.
    #[error("the job store's thread failed, the server's log says why")]
    Panicked,
}

impl StoreError {
    /// Whether the disk of the store is full.
    pub fn is_full(&self) -> bool {
        matches!(self, Self::Sqlite(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull))
    }
}
