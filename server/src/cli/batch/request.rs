//! `isopeel batch` with a request file: runs a batch job of one volume without a server.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use isopeel_volumes::{Catalog, Reader, open_dataset};
use sha2::{Digest, Sha256};
use tokio_util::sync::CancellationToken;

use super::{Args, BatchError, Interrupt};
use crate::cli::jobs::{
    MANIFEST_FILE, cost, empty_ones, first_failure, progress_bar, read_request_file, write_manifest,
};
use crate::jobs::{JobInfo, JobRequest, JobState, Jobs, Limits, OPERATOR, StateFolder, file_name};

/// Default state folder, below the output folder. It is removed when the job is done.
const STATE_FOLDER: &str = ".isopeel-batch";

/// Runs the job of a request file, and waits for its end.
///
/// # Errors
/// [`BatchError`].
pub(super) fn run(args: &Args, file: &Path) -> Result<(), BatchError> {
    let mut request = read_request(file).map_err(|source| BatchError::Request {
        path: file.to_owned(),
        source,
    })?;
    let mut dataset = open_dataset(&resolve_path(file, &request.volume))?;
    dataset.set_frame(args.frame);
    request.volume = dataset.id.clone();
    let mut catalog = Catalog::default();
    let types = dataset.fields.iter().map(|field| field.sample_type).collect();
    catalog.add(dataset);
    args.create_folder()?;
    let own_folder = args.output.join(STATE_FOLDER);
    let folder = StateFolder::open(args.state_folder.as_deref().unwrap_or(&own_folder), args.folder_access)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut interrupt = Interrupt::new()?;
        let worker = args.worker(types)?;
        let stop = CancellationToken::new();
        // The maximum of SQLite's integers, which are signed.
        let unlimited = Limits {
            quota_bytes: i64::MAX as u64,
        };
        let jobs = Jobs::open(folder, unlimited, catalog.into(), worker.clone().into(), stop.clone()).await?;
        let runner = tokio::spawn(jobs.clone().run());
        let outcome = tokio::select! {
            outcome = run_job(&jobs, request, &args.output) => outcome,
            () = interrupt.wait() => Err(BatchError::Interrupted),
            error = worker.unusable() => Err(error.map_or(BatchError::Interrupted, BatchError::Device)),
        };
        stop.cancel();
        let _ = runner.await;
        outcome
    })?;
    if args.state_folder.is_none() {
        // Nothing of value is left: the results were moved to the output folder, and the job was deleted.
        let _ = std::fs::remove_dir_all(own_folder);
    }
    Ok(())
}

fn read_request(file: &Path) -> io::Result<JobRequest> {
    Ok(serde_json::from_slice(&read_request_file(file)?)?)
}

/// Returns the path of a volume that a request file names. The name is an address, or a path relative to the folder of the request file.
fn resolve_path(file: &Path, name: &str) -> PathBuf {
    if name.contains("://") {
        return name.into();
    }
    file.parent().unwrap_or(Path::new("")).join(name)
}

/// Submits the job, or continues an interrupted one, and waits for it. Then moves its results to the output folder, and deletes the job.
///
/// # Errors
/// The job has failed, or the results cannot be written.
async fn run_job(jobs: &Jobs, request: JobRequest, output: &Path) -> Result<(), BatchError> {
    let extensions: Vec<_> = request
        .extractions
        .iter()
        .map(|e| e.options.format.extension())
        .collect();
    let job = submit(jobs, request).await?;
    eprintln!("isopeel: {}", cost(job.estimate));
    let job = wait(jobs, &job.id).await?;
    let entries = jobs.manifest(OPERATOR, &job.id).await?;
    let manifest = output.join(MANIFEST_FILE);
    write_manifest(&manifest, &entries).map_err(|source| BatchError::Output { path: manifest, source })?;
    for (extraction, extension) in (0..).zip(extensions) {
        // There is no file if the extraction has failed, the surface is empty, or an interrupted command has moved the file.
        let Some(result) = jobs.result_path(&job.id, extraction) else {
            continue;
        };
        let path = output.join(file_name(extraction, extension));
        move_file(&result, &path).map_err(|source| BatchError::Output { path, source })?;
    }
    let empty = empty_ones(&entries);
    if !empty.is_empty() {
        eprintln!("isopeel: {empty}");
    }
    jobs.delete(OPERATOR, &job.id).await?;
    if job.state == JobState::Done {
        return Ok(());
    }
    let first = first_failure(&job);
    let why = job
        .error
        .map_or("the job was cancelled".to_owned(), |cause| cause.detail);
    Err(BatchError::Failed(why + &first))
}

/// Submits a job. The idempotency key is a hash of the request, so that the same request continues an interrupted job. A job that has
/// failed or was cancelled is deleted and submitted again.
async fn submit(jobs: &Jobs, request: JobRequest) -> Result<JobInfo, BatchError> {
    let text = serde_json::to_vec(&request).map_err(io::Error::from)?;
    let operator = Reader::new(OPERATOR, true);
    let key = HEXLOWER.encode(&Sha256::digest(text));
    let (job, is_new) = jobs.submit(operator, Some(key.clone()), request.clone()).await?;
    if is_new || matches!(job.state, JobState::Queued | JobState::Running | JobState::Done) {
        return Ok(job);
    }
    jobs.delete(OPERATOR, &job.id).await?;
    Ok(jobs.submit(operator, Some(key), request).await?.0)
}

/// Waits until a job is finished, and shows its progress if stderr is a terminal.
async fn wait(jobs: &Jobs, id: &str) -> Result<JobInfo, BatchError> {
    let mut changes = jobs.changes();
    let mut bar = None;
    loop {
        changes.mark_unchanged();
        let job = jobs.get(OPERATOR, id).await?;
        let bar = bar.get_or_insert_with(|| progress_bar(job.extractions.total));
        bar.set_position(job.extractions.ended());
        bar.set_message(job.paused.clone().unwrap_or_default());
        if job.state.is_finished() {
            bar.finish_and_clear();
            return Ok(job);
        }
        // An error means that the runner has ended.
        changes.changed().await.map_err(io::Error::other)?;
    }
}

/// Moves a file, or copies it if the target is on another disk.
fn move_file(from: &Path, to: &Path) -> io::Result<()> {
    match std::fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
            std::fs::copy(from, to)?;
            File::open(to)?.sync_all()
        }
        other => other,
    }
}
