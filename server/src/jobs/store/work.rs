//! Transactions of the runner.

use std::sync::PoisonError;

use isopeel_extraction::MeasuredError;
use isopeel_volumes::InputIdentity;
use rusqlite::Transaction;

use super::super::MAX_ATTEMPTS;
use super::super::error::StoreError;
use super::super::results::Written;
use super::super::state::{Cause, JobState};
use super::requests::file_request;
use super::{Store, add_event, now, optional};
use crate::export::FileRequest;

/// An extraction whose attempt has begun.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// Number of the job in the store.
    pub(super) number: i64,
    /// Id of the job.
    pub job: String,
    /// Owner of the job.
    pub owner: String,
    /// Number of the extraction in its job, from 0.
    pub extraction: u32,
    /// The requested file.
    pub request: FileRequest,
    /// Id of the volume.
    pub volume: String,
    /// Input files that the job has pinned when it was submitted.
    pub input: InputIdentity,
    /// Bytes of all results of the owner.
    pub bytes_taken: u64,
}

/// How an attempt ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The result was flushed to the disk.
    Done {
        /// The written file.
        written: Written,
        /// Triangles of the surface.
        triangles: u64,
        /// Error of the surface, if it was measured.
        error: Option<MeasuredError>,
        /// Notices about what the file format could not hold.
        notices: Vec<String>,
        /// Seconds that the attempt took.
        seconds: f64,
    },
    /// The surface has no triangles, and the request does not ask for an empty file.
    Empty(Cause),
    /// The attempt failed; another attempt may succeed.
    Failed(Cause),
    /// The attempt failed, and every other attempt would fail too.
    Refused(Cause),
    /// No extraction of the job will succeed.
    JobFailed(Cause),
    /// The attempt does not count, because the extraction did not cause its failure.
    GivenBack,
}

impl Store {
    /// Begins an attempt at the next extraction, and counts the attempt. Returns `None` if no extraction is waiting.
    ///
    /// Owners with unfinished jobs take turns, so that an owner of many jobs does not delay the others. The oldest unfinished job of an
    /// owner is next. An extraction that has used all of its attempts fails.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn begin_attempt(&self) -> Result<Option<Work>, StoreError> {
        let last_owner = || self.last_owner.lock().unwrap_or_else(PoisonError::into_inner);
        let after = last_owner().clone();
        let next_work = self.write(move |transaction| {
            while let Some((number, extraction, attempts)) = next(transaction, &after)? {
                if attempts < MAX_ATTEMPTS {
                    return start(transaction, number, extraction).map(Some);
                }
                let cause = Cause {
                    code: "attempts-exhausted".into(),
                    detail: format!("the server ended during each of {attempts} attempts"),
                };
                fail(transaction, number, extraction, &cause)?;
                finish_job(transaction, number, extraction)?;
            }
            Ok(None)
        });
        let next_work: Option<Work> = next_work.await?;
        if let Some(work) = &next_work {
            last_owner().clone_from(&work.owner);
        }
        Ok(next_work)
    }

    /// Records how an attempt ended. Returns false, without a change, if the job is no longer running: a user has cancelled or deleted it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn finish(&self, work: &Work, outcome: Outcome) -> Result<bool, StoreError> {
        let (number, extraction) = (work.number, work.extraction);
        self.write(move |transaction| {
            let row = transaction.query_row("SELECT state FROM jobs WHERE number = ?1", [number], |row| {
                Ok(row.get::<_, String>(0).map_err(StoreError::from))
            });
            if optional(row)?.as_deref() != Some(JobState::Running.name()) {
                return Ok(false);
            }
            apply(transaction, number, extraction, &outcome)?;
            Ok(true)
        })
        .await
    }
}

/// Returns the next extraction: number of its job, its own number, and its attempts so far. Owners are sorted by name and served round
/// robin; `after` is the previous owner.
fn next(transaction: &Transaction<'_>, after: &str) -> Result<Option<(i64, u32, u32)>, StoreError> {
    // Finds the job first, because sorting all waiting extractions would take longer.
    let query = "SELECT number FROM jobs WHERE state IN ('queued', 'running')
        AND EXISTS (SELECT 1 FROM extractions WHERE job = number AND state = 'waiting') ORDER BY owner <= ?1, owner, number LIMIT 1";
    let Some(number): Option<i64> = optional(transaction.query_row(query, [after], |row| Ok(Ok(row.get(0)?))))? else {
        return Ok(None);
    };
    let query = "SELECT job, extraction, attempts FROM extractions WHERE job = ?1 AND state = 'waiting' ORDER BY extraction LIMIT 1";
    optional(transaction.query_row(query, [number], |row| Ok(Ok((row.get(0)?, row.get(1)?, row.get(2)?)))))
}

fn start(transaction: &Transaction<'_>, number: i64, extraction: u32) -> Result<Work, StoreError> {
    transaction.execute(
        "UPDATE extractions SET attempts = attempts + 1 WHERE job = ?1 AND extraction = ?2",
        (number, extraction),
    )?;
    let is_first = transaction.execute(
        "UPDATE jobs SET state = 'running', started = ?2 WHERE number = ?1 AND state = 'queued'",
        (number, now()),
    )?;
    if is_first > 0 {
        add_event(transaction, number, None)?;
    }
    let query = "SELECT id, owner, volume, input, request,
            (SELECT coalesce(sum(bytes), 0) FROM jobs AS others WHERE others.owner = jobs.owner)
            FROM jobs JOIN extractions ON job = number WHERE number = ?1 AND extraction = ?2";
    let (job, owner, volume, input, request, bytes_taken): (_, _, _, String, String, _) =
        transaction.query_row(query, (number, extraction), |row| {
            Ok((
                row.get(0)?,
                row.get(1)?,
                row.get(2)?,
                row.get(3)?,
                row.get(4)?,
                row.get(5)?,
            ))
        })?;
    Ok(Work {
        number,
        job,
        owner,
        extraction,
        request: file_request(&request)?,
        volume,
        input: serde_json::from_str(&input).map_err(|_| StoreError::Malformed(input))?,
        bytes_taken,
    })
}

fn apply(transaction: &Transaction<'_>, number: i64, extraction: u32, outcome: &Outcome) -> Result<(), StoreError> {
    match outcome {
        Outcome::Done {
            written,
            triangles,
            error,
            notices,
            seconds,
        } => {
            let notices = serde_json::to_string(notices).map_err(|error| StoreError::Malformed(error.to_string()))?;
            transaction.execute(
                "UPDATE extractions SET state = 'done', bytes = ?3, checksum = ?4, triangles = ?5, seconds = ?6,
                    error_rms = ?7, error_max = ?8, notices = ?9 WHERE job = ?1 AND extraction = ?2",
                (
                    number,
                    extraction,
                    written.bytes,
                    &written.checksum[..],
                    triangles,
                    seconds,
                    error.map(|error| error.rms),
                    error.map(|error| error.max),
                    notices,
                ),
            )?;
            transaction.execute(
                "UPDATE jobs SET done = done + 1, bytes = bytes + ?2, seconds = seconds + ?3 WHERE number = ?1",
                (number, written.bytes, seconds),
            )?;
        }
        Outcome::Empty(cause) => end_without_result(transaction, number, extraction, "empty", cause)?,
        Outcome::Refused(cause) => fail(transaction, number, extraction, cause)?,
        Outcome::Failed(cause) => {
            let query = "SELECT attempts FROM extractions WHERE job = ?1 AND extraction = ?2";
            let attempts: u32 = transaction.query_row(query, (number, extraction), |row| row.get(0))?;
            if attempts < MAX_ATTEMPTS {
                return Ok(());
            }
            fail(transaction, number, extraction, cause)?;
        }
        Outcome::JobFailed(cause) => {
            let update =
                "UPDATE jobs SET state = 'failed', finished = ?2, error_code = ?3, error_detail = ?4 WHERE number = ?1";
            transaction.execute(update, (number, now(), &cause.code, &cause.detail))?;
            return add_event(transaction, number, None);
        }
        Outcome::GivenBack => {
            let update = "UPDATE extractions SET attempts = attempts - 1 WHERE job = ?1 AND extraction = ?2";
            transaction.execute(update, (number, extraction))?;
            return Ok(());
        }
    }
    finish_job(transaction, number, extraction)
}

fn fail(transaction: &Transaction<'_>, number: i64, extraction: u32, cause: &Cause) -> Result<(), StoreError> {
    end_without_result(transaction, number, extraction, "failed", cause)
}

/// Ends an extraction as `failed` or `empty`. `state` is also the name of the job's column that counts such extractions.
fn end_without_result(
    transaction: &Transaction<'_>,
    number: i64,
    extraction: u32,
    state: &'static str,
    cause: &Cause,
) -> Result<(), StoreError> {
    transaction.execute(
        "UPDATE extractions SET state = ?3, error_code = ?4, error_detail = ?5 WHERE job = ?1 AND extraction = ?2",
        (number, extraction, state, &cause.code, &cause.detail),
    )?;
    let count = format!("UPDATE jobs SET {state} = {state} + 1 WHERE number = ?1");
    transaction.execute(&count, [number])?;
    Ok(())
}

/// Adds an event for an extraction that has ended, and ends its job if no other extraction remains. The job fails if an extraction has
/// failed, or if all surfaces are empty.
fn finish_job(transaction: &Transaction<'_>, number: i64, extraction: u32) -> Result<(), StoreError> {
    transaction.execute(
        "UPDATE jobs SET finished = ?2,
            state = CASE WHEN failed > 0 OR empty = total THEN 'failed' ELSE 'done' END,
            error_code = CASE WHEN failed > 0 THEN 'extractions-failed' WHEN empty = total THEN 'empty-surface' END,
            error_detail = CASE WHEN failed > 0 THEN failed || ' of ' || total || ' extractions have no result'
                WHEN empty = total THEN 'none of the ' || total || ' surfaces has triangles' END
            WHERE number = ?1 AND done + failed + empty = total",
        (number, now()),
    )?;
    add_event(transaction, number, Some(extraction))
}
