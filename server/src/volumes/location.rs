//! Files on disk or in memory.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::{ReadError, ReadProgress};

/// Files of a folder in memory, by name.
pub type MemoryFolder = BTreeMap<String, Cow<'static, [u8]>>;

/// Where a file is. Cheap to clone. Holds no file descriptor, so that a catalog may have thousands of files.
#[derive(Clone)]
pub struct FileLocation {
    path: PathBuf,
    memory: Option<Arc<MemoryFolder>>,
}

impl FileLocation {
    /// A file on disk.
    pub fn disk(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            memory: None,
        }
    }

    /// The file `name` of a folder in memory.
    pub fn memory(folder: Arc<MemoryFolder>, name: impl Into<String>) -> Self {
        Self {
            path: PathBuf::from(name.into()),
            memory: Some(folder),
        }
    }

    /// A single file in memory.
    pub fn bytes(name: impl Into<String>, bytes: impl Into<Cow<'static, [u8]>>) -> Self {
        let name = name.into();
        Self::memory(Arc::new(MemoryFolder::from([(name.clone(), bytes.into())])), name)
    }

    /// Path, or name in memory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// File name without its extension; `.nii.gz` counts as one extension.
    pub fn stem(&self) -> String {
        stem(&self.path)
    }

    /// A file that a header names, in the header's folder or below it.
    ///
    /// # Errors
    /// An absolute name, one with `..`, or no file of that name; `field` is the header's field that holds it.
    pub fn sibling(&self, name: &str, field: &str) -> Result<Self, ReadError> {
        let relative = Path::new(name);
        let inside = !name.is_empty()
            && !name.contains('\0')
            && relative
                .components()
                .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        if !inside {
            return Err(ReadError::new(
                &self.path,
                field,
                format!("{name:?}, expected a file in the header's own folder (no absolute path, no `..`)"),
            ));
        }
        let sibling = match &self.memory {
            Some(folder) => Self::memory(folder.clone(), name),
            None => Self::disk(self.path.parent().unwrap_or(Path::new("")).join(relative)),
        };
        match sibling.open() {
            Ok(_) => Ok(sibling),
            Err(e) => Err(ReadError {
                source: e.source,
                ..ReadError::new(&self.path, field, format!("{name:?}: {}", e.why))
            }),
        }
    }

    /// Opens the file for reading.
    ///
    /// # Errors
    /// It is missing, may not be read, or is not a regular file (a folder, a pipe, a device).
    pub fn open(&self) -> Result<Blob<'_>, ReadError> {
        if let Some(folder) = &self.memory {
            let name = self.path.to_string_lossy();
            let bytes = folder
                .get(name.as_ref())
                .ok_or_else(|| ReadError::new(&self.path, "file", "not found, expected a file"))?;
            return Ok(Blob {
                path: &self.path,
                len: bytes.len() as u64,
                content: Content::Memory(bytes),
                progress: None,
            });
        }
        let fail = |e: io::Error| {
            let why = match e.kind() {
                io::ErrorKind::NotFound => "not found, expected a file",
                io::ErrorKind::PermissionDenied => "may not be read",
                _ => "cannot be opened",
            };
            ReadError::io(&self.path, "file", why, e)
        };
        // Asked before opening: to open a named pipe would wait for its writer.
        let metadata = std::fs::metadata(&self.path).map_err(fail)?;
        if !metadata.is_file() {
            let what = if metadata.is_dir() {
                "a folder"
            } else {
                "not a regular file"
            };
            return Err(ReadError::new(&self.path, "file", format!("{what}, expected a file")));
        }
        let file = File::open(&self.path).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        Ok(Blob {
            path: &self.path,
            len,
            content: Content::Disk(file),
            progress: None,
        })
    }
}

impl std::fmt::Debug for FileLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kind = if self.memory.is_some() { "memory" } else { "disk" };
        write!(f, "{kind}:{:?}", self.path)
    }
}

/// File name without its extension; `.nii.gz` counts as one extension.
pub fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let cut = if name.to_ascii_lowercase().ends_with(".nii.gz") {
        name.len() - ".nii.gz".len()
    } else {
        name.rfind('.').unwrap_or(name.len())
    };
    match &name[..cut] {
        "" => name.into_owned(),
        stem => stem.to_owned(),
    }
}

enum Content<'a> {
    Disk(File),
    Memory(&'a [u8]),
}

/// An open file of known length, read at any offset from any thread.
pub struct Blob<'a> {
    path: &'a Path,
    len: u64,
    content: Content<'a>,
    progress: Option<&'a ReadProgress>,
}

impl<'a> Blob<'a> {
    /// Counts what is read from here on.
    #[must_use]
    pub fn counted(mut self, progress: &'a ReadProgress) -> Self {
        self.progress = Some(progress);
        self
    }

    fn count(&self, bytes: usize) {
        if let Some(progress) = self.progress {
            progress.add(bytes as u64);
        }
    }

    /// Path, for messages.
    pub fn path(&self) -> &Path {
        self.path
    }

    /// Bytes in the file.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether the file has no byte.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Fills `buffer` from `offset` on.
    ///
    /// # Errors
    /// The operating system's; `UnexpectedEof` where the file ends first.
    pub fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        match &self.content {
            Content::Disk(file) => file.read_exact_at(buffer, offset)?,
            Content::Memory(bytes) => {
                let from = usize::try_from(offset)
                    .ok()
                    .and_then(|o| bytes.get(o..)?.get(..buffer.len()));
                buffer.copy_from_slice(from.ok_or(io::ErrorKind::UnexpectedEof)?);
            }
        }
        self.count(buffer.len());
        Ok(())
    }

    /// The first bytes of the file, at most `limit`.
    ///
    /// # Errors
    /// The operating system's.
    pub fn head(&self, limit: usize) -> Result<Vec<u8>, ReadError> {
        let mut bytes = vec![0; limit.min(usize::try_from(self.len).unwrap_or(limit))];
        self.read_exact_at(&mut bytes, 0)
            .map_err(|e| ReadError::io(self.path, "file", "cannot be read", e))?;
        Ok(bytes)
    }

    /// A stream from `offset` to the end of the file.
    pub fn reader(&self, offset: u64) -> impl Read + '_ {
        BlobReader { blob: self, offset }
    }
}

struct BlobReader<'a> {
    blob: &'a Blob<'a>,
    offset: u64,
}

impl Read for BlobReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = match &self.blob.content {
            Content::Disk(file) => file.read_at(buffer, self.offset)?,
            Content::Memory(bytes) => {
                let mut rest = usize::try_from(self.offset)
                    .ok()
                    .and_then(|o| bytes.get(o..))
                    .unwrap_or(&[]);
                rest.read(buffer)?
            }
        };
        self.offset += n as u64;
        self.blob.count(n);
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stems() {
        for (name, expected) in [
            ("a/ct.nrrd", "ct"),
            ("a/t1.nii.gz", "t1"),
            ("a/T1.NII.GZ", "T1"),
            ("a.b/head.v2.mha", "head.v2"),
            ("noext", "noext"),
            (".nrrd", ".nrrd"),
        ] {
            assert_eq!(stem(Path::new(name)), expected, "{name}");
        }
    }

    #[test]
    fn detached_data_stays_in_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("sub")).unwrap();
        for file in ["head.raw", "sub/head.raw"] {
            std::fs::write(path(file), b"").unwrap();
        }
        let header = FileLocation::disk(path("head.mhd"));
        assert_eq!(header.sibling("head.raw", "f").unwrap().path(), path("head.raw"));
        assert_eq!(
            header.sibling("./sub/head.raw", "f").unwrap().path(),
            path("./sub/head.raw")
        );
        for bad in [
            "",
            "/etc/passwd",
            "../head.raw",
            "sub/../../head.raw",
            "a\0b",
            "none.raw",
            "sub",
        ] {
            let error = header.sibling(bad, "ElementDataFile").unwrap_err();
            assert_eq!(error.field, "ElementDataFile", "{bad:?}");
        }
    }

    #[test]
    fn what_is_no_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = FileLocation::disk(folder.path()).open().err().unwrap();
        assert!(error.to_string().contains("a folder, expected a file"), "{error}");
        let error = FileLocation::disk("/dev/zero").open().err().unwrap();
        assert!(error.to_string().contains("not a regular file"), "{error}");
        let error = FileLocation::disk(folder.path().join("none.nrrd"))
            .open()
            .err()
            .unwrap();
        assert!(error.to_string().contains("none.nrrd: file: not found"), "{error}");
    }
}
