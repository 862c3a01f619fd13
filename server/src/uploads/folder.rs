//! Uploads on the disk: a folder for each, with a record of what was declared and the files below `files`. A folder has its record before
//! it has its name, and loses its name before it loses its files, so that a process may end at any time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::names::DeclaredFile;
use crate::private_folder::{self, FolderAccess, FolderAccessError};

/// Lock file, held by the server that uses the folder.
const LOCK: &str = "lock";
const RECORD: &str = "upload.json";
/// The folder of an upload's files.
pub(super) const FILES: &str = "files";
/// Begins the names of folders that are made or removed.
const ASIDE: char = '.';

/// Why the folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// It cannot be made, opened or locked.
    #[error("folder of uploads {}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Others may use it, or it cannot be made.
    #[error("folder of uploads")]
    Access(#[from] FolderAccessError),
    /// It is below a folder that is served, all of whose users would see the uploads.
    #[error("folder of uploads {} is below {}, which is served to all: expected a folder beside it", path.display(), served.display())]
    Served {
        /// The folder.
        path: PathBuf,
        /// The folder that is served.
        served: PathBuf,
    },
    /// Another server uses it.
    #[error("folder of uploads {} is used by another server, expected one of its own", path.display())]
    InUse {
        /// The folder.
        path: PathBuf,
    },
}

/// Record of an upload: all that is stored of it beside its bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Record {
    pub owner: String,
    /// Of the request that made it.
    pub key: Option<String>,
    pub created: SystemTime,
    pub files: Vec<DeclaredFile>,
    /// Bytes by which the contents of its compressed files exceed these files; 0 before it was read.
    #[serde(default)]
    pub unpacked: u64,
    /// It was read as a volume.
    pub is_ready: bool,
}

/// A locked folder. Dropping it unlocks it, and so does the end of the process, however it ends.
#[derive(Debug)]
pub struct UploadFolder {
    path: PathBuf,
    _lock: File,
}

impl UploadFolder {
    /// Opens and locks a folder, made for this user alone if there is none.
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

    /// Checks that it is in none of the folders that are served to all.
    ///
    /// # Errors
    /// [`FolderError::Served`].
    pub fn is_beside(&self, served: &[PathBuf]) -> Result<(), FolderError> {
        // Paths that do not exist are skipped: addresses, and folders that appear later.
        let folders = served.iter().filter_map(|path| path.canonicalize().ok());
        match folders.into_iter().find(|folder| self.path.starts_with(folder)) {
            Some(served) => Err(FolderError::Served {
                path: self.path.clone(),
                served,
            }),
            None => Ok(()),
        }
    }

    /// Bytes that are free on its disk.
    pub(super) fn free_bytes(&self) -> io::Result<u64> {
        isopeel_volumes::disk::free_bytes(&self.path)
    }

    /// Makes the folder of an upload.
    pub(super) fn make(&self, id: &str, record: &Record) -> io::Result<PathBuf> {
        let (aside, path) = (self.path.join(format!("{ASIDE}{id}")), self.path.join(id));
        private_folder::make(&aside.join(FILES))?;
        write_record(&aside, record)?;
        std::fs::rename(&aside, &path)?;
        File::open(&self.path)?.sync_all()?;
        Ok(path)
    }

    /// Renames the folder of an upload, so that the upload is gone even if the process ends now. Returns the new path, which is to be
    /// removed.
    pub(super) fn rename_for_removal(&self, id: &str) -> io::Result<PathBuf> {
        let aside = self.path.join(format!("{ASIDE}{id}"));
        std::fs::rename(self.path.join(id), &aside)?;
        Ok(aside)
    }

    /// Returns the uploads on the disk, with their records. Removes folders that an earlier process was creating or removing.
    pub(super) fn list(&self) -> io::Result<Vec<(String, PathBuf, Record)>> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&self.path)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if !entry.file_type()?.is_dir() {
                continue;
            }
            if name.starts_with(ASIDE) {
                std::fs::remove_dir_all(entry.path())?;
                continue;
            }
            match read_record(&entry.path()) {
                Ok(record) => found.push((name, entry.path(), record)),
                Err(error) => tracing::warn!(upload = name, %error, "passed over: no upload, expected {RECORD} in it"),
            }
        }
        found.sort_by_key(|(_, _, record)| record.created);
        Ok(found)
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

/// Returns when an upload was used last: the modification time of its record.
pub(super) fn read_last_use(folder: &Path) -> io::Result<SystemTime> {
    std::fs::metadata(folder.join(RECORD))?.modified()
}

/// Stores the time at which an upload was used last.
pub(super) fn write_last_use(folder: &Path, when: SystemTime) -> io::Result<()> {
    OpenOptions::new()
        .write(true)
        .open(folder.join(RECORD))?
        .set_modified(when)
}

/// The folder of an upload's files.
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
