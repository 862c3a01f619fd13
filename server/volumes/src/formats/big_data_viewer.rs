//! BigDataViewer's `.xml`: opens the HDF5 file or the N5 folder that it names.

use std::path::{Component, Path};

use super::{spim_data, variables, zarr};
use crate::{FileLocation, OpenedFile, ReadError};

/// Opens the volume that a `.xml` file describes.
///
/// # Errors
/// What is wrong with it, or with the file that it names.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let data = spim_data::read(location)?;
    let fail = |why: String| ReadError::new(location.path(), "ImageLoader", why);
    match data.format.as_str() {
        "bdv.hdf5" => variables::open_views(&location.sibling(&data.file, "hdf5")?.with_part_of(location), &data),
        "bdv.n5" => {
            let relative = Path::new(&data.file);
            let is_inside = relative
                .components()
                .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
            if !is_inside || data.file.is_empty() || location.is_in_memory() {
                return Err(fail(format!("{:?}, expected a folder beside the file", data.file)));
            }
            let folder = location.path().parent().unwrap_or(Path::new("")).join(relative);
            zarr::open_views(&FileLocation::disk(folder).with_part_of(location), &data)
        }
        "" => Err(fail(
            "none, expected a file of BigDataViewer with its ImageLoader".to_owned(),
        )),
        other => Err(fail(format!("{other:?}, expected bdv.hdf5 or bdv.n5"))),
    }
}
