//! Input paths on the command line, where `-` means stdin.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::signal::unix::{SignalKind, signal};

use isopeel_volumes::ReadError;

/// The path that means stdin.
const STDIN: &str = "-";

/// The path of an input. For stdin, this is a temporary file with a copy of stdin. Dropping this value removes the temporary file.
pub(super) struct InputPath {
    path: PathBuf,
    /// Folder of the temporary file, if the input is stdin.
    folder: Option<TempDir>,
}

impl InputPath {
    /// Returns the input of a path. For `-`, copies stdin to a temporary file first. This file has no extension, so readers detect its
    /// format by its first bytes.
    ///
    /// # Errors
    /// Stdin cannot be read, or the folder for temporary files has no space.
    pub(super) fn new(path: &Path) -> Result<Self, ReadError> {
        if path != Path::new(STDIN) {
            return Ok(Self {
                path: path.to_owned(),
                folder: None,
            });
        }
        Self::spool().map_err(|error| ReadError::io(path, "stdin", "cannot be read", error))
    }

    /// Copies stdin to a temporary file. SIGINT and SIGTERM end the copy with an error, so that the temporary file is removed.
    ///
    /// Then makes the temporary file the new stdin. So a process that replaces this one can read the input again.
    fn spool() -> io::Result<Self> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("stdin");
        let mut file = File::create(&path)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let copied = runtime.block_on(async {
            let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
            let copy = tokio::task::spawn_blocking(move || io::copy(&mut io::stdin().lock(), &mut file));
            tokio::select! {
                copied = copy => copied?,
                _ = interrupt.recv() => Err(io::Error::other("interrupted")),
                _ = terminate.recv() => Err(io::Error::other("interrupted")),
            }
        });
        // Does not wait for the thread, which may still be blocked on stdin after an interruption.
        runtime.shutdown_background();
        copied?;
        rustix::stdio::dup2_stdin(File::open(&path)?)?;
        Ok(Self {
            path,
            folder: Some(folder),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the path of the temporary file in an error by `stdin`.
    pub(super) fn name_in(&self, error: ReadError) -> ReadError {
        match &self.folder {
            Some(folder) if error.path.starts_with(folder.path()) => error.in_folder(folder.path()),
            _ => error,
        }
    }
}
