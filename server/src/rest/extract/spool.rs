//! Temporary files for exports whose clients read slowly.

use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::body::Bytes;

use isopeel_volumes::disk::free_bytes;

/// Maximum total bytes of all spooled exports.
const SPOOL_BYTES: u64 = 8 << 30;

/// Bytes that must stay free on the disk of the folder.
const RESERVE_BYTES: u64 = 64 << 20;

/// The folder for spooled exports. Clones share its limit.
#[derive(Clone, Debug)]
pub struct SpoolFolder(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    path: PathBuf,
    limit: u64,
    used: AtomicU64,
}

impl Default for SpoolFolder {
    /// Uses the folder of temporary files.
    fn default() -> Self {
        Self::new(std::env::temp_dir())
    }
}

impl SpoolFolder {
    /// Creates a spool folder. Its files have no names, so that none are left after a crash.
    pub fn new(path: PathBuf) -> Self {
        Self::limited(path, SPOOL_BYTES)
    }

    pub(super) fn limited(path: PathBuf, limit: u64) -> Self {
        let used = AtomicU64::new(0);
        Self(Arc::new(Shared { path, limit, used }))
    }

    /// Creates an empty spool file.
    pub(super) fn create_file(&self) -> io::Result<Spool> {
        Ok(Spool {
            file: tempfile::tempfile_in(&self.0.path)?,
            folder: self.clone(),
            written: 0,
            read: 0,
        })
    }

    /// Reserves `bytes` if the limit and the disk have space for them.
    fn reserve(&self, bytes: u64) -> io::Result<()> {
        let Shared { path, limit, used } = &*self.0;
        let before = used.fetch_add(bytes, Ordering::Relaxed);
        let free = free_bytes(path).unwrap_or(0);
        if before + bytes <= *limit && free >= RESERVE_BYTES + bytes {
            return Ok(());
        }
        used.fetch_sub(bytes, Ordering::Relaxed);
        let why =
            format!("exports that clients read slowly take {before} of {limit} bytes, {free} are free on the disk");
        Err(io::Error::new(io::ErrorKind::StorageFull, why))
    }
}

/// An unnamed file with the bytes that a client has not read yet.
#[derive(Debug)]
pub(super) struct Spool {
    file: File,
    folder: SpoolFolder,
    /// Bytes that were written. They are reserved in the folder.
    written: u64,
    /// Bytes that were read.
    read: u64,
}

impl Spool {
    /// Appends bytes.
    pub fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.folder.reserve(bytes.len() as u64)?;
        self.written += bytes.len() as u64;
        self.file.write_all(bytes)
    }

    /// Returns the next bytes, at most `limit`; `None` at the end. Call this only after all bytes were appended.
    pub fn next_chunk(&mut self, limit: usize) -> io::Result<Option<Bytes>> {
        if self.read == 0 {
            self.file.rewind()?;
        }
        let left = usize::try_from(self.written - self.read).unwrap_or(limit);
        let mut chunk = vec![0; left.min(limit)];
        self.file.read_exact(&mut chunk)?;
        self.read += chunk.len() as u64;
        Ok((!chunk.is_empty()).then(|| chunk.into()))
    }
}

impl Drop for Spool {
    fn drop(&mut self) {
        self.folder.0.used.fetch_sub(self.written, Ordering::Relaxed);
    }
}
