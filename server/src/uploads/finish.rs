//! Files become volumes, as those of a path on the command line would.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError};
use std::time::SystemTime;

use isopeel_volumes::location::stem;
use isopeel_volumes::{Dataset, FileLocation, Frame, open_path};

use super::error::UploadError;
use super::folder::{FILES, write_record};
use super::names::common_folder;
use super::state::{UploadInfo, UploadState};
use super::upload::Upload;
use super::{Reader, Uploads, quota_bytes_of};
use crate::pool::ReadPool;

impl Uploads {
    /// Reads a complete upload as volumes, and offers these to its owner. Does nothing if it was read before.
    ///
    /// # Errors
    /// Bytes are missing, or the files cannot be read as volumes.
    pub async fn finish(&self, who: Reader<'_>, id: &str) -> Result<UploadInfo, UploadError> {
        let upload = self.find(who, id)?;
        let writer = upload.take_over().await?;
        let (state, received) = {
            let status = upload.status();
            (status.state, status.received)
        };
        if state == UploadState::Ready {
            return Ok(self.info(&upload));
        }
        if received < upload.total {
            let missing = upload.contents.file_at(received);
            return Err(UploadError::Incomplete {
                received,
                total: upload.total,
                file: upload.contents.files()[missing].name.clone(),
            });
        }
        let _slot = self.0.finishes.enter(&upload.owner)?;
        let (uploads, read) = (self.clone(), Arc::clone(&upload));
        let reading = move || {
            let _writer = writer;
            ReadPool::start().run(|| uploads.read(&read))
        };
        let outcome = tokio::task::spawn_blocking(reading).await?;
        upload.status().error = outcome.as_ref().err().map(ToString::to_string);
        outcome?;
        Ok(self.info(&upload))
    }

    fn read(&self, upload: &Upload) -> Result<(), UploadError> {
        let missing = |error| UploadError::of_write(error, 0);
        upload.contents.seal().map_err(missing)?;
        self.count_unpacked(upload)?;
        let datasets = self.datasets(upload)?;
        write_record(&upload.folder, &upload.record(true)).map_err(missing)?;
        // Offers nothing if it was deleted meanwhile. If it is deleted later, its volumes are in the list and are removed with it.
        if !self.all().contains_key(&upload.id) {
            return Err(UploadError::Unknown(upload.id.clone()));
        }
        upload.status().used = SystemTime::now();
        self.offer(upload, datasets);
        Ok(())
    }

    /// Counts the contents of compressed files in the quota.
    fn count_unpacked(&self, upload: &Upload) -> Result<(), UploadError> {
        loop {
            let more = self.unpacked(upload)?;
            let _creating = self.0.creating.lock().unwrap_or_else(PoisonError::into_inner);
            // Another upload may have reserved its bytes meanwhile: then fewer remain.
            let needed = self
                .used_by_others(upload)
                .saturating_add(upload.total)
                .saturating_add(more);
            if more == 0 || needed <= self.0.limits.quota_bytes {
                upload.status().unpacked = more;
                return Ok(());
            }
        }
    }

    /// Bytes of the owner's other uploads that count in the quota.
    fn used_by_others(&self, upload: &Upload) -> u64 {
        let all: Vec<_> = self.all().values().cloned().collect();
        let others = all
            .iter()
            .filter(|one| one.owner == upload.owner && one.id != upload.id);
        quota_bytes_of(&others.collect::<Vec<_>>())
    }

    /// Returns by how many bytes the contents of compressed files exceed these files.
    ///
    /// # Errors
    /// [`UploadError::UnpacksOverQuota`] if the owner's quota has no space for them.
    fn unpacked(&self, upload: &Upload) -> Result<u64, UploadError> {
        let (used, quota) = (self.used_by_others(upload), self.0.limits.quota_bytes);
        let mut left = quota.saturating_sub(used).saturating_sub(upload.total);
        let mut more = 0;
        for file in upload.contents.files() {
            let location = FileLocation::disk(upload.contents.folder().join(&file.name)).packed_by_name();
            let limit = file.bytes.saturating_add(left);
            // The reader reports files that cannot be decoded.
            let bytes = location.unpacked_bytes(limit).unwrap_or(0);
            if bytes > limit {
                return Err(UploadError::UnpacksOverQuota {
                    file: file.name.clone(),
                    used: used.saturating_add(upload.total).saturating_add(more),
                    quota,
                });
            }
            let grown = bytes.saturating_sub(file.bytes);
            (left, more) = (left - grown, more + grown);
        }
        Ok(more)
    }

    /// Offers the volumes of an upload again after a restart.
    pub(super) fn offer_again(&self, upload: &Upload) {
        match self.datasets(upload) {
            Ok(datasets) => self.offer(upload, datasets),
            Err(error) => {
                tracing::warn!(upload = upload.id, "an upload cannot be read any more: {error}");
                let mut status = upload.status();
                // Kept as long as other volumes: another version of the server may be able to read it.
                status.state = UploadState::Ready;
                status.error = Some(error.to_string());
            }
        }
    }

    fn offer(&self, upload: &Upload, datasets: Vec<Dataset>) {
        let mut status = upload.status();
        status.state = UploadState::Ready;
        status.volumes = datasets.iter().map(|dataset| dataset.id.clone()).collect();
        let datasets = datasets.into_iter().map(Arc::new);
        self.0.catalog.private().add(&upload.owner, datasets, status.used);
    }

    fn datasets(&self, upload: &Upload) -> Result<Vec<Dataset>, UploadError> {
        let path = path_of(upload);
        let root = upload.contents.folder().to_string_lossy().into_owned();
        let mut datasets = open_path(&path).map_err(|error| UploadError::of_read(&error, &root))?;
        for (at, dataset) in datasets.iter_mut().enumerate() {
            // Ids do not derive from file names or headers, which may identify a patient.
            dataset.id = match at {
                0 => format!("upload-{}", upload.id),
                _ => format!("upload-{}-{}", upload.id, at + 1),
            };
            dataset.geometry = dataset.geometry.in_frame(self.frame());
            // The folder's name is the server's: the title is that of the upload.
            if path == upload.contents.folder() && dataset.title == FILES {
                dataset.title = stem(Path::new(&upload.title()));
            }
        }
        Ok(datasets)
    }

    fn frame(&self) -> Frame {
        self.0.frame
    }
}

/// Returns the path that a user would name on the command line: the only file, or the folder of all files.
fn path_of(upload: &Upload) -> PathBuf {
    let (files, folder) = (upload.contents.files(), upload.contents.folder());
    match (files, common_folder(files)) {
        ([file], _) => folder.join(&file.name),
        (_, Some(common)) => folder.join(common),
        _ => folder.to_owned(),
    }
}
