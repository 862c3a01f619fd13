//! Opens files that must be in a folder or below it. Links that lead out of the folder are not followed, not even if a file is replaced
//! by such a link while the server runs.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Set once, before a file is opened.
static FOLLOW_LINKS: AtomicBool = AtomicBool::new(false);

/// From now on links are followed wherever they lead.
pub fn follow_links() {
    FOLLOW_LINKS.store(true, Ordering::Relaxed);
}

fn links_are_followed() -> bool {
    FOLLOW_LINKS.load(Ordering::Relaxed)
}

/// Resolves the links in a folder's path. The empty path is the current folder.
fn real(folder: &Path) -> io::Result<PathBuf> {
    let folder = if folder == Path::new("") {
        Path::new(".")
    } else {
        folder
    };
    folder.canonicalize()
}

/// Whether a file is outside the folder after links are resolved. Also true if its path cannot be resolved.
pub(super) fn leaves(folder: &Path, file: &Path) -> bool {
    if links_are_followed() {
        return false;
    }
    match (real(folder), file.canonicalize()) {
        (Ok(folder), Ok(file)) => !file.starts_with(folder),
        _ => true,
    }
}

/// Whether an entry of a listed folder is a link out of the folder `root`.
pub(super) fn is_link_out(root: &Path, entry: &std::fs::DirEntry) -> bool {
    let is_link = entry.file_type().is_ok_and(|kind| kind.is_symlink());
    is_link && leaves(root, &entry.path())
}

/// Opens a file that must be in a folder or below it. Resolves the links of the path first, then opens the resolved path without
/// following links: a link that was put there in between is an error, unless the system has no `openat2`.
///
/// # Errors
/// `PermissionDenied` if the file is outside the folder; errors of the operating system.
pub(super) fn open(folder: &Path, file: &Path) -> io::Result<File> {
    if links_are_followed() {
        return File::open(file);
    }
    let (folder, file) = (real(folder)?, file.canonicalize()?);
    let Ok(relative) = file.strip_prefix(&folder) else {
        let why = "a link out of the folder, expected one that stays below it";
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, why));
    };
    open_without_links(&folder, relative, &file)
}

#[cfg(target_os = "linux")]
fn open_without_links(folder: &Path, relative: &Path, file: &Path) -> io::Result<File> {
    use rustix::fs::{CWD, Mode, OFlags, ResolveFlags, openat, openat2};
    use rustix::io::Errno;
    let folder = openat(
        CWD,
        folder,
        OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC,
        Mode::empty(),
    )?;
    // Do not block on a named pipe without a writer.
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    let beneath = ResolveFlags::BENEATH | ResolveFlags::NO_SYMLINKS | ResolveFlags::NO_MAGICLINKS;
    match openat2(&folder, relative, flags, Mode::empty(), beneath) {
        Ok(opened) => Ok(opened.into()),
        // Kernels before 5.6, and containers that forbid the call: only the check above protects.
        Err(Errno::NOSYS | Errno::PERM) => File::open(file),
        Err(error) => Err(error.into()),
    }
}

#[cfg(not(target_os = "linux"))]
fn open_without_links(_: &Path, _: &Path, file: &Path) -> io::Result<File> {
    File::open(file)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn a_link_that_takes_the_place_of_a_file_is_not_opened() {
        let (folder, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("sub")).unwrap();
        std::fs::write(path("sub/file"), b"").unwrap();
        std::fs::write(outside.path().join("secret"), b"").unwrap();
        symlink(path("sub/file"), path("inside")).unwrap();
        symlink(outside.path().join("secret"), path("out")).unwrap();
        symlink(outside.path(), path("far")).unwrap();
        for inside in ["sub/file", "inside", "sub/../sub/file"] {
            assert!(open(folder.path(), &path(inside)).is_ok(), "{inside}");
        }
        for out in ["out", "far/secret", "../secret"] {
            assert!(open(folder.path(), &path(out)).is_err(), "{out}");
        }
        // A race between check and open: the path has no link when it is checked, and has one when it is opened.
        let real = folder.path().canonicalize().unwrap();
        assert!(open_without_links(&real, Path::new("sub/file"), &path("sub/file")).is_ok());
        std::fs::rename(path("sub"), path("moved")).unwrap();
        std::fs::write(outside.path().join("file"), b"").unwrap();
        symlink(outside.path(), path("sub")).unwrap();
        let swapped = open_without_links(&real, Path::new("sub/file"), &path("sub/file"));
        #[cfg(target_os = "linux")]
        assert!(swapped.is_err());
        let _ = swapped;
    }
}
