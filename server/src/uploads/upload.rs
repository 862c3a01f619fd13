//! One upload: its state, and which request writes to it. One request writes at a time. A client whose connection was lost may reconnect
//! before the server has noticed the loss, so the newest request replaces the one before.

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

/// Longest wait for the request before, which ends at its next piece: a disk may be slow.
const TAKE_OVER: Duration = Duration::from_secs(5);

pub(super) struct Upload {
    pub id: String,
    pub owner: String,
    pub key: Option<String>,
    pub created: SystemTime,
    pub total: u64,
    pub folder: PathBuf,
    pub contents: Contents,
    status: Mutex<Status>,
    writing: Arc<tokio::sync::Mutex<()>>,
    /// Cancels the request that writes now.
    current: Mutex<CancellationToken>,
}

/// The changing state of an upload.
#[derive(Clone, Debug)]
pub(super) struct Status {
    pub state: UploadState,
    pub received: u64,
    /// Bytes by which the contents of its compressed files exceed these files: known once it was read.
    pub unpacked: u64,
    /// When it was last written to or used.
    pub used: SystemTime,
    /// Ids of its volumes.
    pub volumes: Vec<String>,
    /// Why it could not be read.
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

    /// For people: the only file, the folder of all files, or the first one.
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

    /// Cancels the request that writes now, and waits until it has ended.
    pub(super) async fn take_over(&self) -> Result<Writer, UploadError> {
        let token = CancellationToken::new();
        self.end_writing(token.clone());
        let waiting = Arc::clone(&self.writing).lock_owned();
        let guard = tokio::time::timeout(TAKE_OVER, waiting).await;
        Ok(Writer {
            _guard: guard.map_err(|_| UploadError::Locked)?,
            token,
        })
    }

    /// Cancels the request that writes now. `next` is the token that cancels the one after it.
    pub(super) fn end_writing(&self, next: CancellationToken) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::replace(&mut *current, next).cancel();
    }
}

/// The right to write to an upload, until it is dropped.
pub(super) struct Writer {
    _guard: OwnedMutexGuard<()>,
    /// Cancelled when another request takes over.
    pub token: CancellationToken,
}
