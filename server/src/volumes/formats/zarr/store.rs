//! Files below a Zarr folder.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use crate::volumes::ReadError;

/// Maximum bytes of a file of metadata. Those of a group may have those of all arrays in them.
const MAX_METADATA_BYTES: u64 = 16 << 20;
/// Maximum folders of a group that are looked at.
const MAX_FOLDERS: usize = 4096;

/// A Zarr folder. What lies below it is named by relative paths.
#[derive(Debug)]
pub(super) struct Store {
    /// As it was named.
    shown: PathBuf,
    /// Without links.
    root: PathBuf,
}

/// Path of `name` in a group.
pub(super) fn join(group: &str, name: &str) -> String {
    match group {
        "" => name.to_owned(),
        group => format!("{group}/{name}"),
    }
}

impl Store {
    pub(super) fn open(folder: &Path) -> Result<Self, ReadError> {
        let root = folder
            .canonicalize()
            .map_err(|e| ReadError::io(folder, "folder", "cannot be opened", e))?;
        Ok(Self {
            shown: folder.to_owned(),
            root,
        })
    }

    pub(super) fn shown(&self) -> &Path {
        &self.shown
    }

    /// For messages.
    pub(super) fn path(&self, relative: &str) -> PathBuf {
        if relative.is_empty() {
            self.shown.clone()
        } else {
            self.shown.join(relative)
        }
    }

    /// An error in a node.
    pub(super) fn error(&self, relative: &str, why: impl Into<String>) -> ReadError {
        ReadError::new(&self.path(relative), "zarr", why)
    }

    /// Opens a file; `None` where there is none.
    pub(super) fn file(&self, relative: &str) -> Result<Option<File>, ReadError> {
        let named = Path::new(relative);
        let fail = |why: &str| Err(ReadError::new(&self.path(relative), "file", why));
        if !named.components().all(|c| matches!(c, Component::Normal(_))) || relative.contains('\0') {
            return fail("not below the folder, expected a plain relative path");
        }
        let io_fail = |e: io::Error| ReadError::io(&self.path(relative), "file", "cannot be opened", e);
        let path = self.root.join(named);
        // Of most chunks that are not stored nothing more than this is asked.
        match path.symlink_metadata() {
            Ok(_) => {}
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(None),
            Err(e) => return Err(io_fail(e)),
        }
        let whole = path.canonicalize().map_err(io_fail)?;
        if !whole.starts_with(&self.root) {
            return fail("a link out of the folder, expected one that stays below it");
        }
        // Asked before opening: to open a named pipe would wait for its writer.
        if !whole.metadata().map_err(io_fail)?.is_file() {
            return fail("not a regular file, expected one");
        }
        File::open(&whole).map(Some).map_err(io_fail)
    }

    /// A file of metadata; `None` where there is none.
    pub(super) fn json<T: serde::de::DeserializeOwned>(&self, relative: &str) -> Result<Option<T>, ReadError> {
        let Some(file) = self.file(relative)? else {
            return Ok(None);
        };
        let mut text = Vec::new();
        file.take(MAX_METADATA_BYTES + 1)
            .read_to_end(&mut text)
            .map_err(|e| ReadError::io(&self.path(relative), "file", "cannot be read", e))?;
        if text.len() as u64 > MAX_METADATA_BYTES {
            return Err(self.error(
                relative,
                format!("more than {MAX_METADATA_BYTES} bytes, expected metadata"),
            ));
        }
        let value = serde_json::from_slice(&text);
        value.map(Some).map_err(|e| self.error(relative, e.to_string()))
    }

    /// Names of the folders in a group, sorted.
    pub(super) fn folders(&self, relative: &str) -> Result<Vec<String>, ReadError> {
        let fail = |e: io::Error| ReadError::io(&self.path(relative), "folder", "cannot be listed", e);
        let mut names = Vec::new();
        for entry in std::fs::read_dir(self.root.join(relative))
            .map_err(fail)?
            .take(MAX_FOLDERS)
        {
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
