//! Selects the library that reads a file.

use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

use hdf5_reader::{Storage, StorageBuffer};

use super::super::super::unpacked::{RESERVE_BYTES, of_space};
use super::super::super::{FileLocation, ReadError};
use super::file::VariableFile;
use super::hdf5::Hdf5;
use super::netcdf3::NetCdf3;
use crate::disk::{free_bytes, is_full};

/// Opens a file by its first bytes: HDF5, also behind a user block, or NetCDF-3.
pub fn open_file(location: &FileLocation) -> Result<Box<dyn VariableFile>, ReadError> {
    let fail = |why: String| ReadError::new(location.path(), "header", why);
    match location.open()?.head(4)?.as_slice() {
        [b'C', b'D', b'F', version @ (1 | 2 | 5)] => {
            let file = NetCdf3::open(storage(location)?, *version).map_err(fail)?;
            Ok(Box::new(file))
        }
        [b'C', b'D', b'F', ..] | [0xcd, 0xf3, ..] => Err(fail(
            "of another kind of CDF, expected NetCDF-3 (version 1, 2 or 5) or HDF5".into(),
        )),
        _ => Ok(Box::new(Hdf5::open(location, storage(location)?).map_err(fail)?)),
    }
}

/// Opens the storage that the libraries read: the file itself, which stays open while the storage exists. A compressed file is decompressed
/// to a temporary file.
fn storage(location: &FileLocation) -> Result<Arc<dyn Storage>, ReadError> {
    // Opening the file reports errors better than the library does, and refuses a pipe.
    let blob = location.open()?;
    if location.is_in_memory() {
        return Ok(Arc::new(hdf5_reader::BytesStorage::new(blob.head(usize::MAX)?)));
    }
    let open =
        |path: &Path| DiskStorage::open(path).map_err(|e| ReadError::io(location.path(), "file", e.to_string(), e));
    if location.packing().is_none() {
        return Ok(Arc::new(open(location.path())?));
    }
    let fail = |e: std::io::Error| {
        let why = if is_full(&e) {
            e.to_string()
        } else {
            "cannot be decompressed".to_owned()
        };
        ReadError::io(location.path(), "file", why, e)
    };
    let mut decoded = tempfile::NamedTempFile::new().map_err(of_space).map_err(fail)?;
    let (len, free) = (blob.len(), free_bytes(decoded.path()).unwrap_or(u64::MAX));
    if len > free.saturating_sub(RESERVE_BYTES) {
        return Err(fail(of_space(ErrorKind::StorageFull.into())));
    }
    std::io::copy(&mut blob.reader(0), &mut decoded).map_err(fail)?;
    Ok(Arc::new(open(decoded.path())?))
}

/// A file on disk. The library's own storage fails if a signal interrupts a read.
struct DiskStorage<F> {
    file: F,
    len: u64,
}

impl DiskStorage<std::fs::File> {
    fn open(path: &Path) -> io::Result<Self> {
        let file = std::fs::File::open(path)?;
        let len = file.metadata()?.len();
        Ok(Self { file, len })
    }
}

impl<F: FileExt + Send + Sync> Storage for DiskStorage<F> {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_range(&self, offset: u64, len: usize) -> hdf5_reader::error::Result<StorageBuffer> {
        let available = self.len.saturating_sub(offset);
        // Checked before the buffer is allocated.
        if len as u64 > available {
            return Err(hdf5_reader::error::Error::UnexpectedEof {
                offset,
                needed: len as u64,
                available,
            });
        }
        let mut bytes = vec![0; len];
        self.file.read_exact_at(&mut bytes, offset)?;
        Ok(StorageBuffer::from_vec(bytes))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    /// Ten bytes. Every other read is interrupted; the others return at most three bytes.
    #[derive(Default)]
    struct Interrupted(AtomicBool);

    impl FileExt for Interrupted {
        fn read_at(&self, out: &mut [u8], offset: u64) -> io::Result<usize> {
            if !self.0.fetch_xor(true, Ordering::Relaxed) {
                return Err(ErrorKind::Interrupted.into());
            }
            let count = out.len().min(3);
            out.iter_mut()
                .zip(offset as u8..)
                .take(count)
                .for_each(|(out, at)| *out = at);
            Ok(count)
        }

        fn write_at(&self, _: &[u8], _: u64) -> io::Result<usize> {
            Err(ErrorKind::Unsupported.into())
        }
    }

    #[test]
    fn reads_that_signals_interrupt_go_on() {
        let storage = DiskStorage {
            file: Interrupted::default(),
            len: 10,
        };
        let read = storage.read_range(1, 8).unwrap();
        assert_eq!(&*read, [1, 2, 3, 4, 5, 6, 7, 8]);
        let beyond = storage
            .read_range(8, 3)
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default();
        assert!(beyond.contains('8') && beyond.contains('3'), "{beyond}");
    }
}
