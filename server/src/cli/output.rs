//! Output files of commands. A file appears under its name only when it is complete.

use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use tempfile::NamedTempFile;
use tokio_util::sync::CancellationToken;

use crate::export::{ExportError, FileContent};

/// Bytes of the write buffer.
const BUFFER_BYTES: usize = 1 << 20;

/// Prefix of the names of temporary files.
const TEMPORARY: &str = ".isopeel-";

/// Prefix of the names of temporary files in the folder of a batch, so that a later batch can recognise and remove them.
pub(super) const BATCH_TEMPORARY: &str = ".isopeel-batch-";

/// The path that stands for stdout.
pub(super) const STDOUT: &str = "-";

/// An output: stdout, or a temporary file in the folder of the output. The temporary file is renamed when it is complete, and removed
/// otherwise.
pub(super) struct Output {
    pub path: PathBuf,
    /// The temporary file; `None` for stdout.
    file: Option<NamedTempFile>,
    hasher: Option<Sha256>,
}

/// A file that was written.
pub(super) struct WrittenFile {
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes, if it was requested.
    pub sha256: Option<[u8; 32]>,
}

/// Why an output was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The file cannot be created or written.
    #[error("output {}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The surface does not fit the format.
    #[error(transparent)]
    Export(ExportError),
}

/// Creates a temporary file in a folder, with the permissions of any new file.
fn temporary_in(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The system applies the umask to this mode.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// Writes a small file of a batch atomically. Replaces an existing file.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = temporary_in(path.parent().unwrap_or(Path::new(".")), BATCH_TEMPORARY)?;
    file.write_all(bytes)?;
    file.persist(path)?;
    Ok(())
}

impl Output {
    /// Creates the temporary file. Call this before any long work, so that a folder that is not writable is reported at once.
    pub(super) fn create(path: &Path) -> Result<Self, OutputError> {
        if path == Path::new(STDOUT) {
            return Self::stdout();
        }
        Self::create_named(path, TEMPORARY)
    }

    /// Creates the temporary file of an output in the folder of a batch.
    pub(super) fn create_of_batch(path: &Path) -> Result<Self, OutputError> {
        Self::create_named(path, BATCH_TEMPORARY)
    }

    fn create_named(path: &Path, prefix: &str) -> Result<Self, OutputError> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let create = || {
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            let folder = folder.unwrap_or(Path::new("."));
            // Checked here, because the error of a missing folder would name the temporary file.
            if !folder.exists() {
                let why = format!("there is no folder {}", folder.display());
                return Err(io::Error::new(io::ErrorKind::NotFound, why));
            }
            temporary_in(folder, prefix)
        };
        let file = create().map_err(|source| OutputError::File {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            file: Some(file),
            hasher: None,
        })
    }

    fn stdout() -> Result<Self, OutputError> {
        let path = PathBuf::from(STDOUT);
        if io::stdout().is_terminal() {
            let source = io::Error::other("stdout is a terminal, expected a pipe or a file");
            return Err(OutputError::File { path, source });
        }
        Ok(Self {
            path,
            file: None,
            hasher: None,
        })
    }

    /// Also computes a checksum of the written bytes.
    pub(super) fn with_checksum(self) -> Self {
        Self {
            hasher: Some(Sha256::new()),
            ..self
        }
    }

    /// Writes bytes, and renames the file.
    pub(super) fn write_bytes(self, bytes: &[u8]) -> Result<(), OutputError> {
        let write = || match self.file {
            Some(mut file) => {
                file.write_all(bytes)?;
                file.persist(&self.path)?;
                Ok(())
            }
            None => {
                let mut stdout = io::stdout();
                stdout.write_all(bytes)?;
                // At its end the process would ignore an error of the bytes that are still buffered.
                stdout.flush()
            }
        };
        let path = self.path.clone();
        write().map_err(|source| OutputError::File { path, source })
    }

    /// Writes `content` to stdout or to the temporary file, and renames the temporary file to its final name. Fails if `token` is
    /// cancelled.
    pub(super) fn write(
        mut self,
        content: &FileContent,
        token: &CancellationToken,
    ) -> Result<WrittenFile, OutputError> {
        let mut stdout = io::stdout();
        let out: &mut dyn Write = match &mut self.file {
            Some(file) => file.as_file_mut(),
            None => &mut stdout,
        };
        let mut out = Interruptible {
            out,
            token,
            hasher: self.hasher,
            bytes: 0,
        };
        let mut buffered = BufWriter::with_capacity(BUFFER_BYTES, &mut out);
        let written = content.write(&mut buffered).and_then(|()| Ok(buffered.flush()?));
        drop(buffered);
        let (bytes, hasher) = (out.bytes, out.hasher);
        let fail = |path, source| OutputError::File { path, source };
        match written {
            Ok(()) => {}
            Err(ExportError::Io(source)) => return Err(fail(self.path, source)),
            Err(other) => return Err(OutputError::Export(other)),
        }
        if let Some(file) = self.file
            && let Err(error) = file.persist(&self.path)
        {
            return Err(fail(self.path, error.error));
        }
        Ok(WrittenFile {
            bytes,
            sha256: hasher.map(|hasher| hasher.finalize().into()),
        })
    }
}

/// Writer that fails after the token was cancelled. Counts and hashes the bytes.
struct Interruptible<'a> {
    out: &'a mut dyn Write,
    token: &'a CancellationToken,
    hasher: Option<Sha256>,
    bytes: u64,
}

impl Write for Interruptible<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.token.is_cancelled() {
            // Not `ErrorKind::Interrupted`, because `write_all` would retry.
            return Err(io::Error::other("interrupted"));
        }
        let written = self.out.write(bytes)?;
        if let Some(hasher) = &mut self.hasher {
            hasher.update(&bytes[..written]);
        }
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::{Format, Mesh};

    fn content() -> FileContent {
        FileContent::of_mesh(Mesh::default(), Format::Glb)
    }

    #[test]
    fn an_output_that_cannot_be_written_fails_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| match Output::create(path) {
            Err(OutputError::File { source, .. }) => source.to_string(),
            _ => panic!("{} is no place for a file", path.display()),
        };
        refused(folder.path());
        let missing = folder.path().join("no/such");
        assert_eq!(
            refused(&missing.join("a.glb")),
            format!("there is no folder {}", missing.display())
        );
    }

    #[test]
    fn the_output_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let files = || std::fs::read_dir(folder.path()).unwrap().count();

        let stopped = CancellationToken::new();
        stopped.cancel();
        assert!(Output::create(&path).unwrap().write(&content(), &stopped).is_err());
        assert_eq!(files(), 0);

        let output = Output::create(&path).unwrap().with_checksum();
        assert_eq!(files(), 1);
        let written = output.write(&content(), &CancellationToken::new()).unwrap();
        assert_eq!(files(), 1);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!(written.bytes, bytes.len() as u64);
        let expected: [u8; 32] = Sha256::digest(&bytes).into();
        assert_eq!(written.sha256, Some(expected));
    }
}
