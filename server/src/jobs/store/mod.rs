//! Jobs, their extractions and their events, in SQLite. A method returns after its changes were flushed to the disk (`synchronous = FULL`).
//!
//! [`Store`] runs one transaction at a time on a blocking thread. [`requests`] has the transactions of clients, and [`work`] has the
//! transactions of the runner.

pub(super) mod requests;
pub(super) mod work;

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rusqlite::{Connection, OptionalExtension, Row, Transaction, TransactionBehavior};
use tokio::sync::Mutex;

use super::error::{JobError, StoreError};
use super::state::{Cause, Estimate, JobEvent, JobInfo, JobState, Progress};

/// Migrations in order. The first n of them lead to version n of the store.
const MIGRATIONS: [&str; 2] = [include_str!("schema.sql"), include_str!("schema-2.sql")];

/// Maximum wait for another process that locks the store, such as a backup.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Columns that [`job_info`] reads, by their positions. The last one is the number of owners with unfinished jobs.
const JOB_COLUMNS: &str = "id, volume, state, total, done, failed, empty, bytes, seconds, estimated_triangles, estimated_bytes, \
    estimated_seconds, submitted, started, finished, error_code, error_detail, number, \
    (SELECT count(DISTINCT owner) FROM jobs WHERE state IN ('queued', 'running'))";

/// The store. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Store {
    /// One connection, because SQLite runs one write transaction at a time anyway. The asynchronous mutex lets tasks wait without blocking
    /// a thread.
    connection: Arc<Mutex<Connection>>,
    /// Owner of the extraction that the runner began most recently. The next one belongs to the next owner, because owners take turns.
    last_owner: Arc<std::sync::Mutex<String>>,
    /// Path of the reserve file; see [`RESERVE_BYTES`].
    reserve: Arc<Path>,
}

/// Bytes of the reserve file. If the disk is full, the store removes this file, so that it can still cancel and delete jobs.
const RESERVE_BYTES: usize = 1 << 20;

impl Store {
    /// Opens the store in a file, and migrates it to the current version. Creates the file if it does not exist.
    ///
    /// # Errors
    /// SQLite fails, or a newer version has written the store.
    pub fn open(file: &Path) -> Result<Self, StoreError> {
        let mut connection = Connection::open(file)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.pragma_update(None, "synchronous", "FULL")?;
        connection.pragma_update(None, "foreign_keys", true)?;
        migrate(&mut connection)?;
        let reserve = file.with_extension("reserve");
        create_reserve(&reserve);
        Ok(Self {
            connection: Arc::new(Mutex::new(connection)),
            last_owner: Arc::default(),
            reserve: reserve.into(),
        })
    }

    /// Runs a transaction that cancels or deletes a job. If the disk is full, removes the reserve file and retries. Then creates the
    /// reserve file again, if the disk has space.
    pub(super) async fn write_from_reserve<T: Send + 'static>(
        &self,
        work: impl Fn(&Transaction<'_>) -> Result<T, JobError> + Clone + Send + 'static,
    ) -> Result<T, JobError> {
        let outcome = match self.write(work.clone()).await {
            Err(JobError::Store(error)) if error.is_full() => {
                tracing::warn!("the disk of the job store is full, its reserve is used");
                // An error is ignored: without a reserve, the retry fails too.
                let _ = std::fs::remove_file(&self.reserve);
                self.write(work).await
            }
            outcome => outcome,
        };
        let reserve = Arc::clone(&self.reserve);
        let _ = tokio::task::spawn_blocking(move || create_reserve(&reserve)).await;
        outcome
    }

    /// Runs a transaction on a blocking thread. The transaction may read and write. Rolls it back if `work` fails.
    pub(super) async fn write<T, E>(
        &self,
        work: impl FnOnce(&Transaction<'_>) -> Result<T, E> + Send + 'static,
    ) -> Result<T, E>
    where
        T: Send + 'static,
        E: From<StoreError> + Send + 'static,
    {
        let mut connection = Arc::clone(&self.connection).lock_owned().await;
        let task = tokio::task::spawn_blocking(move || {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate);
            let transaction = transaction.map_err(StoreError::from)?;
            let result = work(&transaction)?;
            transaction.commit().map_err(StoreError::from)?;
            Ok(result)
        });
        task.await.unwrap_or_else(|_| Err(StoreError::Panicked.into()))
    }

    /// Returns all extractions that have a result, as pairs of a job's id and the number of the extraction.
    ///
    /// # Errors
    /// SQLite fails.
    pub async fn results(&self) -> Result<HashSet<(String, u32)>, StoreError> {
        self.write(|transaction| {
            let mut rows = transaction.prepare(
                "SELECT id, extraction FROM extractions JOIN jobs ON number = job WHERE extractions.state = 'done'",
            )?;
            let results = rows.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
            Ok(results.collect::<Result<_, _>>()?)
        })
        .await
    }
}

/// Creates the reserve file, unless it exists or the disk has no space.
fn create_reserve(path: &Path) {
    if path.exists() {
        return;
    }
    if let Err(error) = std::fs::write(path, vec![0; RESERVE_BYTES]) {
        tracing::debug!(%error, "there is no space for the reserve of the job store");
        // Removes a partial file.
        let _ = std::fs::remove_file(path);
    }
}

/// Runs the migrations that are missing.
fn migrate(connection: &mut Connection) -> Result<(), StoreError> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let found: i64 = transaction.pragma_query_value(None, "user_version", |row| row.get(0))?;
    let known = MIGRATIONS.len() as i64;
    let missing = usize::try_from(found).ok().and_then(|found| MIGRATIONS.get(found..));
    for changes in missing.ok_or(StoreError::Newer { found, known })? {
        transaction.execute_batch(changes)?;
    }
    transaction.pragma_update(None, "user_version", known)?;
    Ok(transaction.commit()?)
}

/// Returns the current time in seconds since 1970.
fn now() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

fn parse_state(name: &str) -> Result<JobState, StoreError> {
    let state = JobState::ALL.into_iter().find(|state| state.name() == name);
    state.ok_or_else(|| StoreError::Malformed(format!("the state {name:?}")))
}

/// Converts a row of [`JOB_COLUMNS`] to a job. Returns the number of the job, by which other tables refer to it, and the job.
fn job_info(row: &Row<'_>) -> Result<(i64, JobInfo), StoreError> {
    let state = parse_state(&row.get::<_, String>(2)?)?;
    let extractions = progress(row, 3)?;
    let (seconds, estimate): (f64, _) = (
        row.get(8)?,
        Estimate {
            triangles: row.get(9)?,
            bytes: row.get(10)?,
            seconds: row.get(11)?,
        },
    );
    let owners = f64::from(row.get::<_, u32>(18)?);
    let code: Option<String> = row.get(15)?;
    let detail: Option<String> = row.get(16)?;
    let info = JobInfo {
        id: row.get(0)?,
        volume: row.get(1)?,
        state,
        paused: None,
        extractions,
        bytes: row.get(7)?,
        estimate,
        eta_seconds: (state == JobState::Running).then(|| eta(extractions, seconds, estimate) * owners),
        submitted: row.get(12)?,
        started: row.get(13)?,
        finished: row.get(14)?,
        error: code.zip(detail).map(|(code, detail)| Cause { code, detail }),
        failures: Vec::new(),
    };
    Ok((row.get(17)?, info))
}

/// Estimates the seconds that the remaining extractions of a job take if no other owner has jobs. Uses the mean time of the finished
/// extractions, or the estimate of the job if none is finished. `seconds` is the total time of the finished extractions.
fn eta(extractions: Progress, seconds: f64, estimate: Estimate) -> f64 {
    let remaining = (extractions.total - extractions.ended()) as f64;
    let mean_seconds = match extractions.done {
        0 => estimate.seconds / extractions.total as f64,
        done => seconds / done as f64,
    };
    remaining * mean_seconds
}

/// Reads the columns `total`, `done`, `failed` and `empty`, the first of which is at position `first_column`.
fn progress(row: &Row<'_>, first_column: usize) -> Result<Progress, StoreError> {
    Ok(Progress {
        total: row.get(first_column)?,
        done: row.get(first_column + 1)?,
        failed: row.get(first_column + 2)?,
        empty: row.get(first_column + 3)?,
    })
}

/// Adds an event with the current state of a job. `extraction` is the extraction that has ended, if one has.
fn add_event(transaction: &Transaction<'_>, job: i64, extraction: Option<u32>) -> Result<(), StoreError> {
    let (name, extractions) = transaction.query_row(
        "SELECT state, total, done, failed, empty FROM jobs WHERE number = ?1",
        [job],
        |row| Ok((row.get::<_, String>(0)?, progress(row, 1))),
    )?;
    let event = JobEvent {
        id: None,
        state: parse_state(&name)?,
        extractions: extractions?,
        extraction,
        paused: None,
    };
    let text = serde_json::to_string(&event).map_err(|error| StoreError::Malformed(error.to_string()))?;
    transaction.execute("INSERT INTO events (job, event) VALUES (?1, ?2)", (job, text))?;
    Ok(())
}

/// Converts the result of a query for one row: `None` if there is no such row.
fn optional<T>(row: rusqlite::Result<Result<T, StoreError>>) -> Result<Option<T>, StoreError> {
    row.optional()?.transpose()
}

#[cfg(test)]
mod tests;
