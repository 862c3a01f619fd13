//! One upload: its state, and the request that writes to it. One request writes at a time. A client may reconnect before the server has
//! noticed that the old connection was lost, so the newest request takes over the upload from the previous one.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use tokio::sync::OwnedMutexGuard;
use tokio_util::sync::CancellationToken;

use super::contents::Contents;
use super::error::UploadError;
use super::folder::{Record, files_of};
use super::names::common_folder;
use super::state::UploadState;

/// Maximum wait for the end of the previous request, which may have to finish a write to a slow disk.
const TAKE_OVER_LIMIT: Duration = Duration::from_secs(5);

/// An upload.
pub(super) struct Upload {
    pub id: String,
    pub owner: String,
    /// Idempotency key of the request that created the upload.
    pub key: Option<String>,
    pub created: SystemTime,
    /// Bytes of all declared files.
    pub total: u64,
    pub folder: PathBuf,
    pub contents: Contents,
    status: Mutex<Status>,
    /// Locked by the request that writes.
    writing: Arc<tokio::sync::Mutex<()>>,
    /// Cancels the request that writes.
    current: Mutex<CancellationToken>,
}

/// The changing state of an upload.
#[derive(Clone, Debug)]
pub(super) struct Status {
    pub state: UploadState,
    /// Bytes that were received.
    pub received: u64,
    /// Number of bytes by which the unpacked contents of compressed files exceed the files; 0 until the upload was read.
    pub unpacked: u64,
    /// When bytes were received or volumes used most recently.
    pub used: SystemTime,
    /// Ids of the volumes.
    pub volumes: Vec<String>,
    /// Why the files could not be read as volumes, if that was tried.
    pub error: Option<String>,
}

impl Upload {
    pub(super) fn new(id: String, folder: PathBuf, record: Record, received: u64, used: SystemTime) -> Self {
        let total = record.files.iter().map(|file| file.bytes).sum();
        Self {
            id,
            owner: record.owner,
            key: record.key,
            created: record.created,
            total,
            contents: Contents::new(files_of(&folder), record.files),
            folder,
            status: Mutex::new(Status {
                state: UploadState::Receiving,
                received,
                unpacked: record.unpacked,
                used,
                volumes: Vec::new(),
                error: None,
            }),
            writing: Arc::default(),
            current: Mutex::default(),
        }
    }

    /// Returns the record to be stored.
    pub(super) fn record(&self, is_ready: bool) -> Record {
        Record {
            owner: self.owner.clone(),
            key: self.key.clone(),
            created: self.created,
            files: self.contents.files().to_vec(),
            unpacked: self.status().unpacked,
            is_ready,
        }
    }

    /// Returns the bytes that count in the owner's quota.
    pub(super) fn quota_bytes(&self) -> u64 {
        self.total.saturating_add(self.status().unpacked)
    }

    /// Returns a title for users: the name of the only file, of the folder of all files, or of the first file.
    pub(super) fn title(&self) -> String {
        let files = self.contents.files();
        let first = files.first().map_or("", |file| file.name.as_str());
        let file = first.rsplit('/').next().unwrap_or(first);
        let folder = common_folder(files).filter(|_| files.len() > 1);
        folder.unwrap_or(file).to_owned()
    }

    pub(super) fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cancels the request that writes, waits until it has ended, and returns the right to write.
    pub(super) async fn take_over(&self) -> Result<Writer, UploadError> {
        let token = CancellationToken::new();
        self.cancel_writer(token.clone());
        let lock = Arc::clone(&self.writing).lock_owned();
        let guard = tokio::time::timeout(TAKE_OVER_LIMIT, lock).await;
        Ok(Writer {
            _guard: guard.map_err(|_| UploadError::Locked)?,
            token,
        })
    }

    /// Cancels the request that writes. `next` is the token that cancels the next one.
    pub(super) fn cancel_writer(&self, next: CancellationToken) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::replace(&mut *current, next).cancel();
    }
}

/// Guard: the right to write to an upload.
pub(super) struct Writer {
    _guard: OwnedMutexGuard<()>,
    /// Cancelled when another request takes over.
    pub token: CancellationToken,
}
