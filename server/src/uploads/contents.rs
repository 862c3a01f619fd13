//! The bytes of an upload: the bytes of all files in the order of their declaration. So a single offset tells a client where to resume.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::names::DeclaredFile;

/// The declared files of an upload, below a folder. Files are numbered from 0 in the order of their declaration.
#[derive(Clone, Debug)]
pub(super) struct Contents {
    folder: PathBuf,
    files: Arc<[DeclaredFile]>,
    /// Offset of the first byte of each file in the upload.
    starts: Arc<[u64]>,
}

impl Contents {
    pub(super) fn new(folder: PathBuf, files: Vec<DeclaredFile>) -> Self {
        let starts = files.iter().scan(0, |end, file| {
            let start = *end;
            *end += file.bytes;
            Some(start)
        });
        Self {
            folder,
            starts: starts.collect(),
            files: files.into(),
        }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn files(&self) -> &[DeclaredFile] {
        &self.files
    }

    fn path(&self, file: usize) -> PathBuf {
        self.folder.join(&self.files[file].name)
    }

    /// Returns the number of the file that contains an offset. This file is incomplete while the upload has `offset` bytes.
    pub(super) fn file_at(&self, offset: u64) -> usize {
        // An empty file starts at the same offset as its successor. The last file with this start contains the offset.
        self.starts.partition_point(|&start| start <= offset).saturating_sub(1)
    }

    /// Returns the number of bytes before the first gap in the files that an earlier process has left. Removes the files behind the gap.
    pub(super) fn settle(&self) -> io::Result<u64> {
        let (mut received, mut has_gap) = (0, false);
        for (i, file) in self.files.iter().enumerate() {
            let path = self.path(i);
            let length = match std::fs::metadata(&path) {
                Ok(metadata) => metadata.len().min(file.bytes),
                Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
                Err(error) => return Err(error),
            };
            if has_gap && length > 0 {
                std::fs::remove_file(&path)?;
            } else {
                received += length;
                has_gap |= length < file.bytes;
            }
        }
        Ok(received)
    }

    /// Writes bytes at an offset of the upload. Returns the number of bytes that were written, and the first error.
    pub(super) fn write(&self, mut offset: u64, mut bytes: &[u8]) -> (usize, io::Result<()>) {
        let length = bytes.len();
        while !bytes.is_empty() {
            let file = self.file_at(offset);
            let offset_in_file = offset - self.starts[file];
            let left = usize::try_from(self.files[file].bytes - offset_in_file).unwrap_or(usize::MAX);
            let (piece, rest) = bytes.split_at(left.min(bytes.len()));
            let mut written = 0;
            let result = self
                .open(file)
                .and_then(|file| write_all(&file, piece, offset_in_file, &mut written));
            offset += written as u64;
            if let Err(error) = result {
                return (length - bytes.len() + written, Err(error));
            }
            bytes = rest;
        }
        (length, Ok(()))
    }

    /// Opens a file for writing. Creates the file and its folders if they do not exist.
    fn open(&self, file: usize) -> io::Result<File> {
        let path = self.path(file);
        let mut options = OpenOptions::new();
        options.create(true).truncate(false).write(true);
        match options.open(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                if let Some(parent) = path.parent() {
                    std::fs::create_dir_all(parent)?;
                }
                options.open(&path)
            }
            opened => opened,
        }
    }

    /// Completes an upload that has received all of its bytes. Creates the empty files, and flushes all files to the disk.
    pub(super) fn seal(&self) -> io::Result<()> {
        for (file, _) in self.files.iter().enumerate().filter(|(_, file)| file.bytes == 0) {
            self.open(file)?;
        }
        // One call flushes all files. An upload may have thousands.
        #[cfg(target_os = "linux")]
        rustix::fs::syncfs(File::open(&self.folder)?)?;
        #[cfg(not(target_os = "linux"))]
        for file in 0..self.files.len() {
            File::open(self.path(file))?.sync_all()?;
        }
        Ok(())
    }
}

/// Writes all bytes at an offset of a file. Unlike [`FileExt::write_all_at`], adds the bytes that were written before an error to
/// `written`.
fn write_all(file: &File, mut bytes: &[u8], mut offset: u64, written: &mut usize) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.write_at(bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => {
                *written += count;
                offset += count as u64;
                bytes = &bytes[count..];
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contents(folder: &Path) -> Contents {
        let file = |(name, bytes): (&str, u64)| DeclaredFile {
            name: name.into(),
            bytes,
        };
        let files = [("empty", 0), ("a/b", 3), ("also", 0), ("c", 4), ("last", 0)];
        Contents::new(folder.to_owned(), files.map(file).to_vec())
    }

    #[test]
    fn bytes_come_into_their_files_however_they_are_parted() {
        for part in 1..=7 {
            let folder = tempfile::tempdir().unwrap();
            let contents = contents(folder.path());
            for (i, bytes) in b"abcdefg".chunks(part).enumerate() {
                let (written, result) = contents.write((i * part) as u64, bytes);
                result.unwrap();
                assert_eq!(written, bytes.len());
                // As a process finds it that begins now.
                assert_eq!(contents.settle().unwrap(), (i * part + bytes.len()) as u64);
            }
            contents.seal().unwrap();
            let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
            assert_eq!((read("a/b"), read("c")), (b"abc".to_vec(), b"defg".to_vec()));
            for empty in ["empty", "also", "last"] {
                assert!(read(empty).is_empty());
            }
        }
    }

    #[test]
    fn what_follows_a_gap_is_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let contents = contents(folder.path());
        contents.write(0, b"abcdef").1.unwrap();
        std::fs::write(folder.path().join("a/b"), b"ab").unwrap();
        assert_eq!(contents.settle().unwrap(), 2);
        assert!(!folder.path().join("c").exists());
        assert_eq!(contents.file_at(2), 1);
        assert_eq!(contents.file_at(3), 3);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_keeps_what_was_written_before() {
        let folder = tempfile::tempdir().unwrap();
        let contents = contents(folder.path());
        std::os::unix::fs::symlink("/dev/full", folder.path().join("c")).unwrap();
        let (written, result) = contents.write(0, b"abcdefg");
        assert_eq!((written, result.unwrap_err().kind()), (3, io::ErrorKind::StorageFull));
    }
}
