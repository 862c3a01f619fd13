//! A file or a folder becomes a dataset.
//!
//! A single file is a dataset with one field. A folder is a dataset with one field for each file directly in it whose name says a
//! format; fields are named after the files' stems and ordered by name. They must share one grid and one number of time steps. Other
//! files are ignored.

use std::path::{Path, PathBuf};

use super::formats::{EXPECTED, Format};
use super::{Dataset, FileLocation, OpenedFile, ReadError};

/// Reads the header of one file, in the format that its name says.
///
/// # Errors
/// An unknown format, or what its reader found wrong.
pub fn read_file(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    if let Some(format) = Format::of(location.path()) {
        return (format.open)(location);
    }
    location.open()?;
    let why = format!("unknown format, {EXPECTED}");
    Err(ReadError::new(location.path(), "file", why))
}

/// The volumes in a folder, sorted by name.
///
/// # Errors
/// The folder cannot be listed, or has none.
pub fn list_folder(folder: &Path) -> Result<Vec<FileLocation>, ReadError> {
    let fail = |e| ReadError::io(folder, "folder", "cannot be listed", e);
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        let wanted = Format::of(&path).is_some_and(|format| (format.is_volume)(&FileLocation::disk(&path)));
        if wanted && !hidden && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(ReadError::new(folder, "folder", format!("holds no volume, {EXPECTED}")));
    }
    Ok(files.into_iter().map(FileLocation::disk).collect())
}

/// Opens a file, or a folder whose files share one grid, as one dataset. Reads headers, not samples.
///
/// # Errors
/// What is wrong with a file, or which two files of a folder do not fit.
pub fn open_dataset(path: &Path) -> Result<Dataset, ReadError> {
    let locations = if path.is_dir() {
        list_folder(path)?
    } else {
        vec![FileLocation::disk(path)]
    };
    let files = locations
        .into_iter()
        .map(|location| read_file(&location).map(|file| (location, file)))
        .collect::<Result<Vec<_>, _>>()?;
    join(&title_of(path), files)
}

/// Title of a dataset: a file's stem, a folder's name.
pub(super) fn title_of(path: &Path) -> String {
    if path.is_dir() {
        // `.` and `..` have no name until they are resolved.
        let folder = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        return folder
            .file_name()
            .map_or("volumes".into(), |n| n.to_string_lossy().into_owned());
    }
    super::location::stem(path)
}

/// Makes one dataset of files that share one grid.
///
/// # Errors
/// Which two files do not fit, and in what. `files` must not be empty.
pub(super) fn join(title: &str, files: Vec<(FileLocation, OpenedFile)>) -> Result<Dataset, ReadError> {
    let (first_location, first) = &files[0];
    let clash = |location: &FileLocation, what: &str, has: String, other: String| {
        let why = format!(
            "{has}, but {} has {other}; expected one grid in a folder",
            first_location.path().display()
        );
        Err(ReadError::new(location.path(), what, why))
    };
    for (i, (location, file)) in files.iter().enumerate() {
        let (a, b) = (&file.geometry, &first.geometry);
        if a.dims != b.dims {
            return clash(location, "dimensions", format!("{:?}", a.dims), format!("{:?}", b.dims));
        }
        if !a.matches(b) {
            let show =
                |g: &super::Geometry| format!("spacing {:?}, origin {:?}, axes {:?}", g.spacing, g.origin, g.direction);
            return clash(location, "geometry", show(a), show(b));
        }
        if file.steps != first.steps {
            return clash(location, "time steps", file.steps.to_string(), first.steps.to_string());
        }
        if let Some((earlier, _)) = files[..i].iter().find(|(_, f)| f.field.name == file.field.name) {
            let why = format!(
                "{:?} is also the stem of {}, expected different stems",
                file.field.name,
                earlier.path().display()
            );
            return Err(ReadError::new(location.path(), "file", why));
        }
    }
    Ok(Dataset {
        id: slug(title),
        title: title.to_owned(),
        geometry: first.geometry,
        steps: first.steps,
        fields: files.into_iter().map(|(_, f)| f.field).collect(),
        notice: None,
        opening: None,
    })
}

/// A name for URLs: `[a-z0-9-]+`.
pub(super) fn slug(title: &str) -> String {
    let kept: String = title
        .to_lowercase()
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect();
    let words: Vec<&str> = kept.split('-').filter(|w| !w.is_empty()).collect();
    if words.is_empty() {
        "volume".into()
    } else {
        words.join("-")
    }
}
