//! `isopeel jobs`: a client for the batch jobs of a server.

mod client;
mod watch;

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use clap::Subcommand;
use data_encoding::HEXLOWER;
use reqwest::{Method, StatusCode};
use serde::Serialize;
use sha2::{Digest, Sha256};
use tempfile::NamedTempFile;

use super::output::write_whole;
use crate::access::{Token, TokenError};
use crate::bounded_read::read_bounded;
use crate::jobs::{Estimate, ExtractionState, JobInfo, JobState, MAX_REQUEST_BYTES, ManifestEntry};
use client::Client;
pub(super) use watch::bar as progress_bar;

/// Arguments of `isopeel jobs`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Address of the server
    #[arg(
        long,
        global = true,
        value_name = "URL",
        env = "ISOPEEL_SERVER",
        default_value = "http://127.0.0.1:8417"
    )]
    server: String,

    /// File whose only line is the server's token [default: none is sent]
    #[arg(long, global = true, value_name = "FILE", env = "ISOPEEL_TOKEN_FILE")]
    token_file: Option<PathBuf>,

    /// What to do.
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Submit a job, and print its id
    Submit {
        /// Request, JSON as `{"volume":"head","extractions":[{"iso":517,"format":"glb"}, …]}`; -: stdin
        #[arg(value_name = "FILE.json")]
        file: PathBuf,

        /// Name of the request: sent again, it makes no second job
        #[arg(long, value_name = "KEY")]
        key: Option<String>,

        /// Wait until the job is finished
        #[arg(long)]
        watch: bool,
    },
    /// List all jobs, the latest first
    List {
        /// Print the JSON of the server
        #[arg(long)]
        json: bool,
    },
    /// Wait until a job is finished; it has failed where the exit code is not 0
    Watch {
        /// Job
        #[arg(value_name = "ID")]
        id: String,
    },
    /// End a job that is queued or running; its results stay
    Cancel {
        /// Job
        #[arg(value_name = "ID")]
        id: String,
    },
    /// Download the results of a job and check them, with manifest.jsonl; those that are there already are left
    Fetch {
        /// Job
        #[arg(value_name = "ID")]
        id: String,

        /// Folder, made where there is none [default: the job's id]
        #[arg(short, long, value_name = "DIR")]
        output: Option<PathBuf>,
    },
    /// Remove a finished job and its results from the server
    Delete {
        /// Job
        #[arg(value_name = "ID")]
        id: String,
    },
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobsError {
    /// The address of the server is invalid.
    #[error("--server {0:?}: expected http://HOST:PORT or https://HOST")]
    Address(String),
    /// The token cannot be read.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The server cannot be reached, or the connection broke.
    #[error("no answer from {server}")]
    Connection {
        /// Address of the server.
        server: String,
        /// Error of the HTTP client.
        source: reqwest::Error,
    },
    /// The server has refused the request.
    #[error("{detail} ({code})")]
    Refused {
        /// Code of the problem.
        code: String,
        /// Detail of the problem.
        detail: String,
    },
    /// A proxy responds that it cannot reach the server.
    #[error("a proxy answers for {server}: {status}")]
    Away {
        /// Address of the server.
        server: String,
        /// Status 502, 503 or 504.
        status: StatusCode,
    },
    /// The response is not one of a server of this version.
    #[error("the answer of {server} is not as expected: {why}")]
    Answer {
        /// Address of the server.
        server: String,
        /// What is wrong with the response.
        why: String,
    },
    /// A file cannot be read or written.
    #[error("{}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A downloaded result differs from the result on the server.
    #[error("result {extraction}: the checksum of what arrived is {found}, expected {expected}")]
    Checksum {
        /// Number of the extraction, from 0.
        extraction: u32,
        /// Checksum of the downloaded bytes.
        found: String,
        /// Checksum of the result on the server.
        expected: String,
    },
    /// The job is finished, but not done.
    #[error("job {id} is {state}{why}")]
    NotDone {
        /// Id of the job.
        id: String,
        /// State of the job.
        state: &'static str,
        /// The reason after a colon; empty if it is not known.
        why: String,
    },
    /// The job has no result for this number of extractions.
    #[error("{0} results are not there, the others were fetched")]
    Missing(u64),
    /// Stdout is closed, or the runtime cannot be started.
    #[error("the process could not go on")]
    System(#[from] io::Error),
}

impl JobsError {
    /// Whether a retry may succeed: the server is busy, or it restarts, perhaps behind a proxy.
    fn is_transient(&self) -> bool {
        match self {
            Self::Connection { .. } | Self::Away { .. } => true,
            Self::Refused { code, .. } => code == "busy",
            _ => false,
        }
    }
}

/// Runs a command.
///
/// # Errors
/// [`JobsError`].
pub fn run(args: &Args) -> Result<(), JobsError> {
    let token = args.token_file.as_deref().map(Token::read).transpose()?;
    let client = Client::new(&args.server, token.as_ref())?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match &args.command {
            Command::Submit { file, key, watch } => submit(&client, file, key.as_deref(), *watch).await,
            Command::List { json } => list(&client, *json).await,
            Command::Watch { id } => is_done(&watch::watch(&client, id).await?),
            Command::Cancel { id } => client.send(Method::POST, &format!("/{id}/cancel")).await.map(|_| ()),
            Command::Fetch { id, output } => fetch(&client, id, output.as_deref().unwrap_or(Path::new(id))).await,
            Command::Delete { id } => client.send(Method::DELETE, &format!("/{id}")).await.map(|_| ()),
        }
    })
}

async fn submit(client: &Client, file: &Path, key: Option<&str>, watch: bool) -> Result<(), JobsError> {
    let request = read_request(file).map_err(|source| JobsError::File {
        path: file.to_owned(),
        source,
    })?;
    let job = client.submit(request, key).await?;
    eprintln!("isopeel: {}", cost(job.estimate));
    super::print(format!("{}\n", job.id).as_bytes())?;
    if watch {
        is_done(&watch::watch(client, &job.id).await?)
    } else {
        Ok(())
    }
}

fn read_request(file: &Path) -> io::Result<Vec<u8>> {
    if file == Path::new("-") {
        return read_request_bytes(io::stdin());
    }
    read_request_file(file)
}

/// Reads a request file of at most [`MAX_REQUEST_BYTES`].
pub(super) fn read_request_file(file: &Path) -> io::Result<Vec<u8>> {
    let file = std::fs::File::open(file)?;
    let metadata = file.metadata()?;
    // Checks the length only of regular files, because pipes and devices have none.
    if metadata.is_file() && metadata.len() > MAX_REQUEST_BYTES as u64 {
        return Err(too_long(&metadata.len().to_string()));
    }
    read_request_bytes(file)
}

fn read_request_bytes(from: impl Read) -> io::Result<Vec<u8>> {
    let request = read_bounded(from, MAX_REQUEST_BYTES)?;
    request.ok_or_else(|| too_long(&format!("more than {MAX_REQUEST_BYTES}")))
}

fn too_long(bytes: &str) -> io::Error {
    let why = format!("it has {bytes} bytes, a request has {MAX_REQUEST_BYTES} or fewer: submit several jobs");
    io::Error::new(io::ErrorKind::FileTooLarge, why)
}

async fn list(client: &Client, json: bool) -> Result<(), JobsError> {
    let text = client.send(Method::GET, "").await?;
    if json {
        return Ok(super::print(&[&text[..], b"\n"].concat())?);
    }
    let jobs: Vec<JobInfo> = client.parse(&text)?;
    let lines: String = jobs.iter().map(line).collect();
    Ok(super::print(lines.as_bytes())?)
}

/// Formats the estimated cost of a job.
pub(super) fn cost(estimate: Estimate) -> String {
    format!(
        "up to about {:.1} million triangles and {:.1} MiB, in some {:.0} s",
        estimate.triangles as f64 / 1e6,
        estimate.bytes as f64 / f64::from(1 << 20),
        estimate.seconds.ceil(),
    )
}

/// Formats a job as a line of a list.
fn line(job: &JobInfo) -> String {
    let (counts, state) = (job.extractions, job.state.name());
    let counted = |count, what: &str| match count {
        0 => String::new(),
        count => format!(", {count} {what}"),
    };
    let failed = counted(counts.failed, "failed") + &counted(counts.empty, "empty");
    let paused = job
        .paused
        .as_ref()
        .map_or(String::new(), |why| format!(", paused: {why}"));
    format!(
        "{}  {state:9}  {}/{} done{failed}, {:.1} MiB  {}{paused}\n",
        job.id,
        counts.done,
        counts.total,
        job.bytes as f64 / f64::from(1 << 20),
        job.volume,
    )
}

/// Prints a job that is done. Returns an error if the job has failed or was cancelled.
fn is_done(job: &JobInfo) -> Result<(), JobsError> {
    if job.state == JobState::Done {
        return Ok(super::print(line(job).as_bytes())?);
    }
    let why = job
        .error
        .as_ref()
        .map_or(String::new(), |cause| format!(": {}", cause.detail));
    Err(JobsError::NotDone {
        id: job.id.clone(),
        state: job.state.name(),
        why: why + &first_failure(job),
    })
}

/// Formats the first failed extraction, to be appended to a message about its job.
pub(super) fn first_failure(job: &JobInfo) -> String {
    let first = job.failures.first();
    first.map_or(String::new(), |f| {
        format!("; extraction {}: {}", f.extraction, f.cause.detail)
    })
}

async fn fetch(client: &Client, id: &str, folder: &Path) -> Result<(), JobsError> {
    let fail = |path: &Path| {
        let path = path.to_owned();
        move |source| JobsError::File { path, source }
    };
    std::fs::create_dir_all(folder).map_err(fail(folder))?;
    let entries = client.manifest(id).await?;
    let (bar, mut missing) = (watch::bar(entries.len() as u64), 0);
    for entry in &entries {
        let extraction = entry.extraction;
        bar.set_position(extraction.into());
        let (Some(name), Some(checksum)) = (&entry.file, &entry.sha256) else {
            missing += u64::from(entry.state != ExtractionState::Empty);
            continue;
        };
        let path = folder.join(name);
        if checksum_of(&path).as_ref() == Some(checksum) {
            continue;
        }
        let mut result = client.result(id, extraction).await?;
        let mut file = NamedTempFile::new_in(folder).map_err(fail(folder))?;
        let mut hasher = Sha256::new();
        while let Some(bytes) = result.next().await? {
            hasher.update(&bytes);
            file.write_all(&bytes).map_err(fail(&path))?;
        }
        let found = HEXLOWER.encode(&hasher.finalize());
        if found != *checksum {
            return Err(JobsError::Checksum {
                extraction,
                found,
                expected: checksum.clone(),
            });
        }
        file.persist(&path).map_err(|error| fail(&path)(error.error))?;
    }
    bar.finish_and_clear();
    let path = folder.join(MANIFEST_FILE);
    write_manifest(&path, &entries).map_err(fail(&path))?;
    if missing > 0 {
        Err(JobsError::Missing(missing))
    } else {
        Ok(())
    }
}

/// Name of the file that lists the results, in the folder of the results.
pub(super) const MANIFEST_FILE: &str = "manifest.jsonl";

/// Writes a manifest, which has a line of JSON for each extraction. Replaces an existing one.
pub(super) fn write_manifest(path: &Path, entries: &[impl Serialize]) -> io::Result<()> {
    let mut text = Vec::new();
    for entry in entries {
        serde_json::to_writer(&mut text, entry)?;
        text.push(b'\n');
    }
    write_whole(path, &text)
}

/// Formats a message about extractions whose surfaces have no triangles; empty if there are none.
pub(super) fn empty_ones(entries: &[ManifestEntry]) -> String {
    let mut empty = entries.iter().filter(|entry| entry.state == ExtractionState::Empty);
    let Some(first) = empty.next() else {
        return String::new();
    };
    let why = first.problem.as_ref().map_or("", |cause| &cause.detail);
    let count = 1 + empty.count();
    format!(
        "{count} of {} surfaces have no triangles; extraction {}: {why}",
        entries.len(),
        first.extraction
    )
}

/// Returns the hexadecimal SHA-256 of a file; `None` if the file cannot be read.
pub(super) fn checksum_of(path: &Path) -> Option<String> {
    let (mut file, mut hasher) = (std::fs::File::open(path).ok()?, Sha256::new());
    let mut bytes = vec![0; 1 << 20];
    loop {
        match file.read(&mut bytes).ok()? {
            0 => return Some(HEXLOWER.encode(&hasher.finalize())),
            read => hasher.update(&bytes[..read]),
        }
    }
}
