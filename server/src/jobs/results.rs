//! The files of finished extractions, in an object store. [`Results::write`] returns after the file was flushed to the disk.

use std::collections::HashSet;
use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::body::Bytes;
use futures_util::stream::BoxStream;
use isopeel_extraction::MeasuredError;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{GetOptions, GetRange, MultipartUpload, ObjectStore, ObjectStoreExt};
use sha2::{Digest, Sha256};
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

use crate::export::ExportError;

/// Bytes of each write to the store.
const PART_BYTES: usize = 4 << 20;

/// SHA-256 of a result.
pub type Checksum = [u8; 32];

/// A file that can be written as a result.
pub trait ResultFile: Send + 'static {
    /// Writes the file to `out`.
    ///
    /// # Errors
    /// The format cannot hold the surface, or `out` fails.
    fn write(&self, out: &mut dyn Write) -> Result<(), ExportError>;
    /// Returns the number of triangles of the surface.
    fn triangles(&self) -> u64;
    /// Returns the distance between the surface and the full-resolution surface; `None` if it was not measured.
    fn error(&self) -> Option<MeasuredError>;
    /// Returns notices about what the file format could not hold.
    fn notices(&self) -> Vec<String>;
}

/// A result that was flushed to the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes.
    pub checksum: Checksum,
}

/// Why a result was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The disk is full, or the disk quota of the server's user is used up.
    #[error("the disk of the state folder is full")]
    Full(#[source] object_store::Error),
    /// The store failed for another reason.
    #[error("the result cannot be written")]
    Storage(#[source] object_store::Error),
    /// The results of the owner would exceed the quota.
    #[error("the result takes more than the {left} bytes that are left of the quota")]
    OverQuota {
        /// Bytes that were left of the quota.
        left: u64,
    },
    /// The surface does not fit its format.
    #[error(transparent)]
    Export(ExportError),
    /// The job was cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// A result that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("the result cannot be read")]
pub struct ReadResultError(#[from] object_store::Error);

/// Bytes of a result, as a stream.
pub type ResultBytes = BoxStream<'static, object_store::Result<Bytes>>;

/// The results of all jobs. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Results {
    folder: PathBuf,
    store: Arc<dyn ObjectStore>,
}

impl Results {
    /// Opens the store in a folder. Creates the folder if it does not exist.
    ///
    /// # Errors
    /// The folder cannot be created or opened.
    pub fn open(folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let store = LocalFileSystem::new_with_prefix(folder).map_err(io::Error::other)?;
        Ok(Self {
            folder: folder.to_owned(),
            store: Arc::new(store.with_fsync(true)),
        })
    }

    /// Wraps the store, to inject faults in tests.
    #[cfg(test)]
    pub(super) fn with_store(mut self, wrap: impl FnOnce(Arc<dyn ObjectStore>) -> Arc<dyn ObjectStore>) -> Self {
        self.store = wrap(self.store);
        self
    }

    /// Writes the result of an extraction, and replaces the file of an earlier attempt. Returns after the file was flushed to the disk.
    ///
    /// # Errors
    /// [`WriteError`]. Removes the partial file, unless the process ends first.
    pub async fn write(
        &self,
        (job, extraction): (&str, u32),
        file: Box<dyn ResultFile>,
        bytes_left: u64,
        token: &CancellationToken,
    ) -> Result<Written, WriteError> {
        let upload = self.store.put_multipart(&key(job, extraction)).await.map_err(storage)?;
        let mut out = PartWriter {
            upload,
            part: Vec::with_capacity(PART_BYTES),
            hasher: Sha256::new(),
            bytes: 0,
            bytes_left,
            token: token.clone(),
            runtime: Handle::current(),
            failed: None,
        };
        let written = tokio::task::spawn_blocking(move || {
            let written = file.write(&mut out).and_then(|()| Ok(out.send_part()?));
            (out, written)
        });
        let (mut out, written) = written.await.map_err(|error| storage(error.into()))?;
        let outcome = match (out.failed.take(), written) {
            (None, Ok(())) => out.upload.complete().await.map_err(storage).map(|_| Written {
                bytes: out.bytes,
                checksum: out.hasher.finalize().into(),
            }),
            (Some(failed), _) => Err(failed),
            (None, Err(error)) => Err(WriteError::Export(error)),
        };
        if outcome.is_err() {
            // An error is ignored, because `abort` fails if `complete` has failed halfway. `remove_staged` then removes the rest.
            let _ = out.upload.abort().await;
            self.remove_staged(job, extraction);
        }
        outcome
    }

    /// Removes the temporary files of a failed write, because the next write needs the space if the disk is full. [`Results::sweep`]
    /// removes temporary files of earlier processes.
    fn remove_staged(&self, job: &str, extraction: u32) {
        // `LocalFileSystem` appends `#` and a number to the name of a file that is not complete.
        let staged = format!("{extraction}#");
        for entry in std::fs::read_dir(self.folder.join(job)).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(&staged) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Reads a range of bytes of a result.
    ///
    /// # Errors
    /// The file cannot be read.
    pub async fn read(
        &self,
        (job, extraction): (&str, u32),
        range: Range<u64>,
    ) -> Result<ResultBytes, ReadResultError> {
        let options = GetOptions::new().with_range(Some(GetRange::Bounded(range)));
        Ok(self.store.get_opts(&key(job, extraction), options).await?.into_stream())
    }

    /// Returns the path of a result, if the file exists.
    pub fn path(&self, (job, extraction): (&str, u32)) -> Option<PathBuf> {
        let path = self.folder.join(job).join(extraction.to_string());
        path.is_file().then_some(path)
    }

    /// Removes the file of an extraction.
    pub async fn remove(&self, (job, extraction): (&str, u32)) {
        if let Err(error) = self.store.delete(&key(job, extraction)).await
            && !matches!(error, object_store::Error::NotFound { .. })
        {
            tracing::warn!(job, extraction, %error, "a result that nobody needs is left until the next start");
        }
    }

    /// Removes all files of a job.
    pub fn remove_job(&self, job: &str) {
        match std::fs::remove_dir_all(self.folder.join(job)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(job, %error, "results that nobody needs are left until the next start");
            }
            _ => {}
        }
    }

    /// Removes all files that earlier processes have left, except the results in `kept`: ids of jobs and numbers of extractions.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn sweep(&self, kept: &HashSet<(String, u32)>) -> io::Result<()> {
        let jobs: HashSet<&str> = kept.iter().map(|(job, _)| job.as_str()).collect();
        for entry in std::fs::read_dir(&self.folder)? {
            let entry = entry?;
            let job = entry.file_name().to_string_lossy().into_owned();
            if !jobs.contains(job.as_str()) {
                self.remove_job(&job);
                continue;
            }
            for file in std::fs::read_dir(entry.path())? {
                let file = file?;
                let number = file.file_name().to_str().and_then(|name| name.parse().ok());
                if !number.is_some_and(|number| kept.contains(&(job.clone(), number))) {
                    std::fs::remove_file(file.path())?;
                }
            }
        }
        Ok(())
    }
}

fn key(job: &str, extraction: u32) -> ObjectPath {
    ObjectPath::from_iter([job, &extraction.to_string()])
}

fn storage(error: object_store::Error) -> WriteError {
    if is_full(&error) {
        WriteError::Full(error)
    } else {
        WriteError::Storage(error)
    }
}

/// Whether an error or one of its sources says that the disk is full.
fn is_full(error: &(dyn std::error::Error + 'static)) -> bool {
    std::iter::successors(Some(error), |error| error.source())
        .filter_map(|error| error.downcast_ref::<io::Error>())
        .any(isopeel_volumes::disk::is_full)
}

/// Writer that hashes its bytes and sends them to the store in parts of [`PART_BYTES`]. Runs on a blocking thread.
struct PartWriter {
    upload: Box<dyn MultipartUpload>,
    part: Vec<u8>,
    hasher: Sha256,
    /// Bytes that were sent.
    bytes: u64,
    /// Maximum bytes of the file: the rest of the owner's quota.
    bytes_left: u64,
    token: CancellationToken,
    runtime: Handle,
    /// Why the first failed write failed.
    failed: Option<WriteError>,
}

impl PartWriter {
    fn fail(&mut self, error: WriteError) -> io::Error {
        self.failed = Some(error);
        io::Error::other("the result cannot be written")
    }

    fn send_part(&mut self) -> io::Result<()> {
        if self.token.is_cancelled() {
            return Err(self.fail(WriteError::Cancelled));
        }
        let part = std::mem::replace(&mut self.part, Vec::with_capacity(PART_BYTES));
        self.hasher.update(&part);
        self.bytes += part.len() as u64;
        if self.bytes > self.bytes_left {
            let left = self.bytes_left;
            return Err(self.fail(WriteError::OverQuota { left }));
        }
        let sent = self.runtime.block_on(self.upload.put_part(part.into()));
        sent.map_err(|error| self.fail(storage(error)))
    }
}

impl Write for PartWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.part.len() == PART_BYTES {
            self.send_part()?;
        }
        let count = bytes.len().min(PART_BYTES - self.part.len());
        self.part.extend_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
