//! The file that `isopeel extract` writes, completely or not at all.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use tokio_util::sync::CancellationToken;

use super::ExtractError;
use crate::export::{ExportError, FileRequest, MadeFile, MakeError};
use crate::extraction::{Extraction, ExtractionStatistics};
use crate::volumes::VolumeStep;

/// Bytes of a write.
const BUFFER_BYTES: usize = 1 << 20;

/// A temporary file beside the output, renamed when it is complete and otherwise deleted.
pub(super) struct Output {
    pub path: PathBuf,
    request: FileRequest,
    file: NamedTempFile,
}

impl Output {
    pub(super) fn create(path: &Path, request: FileRequest) -> Result<Self, ExtractError> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let mut builder = tempfile::Builder::new();
        builder.prefix(".isopeel-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As for any new file, before the umask.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let create = || {
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            let folder = folder.unwrap_or(Path::new("."));
            // The error would name the temporary file, which nobody has asked for.
            if !folder.exists() {
                let why = format!("there is no folder {}", folder.display());
                return Err(io::Error::new(io::ErrorKind::NotFound, why));
            }
            builder.tempfile_in(folder)
        };
        let file = create().map_err(|source| ExtractError::Output {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            request,
            file,
        })
    }

    /// Writes the file of a surface. Returns its statistics, with what the format could not keep.
    pub(super) fn write(
        mut self,
        extraction: Extraction,
        volume: &VolumeStep,
        device: &str,
        token: &CancellationToken,
    ) -> Result<ExtractionStatistics, ExtractError> {
        let made = MadeFile::new(extraction, volume, &self.request, device, &|| false)?;
        let file = Interruptible {
            file: self.file.as_file_mut(),
            token,
        };
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, file);
        let written = made.write(&mut out).and_then(|()| Ok(out.flush()?));
        drop(out);
        match written {
            Ok(()) => {}
            Err(ExportError::Io(source)) => {
                return Err(ExtractError::Output {
                    path: self.path,
                    source,
                });
            }
            Err(other) => return Err(MakeError::from(other).into()),
        }
        self.file.persist(&self.path).map_err(|error| ExtractError::Output {
            path: self.path,
            source: error.error,
        })?;
        Ok(made.statistics)
    }
}

/// A file whose writes fail once the token is cancelled.
struct Interruptible<'a> {
    file: &'a mut File,
    token: &'a CancellationToken,
}

impl Write for Interruptible<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.token.is_cancelled() {
            // `Interrupted` would be retried.
            return Err(io::Error::other("interrupted"));
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
