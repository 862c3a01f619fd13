//! Folders that only the user of the server may access, because their contents are secret or trusted.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Maximum wait for a lock. The system keeps the lock of a killed process until it has freed the memory of this process.
const LOCK_WAIT: Duration = Duration::from_secs(4);

/// Locks a file in a folder as [`lock`] does. Creates the file if it does not exist.
///
/// # Errors
/// As [`lock`], or the file cannot be created.
pub fn lock_in(folder: &Path, name: &str) -> Result<File, TryLockError> {
    let mut options = File::options();
    let file = options
        .create(true)
        .truncate(false)
        .write(true)
        .open(folder.join(name))
        .map_err(TryLockError::Error)?;
    lock(&file)?;
    Ok(file)
}

/// Locks a file for this process alone. Waits some seconds for the lock of another process.
///
/// # Errors
/// [`TryLockError::WouldBlock`] if another process still holds the lock; [`TryLockError::Error`] if the file system has no locks.
pub fn lock(file: &File) -> Result<(), TryLockError> {
    let start = Instant::now();
    loop {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) if start.elapsed() < LOCK_WAIT => std::thread::sleep(LOCK_WAIT / 100),
            outcome => return outcome,
        }
    }
}

/// Who may use such a folder beside the server's user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum FolderAccess {
    /// No other user.
    #[default]
    User,
    /// Its group too, and it may belong to root, as volumes of containers do.
    Group,
}

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderAccessError {
    /// The folder cannot be created or inspected.
    #[error("folder {}", path.display())]
    Io {
        /// Path of the folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The user of the server may not create or enter the folder.
    #[error(
        "folder {} cannot be made or entered by user {user}, the server's: expected one above it that this user or group 0 may write, such as a volume of its own", path.display()
    )]
    Denied {
        /// Path of the folder.
        path: PathBuf,
        /// Id of the server's user.
        user: u32,
    },
    /// The folder belongs to another user.
    #[error(
        "folder {} belongs to user {owner}, expected {user}, the server's: sudo chown -R {user} '{}'", path.display(), path.display()
    )]
    Owner {
        /// Path of the folder.
        path: PathBuf,
        /// Id of the user who owns the folder.
        owner: u32,
        /// Id of the server's user, who must own the folder.
        user: u32,
    },
    /// Other users may read or change the contents of the folder.
    #[error(
        "folder {} has mode {mode:04o}, expected no rights of {}: chmod {} '{}'", path.display(), access.others(), access.remedy(), path.display()
    )]
    Mode {
        /// Path of the folder.
        path: PathBuf,
        /// Mode of the folder.
        mode: u32,
        /// The requested access.
        access: FolderAccess,
    },
}

impl FolderAccess {
    /// Returns the mode bits that a folder must not have.
    fn forbidden(self) -> u32 {
        match self {
            Self::User => 0o077,
            Self::Group => 0o007,
        }
    }

    /// Returns the classes of users who must not have access, for the error message.
    fn others(self) -> &'static str {
        match self {
            Self::User => "group and others (--folder-access group lets the group in)",
            Self::Group => "others",
        }
    }

    /// Returns the argument of `chmod` that removes the forbidden mode bits.
    fn remedy(self) -> &'static str {
        match self {
            Self::User => "go-rwx",
            Self::Group => "o-rwx",
        }
    }
}

/// Opens a folder, and returns its canonical path. If the folder does not exist, creates it with access for this user alone; otherwise
/// checks its owner and mode.
///
/// # Errors
/// [`FolderAccessError`].
pub fn open(path: &Path, access: FolderAccess) -> Result<PathBuf, FolderAccessError> {
    let fail = |source: io::Error| {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
                let user = rustix::process::geteuid().as_raw();
                FolderAccessError::Denied { path, user }
            }
            _ => FolderAccessError::Io { path, source },
        }
    };
    make(path).map_err(fail)?;
    let path = path.canonicalize().map_err(fail)?;
    check(path, access)
}

/// Creates a folder with access for this user alone, and missing folders above it.
///
/// # Errors
/// Errors of the system.
pub fn make(path: &Path) -> io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.recursive(true).create(path)
}

#[cfg(unix)]
fn check(path: PathBuf, access: FolderAccess) -> Result<PathBuf, FolderAccessError> {
    use std::os::unix::fs::MetadataExt;
    let metadata = match std::fs::metadata(&path) {
        Ok(metadata) => metadata,
        Err(source) => return Err(FolderAccessError::Io { path, source }),
    };
    let (owner, mode) = (metadata.uid(), metadata.mode() & 0o7777);
    let user = rustix::process::geteuid().as_raw();
    let may_belong_to_root = access == FolderAccess::Group;
    if owner != user && !(may_belong_to_root && owner == 0) {
        return Err(FolderAccessError::Owner { path, owner, user });
    }
    if mode & access.forbidden() != 0 {
        return Err(FolderAccessError::Mode { path, mode, access });
    }
    Ok(path)
}

#[cfg(not(unix))]
fn check(path: PathBuf, _: FolderAccess) -> Result<PathBuf, FolderAccessError> {
    Ok(path)
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_lock_that_is_let_go_soon_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let open = || File::options().create(true).append(true).open(&path).unwrap();
        let (dying, next) = (open(), open());
        dying.try_lock().unwrap();
        let thread = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            drop(dying);
        });
        lock(&next).unwrap();
        thread.join().unwrap();
    }

    #[test]
    fn a_folder_that_others_may_use_is_refused_with_the_command_that_helps() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("a/b");
        let made = open(&path, FolderAccess::User).unwrap();
        let mode = |mode| std::fs::set_permissions(&made, PermissionsExt::from_mode(mode)).unwrap();
        assert_eq!(std::fs::metadata(&made).unwrap().permissions().mode() & 0o777, 0o700);
        for (set, user, group) in [
            (0o700, true, true),
            (0o750, false, true),
            (0o2770, false, true),
            (0o755, false, false),
            (0o777, false, false),
            (0o701, false, false),
        ] {
            mode(set);
            assert_eq!(open(&path, FolderAccess::User).is_ok(), user, "{set:o}");
            assert_eq!(open(&path, FolderAccess::Group).is_ok(), group, "{set:o}");
        }
        mode(0o755);
        let error = open(&path, FolderAccess::User).unwrap_err().to_string();
        assert!(
            error.contains("has mode 0755, expected no rights of group and others")
                && error.ends_with(&format!("chmod go-rwx '{}'", made.display())),
            "{error}"
        );
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_the_system_does_not_allow_is_named_with_what_helps() {
        // No user can make folders there, not even root.
        let error = open(Path::new("/sys/isopeel"), FolderAccess::Group).unwrap_err();
        assert!(matches!(&error, FolderAccessError::Denied { .. }), "{error:?}");
        assert!(error.to_string().contains("group 0 may write"), "{error}");
    }

    #[test]
    fn a_folder_of_another_user_is_refused() {
        // `/` belongs to root. If the test runs as root, it gives a temporary folder to another user instead.
        let parent = tempfile::tempdir().unwrap();
        let is_root = rustix::process::geteuid().is_root();
        let path = if is_root {
            std::os::unix::fs::chown(parent.path(), Some(65534), None).unwrap();
            parent.path()
        } else {
            Path::new("/")
        };
        let error = open(path, FolderAccess::User).unwrap_err();
        assert!(matches!(&error, FolderAccessError::Owner { .. }), "{error}");
        assert!(error.to_string().contains("sudo chown -R"), "{error}");
    }
}
