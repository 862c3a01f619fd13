//! Which of the libraries reads a file.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use hdf5_reader::Storage;

use super::super::super::unpacked::{RESERVE_BYTES, of_space};
use super::super::super::{FileLocation, ReadError};
use super::file::VariableFile;
use super::hdf5::Hdf5;
use super::netcdf3::NetCdf3;
use crate::private_folder::{free_bytes, is_full};

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

/// What the libraries read: the file itself, which stays open as long as this is held; of a compressed one what is in it, in a
/// temporary file.
fn storage(location: &FileLocation) -> Result<Arc<dyn Storage>, ReadError> {
    // Says what is wrong with the file better than the library, and refuses a pipe.
    let blob = location.open()?;
    if location.is_in_memory() {
        return Ok(Arc::new(hdf5_reader::BytesStorage::new(blob.head(usize::MAX)?)));
    }
    let open = |path: &Path| {
        hdf5_reader::FileStorage::open(path).map_err(|e| ReadError::new(location.path(), "file", e.to_string()))
    };
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
