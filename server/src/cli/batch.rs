//! `isopeel batch`: many surfaces without a server.

mod inputs;
mod manifest;
mod request;
mod series;
mod steps;
mod volumes;

use std::io;
use std::path::{Path, PathBuf};

use isopeel_extraction::WorkError;
use isopeel_kernels::SampleType;
use isopeel_view::EditError;
use isopeel_volumes::{Frame, ReadError};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::output::OutputError;
use super::surface::{SurfaceArgs, TransferFunctionError};
use crate::cli::device::DeviceArgs;
use crate::export::Format;
use crate::jobs::{JobError, OpenError, StateFolderError};
use crate::private_folder::FolderAccess;
use crate::service::DeviceWorker;
use steps::Steps;

/// Arguments of `isopeel batch`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volumes: files, patterns of their names ('scans/*.nii.gz'), folders, each file of which is a volume, and addresses as extract takes them. Or a
    /// request of one volume, JSON as `{"volume":"head.nrrd","extractions":[{"iso":517,"format":"glb"}, …]}`; the path of the volume is relative to
    /// the file
    #[arg(value_name = "VOLUME", required = true)]
    inputs: Vec<PathBuf>,

    /// Folder for the surfaces and for manifest.jsonl, which says what they are; made if there is none
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Time steps of each volume, counted from 0: `all`, or numbers and ranges, `0,5..9`; a volume with fewer steps has those that it has
    /// [default: all]
    #[arg(long, value_name = "STEPS")]
    steps: Option<Steps>,

    #[command(flatten)]
    surface: Option<SurfaceArgs>,

    /// Of a request: folder on a disk of this machine for the files of an unfinished job, with which the same command goes on [default:
    /// .isopeel-batch in the output's folder]
    #[arg(long, value_name = "DIR")]
    state_folder: Option<PathBuf>,

    /// Who may use that folder: this user alone, or its group too
    #[arg(long, value_enum, default_value_t, value_name = "WHO")]
    folder_access: FolderAccess,

    #[command(flatten)]
    pub(super) device: DeviceArgs,

    /// Frame of all positions: LPS (left, back and head of a patient are positive), RAS (right, front, head), or index, which counts
    /// samples. Volumes that do not say where a patient's sides are keep their own axes in the first two
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    frame: Frame,
}

/// Why a batch has failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// The request file cannot be read.
    #[error("request {}", path.display())]
    Request {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system, or of parsing the JSON.
        source: io::Error,
    },
    /// The volume cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The state folder cannot be used.
    #[error(transparent)]
    StateFolder(#[from] StateFolderError),
    /// The job store cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A request to the job store has failed.
    #[error(transparent)]
    Job(#[from] JobError),
    /// A file in the output folder cannot be written.
    #[error("output {}", path.display())]
    Output {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Some surfaces were not made.
    #[error("{0}")]
    Failed(String),
    /// The device cannot be used.
    #[error(transparent)]
    Device(#[from] WorkError),
    /// The file of the transfer function cannot be read.
    #[error(transparent)]
    TransferFunction(#[from] TransferFunctionError),
    /// A value is invalid for every volume.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The file of a surface cannot be written.
    #[error("{0}; what was made is in the manifest, and the same command goes on")]
    Write(#[source] OutputError),
    /// Options are given beside a request file, which contains its own.
    #[error("a request has its own format, steps and surfaces: expected none of these options beside {}", .0.display())]
    OptionsBesideRequest(PathBuf),
    /// A state folder is given beside volumes. Only a request file uses one.
    #[error("--state-folder is of a request: of volumes, the manifest in the output's folder says how far they are")]
    StateFolderBesideVolumes,
    /// No format is given.
    #[error("--format is missing: expected the format of the files, {}", Format::EXPECTED)]
    NoFormat,
    /// A pattern of file names is invalid.
    #[error("{pattern:?} is no pattern of files")]
    Pattern {
        /// The pattern.
        pattern: String,
        /// What is wrong with the pattern.
        source: glob::PatternError,
    },
    /// No file matches the pattern.
    #[error("{0:?} matches no file")]
    NoMatch(String),
    /// The process has received SIGINT or SIGTERM.
    #[error("interrupted, the same command goes on")]
    Interrupted,
    /// A thread could not be started, or a signal handler could not be installed.
    #[error("the process could not go on")]
    System(#[from] io::Error),
}

/// Makes all surfaces of a request, or of many volumes.
///
/// # Errors
/// [`BatchError`].
pub fn run(args: &Args) -> Result<(), BatchError> {
    let Some(file) = args.request_file() else {
        if args.state_folder.is_some() {
            return Err(BatchError::StateFolderBesideVolumes);
        }
        return volumes::run(args);
    };
    if args.steps.is_some() || args.surface.is_some() {
        return Err(BatchError::OptionsBesideRequest(file.to_owned()));
    }
    request::run(args, file)
}

impl Args {
    /// Returns the request file: the only input, if its extension is `json` and it is not a folder.
    fn request_file(&self) -> Option<&Path> {
        let [file] = &self.inputs[..] else { return None };
        let is_json = file
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        (is_json && !file.is_dir()).then_some(file)
    }

    fn create_folder(&self) -> Result<(), BatchError> {
        std::fs::create_dir_all(&self.output).map_err(|source| BatchError::Output {
            path: self.output.clone(),
            source,
        })
    }

    /// Starts the device worker.
    fn worker(&self, types: Vec<SampleType>) -> io::Result<DeviceWorker> {
        let options = self.device.options(types, |text| tracing::info!("{text}"));
        DeviceWorker::start_with(options)
    }
}

/// Handler of SIGINT and SIGTERM. Create it before the device is opened: PoCL's compiler installs a handler that ends the process, unless
/// another handler is already installed.
struct Interrupt {
    interrupt: Signal,
    terminate: Signal,
}

impl Interrupt {
    fn new() -> io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    async fn wait(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}
