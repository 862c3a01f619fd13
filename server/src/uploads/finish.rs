//! Reads a complete upload as volumes, by the same rules as a path on the command line.

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
    /// Reads a complete upload as volumes, and adds these to the catalog of its owner. Does nothing if the upload was read before.
    ///
    /// # Errors
    /// The upload is incomplete, or its files cannot be read as volumes.
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
        let (uploads, complete) = (self.clone(), Arc::clone(&upload));
        let read = move || {
            let _writer = writer;
            ReadPool::start().run(|| uploads.read(&complete))
        };
        let outcome = tokio::task::spawn_blocking(read).await?;
        upload.status().error = outcome.as_ref().err().map(ToString::to_string);
        outcome?;
        Ok(self.info(&upload))
    }

    fn read(&self, upload: &Upload) -> Result<(), UploadError> {
        let write_error = |error| UploadError::of_write(error, 0);
        upload.contents.seal().map_err(write_error)?;
        self.count_unpacked(upload)?;
        let datasets = self.datasets(upload)?;
        write_record(&upload.folder, &upload.record(true)).map_err(write_error)?;
        // Adds no volumes if the upload was deleted meanwhile. A later deletion finds the volumes in the status of the upload.
        if !self.all().contains_key(&upload.id) {
            return Err(UploadError::Unknown(upload.id.clone()));
        }
        upload.status().used = SystemTime::now();
        self.add_to_catalog(upload, datasets);
        Ok(())
    }

    /// Adds the unpacked contents of compressed files to the bytes that count in the quota.
    fn count_unpacked(&self, upload: &Upload) -> Result<(), UploadError> {
        loop {
            let additional = self.unpacked(upload)?;
            let _creating = self.0.creating.lock().unwrap_or_else(PoisonError::into_inner);
            // Repeats the check if another upload has reserved bytes meanwhile, so that these do not fit any more.
            let needed = self
                .used_by_others(upload)
                .saturating_add(upload.total)
                .saturating_add(additional);
            if additional == 0 || needed <= self.0.limits.quota_bytes {
                upload.status().unpacked = additional;
                return Ok(());
            }
        }
    }

    /// Returns the bytes of the owner's other uploads that count in the quota.
    fn used_by_others(&self, upload: &Upload) -> u64 {
        let all: Vec<_> = self.all().values().cloned().collect();
        let others = all
            .iter()
            .filter(|other| other.owner == upload.owner && other.id != upload.id);
        quota_bytes_of(&others.collect::<Vec<_>>())
    }

    /// Returns the number of bytes by which the unpacked contents of compressed files exceed the files.
    ///
    /// # Errors
    /// [`UploadError::UnpacksOverQuota`] if they exceed the rest of the owner's quota.
    fn unpacked(&self, upload: &Upload) -> Result<u64, UploadError> {
        let (used, quota) = (self.used_by_others(upload), self.0.limits.quota_bytes);
        let mut left = quota.saturating_sub(used).saturating_sub(upload.total);
        let mut additional = 0;
        for file in upload.contents.files() {
            let location = FileLocation::disk(upload.contents.folder().join(&file.name)).packed_by_name();
            let limit = file.bytes.saturating_add(left);
            // An error counts as 0 bytes here, because the reader reports it later.
            let bytes = location.unpacked_bytes(limit).unwrap_or(0);
            if bytes > limit {
                return Err(UploadError::UnpacksOverQuota {
                    file: file.name.clone(),
                    used: used.saturating_add(upload.total).saturating_add(additional),
                    quota,
                });
            }
            let growth = bytes.saturating_sub(file.bytes);
            (left, additional) = (left - growth, additional + growth);
        }
        Ok(additional)
    }

    /// Adds the volumes of an upload to the catalog again after a restart.
    pub(super) fn restore_volumes(&self, upload: &Upload) {
        match self.datasets(upload) {
            Ok(datasets) => self.add_to_catalog(upload, datasets),
            Err(error) => {
                tracing::warn!(upload = upload.id, "an upload cannot be read any more: {error}");
                let mut status = upload.status();
                // Keeps the upload as long as others, because another version of the server may be able to read it.
                status.state = UploadState::Ready;
                status.error = Some(error.to_string());
            }
        }
    }

    /// Marks an upload as ready, and adds its volumes to the catalog of its owner.
    fn add_to_catalog(&self, upload: &Upload, datasets: Vec<Dataset>) {
        let mut status = upload.status();
        status.state = UploadState::Ready;
        status.volumes = datasets.iter().map(|dataset| dataset.id.clone()).collect();
        let datasets = datasets.into_iter().map(Arc::new);
        self.0.catalog.private().add(&upload.owner, datasets, status.used);
    }

    /// Opens the files of an upload as volumes, and assigns ids and titles to them.
    fn datasets(&self, upload: &Upload) -> Result<Vec<Dataset>, UploadError> {
        let path = path_of(upload);
        let root = upload.contents.folder().to_string_lossy().into_owned();
        let mut datasets = open_path(&path).map_err(|error| UploadError::of_read(&error, &root))?;
        for (i, dataset) in datasets.iter_mut().enumerate() {
            // Ids must not contain file names or values of headers, because these may identify a patient.
            dataset.id = match i {
                0 => format!("upload-{}", upload.id),
                _ => format!("upload-{}-{}", upload.id, i + 1),
            };
            dataset.geometry = dataset.geometry.in_frame(self.frame());
            // The reader takes the title from the name of the folder, which the server has chosen: uses the upload's title instead.
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
