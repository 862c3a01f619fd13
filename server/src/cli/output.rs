//! Files that commands write, completely or not at all.

use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use tempfile::NamedTempFile;
use tokio_util::sync::CancellationToken;

use crate::export::{ExportError, MadeFile};

/// Bytes of a write.
const BUFFER_BYTES: usize = 1 << 20;

/// Prefix of names of files that are not complete.
const TEMPORARY: &str = ".isopeel-";

/// The same, of files that a batch writes to its folder.
pub(super) const BATCH_TEMPORARY: &str = ".isopeel-batch-";

/// The path that stands for stdout.
pub(super) const STDOUT: &str = "-";

/// A temporary file beside the output, renamed when it is complete and otherwise deleted; or stdout.
pub(super) struct Output {
    pub path: PathBuf,
    /// `None`: stdout.
    file: Option<NamedTempFile>,
    hasher: Option<Sha256>,
}

/// A file that was written.
pub(super) struct WrittenFile {
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256, if that was asked for.
    pub sha256: Option<[u8; 32]>,
}

/// Why a file is not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// It cannot be created or written.
    #[error("output {}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The surface does not fit the format.
    #[error(transparent)]
    Export(ExportError),
}

/// A temporary file in a folder, with the rights of any new file.
fn temporary_in(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Before the umask.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// Writes a small file of a batch, whole or not at all, in place of one that is there.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = temporary_in(path.parent().unwrap_or(Path::new(".")), BATCH_TEMPORARY)?;
    file.write_all(bytes)?;
    file.persist(path)?;
    Ok(())
}

impl Output {
    /// Creates the temporary file, so that a folder that cannot be written is found before the work.
    pub(super) fn create(path: &Path) -> Result<Self, OutputError> {
        if path == Path::new(STDOUT) {
            return Self::stdout();
        }
        Self::create_named(path, TEMPORARY)
    }

    /// As [`Output::create`], of a file in the folder of a batch.
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
            // The error would name the temporary file.
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

    /// The same, with a checksum of the written bytes.
    pub(super) fn with_checksum(self) -> Self {
        Self {
            hasher: Some(Sha256::new()),
            ..self
        }
    }

    /// Writes bytes and gives the file its name.
    pub(super) fn write_bytes(self, bytes: &[u8]) -> Result<(), OutputError> {
        let write = || match self.file {
            Some(mut file) => {
                file.write_all(bytes)?;
                file.persist(&self.path)?;
                Ok(())
            }
            None => io::stdout().write_all(bytes),
        };
        let path = self.path.clone();
        write().map_err(|source| OutputError::File { path, source })
    }

    /// Writes the file of a surface and gives it its name.
    pub(super) fn write(mut self, made: &MadeFile, token: &CancellationToken) -> Result<WrittenFile, OutputError> {
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
        let written = made.write(&mut buffered).and_then(|()| Ok(buffered.flush()?));
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

/// An output whose writes fail once the token is cancelled.
struct Interruptible<'a> {
    out: &'a mut dyn Write,
    token: &'a CancellationToken,
    hasher: Option<Sha256>,
    bytes: u64,
}

impl Write for Interruptible<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.token.is_cancelled() {
            // `Interrupted` would be retried.
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

    fn made() -> MadeFile {
        MadeFile::of_mesh(Mesh::default(), Format::Glb)
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
        assert!(Output::create(&path).unwrap().write(&made(), &stopped).is_err());
        assert_eq!(files(), 0);

        let output = Output::create(&path).unwrap().with_checksum();
        assert_eq!(files(), 1);
        let written = output.write(&made(), &CancellationToken::new()).unwrap();
        assert_eq!(files(), 1);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!(written.bytes, bytes.len() as u64);
        let expected: [u8; 32] = Sha256::digest(&bytes).into();
        assert_eq!(written.sha256, Some(expected));
    }
}
