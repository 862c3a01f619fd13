//! `isopeel batch`: a batch job without a server.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::jobs::{MANIFEST_FILE, cost, empty_ones, first_failure, progress_bar, read_request_file, write_manifest};
use crate::cli::device::DeviceArgs;
use crate::extraction::{DeviceWorker, Extractor};
use crate::jobs::{
    JobError, JobInfo, JobRequest, JobState, Jobs, Limits, OPERATOR, OpenError, StateFolder, StateFolderError,
    file_name,
};
use crate::private_folder::FolderAccess;
use crate::volumes::{Catalog, Frame, ReadError, Reader, open_dataset};
use crate::wire::encode::encoded_bytes;

/// Below the output's folder, while the job is not done.
const STATE_FOLDER: &str = ".isopeel-batch";

/// Arguments of `isopeel batch`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Request, JSON as `{"volume":"head.nrrd","extractions":[{"iso":517,"format":"glb"}, …]}`; the path of the volume is relative to the file
    #[arg(value_name = "FILE.json")]
    file: PathBuf,

    /// Folder for the surfaces, 00000.glb and so on, and for manifest.jsonl, which says what they are; made if there is none
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Folder on a disk of this machine for what is made while the job is not done: the same command then goes on [default: .isopeel-batch in
    /// the output's folder]
    #[arg(long, value_name = "DIR")]
    state_folder: Option<PathBuf>,

    /// Who may use that folder beside this user: nobody, or its group too
    #[arg(long, value_enum, default_value_t, value_name = "WHO")]
    folder_access: FolderAccess,

    #[command(flatten)]
    device: DeviceArgs,

    /// Frame of all positions: LPS (left, back and head of a patient are positive), RAS (right, front, head), or index, which counts
    /// samples. Volumes that do not say where a patient's sides are keep their own axes in the first two
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    frame: Frame,
}

/// Why a batch job is not done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// The request's file cannot be read.
    #[error("request {}", path.display())]
    Request {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The volume cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The state folder cannot be used.
    #[error(transparent)]
    StateFolder(#[from] StateFolderError),
    /// The job's store cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The job is not accepted.
    #[error(transparent)]
    Job(#[from] JobError),
    /// A surface cannot be put into its folder.
    #[error("output {}", path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Some surfaces were not made.
    #[error("{0}")]
    Failed(String),
    /// Ctrl-C, or SIGTERM.
    #[error("interrupted, the same command goes on")]
    Interrupted,
    /// No thread or signal handler could be had.
    #[error("the process could not go on")]
    System(#[from] io::Error),
}

/// Makes all surfaces of a request.
///
/// # Errors
/// [`BatchError`].
pub fn run(args: &Args) -> Result<(), BatchError> {
    let mut request = read_request(&args.file).map_err(|source| BatchError::Request {
        path: args.file.clone(),
        source,
    })?;
    let mut dataset = open_dataset(&beside(&args.file, &request.volume))?;
    dataset.set_frame(args.frame);
    request.volume = dataset.id.clone();
    let mut catalog = Catalog::default();
    let types = dataset.fields.iter().map(|field| field.sample_type).collect();
    catalog.add(dataset);
    let output = |source| BatchError::Output {
        path: args.output.clone(),
        source,
    };
    std::fs::create_dir_all(&args.output).map_err(output)?;
    let own_folder = args.output.join(STATE_FOLDER);
    let folder = StateFolder::open(args.state_folder.as_deref().unwrap_or(&own_folder), args.folder_access)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        // Before the device is opened: PoCL's compiler ends the process in a handler of its own, unless it finds another one that it calls.
        let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        let worker = DeviceWorker::start_with(args.device.options(types, |text| tracing::info!("{text}")))?;
        let extractor = Extractor::new(worker, u64::MAX, encoded_bytes);
        let stop = CancellationToken::new();
        // The store counts in 63 bits.
        let unlimited = Limits {
            quota_bytes: i64::MAX as u64,
        };
        let jobs = Jobs::open(folder, unlimited, catalog.into(), extractor, stop.clone()).await?;
        let runner = tokio::spawn(jobs.clone().run());
        let made = tokio::select! {
            made = make(&jobs, request, &args.output) => made,
            _ = interrupt.recv() => Err(BatchError::Interrupted),
            _ = terminate.recv() => Err(BatchError::Interrupted),
        };
        stop.cancel();
        let _ = runner.await;
        made
    })?;
    if args.state_folder.is_none() {
        // What is left of it is empty.
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

/// Submits a job under the name of its request, so that an interrupted one goes on. One that has ended in another way is made anew.
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

/// Waits until a job is finished, with a bar on stderr where that is a terminal.
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
        // Nobody sends any more where the runner has ended.
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
