//! The surfaces of a request of one volume: a batch job without a server.

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

/// Below the output's folder, while the job is not done.
const STATE_FOLDER: &str = ".isopeel-batch";

/// Makes all surfaces of a request.
///
/// # Errors
/// [`BatchError`].
pub(super) fn run(args: &Args, file: &Path) -> Result<(), BatchError> {
    let mut request = read_request(file).map_err(|source| BatchError::Request {
        path: file.to_owned(),
        source,
    })?;
    let mut dataset = open_dataset(&beside(file, &request.volume))?;
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
        // The store counts in 63 bits.
        let unlimited = Limits {
            quota_bytes: i64::MAX as u64,
        };
        let jobs = Jobs::open(folder, unlimited, catalog.into(), worker.clone(), stop.clone()).await?;
        let runner = tokio::spawn(jobs.clone().run());
        let made = tokio::select! {
            made = make(&jobs, request, &args.output) => made,
            () = interrupt.wait() => Err(BatchError::Interrupted),
            error = worker.unusable() => Err(error.map_or(BatchError::Interrupted, BatchError::Device)),
        };
        stop.cancel();
        let _ = runner.await;
        made
    })?;
    if args.state_folder.is_none() {
        // Its results were moved to the output folder, and its job was deleted.
        let _ = std::fs::remove_dir_all(own_folder);
    }
    Ok(())
}

fn read_request(file: &Path) -> io::Result<JobRequest> {
    Ok(serde_json::from_slice(&read_request_file(file)?)?)
}

/// A path of a file that another one names.
fn beside(file: &Path, name: &str) -> PathBuf {
    if name.contains("://") {
        return name.into();
    }
    file.parent().unwrap_or(Path::new("")).join(name)
}

/// Makes a job, or goes on with it, and puts its results into a folder.
async fn make(jobs: &Jobs, request: JobRequest, output: &Path) -> Result<(), BatchError> {
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
        // None if it failed, is empty, or was taken before an interruption.
        let Some(made) = jobs.result_path(&job.id, extraction) else {
            continue;
        };
        let path = output.join(file_name(extraction, extension));
        take(&made, &path).map_err(|source| BatchError::Output { path, source })?;
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

/// Submits a job under the name of its request, so that an interrupted one goes on. One that has ended in another way is submitted again.
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

/// Waits until a job is finished, with a bar if stderr is a terminal.
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
        // The sender is gone if the runner has ended.
        changes.changed().await.map_err(io::Error::other)?;
    }
}

/// Moves a file, to another disk too.
fn take(from: &Path, to: &Path) -> io::Result<()> {
    match std::fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
            std::fs::copy(from, to)?;
            File::open(to)?.sync_all()
        }
        other => other,
    }
}
