//! Files below a folder.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Component, Path, PathBuf};

use super::MAX_FOLDERS;
use crate::ReadError;
use crate::beneath::{self, leaves};
use crate::remote::{Object, Part};

/// A folder. Paths are relative to it; each comes with the path for messages.
#[derive(Debug)]
pub(super) struct Folder {
    /// Path without links.
    root: PathBuf,
}

impl Folder {
    pub(super) fn open(folder: &Path) -> Result<Self, ReadError> {
        let root = folder
            .canonicalize()
            .map_err(|e| ReadError::io(folder, "folder", "cannot be opened", e))?;
        Ok(Self { root })
    }

    /// Opens a file; `None` if it does not exist.
    fn file(&self, shown: &Path, relative: &str) -> Result<Option<File>, ReadError> {
        let named = Path::new(relative);
        let fail = |why: &str| Err(ReadError::new(shown, "file", why));
        if !named.components().all(|c| matches!(c, Component::Normal(_))) || relative.contains('\0') {
            return fail("not below the folder, expected a plain relative path");
        }
        let io_fail = |e: io::Error| ReadError::io(shown, "file", "cannot be opened", e);
        let path = self.root.join(named);
        // For most chunks that are not stored, this is the only system call.
        match path.symlink_metadata() {
            Ok(_) => {}
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(None),
            Err(e) => return Err(io_fail(e)),
        }
        let whole = path.canonicalize().map_err(io_fail)?;
        if leaves(&self.root, &whole) {
            return fail("a link out of the folder, expected one that stays below it");
        }
        // Checked before opening: opening a named pipe would block until it has a writer.
        if !whole.metadata().map_err(io_fail)?.is_file() {
            return fail("not a regular file, expected one");
        }
        beneath::open(&self.root, &whole).map(Some).map_err(io_fail)
    }

    pub(super) fn size(&self, shown: &Path, relative: &str) -> Result<Option<u64>, ReadError> {
        let file = self.file(shown, relative)?;
        Ok(file.and_then(|file| file.metadata().ok()).map(|m| m.len()))
    }

    pub(super) fn read(
        &self,
        shown: &Path,
        relative: &str,
        part: Part,
        limit: u64,
    ) -> Result<Option<Object>, ReadError> {
        let Some(file) = self.file(shown, relative)? else {
            return Ok(None);
        };
        let io_fail = |e: io::Error| ReadError::io(shown, "file", "cannot be read", e);
        let fail = |why: String| ReadError::new(shown, "file", why);
        let size = file.metadata().map_err(io_fail)?.len();
        let [from, to] = match part {
            Part::Whole => [0, size],
            Part::At(range) => [range.start, range.end],
            Part::End(bytes) => [size.saturating_sub(bytes), size],
        };
        if to > size {
            return Err(fail(format!("{size} bytes, expected {to} at least")));
        }
        let length = to.saturating_sub(from);
        if length > limit {
            return Err(fail(format!("{length} bytes, expected {limit} at most")));
        }
        let mut bytes = Vec::new();
        if from == 0 && to == size {
            // If the file grows meanwhile, the excess is cut off.
            file.take(limit).read_to_end(&mut bytes).map_err(io_fail)?;
        } else {
            bytes = vec![0; length as usize];
            file.read_exact_at(&mut bytes, from).map_err(io_fail)?;
        }
        Ok(Some(Object { bytes, size }))
    }

    pub(super) fn folders(&self, shown: &Path, relative: &str) -> Result<Vec<String>, ReadError> {
        let fail = |e: io::Error| ReadError::io(shown, "folder", "cannot be listed", e);
        let mut names = Vec::new();
        let entries = std::fs::read_dir(self.root.join(relative)).map_err(fail)?;
        for entry in entries.take(MAX_FOLDERS) {
            let entry = entry.map_err(fail)?;
            if let Ok(name) = entry.file_name().into_string()
                && entry.path().is_dir()
            {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }
}
