//! The bytes of an upload: those of its files one after the other, as they were declared, so that one offset tells a client where to
//! continue.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::names::DeclaredFile;

/// Files below a folder.
#[derive(Clone, Debug)]
pub(super) struct Contents {
    folder: PathBuf,
    files: Arc<[DeclaredFile]>,
    /// Offset of each file's first byte.
    starts: Arc<[u64]>,
}

impl Contents {
    pub(super) fn new(folder: PathBuf, files: Vec<DeclaredFile>) -> Self {
        let starts = files.iter().scan(0, |at, file| {
            let start = *at;
            *at += file.bytes;
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

    /// Returns the file that contains an offset: the first incomplete file once `offset` bytes have arrived.
    pub(super) fn file_at(&self, offset: u64) -> usize {
        // Empty files share their start with the one behind them.
        self.starts.partition_point(|&start| start <= offset).saturating_sub(1)
    }

    /// Counts the bytes before the first gap, from the files that an earlier process has left. Removes files behind the gap.
    pub(super) fn settle(&self) -> io::Result<u64> {
        let (mut there, mut has_gap) = (0, false);
        for (at, file) in self.files.iter().enumerate() {
            let path = self.path(at);
            let length = match std::fs::metadata(&path) {
                Ok(found) => found.len().min(file.bytes),
                Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
                Err(error) => return Err(error),
            };
            if has_gap && length > 0 {
                std::fs::remove_file(&path)?;
            } else {
                there += length;
                has_gap |= length < file.bytes;
            }
        }
        Ok(there)
    }

    /// Writes bytes at an offset of the upload. Returns how many were written, and the error that stopped it, if there was one.
    pub(super) fn write(&self, mut offset: u64, mut bytes: &[u8]) -> (usize, io::Result<()>) {
        let before = bytes.len();
        while !bytes.is_empty() {
            let at = self.file_at(offset);
            let inside = offset - self.starts[at];
            let left = usize::try_from(self.files[at].bytes - inside).unwrap_or(usize::MAX);
            let (piece, rest) = bytes.split_at(left.min(bytes.len()));
            let mut written = 0;
            let result = self
                .open(at)
                .and_then(|file| write_all(&file, piece, inside, &mut written));
            offset += written as u64;
            if let Err(error) = result {
                return (before - bytes.len() + written, Err(error));
            }
            bytes = rest;
        }
        (before, Ok(()))
    }

    fn open(&self, at: usize) -> io::Result<File> {
        let path = self.path(at);
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

    /// Completes an upload of which all bytes have arrived: creates its empty files and flushes everything to the disk.
    pub(super) fn seal(&self) -> io::Result<()> {
        for (at, _) in self.files.iter().enumerate().filter(|(_, file)| file.bytes == 0) {
            self.open(at)?;
        }
        // One call flushes all files, of which there may be thousands.
        #[cfg(target_os = "linux")]
        rustix::fs::syncfs(File::open(&self.folder)?)?;
        #[cfg(not(target_os = "linux"))]
        for at in 0..self.files.len() {
            File::open(self.path(at))?.sync_all()?;
        }
        Ok(())
    }
}

/// As [`FileExt::write_all_at`], and counts what was written before an error.
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
