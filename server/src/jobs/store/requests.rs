//! Transactions of clients. Each finds only the jobs of the given owner. The exception is [`Store::counts`], which counts the jobs of all
//! owners for metrics.

use data_encoding::HEXLOWER;
use isopeel_extraction::MeasuredError;
use rusqlite::{Row, Transaction};

use super::super::error::{JobError, StoreError};
use super::super::results::Checksum;
use super::super::state::{
    Cause, Estimate, ExtractionState, Failure, JobEvent, JobInfo, JobState, ManifestEntry, file_name,
};
use super::super::{Limits, MAX_JOBS, MAX_UNFINISHED_JOBS};
use super::{JOB_COLUMNS, Store, add_event, job_info, now, optional};
use crate::export::{FileRequest, Format};

/// Maximum number of failures that the description of a job lists.
const LISTED_FAILURES: u32 = 100;
/// Maximum number of events that one transaction reads, some 10 KiB.
const EVENT_BATCH: u32 = 100;

/// Identity of a request, by which repeated requests are detected.
#[derive(Clone, Debug)]
pub struct RequestKey {
    /// The user who sent the request, and who owns the job.
    pub owner: String,
    /// Value of the header `Idempotency-Key`.
    pub key: Option<String>,
    /// SHA-256 of the request. Another digest with the same key is an error.
    pub digest: Checksum,
}

/// A job to be stored.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// Id of the job.
    pub id: String,
    /// Identity of the request that submits the job.
    pub request: RequestKey,
    /// Id of the volume.
    pub volume: String,
    /// An [`isopeel_volumes::InputIdentity`] as JSON: the input files that the job has pinned.
    pub input: String,
    /// A [`FileRequest`] as JSON for each extraction.
    pub extractions: Vec<String>,
    /// Estimated cost of the job.
    pub estimate: Estimate,
}

/// What the store knows about a result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResultInfo {
    /// Length of the file in bytes.
    pub bytes: u64,
    /// SHA-256 of the file.
    pub checksum: Checksum,
    /// Format of the file.
    pub format: Format,
    /// Isovalue of the surface, if the request has one.
    pub iso: Option<f32>,
}

impl Store {
    /// Returns the job that the same request has created before, if any.
    ///
    /// # Errors
    /// [`JobError::KeyReused`].
    pub async fn repeated(&self, request: RequestKey) -> Result<Option<JobInfo>, JobError> {
        self.write(move |transaction| repeated(transaction, &request)).await
    }

    /// Stores a job. Returns the job, and whether it is new. If the same request has created a job before, returns that job.
    ///
    /// # Errors
    /// The limit that the job exceeds.
    pub async fn submit(&self, job: NewJob, limits: Limits) -> Result<(JobInfo, bool), JobError> {
        self.write(move |transaction| {
            if let Some(earlier) = repeated(transaction, &job.request)? {
                return Ok((earlier, false));
            }
            check_limits(transaction, &job, limits)?;
            insert(transaction, &job)?;
            Ok((find_job(transaction, &job.request.owner, &job.id)?.1, true))
        })
        .await
    }

    /// Returns all jobs of an owner, the latest first.
    ///
    /// # Errors
    /// [`JobError::Store`].
    pub async fn list(&self, owner: &str) -> Result<Vec<JobInfo>, JobError> {
        let owner = owner.to_owned();
        self.write(move |transaction| {
            let query = format!("SELECT {JOB_COLUMNS} FROM jobs WHERE owner = ?1 ORDER BY number DESC");
            let mut rows = transaction.prepare(&query).map_err(StoreError::from)?;
            let jobs = rows
                .query_map([owner], |row| Ok(job_info(row)))
                .map_err(StoreError::from)?;
            jobs.map(|job| Ok(job.map_err(StoreError::from)??.1)).collect()
        })
        .await
    }

    /// Returns the number of jobs of all owners in each state.
    ///
    /// # Errors
    /// [`JobError::Store`].
    pub async fn counts(&self) -> Result<Vec<(JobState, u64)>, JobError> {
        self.write(|transaction| {
            let count = |state: JobState| -> Result<_, StoreError> {
                let query = "SELECT COUNT(*) FROM jobs WHERE state = ?1";
                let count: i64 = transaction.query_row(query, [state.name()], |row| row.get(0))?;
                Ok((state, count.unsigned_abs()))
            };
            Ok(JobState::ALL.into_iter().map(count).collect::<Result<_, _>>()?)
        })
        .await
    }

    /// Returns a job with its failed extractions.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn get(&self, owner: &str, id: &str) -> Result<JobInfo, JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write(move |transaction| {
            let (number, info) = find_job(transaction, &owner, &id)?;
            let failures = failures(transaction, number)?;
            Ok(JobInfo { failures, ..info })
        })
        .await
    }

    /// Cancels a queued or running job. Results that are complete stay.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::Finished`].
    pub async fn cancel(&self, owner: &str, id: &str) -> Result<JobInfo, JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write_from_reserve(move |transaction| {
            let (number, info) = find_job(transaction, &owner, &id)?;
            if info.state.is_finished() {
                let (job, state) = (id.clone(), info.state.name());
                return Err(JobError::Finished { job, state });
            }
            let update = "UPDATE jobs SET state = ?2, finished = ?3 WHERE number = ?1";
            let values = (number, JobState::Cancelled.name(), now());
            transaction.execute(update, values).map_err(StoreError::from)?;
            add_event(transaction, number, None)?;
            Ok(find_job(transaction, &owner, &id)?.1)
        })
        .await
    }

    /// Removes a finished job from the store. The caller must remove the files of the job.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::NotFinished`].
    pub async fn delete(&self, owner: &str, id: &str) -> Result<(), JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write_from_reserve(move |transaction| {
            let (number, info) = find_job(transaction, &owner, &id)?;
            if !info.state.is_finished() {
                return Err(JobError::NotFinished(id.clone()));
            }
            let deleted = transaction.execute("DELETE FROM jobs WHERE number = ?1", [number]);
            deleted.map_err(StoreError::from)?;
            Ok(())
        })
        .await
    }

    /// Returns the next [`EVENT_BATCH`] events of a job after the event with id `after`, and whether the job is finished.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn events(&self, owner: &str, id: &str, after: i64) -> Result<(Vec<JobEvent>, bool), JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write(move |transaction| {
            let (number, info) = find_job(transaction, &owner, &id)?;
            let events = events(transaction, number, after)?;
            Ok((events, info.state.is_finished()))
        })
        .await
    }

    /// Returns all extractions of a job, in the order of the request.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`].
    pub async fn manifest(&self, owner: &str, id: &str) -> Result<Vec<ManifestEntry>, JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write(move |transaction| {
            let (number, _) = find_job(transaction, &owner, &id)?;
            Ok(manifest(transaction, number)?)
        })
        .await
    }

    /// Returns the result of an extraction.
    ///
    /// # Errors
    /// [`JobError::UnknownJob`], [`JobError::NoResult`].
    pub async fn result(&self, owner: &str, id: &str, extraction: u32) -> Result<ResultInfo, JobError> {
        let (owner, id) = (owner.to_owned(), id.to_owned());
        self.write(move |transaction| {
            let (number, info) = find_job(transaction, &owner, &id)?;
            match result(transaction, number, extraction)? {
                Ok(info) => Ok(info),
                Err(why) => Err(JobError::NoResult {
                    why: why.unwrap_or_else(|| format!("is not there, the job has {}", info.extractions.total)),
                    job: id,
                    extraction,
                }),
            }
        })
        .await
    }
}

/// Returns the number of a job, by which other tables refer to it, and the job.
fn find_job(transaction: &Transaction<'_>, owner: &str, id: &str) -> Result<(i64, JobInfo), JobError> {
    let query = format!("SELECT {JOB_COLUMNS} FROM jobs WHERE owner = ?1 AND id = ?2");
    let job = optional(transaction.query_row(&query, [owner, id], |row| Ok(job_info(row))))?;
    job.ok_or_else(|| JobError::UnknownJob(id.to_owned()))
}

fn repeated(transaction: &Transaction<'_>, request: &RequestKey) -> Result<Option<JobInfo>, JobError> {
    let Some(key) = &request.key else { return Ok(None) };
    let query = "SELECT id, digest FROM jobs WHERE owner = ?1 AND key = ?2";
    let row = transaction.query_row(query, [&request.owner, key], |row| Ok(Ok((row.get(0)?, row.get(1)?))));
    let Some((id, digest)): Option<(String, Vec<u8>)> = optional(row)? else {
        return Ok(None);
    };
    if digest != request.digest {
        let (key, job) = (key.clone(), id);
        return Err(JobError::KeyReused { key, job });
    }
    Ok(Some(find_job(transaction, &request.owner, &id)?.1))
}

fn check_limits(transaction: &Transaction<'_>, job: &NewJob, limits: Limits) -> Result<(), JobError> {
    let owner = &job.request.owner;
    let counts = transaction.query_row(
        "SELECT count(*), count(*) FILTER (WHERE state IN ('queued', 'running')),
            coalesce(sum(CASE WHEN state IN ('queued', 'running') THEN max(bytes, estimated_bytes) ELSE bytes END), 0)
            FROM jobs WHERE owner = ?1",
        [owner],
        |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)),
    );
    let (all, unfinished, taken): (u64, u64, u64) = counts.map_err(StoreError::from)?;
    let too_many = |found, which, limit, advice| {
        Err(JobError::TooMany {
            found,
            which,
            limit,
            advice,
        })
    };
    if unfinished >= MAX_UNFINISHED_JOBS {
        return too_many(
            unfinished,
            "jobs that are not finished",
            MAX_UNFINISHED_JOBS,
            "wait for one, or cancel it",
        );
    }
    if all >= MAX_JOBS {
        return too_many(all, "jobs", MAX_JOBS, "delete some that are finished");
    }
    let (estimated, quota) = (job.estimate.bytes, limits.quota_bytes);
    let left = quota.saturating_sub(taken);
    if estimated > left {
        return Err(JobError::OverQuota { estimated, left, quota });
    }
    Ok(())
}

fn insert(transaction: &Transaction<'_>, job: &NewJob) -> Result<(), StoreError> {
    let NewJob { request, estimate, .. } = job;
    transaction.execute(
        "INSERT INTO jobs (id, owner, key, digest, volume, input, state, submitted, total, estimated_triangles, estimated_bytes,
            estimated_seconds) VALUES (?1, ?2, ?3, ?4, ?5, ?6, 'queued', ?7, ?8, ?9, ?10, ?11)",
        (
            &job.id,
            &request.owner,
            &request.key,
            &request.digest[..],
            &job.volume,
            &job.input,
            now(),
            job.extractions.len(),
            estimate.triangles,
            estimate.bytes,
            estimate.seconds,
        ),
    )?;
    let number = transaction.last_insert_rowid();
    let mut insert_row =
        transaction.prepare("INSERT INTO extractions (job, extraction, request) VALUES (?1, ?2, ?3)")?;
    for (extraction, request) in job.extractions.iter().enumerate() {
        insert_row.execute((number, extraction, request))?;
    }
    add_event(transaction, number, None)
}

fn failures(transaction: &Transaction<'_>, job: i64) -> Result<Vec<Failure>, StoreError> {
    let mut rows = transaction.prepare(
        "SELECT extraction, coalesce(error_code, ''), coalesce(error_detail, '') FROM extractions
            WHERE job = ?1 AND state = 'failed' ORDER BY extraction LIMIT ?2",
    )?;
    let failures = rows.query_map((job, LISTED_FAILURES), |row| {
        Ok(Failure {
            extraction: row.get(0)?,
            cause: Cause {
                code: row.get(1)?,
                detail: row.get(2)?,
            },
        })
    })?;
    Ok(failures.collect::<Result<_, _>>()?)
}

fn manifest(transaction: &Transaction<'_>, job: i64) -> Result<Vec<ManifestEntry>, StoreError> {
    let mut rows = transaction.prepare(
        "SELECT extraction, state, request, triangles, error_rms, error_max, bytes, checksum, seconds, error_code,
            error_detail, notices FROM extractions WHERE job = ?1 ORDER BY extraction",
    )?;
    let entries = rows.query_map([job], |row| Ok(manifest_entry(row)))?;
    entries.map(|entry| entry?).collect()
}

/// Converts a row of [`manifest`] to a line of the manifest.
fn manifest_entry(row: &Row<'_>) -> Result<ManifestEntry, StoreError> {
    let (extraction, request): (u32, String) = (row.get(0)?, row.get(2)?);
    let state = match row.get::<_, String>(1)?.as_str() {
        "waiting" => ExtractionState::Waiting,
        "done" => ExtractionState::Done,
        "empty" => ExtractionState::Empty,
        "failed" => ExtractionState::Failed,
        other => return Err(StoreError::Malformed(format!("the state {other:?} of an extraction"))),
    };
    let extension = file_request(&request)?.options.format.extension();
    let error = row.get::<_, Option<f32>>(4)?.zip(row.get(5)?);
    let checksum: Option<Checksum> = row.get(7)?;
    let (code, detail): (Option<String>, Option<String>) = (row.get(9)?, row.get(10)?);
    let notices: String = row.get(11)?;
    Ok(ManifestEntry {
        extraction,
        state,
        file: (state == ExtractionState::Done).then(|| file_name(extraction, extension)),
        triangles: row.get(3)?,
        error: error.map(|(rms, max)| MeasuredError { rms, max }),
        bytes: row.get(6)?,
        sha256: checksum.map(|checksum| HEXLOWER.encode(&checksum)),
        seconds: row.get(8)?,
        notices: serde_json::from_str(&notices).map_err(|_| StoreError::Malformed(notices))?,
        problem: code.zip(detail).map(|(code, detail)| Cause { code, detail }),
    })
}

fn events(transaction: &Transaction<'_>, job: i64, after: i64) -> Result<Vec<JobEvent>, StoreError> {
    let mut rows =
        transaction.prepare("SELECT id, event FROM events WHERE job = ?1 AND id > ?2 ORDER BY id LIMIT ?3")?;
    let rows = rows.query_map((job, after, EVENT_BATCH), |row| {
        Ok((row.get(0)?, row.get::<_, String>(1)?))
    })?;
    rows.map(|row| {
        let (id, text) = row?;
        let event: JobEvent = serde_json::from_str(&text).map_err(|_| StoreError::Malformed(text))?;
        Ok(JobEvent { id: Some(id), ..event })
    })
    .collect()
}

/// Returns a result. If the extraction has none, returns `Err` with the end of a sentence that says why; `Err(None)` if the job has no such
/// extraction.
fn result(
    transaction: &Transaction<'_>,
    job: i64,
    extraction: u32,
) -> Result<Result<ResultInfo, Option<String>>, StoreError> {
    let query = "SELECT request, state, coalesce(bytes, 0), checksum, coalesce(error_detail, '') FROM extractions
        WHERE job = ?1 AND extraction = ?2";
    let row = transaction.query_row(query, (job, extraction), |row| {
        Ok(Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?)))
    });
    let Some(columns) = optional(row)? else {
        return Ok(Err(None));
    };
    let (request, state, bytes, checksum, detail): (String, String, u64, Option<Checksum>, String) = columns;
    Ok(match (state.as_str(), checksum) {
        ("done", Some(checksum)) => {
            let request = file_request(&request)?;
            Ok(ResultInfo {
                bytes,
                checksum,
                format: request.options.format,
                iso: request.edit.iso,
            })
        }
        ("failed", _) => Err(Some(format!("failed: {detail}"))),
        ("empty", _) => Err(Some(format!("is empty: {detail}"))),
        _ => Err(Some("is not made yet".to_owned())),
    })
}

/// Parses the request of an extraction.
pub(super) fn file_request(text: &str) -> Result<FileRequest, StoreError> {
    serde_json::from_str(text).map_err(|_| StoreError::Malformed(text.to_owned()))
}
