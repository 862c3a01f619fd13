//! A volume from stdin.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::signal::unix::{SignalKind, signal};

use isopeel_volumes::ReadError;

/// The path that stands for stdin.
const STDIN: &str = "-";

/// A path that was named; stdin is kept in a file as long as this is.
pub(super) struct InputPath {
    path: PathBuf,
    folder: Option<TempDir>,
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
                folder: None,
            });
        }
        Self::spool().map_err(|error| ReadError::io(path, "stdin", "cannot be read", error))
    }

    /// Copies stdin to a file, which goes with its folder at Ctrl-C too. It becomes stdin in turn, for a process that takes the place of
    /// this one.
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
        // Its thread may wait for stdin for ever.
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

    /// Returns an error with `stdin` in place of the name of its file.
    pub(super) fn named(&self, error: ReadError) -> ReadError {
        match &self.folder {
            Some(folder) if error.path.starts_with(folder.path()) => error.in_folder(folder.path()),
            _ => error,
        }
    }
}
