//! The folder that stores batch jobs and tokens. The folder must be on a local disk, and one server uses it at a time.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::private_folder::{self, FolderAccess, FolderAccessError};

/// Name of the lock file. The server that uses the folder holds the lock.
const LOCK: &str = "lock";

/// A locked folder. The lock ends when this value is dropped or the process ends, even by a crash.
#[derive(Debug)]
pub struct StateFolder {
    path: PathBuf,
    _lock: File,
}

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateFolderError {
    /// The folder cannot be created, opened or locked.
    #[error("state folder {}", path.display())]
    Io {
        /// Path of the folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Other users can access the folder, or it cannot be created.
    #[error("state folder")]
    Access(#[from] FolderAccessError),
    /// The folder is on a network file system, whose locks and fsync are not reliable.
    #[error("state folder {} is on {kind}, expected a disk of this machine: its locks and its fsync are relied on", path.display())]
    Network {
        /// Path of the folder.
        path: PathBuf,
        /// Name of the file system.
        kind: &'static str,
    },
    /// Another server uses the folder.
    #[error("state folder {} is used by another server, expected one of its own", path.display())]
    InUse {
        /// Path of the folder.
        path: PathBuf,
    },
}

impl StateFolder {
    /// Opens and locks a folder. If the folder does not exist, creates it with access for this user alone.
    ///
    /// # Errors
    /// [`StateFolderError`].
    pub fn open(path: &Path, access: FolderAccess) -> Result<Self, StateFolderError> {
        let path = Self::prepare(path, access)?;
        let fail = |source| StateFolderError::Io {
            path: path.clone(),
            source,
        };
        match private_folder::lock_in(&path, LOCK) {
            Ok(lock) => Ok(Self { path, _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(StateFolderError::InUse { path }),
            Err(TryLockError::Error(source)) => Err(fail(source)),
        }
    }

    /// Prepares a folder as [`StateFolder::open`] does, but without a lock, and returns its path. For commands that change the folder while
    /// a server uses it.
    ///
    /// # Errors
    /// [`StateFolderError`].
    pub fn prepare(path: &Path, access: FolderAccess) -> Result<PathBuf, StateFolderError> {
        let path = private_folder::open(path, access)?;
        let network = file_system(&path).map(|magic| magic.and_then(network_file_system));
        match network {
            Ok(Some(kind)) => Err(StateFolderError::Network { path, kind }),
            Ok(None) => Ok(path),
            Err(source) => Err(StateFolderError::Io { path, source }),
        }
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Returns the magic number of a folder's file system; `None` on systems without magic numbers.
#[cfg(target_os = "linux")]
fn file_system(path: &Path) -> io::Result<Option<i64>> {
    use std::os::unix::ffi::OsStrExt;
    let name = std::ffi::CString::new(path.as_os_str().as_bytes())?;
    let mut info = std::mem::MaybeUninit::<libc::statfs>::uninit();
    // SAFETY: the name is zero-terminated, and `info` has space for the result.
    if unsafe { libc::statfs(name.as_ptr(), info.as_mut_ptr()) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: initialised, because the call succeeded.
    let info = unsafe { info.assume_init() };
    #[allow(clippy::unnecessary_cast, reason = "its type depends on the C library")]
    let magic = info.f_type as i64;
    Ok(Some(magic & 0xffff_ffff))
}

#[cfg(not(target_os = "linux"))]
fn file_system(_: &Path) -> io::Result<Option<i64>> {
    Ok(None)
}

/// Returns the name of a network or FUSE file system; `None` for other file systems. The magic numbers are from statfs(2) and
/// `linux/magic.h`.
fn network_file_system(magic: i64) -> Option<&'static str> {
    Some(match magic {
        0x6969 => "NFS",
        0x517b | 0xff53_4d42 | 0xfe53_4d42 => "SMB",
        0x5346_414f | 0x6b41_4653 => "AFS",
        0x00c3_6400 => "Ceph",
        0x6573_5546 => "FUSE",
        0x0bd0_0bd0 => "Lustre",
        0x4750_4653 => "GPFS",
        0x1983_0326 => "BeeGFS",
        0x0102_1997 => "9P",
        0x7375_7245 => "Coda",
        0x564c => "NCP",
        0x0116_1970 => "GFS2",
        0x7461_636f => "OCFS2",
        0xaad7_aaea => "PanFS",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_server_at_a_time() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("a/b");
        let folder = StateFolder::open(&path, FolderAccess::User).unwrap();
        assert_eq!(folder.path(), path.canonicalize().unwrap());
        let second = StateFolder::open(&path, FolderAccess::User).unwrap_err();
        assert!(matches!(&second, StateFolderError::InUse { .. }), "{second}");
        drop(folder);
        assert!(StateFolder::open(&path, FolderAccess::User).is_ok());
    }

    #[test]
    fn a_file_is_no_folder() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = StateFolder::open(file.path(), FolderAccess::User).unwrap_err();
        assert!(
            matches!(&error, StateFolderError::Access(FolderAccessError::Io { .. })),
            "{error}"
        );
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn file_systems_are_told_apart() {
        // Of every Linux: proc is no network's.
        let proc = file_system(Path::new("/proc")).unwrap().unwrap();
        assert_eq!((proc, network_file_system(proc)), (0x9fa0, None));
        let ext4 = 0xef53;
        assert_eq!(network_file_system(ext4), None);
        assert_eq!(network_file_system(0x6969), Some("NFS"));
        assert_eq!(network_file_system(0xff53_4d42), Some("SMB"));
    }
}
