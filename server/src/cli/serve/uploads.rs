//! Options of `isopeel serve` about uploads.

use std::path::PathBuf;
use std::time::Duration;

use isopeel_volumes::{Frame, SharedCatalog};

use super::super::token::lifetime;
use crate::private_folder::FolderAccess;
use crate::uploads::{FolderError, Limits, UploadFolder, Uploads};

/// Default of `--upload-quota`. Enough for some volumes of 1024³ samples.
const QUOTA_MIB: u64 = 20 * 1024;

/// These options.
#[derive(Debug, clap::Args)]
pub struct UploadArgs {
    /// Let users who have a token for `upload` bring volumes: they are kept in this folder, which is made where there is none, and only
    /// whoever has brought them and administrators see them. Without it none are taken
    #[arg(long, value_name = "DIR")]
    uploads: Option<PathBuf>,

    /// Disk space for the uploads of each user, in MiB
    #[arg(long, value_name = "MIB", default_value_t = QUOTA_MIB, requires = "uploads", value_parser = clap::value_parser!(u64).range(1..))]
    upload_quota: u64,

    /// Remove uploaded volumes that nobody has looked at for so long: 7d, 12h
    #[arg(long, value_name = "TIME", default_value = "7d", requires = "uploads", value_parser = lifetime)]
    upload_expiry: Duration,

    /// Remove uploads that are not finished, and of which nothing has come for so long
    #[arg(long, value_name = "TIME", default_value = "1d", requires = "uploads", value_parser = lifetime)]
    upload_timeout: Duration,
}

impl UploadArgs {
    /// Whether users may upload volumes.
    pub(super) fn are_enabled(&self) -> bool {
        self.uploads.is_some()
    }

    /// Returns the folder of uploads.
    pub(super) fn folder(&self) -> Option<&PathBuf> {
        self.uploads.as_ref()
    }

    /// Opens the uploads of the folder, and adds their volumes to the catalog. `served`: paths of other volumes; `access`: who may use the
    /// folder; `frame`: coordinates of all volumes.
    pub(super) fn open(
        &self,
        served: &[PathBuf],
        access: FolderAccess,
        frame: Frame,
        catalog: &SharedCatalog,
    ) -> Result<Option<Uploads>, FolderError> {
        let Some(path) = &self.uploads else { return Ok(None) };
        let folder = UploadFolder::open(path, access)?;
        folder.is_beside(served)?;
        let limits = Limits {
            quota_bytes: self.upload_quota.saturating_mul(1 << 20),
            keep: self.upload_expiry,
            keep_unfinished: self.upload_timeout,
        };
        let opened = Uploads::open(folder, limits, frame, catalog.clone());
        opened.map(Some).map_err(|source| FolderError::Io {
            path: path.clone(),
            source,
        })
    }
}
