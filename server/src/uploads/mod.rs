//! Volumes that users upload. A client sends files in parts, and can resume after a lost connection or a restart of the server. The server
//! then serves the volumes to their owner alone, until the owner deletes them or has not used them for some time.
//!
//! - `names`: checks the names of files; `contents`: the bytes of an upload, in its files.
//! - `folder`: the folders on the disk, and the records that survive a restart.
//! - `upload`: one upload, and the request that writes to it; `receive`: receives parts; `finish`: reads complete uploads as volumes.
//! - `state`, `error`: uploads and errors as clients see them.

mod contents;
mod error;
mod finish;
mod folder;
mod names;
mod receive;
mod slots;
mod state;
#[cfg(test)]
mod tests;
mod upload;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use data_encoding::HEXLOWER;
use isopeel_volumes::{Frame, Reader, SharedCatalog};
use tokio_util::sync::CancellationToken;

use crate::clock::rfc3339_seconds;
pub use error::UploadError;
pub use folder::{FolderError, UploadFolder};
use folder::{Record, read_last_use, write_last_use};
pub use names::{DeclaredFile, MAX_FILES, NameError};
use slots::Slots;
pub use state::{UploadInfo, UploadList, UploadRequest, UploadState};
use upload::Upload;

/// Maximum bytes of a request that declares files. Enough for 20,000 names of 200 bytes.
pub const MAX_REQUEST_BYTES: usize = 4 << 20;
/// Maximum number of uploads of a user. The user's list of volumes contains all of them.
pub const MAX_UPLOADS: usize = 100;
/// Bytes on the disk that uploads must leave free.
const RESERVE_BYTES: u64 = 1 << 30;
/// Maximum number of uploads that are read as volumes at the same time, one for each user. Few, because the headers of thousands of files
/// may have to be read.
const MAX_FINISHES: usize = 2;
/// Random bytes of an id. 128 bits, so that no user can guess the id of another user's upload.
const ID_BYTES: usize = 16;
/// Maximum interval between two checks for expired uploads.
const MAX_EXPIRY_INTERVAL: Duration = Duration::from_secs(60);

/// Maximum time between the expiry of an upload and its removal. If the wall clock is wrong, it may be corrected within this time, before
/// uploads are lost.
const MAX_GRACE_PERIOD: Duration = Duration::from_secs(3600);

/// Stands for a time of use plus a retention beyond what the system's clock can hold.
const CENTURY: Duration = Duration::from_secs(100 * 365 * 86_400);

/// For each overdue upload, by its id, the time at which its expiry was first noticed.
type Overdue = HashMap<String, Instant>;

/// Limits on the size and the age of uploads.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Maximum bytes of a user's uploads. The unpacked contents of a compressed file count, if they are larger than the file.
    pub quota_bytes: u64,
    /// Finished uploads are removed after this time without use.
    pub keep: Duration,
    /// Unfinished uploads are removed after this time without a received byte.
    pub keep_unfinished: Duration,
}

/// The uploads of a server. Clones are cheap.
#[derive(Clone)]
pub struct Uploads(Arc<Shared>);

struct Shared {
    folder: UploadFolder,
    limits: Limits,
    frame: Frame,
    catalog: SharedCatalog,
    /// Uploads by their ids.
    uploads: Mutex<HashMap<String, Arc<Upload>>>,
    /// Held while an upload is checked against the quota and stored, so that concurrent requests cannot exceed the quota together.
    creating: Mutex<()>,
    /// Slots for parts that are being received.
    parts: Slots,
    /// Slots for uploads that are being read as volumes.
    finishes: Slots,
}

impl Uploads {
    /// Opens the uploads of a folder. Adds the volumes of finished uploads to the catalog, and reads the headers of their files for that.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn open(folder: UploadFolder, limits: Limits, frame: Frame, catalog: SharedCatalog) -> std::io::Result<Self> {
        let stored = folder.list()?;
        let uploads = Self(Arc::new(Shared {
            folder,
            limits,
            frame,
            catalog,
            uploads: Mutex::default(),
            creating: Mutex::default(),
            parts: Slots::new(receive::MAX_PARTS, receive::MAX_PARTS_OF_USER),
            finishes: Slots::new(MAX_FINISHES, 1),
        }));
        for (id, path, record) in stored {
            let (is_ready, used) = (record.is_ready, read_last_use(&path)?);
            let upload = Arc::new(Upload::new(id.clone(), path, record, 0, used));
            let received = upload.contents.settle()?;
            upload.status().received = received;
            if is_ready {
                uploads.restore_volumes(&upload);
            }
            uploads.all().insert(id, upload);
        }
        Ok(uploads)
    }

    /// Removes expired uploads, until `stop` is cancelled.
    pub async fn run(self, stop: CancellationToken) {
        let Limits {
            keep, keep_unfinished, ..
        } = self.0.limits;
        let pause = (keep.min(keep_unfinished) / 4).clamp(Duration::from_millis(250), MAX_EXPIRY_INTERVAL);
        let mut overdue = Overdue::default();
        while tokio::time::timeout(pause, stop.cancelled()).await.is_err() {
            self.expire(&mut overdue, SystemTime::now(), Instant::now()).await;
        }
    }

    /// Removes uploads that have been overdue for longer than their grace period. Expiry is a time of the wall clock, `now`. The grace
    /// period is measured by the monotonic clock, `instant`, because the wall clock may be set.
    async fn expire(&self, overdue: &mut Overdue, now: SystemTime, instant: Instant) {
        let all: Vec<Arc<Upload>> = self.all().values().cloned().collect();
        overdue.retain(|id, _| all.iter().any(|upload| upload.id == *id));
        for upload in all {
            self.record_last_use(&upload);
            if self.expiry(&upload) > now {
                overdue.remove(&upload.id);
                continue;
            }
            let since = *overdue.entry(upload.id.clone()).or_insert(instant);
            if instant.saturating_duration_since(since) >= self.grace_period(&upload) {
                tracing::info!(upload = upload.id, "an upload has expired");
                if let Err(error) = self.remove(&upload).await {
                    tracing::error!(
                        upload = upload.id,
                        error = crate::error::chain(&error),
                        "an upload stays"
                    );
                }
            }
        }
    }

    /// Stores the time of the last use of an upload's volumes, in memory and on the disk.
    fn record_last_use(&self, upload: &Upload) {
        let private = self.0.catalog.private();
        let mut status = upload.status();
        let used = status.volumes.iter().filter_map(|id| private.last_used(id)).max();
        status.used = status.used.max(used.unwrap_or(SystemTime::UNIX_EPOCH));
        if let Err(error) = write_last_use(&upload.folder, status.used) {
            tracing::debug!(upload = upload.id, %error, "when it was used is not noted");
        }
    }

    /// Returns how long an upload in this state is kept without use.
    fn retention(&self, state: UploadState) -> Duration {
        match state {
            UploadState::Receiving => self.0.limits.keep_unfinished,
            UploadState::Ready => self.0.limits.keep,
        }
    }

    /// Returns the time between the expiry of an upload and its removal.
    fn grace_period(&self, upload: &Upload) -> Duration {
        (self.retention(upload.status().state) / 4).min(MAX_GRACE_PERIOD)
    }

    /// Returns when an upload expires if it is not used before.
    fn expiry(&self, upload: &Upload) -> SystemTime {
        let status = upload.status();
        let keep = self.retention(status.state);
        status
            .used
            .checked_add(keep)
            .unwrap_or_else(|| SystemTime::now() + CENTURY)
    }

    /// Locks the map of uploads.
    fn all(&self) -> MutexGuard<'_, HashMap<String, Arc<Upload>>> {
        self.0.uploads.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns an upload that this user may see.
    fn find(&self, who: Reader<'_>, id: &str) -> Result<Arc<Upload>, UploadError> {
        let upload = self.all().get(id).cloned();
        let visible = upload.filter(|upload| who.sees(&upload.owner));
        visible.ok_or_else(|| UploadError::Unknown(id.to_owned()))
    }

    /// Creates an upload. Returns the upload, and whether it is new. If a request with the same key and the same files has created an
    /// upload before, returns that upload.
    ///
    /// # Errors
    /// The files are invalid, or exceed a limit.
    pub async fn create(
        &self,
        who: Reader<'_>,
        key: Option<String>,
        request: UploadRequest,
    ) -> Result<(UploadInfo, bool), UploadError> {
        let total = names::check(&request.files)?;
        if let Some(key) = key.as_deref().filter(|key| !is_key(key)) {
            return Err(UploadError::BadKey(key.len()));
        }
        let (uploads, owner) = (self.clone(), who.user().to_owned());
        tokio::task::spawn_blocking(move || uploads.create_blocking(owner, key, request, total)).await?
    }

    /// Does the work of [`Uploads::create`] after the arguments were checked. `total` is the declared bytes of all files. Blocks on the
    /// disk.
    fn create_blocking(
        &self,
        owner: String,
        key: Option<String>,
        request: UploadRequest,
        total: u64,
    ) -> Result<(UploadInfo, bool), UploadError> {
        let _creating = self.0.creating.lock().unwrap_or_else(PoisonError::into_inner);
        let all: Vec<Arc<Upload>> = self.all().values().cloned().collect();
        let own: Vec<&Arc<Upload>> = all.iter().filter(|upload| upload.owner == owner).collect();
        if let Some(earlier) = own.iter().find(|upload| key.is_some() && upload.key == key) {
            if earlier.contents.files() != request.files {
                return Err(UploadError::KeyReused {
                    upload: earlier.id.clone(),
                });
            }
            return Ok((self.info(earlier), false));
        }
        if own.len() >= MAX_UPLOADS {
            return Err(UploadError::TooMany);
        }
        self.check_space(&all, &own, total)?;
        let record = Record {
            owner,
            key,
            created: SystemTime::now(),
            files: request.files,
            unpacked: 0,
            is_ready: false,
        };
        let id = new_id()?;
        let folder = self.0.folder.make(&id, &record);
        let folder = folder.map_err(|error| UploadError::of_write(error, total))?;
        let upload = Arc::new(Upload::new(id.clone(), folder, record, 0, SystemTime::now()));
        self.all().insert(id, Arc::clone(&upload));
        Ok((self.info(&upload), true))
    }

    /// Checks whether an upload of `total` bytes fits in the quota of its user and on the disk. `own` are the other uploads of the user.
    /// Bytes that `all` uploads have not received yet count as occupied.
    fn check_space(&self, all: &[Arc<Upload>], own: &[&Arc<Upload>], total: u64) -> Result<(), UploadError> {
        let (used, quota) = (quota_bytes_of(own), self.0.limits.quota_bytes);
        if total > quota.saturating_sub(used) {
            return Err(UploadError::OverQuota {
                wanted: total,
                used,
                quota,
            });
        }
        let promised: u64 = all.iter().map(|upload| upload.total - upload.status().received).sum();
        let needed = total.saturating_add(promised).saturating_add(RESERVE_BYTES);
        if needed > self.0.folder.free_bytes()? {
            return Err(UploadError::DiskFull(total));
        }
        Ok(())
    }

    /// Returns the uploads that a user may see, the latest first, and the user's quota.
    pub fn list(&self, who: Reader<'_>) -> UploadList {
        let all: Vec<Arc<Upload>> = self.all().values().cloned().collect();
        let own: Vec<_> = all.iter().filter(|upload| upload.owner == who.user()).collect();
        let used_bytes = quota_bytes_of(&own);
        let mut visible: Vec<_> = all.into_iter().filter(|upload| who.sees(&upload.owner)).collect();
        visible.sort_by_key(|upload| std::cmp::Reverse(upload.created));
        UploadList {
            quota_bytes: self.0.limits.quota_bytes,
            used_bytes,
            uploads: visible.iter().map(|upload| self.info(upload)).collect(),
        }
    }

    /// Returns the number of uploads of all users in each state, and the total bytes that they have received.
    pub fn counts(&self) -> (Vec<(UploadState, usize)>, u64) {
        let all: Vec<Arc<Upload>> = self.all().values().cloned().collect();
        let count = |state| all.iter().filter(|upload| upload.status().state == state).count();
        let bytes = all.iter().map(|upload| upload.status().received).sum();
        (UploadState::ALL.map(|state| (state, count(state))).to_vec(), bytes)
    }

    /// Returns the description of an upload.
    ///
    /// # Errors
    /// [`UploadError::Unknown`].
    pub fn get(&self, who: Reader<'_>, id: &str) -> Result<UploadInfo, UploadError> {
        Ok(self.info(&*self.find(who, id)?))
    }

    /// Removes an upload in any state, and its volumes. Viewers of these volumes are notified.
    ///
    /// # Errors
    /// [`UploadError::Unknown`].
    pub async fn delete(&self, who: Reader<'_>, id: &str) -> Result<(), UploadError> {
        let upload = self.find(who, id)?;
        self.remove(&upload).await
    }

    /// Removes an upload, its volumes and its folder.
    async fn remove(&self, upload: &Arc<Upload>) -> Result<(), UploadError> {
        // After this, no new request finds the upload. `take_over` below ends a request that still writes to it.
        if self.all().remove(&upload.id).is_none() {
            return Err(UploadError::Unknown(upload.id.clone()));
        }
        for volume in &upload.status().volumes {
            self.0.catalog.private().remove(volume);
        }
        let writer = upload.take_over().await;
        let (uploads, upload) = (self.clone(), Arc::clone(upload));
        let remove_folder = move || {
            // Repeated, because `finish` may have added the volumes to the catalog meanwhile.
            for volume in &upload.status().volumes {
                uploads.0.catalog.private().remove(volume);
            }
            let folder = uploads.0.folder.rename_for_removal(&upload.id)?;
            drop(writer);
            std::fs::remove_dir_all(folder)
        };
        Ok(tokio::task::spawn_blocking(remove_folder).await??)
    }

    /// Returns the description of an upload for clients.
    fn info(&self, upload: &Upload) -> UploadInfo {
        let expires = self.expiry(upload);
        let status = upload.status().clone();
        UploadInfo {
            id: upload.id.clone(),
            title: upload.title(),
            owner: upload.owner.clone(),
            state: status.state,
            files: upload.contents.files().len(),
            bytes: upload.total,
            received_bytes: status.received,
            created: rfc3339_seconds(upload.created),
            expires: rfc3339_seconds(expires),
            volumes: status.volumes,
            error: status.error,
        }
    }
}

/// Returns the bytes of these uploads that count in the quota of their owner.
fn quota_bytes_of(uploads: &[&Arc<Upload>]) -> u64 {
    uploads
        .iter()
        .fold(0, |sum: u64, upload| sum.saturating_add(upload.quota_bytes()))
}

/// Whether a text is valid as idempotency key: 1 to 255 printable ASCII characters without spaces.
fn is_key(key: &str) -> bool {
    (1..=255).contains(&key.len()) && key.bytes().all(|byte| byte.is_ascii_graphic())
}

fn new_id() -> std::io::Result<String> {
    let mut bytes = [0; ID_BYTES];
    getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
    Ok(HEXLOWER.encode(&bytes))
}
