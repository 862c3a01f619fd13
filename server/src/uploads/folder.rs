//! Uploads on the disk. Each upload has a folder with a record of its declaration, and with its files below `files`.
//!
//! A new folder has a temporary name until its record is complete, and a folder gets a temporary name before its files are removed. So the
//! process may end at any time: the next process removes folders with temporary names.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::names::DeclaredFile;
use crate::private_folder::{self, FolderAccess, FolderAccessError};

/// Name of the lock file. The server that uses the folder holds the lock.
const LOCK: &str = "lock";
const RECORD: &str = "upload.json";
/// Name of the folder with the files of an upload, below the folder of the upload.
pub(super) const FILES: &str = "files";
/// Prefix of the temporary names of folders that are being created or removed.
const TEMPORARY: char = '.';

/// Why a folder cannot be used for uploads.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// The folder cannot be created, opened or locked.
    #[error("folder of uploads {}", path.display())]
    Io {
        /// Path of the folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Other users can access the folder, or it cannot be created.
    #[error("folder of uploads")]
    Access(#[from] FolderAccessError),
    /// The folder is below a served folder, so that all users would see the uploads.
    #[error("folder of uploads {} is below {}, which is served to all: expected a folder beside it", path.display(), served.display())]
    Served {
        /// Path of the folder.
        path: PathBuf,
        /// Path of the served folder.
        served: PathBuf,
    },
    /// Another server uses the folder.
    #[error("folder of uploads {} is used by another server, expected one of its own", path.display())]
    InUse {
        /// Path of the folder.
        path: PathBuf,
    },
}

/// What the server stores about an upload, apart from the files. Serialised as JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Record {
    pub owner: String,
    /// Idempotency key of the request that created the upload.
    pub key: Option<String>,
    pub created: SystemTime,
    pub files: Vec<DeclaredFile>,
    /// Number of bytes by which the unpacked contents of compressed files exceed the files; 0 until the upload was read.
    #[serde(default)]
    pub unpacked: u64,
    /// Whether the upload was read as volumes.
    pub is_ready: bool,
}

/// A locked folder. The lock ends when this value is dropped or the process ends, even by a crash.
#[derive(Debug)]
pub struct UploadFolder {
    path: PathBuf,
    _lock: File,
}

impl UploadFolder {
    /// Opens and locks a folder. If the folder does not exist, creates it with access for this user alone.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn open(path: &Path, access: FolderAccess) -> Result<Self, FolderError> {
        let path = private_folder::open(path, access)?;
        let fail = |source| FolderError::Io {
            path: path.clone(),
            source,
        };
        match private_folder::lock_in(&path, LOCK) {
            Ok(lock) => Ok(Self { path, _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(FolderError::InUse { path }),
            Err(TryLockError::Error(source)) => Err(fail(source)),
        }
    }

    /// Checks that the folder is not below any of the folders that are served to all users.
    ///
    /// # Errors
    /// [`FolderError::Served`].
    pub fn is_beside(&self, served: &[PathBuf]) -> Result<(), FolderError> {
        // Skips paths that do not exist: URLs, and folders that may be created later.
        let folders = served.iter().filter_map(|path| path.canonicalize().ok());
        match folders.into_iter().find(|folder| self.path.starts_with(folder)) {
            Some(served) => Err(FolderError::Served {
                path: self.path.clone(),
                served,
            }),
            None => Ok(()),
        }
    }

    /// Returns the free bytes on the disk of the folder.
    pub(super) fn free_bytes(&self) -> io::Result<u64> {
        isopeel_volumes::disk::free_bytes(&self.path)
    }

    /// Creates the folder of an upload, and returns its path.
    pub(super) fn make(&self, id: &str, record: &Record) -> io::Result<PathBuf> {
        let (temporary, path) = (self.path.join(format!("{TEMPORARY}{id}")), self.path.join(id));
        private_folder::make(&temporary.join(FILES))?;
        write_record(&temporary, record)?;
        std::fs::rename(&temporary, &path)?;
        File::open(&self.path)?.sync_all()?;
        Ok(path)
    }

    /// Gives the folder of an upload a temporary name, so that the upload does not exist any more even if the process ends now. Returns the
    /// new path. The caller removes this folder.
    pub(super) fn rename_for_removal(&self, id: &str) -> io::Result<PathBuf> {
        let temporary = self.path.join(format!("{TEMPORARY}{id}"));
        std::fs::rename(self.path.join(id), &temporary)?;
        Ok(temporary)
    }

    /// Returns the id, folder and record of each upload, in the order of their creation. Removes folders that an earlier process was
    /// creating or removing.
    pub(super) fn list(&self) -> io::Result<Vec<(String, PathBuf, Record)>> {
        let mut uploads = Vec::new();
        for entry in std::fs::read_dir(&self.path)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if !entry.file_type()?.is_dir() {
                continue;
            }
            if name.starts_with(TEMPORARY) {
                std::fs::remove_dir_all(entry.path())?;
                continue;
            }
            match read_record(&entry.path()) {
                Ok(record) => uploads.push((name, entry.path(), record)),
                Err(error) => tracing::warn!(upload = name, %error, "passed over: no upload, expected {RECORD} in it"),
            }
        }
        uploads.sort_by_key(|(_, _, record)| record.created);
        Ok(uploads)
    }
}

/// Replaces the record of an upload atomically.
pub(super) fn write_record(folder: &Path, record: &Record) -> io::Result<()> {
    let (path, new) = (folder.join(RECORD), folder.join("upload.json.new"));
    let mut file = File::create(&new)?;
    file.write_all(&serde_json::to_vec(record)?)?;
    file.sync_all()?;
    std::fs::rename(&new, &path)?;
    File::open(folder)?.sync_all()
}

fn read_record(folder: &Path) -> io::Result<Record> {
    Ok(serde_json::from_slice(&std::fs::read(folder.join(RECORD))?)?)
}

/// Returns the time of the last use of an upload. It is stored as the modification time of the record.
pub(super) fn read_last_use(folder: &Path) -> io::Result<SystemTime> {
    std::fs::metadata(folder.join(RECORD))?.modified()
}

/// Stores the time of the last use of an upload.
pub(super) fn write_last_use(folder: &Path, when: SystemTime) -> io::Result<()> {
    OpenOptions::new()
        .write(true)
        .open(folder.join(RECORD))?
        .set_modified(when)
}

/// Returns the folder with the files of an upload.
pub(super) fn files_of(folder: &Path) -> PathBuf {
    folder.join(FILES)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        Record {
            owner: "ann".into(),
            key: None,
            created: SystemTime::now(),
            files: vec![DeclaredFile {
                name: "a.nii".into(),
                bytes: 7,
            }],
            unpacked: 0,
            is_ready: false,
        }
    }

    #[test]
    fn a_folder_is_its_users_alone_and_of_one_server() {
        use std::os::unix::fs::PermissionsExt;
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("a/uploads");
        let folder = UploadFolder::open(&path, FolderAccess::User).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o700);
        assert!(matches!(
            UploadFolder::open(&path, FolderAccess::User),
            Err(FolderError::InUse { .. })
        ));
        drop(folder);
        assert!(UploadFolder::open(&path, FolderAccess::User).is_ok());
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(
            UploadFolder::open(file.path(), FolderAccess::User),
            Err(FolderError::Access(FolderAccessError::Io { .. }))
        ));
    }

    #[test]
    fn uploads_below_a_served_folder_are_refused() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("served/uploads");
        let folder = UploadFolder::open(&path, FolderAccess::User).unwrap();
        let beside = [
            parent.path().join("other"),
            path.join("below"),
            "https://a.example/b".into(),
        ];
        std::fs::create_dir(&beside[0]).unwrap();
        assert!(folder.is_beside(&beside).is_ok());
        for served in [parent.path().join("served"), path.clone()] {
            let error = folder.is_beside(&[served]).unwrap_err().to_string();
            assert!(error.contains("which is served to all"), "{error}");
        }
    }

    #[test]
    fn what_is_half_made_or_half_removed_is_swept_and_the_rest_is_kept() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("uploads");
        let folder = UploadFolder::open(&path, FolderAccess::User).unwrap();
        let kept = folder.make("kept", &record()).unwrap();
        let removed = folder.make("removed", &record()).unwrap();
        std::fs::write(files_of(&removed).join("a.nii"), b"1234567").unwrap();
        let aside = folder.rename_for_removal("removed").unwrap();
        assert!(aside.exists() && !removed.exists());
        let half = path.join(".half");
        private_folder::make(&half).unwrap();
        private_folder::make(&path.join("strange")).unwrap();
        let found = folder.list().unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].0.as_str(), &found[0].1), ("kept", &kept));
        assert!(!aside.exists() && !half.exists(), "what was put aside is gone");
        assert!(path.join("strange").exists(), "what is none of ours is let be");
        let ready = Record {
            is_ready: true,
            ..record()
        };
        write_record(&kept, &ready).unwrap();
        assert!(folder.list().unwrap()[0].2.is_ready);
        let then = SystemTime::now() - std::time::Duration::from_secs(1_000);
        write_last_use(&kept, then).unwrap();
        let found = read_last_use(&kept).unwrap();
        assert!(found.duration_since(then).unwrap_or_default().as_secs() < 1);
    }
}
