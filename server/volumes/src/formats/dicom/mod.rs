//! DICOM: a folder with the images of one or more series, or a file with several images
//! (<https://www.dicomstandard.org>).
//!
//! - [`beginning`]: first bytes of a file. [`elements`]: data elements, some of which a [`data_set`] keeps; [`syntax`]: their encoding.
//! - [`image`], [`frames`]: properties of each image in the header.
//! - [`samples`], [`codecs`]: stored samples and their values.
//! - [`segments`], [`segmentation`]: segments, and their labels. [`series`]: makes volumes of images; [`source`] reads their samples.
//!
//! What identifies a patient is not read, or not shown. A volume is named by the number of its series and its modality; an error names the
//! folder and the number of a file. Unknown values of tags are not shown, as they may identify a patient.

mod beginning;
mod codecs;
mod data_set;
mod elements;
mod frames;
mod grid;
mod image;
mod increments;
mod label;
mod samples;
mod segmentation;
mod segments;
mod series;
mod source;
mod syntax;

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};

use super::super::beneath::is_link_out;
use super::super::parallel::try_map;
use super::super::{FileLocation, OpenedFile, ReadError};
use super::{FolderVolume, Format};
pub use beginning::is_dicom;

use beginning::Beginning;
use image::Found;
use label::FileLabel;

/// Files of a folder that are examined to detect DICOM.
const PROBED_FILES: usize = 32;
/// Folders below a folder that are examined to detect DICOM.
const PROBED_FOLDERS: usize = 64;
/// Maximum files of a folder and of those below it, and maximum number of such folders.
const MAX_FILES: usize = 200_000;
/// Maximum depth of folders: archives write one for each patient, study and series.
const MAX_DEPTH: usize = 6;

/// Whether a path is a DICOM file by its first bytes, or a folder that has some, also in folders below it, as archives write them.
/// Examines only the first files. A folder with volumes of other formats does not count.
pub fn holds(path: &Path) -> bool {
    let is_dicom = |file: &PathBuf| Beginning::of_file(&FileLocation::disk(file)).is_some();
    if !path.is_dir() {
        return is_dicom(&path.to_owned());
    }
    let mut folders = Folders::below(path);
    let Some(Ok(own)) = folders.next() else {
        return false;
    };
    let some = |files: &[PathBuf]| files.iter().take(PROBED_FILES).any(is_dicom);
    let is_other = |file: &PathBuf| Format::of(file).is_some();
    some(&own)
        || !own.iter().any(is_other)
            && folders
                .take(PROBED_FOLDERS)
                .any(|files| files.is_ok_and(|files| some(&files)))
}

/// Opens the volumes of a folder or a file, or the one that is named by its number.
///
/// # Errors
/// What is wrong with a file, or with each series.
pub fn open_all(location: &FileLocation) -> Result<Vec<FolderVolume>, ReadError> {
    let asked = FileLabel::of(location.path());
    let files = if location.path().is_dir() {
        read_folder(&asked)?
    } else {
        vec![image::read(location, &asked)?]
    };
    if files.iter().all(|found| matches!(found, Found::Nothing)) {
        let why = "no image with a place in space, expected ImagePositionPatient, ImageOrientationPatient and \
                   PixelSpacing; or of several frames SpacingBetweenSlices or functional groups";
        return Err(asked.error("images", why));
    }
    let mut volumes = series::volumes(&asked, files)?;
    let Some(part) = location.part() else {
        return Ok(volumes);
    };
    match part.parse::<usize>() {
        Ok(number) if (1..=volumes.len()).contains(&number) => Ok(vec![volumes.swap_remove(number - 1)]),
        _ => Err(asked.error(
            "volume",
            format!("{part:?}, expected a number from 1 to {}", volumes.len()),
        )),
    }
}

/// Reads the header of a file with several images.
///
/// # Errors
/// What is wrong with the file; several volumes, none of which is named.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let mut volumes = open_all(location)?;
    if volumes.len() > 1 {
        let why = format!("{} of them, expected one to be named by its number", volumes.len());
        return Err(FileLabel::of(location.path()).error("volume", why));
    }
    Ok(volumes.swap_remove(0).file)
}

/// Iterates over the folders with their files, the upper ones first. Sorted; without hidden files. Links to folders are not followed, as
/// they may form cycles; nor are links to files that are not below the first folder.
struct Folders {
    root: PathBuf,
    next: VecDeque<(PathBuf, usize)>,
}

impl Folders {
    fn below(folder: &Path) -> Self {
        Self {
            root: folder.to_owned(),
            next: VecDeque::from([(folder.to_owned(), 0)]),
        }
    }

    fn list(&mut self, folder: &Path, depth: usize) -> io::Result<Vec<PathBuf>> {
        let (mut files, mut folders) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(folder)?.take(MAX_FILES + 1) {
            let entry = entry?;
            let path = entry.path();
            if entry.file_name().to_string_lossy().starts_with('.') {
            } else if entry.file_type()?.is_dir() {
                folders.push(path);
            } else if path.is_file() && !is_link_out(&self.root, &entry) {
                files.push(path);
            }
        }
        files.sort();
        folders.sort();
        if depth < MAX_DEPTH {
            self.next.extend(folders.into_iter().map(|folder| (folder, depth + 1)));
        }
        Ok(files)
    }
}

impl Iterator for Folders {
    type Item = io::Result<Vec<PathBuf>>;

    fn next(&mut self) -> Option<Self::Item> {
        let (folder, depth) = self.next.pop_front()?;
        Some(self.list(&folder, depth))
    }
}

/// Reads the headers of the files of a folder and of the folders below it.
fn read_folder(asked: &FileLabel) -> Result<Vec<Found>, ReadError> {
    let fail = |e| ReadError::io(&asked.asked, "folder", "cannot be listed", e);
    let mut files = Vec::new();
    for (i, folder) in Folders::below(&asked.asked).enumerate() {
        files.extend(folder.map_err(fail)?);
        if files.len().max(i) > MAX_FILES {
            let why = format!("more than {MAX_FILES} files or folders, expected fewer");
            return Err(asked.error("folder", why));
        }
    }
    let read = try_map(files.len(), |i| {
        let location = FileLocation::disk(&files[i]).beneath(&asked.asked);
        if Beginning::of_file(&location).is_none() {
            return Ok(Found::Nothing);
        }
        let label = FileLabel {
            number: Some(i + 1),
            ..asked.clone()
        };
        image::read(&location, &label)
    })?;
    let others = read.iter().filter(|found| matches!(found, Found::Nothing)).count();
    if others > 0 {
        tracing::info!(path = %asked.asked.display(), "{others} files without images in space passed over");
    }
    Ok(read)
}
