//! Files on disk or in memory, and stores over a network.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::beneath::{self, leaves};
use super::codec::{Encoding, decoder};
use super::remote::Address;
use super::unpacked::{ReadAt, Unpacked, packing};
use super::{ReadError, ReadProgress};

/// Bytes at the beginning of a file that its format is detected by.
const HEAD_BYTES: usize = 8192;

/// Files of a folder in memory, by name.
pub type MemoryFolder = BTreeMap<String, Cow<'static, [u8]>>;

/// Location of a file. Cheap to clone. Holds no file descriptor, so that a catalog may have thousands of files.
#[derive(Clone)]
pub struct FileLocation {
    path: PathBuf,
    part: Option<String>,
    memory: Option<Arc<MemoryFolder>>,
    /// For a store over a network: its address.
    address: Option<Arc<Address>>,
    /// Encoding of a file that is compressed as a whole.
    packing: Option<Encoding>,
    /// The folder that must hold the file, directly or below it.
    beneath: Option<Arc<Path>>,
}

/// Stamp of a file by its metadata: another one after the file was written or replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileStamp {
    /// Device and inode number.
    file: [u64; 2],
    bytes: u64,
    /// Seconds and nanoseconds of the last write and of the last change.
    times: [i64; 4],
}

impl FileLocation {
    /// Returns the file's stamp; `None` for files in memory, stores over a network, and missing files.
    pub fn stamp(&self) -> Option<FileStamp> {
        use std::os::unix::fs::MetadataExt;
        if self.memory.is_some() || self.address.is_some() {
            return None;
        }
        let found = std::fs::metadata(&self.path).ok()?;
        Some(FileStamp {
            file: [found.dev(), found.ino()],
            bytes: found.len(),
            times: [found.mtime(), found.mtime_nsec(), found.ctime(), found.ctime_nsec()],
        })
    }

    /// A file on disk.
    pub fn disk(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            part: None,
            memory: None,
            address: None,
            packing: None,
            beneath: None,
        }
    }

    /// Returns the same location, which must be in this folder or below it when it is opened: links out of it are not followed.
    #[must_use]
    pub fn beneath(mut self, folder: &Path) -> Self {
        self.beneath = Some(folder.into());
        self
    }

    /// Location of the file `name` of a folder in memory.
    pub fn memory(folder: Arc<MemoryFolder>, name: impl Into<String>) -> Self {
        Self {
            path: PathBuf::from(name.into()),
            part: None,
            memory: Some(folder),
            address: None,
            packing: None,
            beneath: None,
        }
    }

    /// Location of a single file in memory.
    pub fn bytes(name: impl Into<String>, bytes: impl Into<Cow<'static, [u8]>>) -> Self {
        let name = name.into();
        Self::memory(Arc::new(MemoryFolder::from([(name.clone(), bytes.into())])), name)
    }

    /// Parses an argument of the command line: a file or folder that exists, the address of a store over a network, or one of the volumes
    /// in these, as `file.h5:/path`.
    pub fn named(argument: &Path) -> Self {
        let text = argument.to_string_lossy();
        if let Some((address, part)) = Address::named(&text) {
            let shown = Self::disk(address.shown());
            return Self {
                part,
                address: Some(Arc::new(address)),
                ..shown
            };
        }
        // The last colon separates the part: the name may have a colon, too.
        let split = (!argument.exists())
            .then(|| {
                text.rmatch_indices(':')
                    .find(|(at, _)| Path::new(&text[..*at]).exists())
            })
            .flatten();
        match split {
            Some((at, _)) => Self {
                part: Some(text[at + 1..].to_owned()),
                ..Self::disk(&text[..at])
            },
            None => Self::disk(argument),
        }
    }

    /// Returns which of the volumes in the file is meant, if one was named.
    pub fn part(&self) -> Option<&str> {
        self.part.as_deref()
    }

    /// Returns this file with the part that another location names.
    #[must_use]
    pub fn with_part_of(mut self, other: &Self) -> Self {
        self.part.clone_from(&other.part);
        self
    }

    /// Returns the address of a store over a network. The path is the form of the address that is shown.
    pub fn address(&self) -> Option<&Address> {
        self.address.as_deref()
    }

    /// Returns the location of the file that is inside this compressed file.
    #[must_use]
    pub fn packed(mut self, encoding: Encoding) -> Self {
        self.packing = Some(encoding);
        self
    }

    /// Returns the same file, with the compression that its name states.
    #[must_use]
    pub fn packed_by_name(&self) -> Self {
        let packing = packing(&self.path.to_string_lossy()).map(|(encoding, _)| encoding);
        Self {
            packing,
            ..self.clone()
        }
    }

    /// Returns the file name in lower case, without the ending of a compression.
    pub fn stored_name(&self) -> String {
        let whole = self
            .path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase();
        packing(&whole).map_or(whole.clone(), |(_, name)| name.to_owned())
    }

    /// Whether the first bytes of the file, decompressed, are of a format.
    pub fn begins_as(&self, is_content: fn(&[u8]) -> bool) -> bool {
        self.open()
            .and_then(|blob| blob.head(HEAD_BYTES))
            .is_ok_and(|head| is_content(&head))
    }

    /// Returns the same file without decompression.
    #[must_use]
    pub fn unpacked(&self) -> Self {
        Self {
            packing: None,
            ..self.clone()
        }
    }

    /// Returns the encoding of a file that is compressed as a whole.
    pub fn packing(&self) -> Option<Encoding> {
        self.packing
    }

    /// Returns the path, or the name in memory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file is in memory, not on disk.
    pub fn is_in_memory(&self) -> bool {
        self.memory.is_some()
    }

    /// Returns the file name without its extension. The ending of a compression is a part of the extension, as in `.nii.gz`.
    pub fn stem(&self) -> String {
        stem(&self.path)
    }

    /// Returns the location of a file that a header names. It must be in the header's folder or below it.
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
        let here = self.path.parent().unwrap_or(Path::new(""));
        let sibling = match &self.memory {
            Some(folder) => Self::memory(folder.clone(), name),
            None => Self::disk(here.join(relative)).beneath(here),
        };
        match sibling.open() {
            Err(_) if !sibling.is_in_memory() && sibling.path.is_file() && leaves(here, &sibling.path) => {
                let why = format!("{name:?}: a link out of the header's own folder, expected a file in it");
                Err(ReadError::new(&self.path, field, why))
            }
            Ok(_) => Ok(sibling),
            Err(e) => Err(ReadError {
                source: e.source,
                ..ReadError::new(&self.path, field, format!("{name:?}: {}", e.why))
            }),
        }
    }

    /// Opens the file for reading. A compressed file is decompressed.
    ///
    /// # Errors
    /// It is missing, may not be read, or is not a regular file (a folder, a pipe, a device).
    pub fn open(&self) -> Result<Blob<'_>, ReadError> {
        let stored = self.open_stored()?;
        let Some(encoding) = self.packing else {
            return Ok(stored);
        };
        let len = stored.len;
        let read_at: ReadAt = match (stored.content, &self.memory) {
            (Content::Disk(file), _) => Box::new(move |buffer, at| file.read_at(buffer, at)),
            (_, folder) => {
                let folder = folder.clone().unwrap_or_default();
                let name = self.path.to_string_lossy().into_owned();
                Box::new(move |buffer, at| read_from(folder.get(&name).map_or(&[], |bytes| bytes), buffer, at))
            }
        };
        let unpacked = Unpacked::new(read_at, len, encoding)
            .map_err(|e| ReadError::io(&self.path, "file", format!("cannot be decoded: {e}"), e))?;
        Ok(Blob {
            path: &self.path,
            len,
            content: Content::Unpacked(Box::new(unpacked)),
            progress: None,
        })
    }

    /// Decodes a compressed file and returns the number of its decoded bytes, counted up to one above `limit`, as far as they can be
    /// decoded; 0 if the file is not compressed as a whole. Keeps no decoded bytes.
    ///
    /// # Errors
    /// As [`FileLocation::open`].
    pub fn unpacked_bytes(&self, limit: u64) -> Result<u64, ReadError> {
        let Some(encoding) = self.packing else { return Ok(0) };
        let stored = self.open_stored()?;
        let fail = |e: io::Error| ReadError::io(&self.path, "file", format!("cannot be decoded: {e}"), e);
        let decoded = decoder(encoding, stored.reader(0), stored.len).map_err(fail)?;
        let (mut decoded, mut piece, mut count) = (decoded.take(limit.saturating_add(1)), vec![0; 1 << 16], 0);
        // Bytes before an error in a broken file count.
        while let Ok(n @ 1..) = decoded.read(&mut piece) {
            count += n as u64;
        }
        Ok(count)
    }

    /// Opens the file for reading without decompression.
    ///
    /// # Errors
    /// As [`FileLocation::open`].
    pub fn open_stored(&self) -> Result<Blob<'_>, ReadError> {
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
                io::ErrorKind::PermissionDenied if e.get_ref().is_some() => "a link out of its folder, expected none",
                io::ErrorKind::PermissionDenied => "may not be read",
                _ => "cannot be opened",
            };
            ReadError::io(&self.path, "file", why, e)
        };
        // Checked before opening: opening a named pipe would block until it has a writer.
        let metadata = std::fs::metadata(&self.path).map_err(fail)?;
        if !metadata.is_file() {
            let what = if metadata.is_dir() {
                "a folder"
            } else {
                "not a regular file"
            };
            return Err(ReadError::new(&self.path, "file", format!("{what}, expected a file")));
        }
        let opened = match &self.beneath {
            Some(folder) => beneath::open(folder, &self.path),
            None => File::open(&self.path),
        };
        let file = opened.map_err(fail)?;
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

/// Returns the title of a dataset: a file's stem, or a folder's name.
pub(crate) fn title_of(path: &Path) -> String {
    if path.is_dir() {
        // `.` and `..` have no name until they are resolved.
        let folder = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        return folder
            .file_name()
            .map_or("volumes".into(), |n| n.to_string_lossy().into_owned());
    }
    stem(path)
}

/// Returns the file name without its extension. The ending of a compression is a part of the extension, as in `.nii.gz`.
pub fn stem(path: &Path) -> String {
    let whole = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let name = packing(&whole).map_or(whole.as_ref(), |(_, name)| name);
    match &name[..name.rfind('.').unwrap_or(name.len())] {
        "" => whole.into_owned(),
        stem => stem.to_owned(),
    }
}

enum Content<'a> {
    Disk(File),
    Memory(&'a [u8]),
    Unpacked(Box<Unpacked>),
}

fn read_from(bytes: &[u8], buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    let from = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..));
    from.unwrap_or(&[]).read(buffer)
}

/// An open file of known length, read at any offset from any thread.
pub struct Blob<'a> {
    path: &'a Path,
    len: u64,
    content: Content<'a>,
    progress: Option<&'a ReadProgress>,
}

impl<'a> Blob<'a> {
    /// Counts bytes that are read from now on.
    #[must_use]
    pub fn counted(mut self, progress: &'a ReadProgress) -> Self {
        self.progress = Some(progress);
        if let Content::Unpacked(unpacked) = &self.content {
            // Opening has read the first bytes of the compressed file.
            self.count(unpacked.stored_read() as usize);
        }
        self
    }

    fn count(&self, bytes: usize) {
        if let Some(progress) = self.progress {
            progress.add(bytes as u64);
        }
    }

    /// Returns the path, for messages.
    pub fn path(&self) -> &Path {
        self.path
    }

    /// Returns the length of the file in bytes. For a compressed file this decodes it to its end.
    pub fn len(&self) -> u64 {
        match &self.content {
            Content::Unpacked(unpacked) => unpacked.len(),
            _ => self.len,
        }
    }

    /// Returns the bytes that were read of a compressed file.
    #[cfg(test)]
    pub(super) fn stored_read(&self) -> u64 {
        match &self.content {
            Content::Unpacked(unpacked) => unpacked.stored_read(),
            _ => 0,
        }
    }

    /// Returns the length of the file as it is stored, in bytes.
    pub fn stored_len(&self) -> u64 {
        self.len
    }

    /// Whether the file is empty.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Reads bytes from `offset` on, perhaps fewer than requested; none at the end.
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        if let Some(progress) = self.progress {
            progress.go_on_reading()?;
        }
        let n = match &self.content {
            Content::Disk(file) => file.read_at(buffer, offset)?,
            Content::Memory(bytes) => {
                let mut rest = usize::try_from(offset).ok().and_then(|o| bytes.get(o..)).unwrap_or(&[]);
                rest.read(buffer)?
            }
            Content::Unpacked(unpacked) => {
                let before = unpacked.stored_read();
                let n = unpacked.read_at(buffer, offset)?;
                self.count((unpacked.stored_read() - before) as usize);
                return Ok(n);
            }
        };
        self.count(n);
        Ok(n)
    }

    /// Fills `buffer` from `offset` on.
    ///
    /// # Errors
    /// Errors of the operating system; `UnexpectedEof` if the file ends first.
    pub fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let mut done = 0;
        while done < buffer.len() {
            match self.read_at(&mut buffer[done..], offset + done as u64) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => done += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    /// Reads the first bytes of the file, at most `limit`.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn head(&self, limit: usize) -> Result<Vec<u8>, ReadError> {
        let mut bytes = Vec::new();
        self.reader(0)
            .take(limit as u64)
            .read_to_end(&mut bytes)
            .map_err(|e| ReadError::io(self.path, "file", format!("cannot be read: {e}"), e))?;
        Ok(bytes)
    }

    /// Returns a reader from `offset` to the end of the file.
    pub fn reader(&self, offset: u64) -> BlobReader<'_> {
        BlobReader { blob: self, offset }
    }
}

/// A reader with a position, for libraries that need [`Read`] and [`Seek`].
pub struct BlobReader<'a> {
    blob: &'a Blob<'a>,
    offset: u64,
}

impl Read for BlobReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.blob.read_at(buffer, self.offset)?;
        self.offset += n as u64;
        Ok(n)
    }
}

impl Seek for BlobReader<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let offset = match to {
            SeekFrom::Start(offset) => Some(offset),
            SeekFrom::End(by) => self.blob.len().checked_add_signed(by),
            SeekFrom::Current(by) => self.offset.checked_add_signed(by),
        };
        self.offset = offset.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.offset)
    }
}

#[cfg(test)]
mod tests;
