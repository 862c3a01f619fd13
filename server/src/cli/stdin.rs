//! A volume from stdin.

use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::volumes::ReadError;

/// The path that stands for stdin.
const STDIN: &str = "-";

/// A path that was named; stdin is kept in a file as long as this is.
pub(super) struct InputPath {
    path: PathBuf,
    _folder: Option<TempDir>,
}

impl InputPath {
    /// The path itself, or that of a file with all of stdin. What the file is, its first bytes say.
    ///
    /// # Errors
    /// Stdin cannot be read, or the folder for temporary files cannot hold it.
    pub(super) fn new(path: &Path) -> Result<Self, ReadError> {
        if path != Path::new(STDIN) {
            return Ok(Self {
                path: path.to_owned(),
                _folder: None,
            });
        }
        let spool = || {
            let folder = tempfile::tempdir()?;
            let path = folder.path().join("stdin");
            io::copy(&mut io::stdin().lock(), &mut std::fs::File::create(&path)?)?;
            Ok(Self {
                path,
                _folder: Some(folder),
            })
        };
        spool().map_err(|error| ReadError::io(path, "stdin", "cannot be read", error))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}
