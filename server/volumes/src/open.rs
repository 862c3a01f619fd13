//! Opens a file or a folder as a dataset.
//!
//! A file is a dataset with the fields that it holds, mostly one. The first of [`FOLDERS`] that recognizes a folder, or a file, opens it.
//! In any other folder, the files whose names have the ending of a format are the dataset: its time steps if all of them are numbered,
//! else its fields, ordered by the files' names. They must share one grid and one number of time steps. Other files are ignored.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::beneath::is_link_out;
use super::formats::vtk::{collection, pieces};
use super::formats::{EXPECTED, FOLDERS, FolderFormat, FolderVolume, Format, format_of, label_table};
use super::location::title_of;
use super::{Dataset, Field, FileLocation, Frame, LengthUnit, Notices, OpenedFile, ReadError, numbered, replaced};

/// Reads the header of one file, in the format that its first bytes and its name say. Positions of patients are in [`Frame::Lps`].
///
/// # Errors
/// An unknown format, or what its reader found wrong.
pub fn read_file(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let stamp = location.stamp();
    Ok(replaced::checked(location, stamp, read_header(location)?, read_header))
}

fn read_header(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let (format, location) = format_of(location)?;
    let mut file = match location.part() {
        Some(part) if !format.has_parts => {
            let why = format!("{part:?} is named in it, expected no name: such a file holds one volume");
            Err(ReadError::new(location.path(), "file", why))
        }
        _ => (format.open)(&location),
    }?;
    file.geometry = file.geometry.in_frame(Frame::Lps);
    label_table::name_labels(&location, &mut file);
    Ok(file)
}

/// Lists the volumes in a folder, sorted by name.
///
/// # Errors
/// The folder cannot be listed, or has none.
pub fn list_folder(folder: &Path) -> Result<Vec<FileLocation>, ReadError> {
    let fail = |e| ReadError::io(folder, "folder", "cannot be listed", e);
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        let wanted =
            Format::of(&path).is_some_and(|format| (format.is_volume)(&FileLocation::disk(&path).packed_by_name()));
        if !wanted || hidden || !path.is_file() {
        } else if is_link_out(folder, &entry) {
            tracing::warn!(path = %path.display(), "passed over: a link out of the folder; name the file itself");
        } else {
            files.push(path);
        }
    }
    // The members of a collection and the pieces of an image are no volumes of their own.
    let is = |path: &Path, ending: &str| Format::of(path).is_some_and(|format| format.endings.contains(&ending));
    let of = |path: &PathBuf| match path {
        path if is(path, ".pvd") => collection::members(path),
        path if is(path, ".pvti") => pieces::members(path),
        _ => Vec::new(),
    };
    let parts: HashSet<PathBuf> = files.iter().flat_map(of).collect();
    files.retain(|path| !parts.contains(path));
    files.sort();
    if files.is_empty() {
        return Err(ReadError::new(folder, "folder", format!("holds no volume, {EXPECTED}")));
    }
    let beneath = |path| FileLocation::disk(path).beneath(folder);
    Ok(files.into_iter().map(beneath).collect())
}

/// Opens a folder, file or address that is in one of the formats of [`FOLDERS`]; `None` for any other location.
pub(super) fn open_folder_format(location: &FileLocation) -> Option<Result<Vec<Dataset>, ReadError>> {
    let is_read = |format: &&FolderFormat| match location.address() {
        Some(address) => (format.is_at)(address),
        None => (format.holds)(location.path()),
    };
    let format = FOLDERS.iter().find(is_read)?;
    let dataset = |volume: FolderVolume| {
        let FolderVolume { title, mut file } = volume;
        file.geometry = file.geometry.in_frame(Frame::Lps);
        Ok(Dataset {
            layout: format.name,
            ..join(&title, vec![(location.clone(), file)])?
        })
    };
    Some((format.open)(location).and_then(|volumes| volumes.into_iter().map(dataset).collect()))
}

/// Returns the only volume of a folder, or an error that lists them if there are several.
fn only(path: &Path, mut volumes: Vec<Dataset>) -> Result<Dataset, ReadError> {
    if volumes.len() == 1 {
        return Ok(volumes.remove(0));
    }
    let titles: Vec<String> = volumes
        .iter()
        .enumerate()
        .map(|(i, v)| format!("{}: {}", i + 1, v.title))
        .collect();
    let why = format!(
        "holds {} volumes, expected one: name it by its number, as {}:1 ({})",
        volumes.len(),
        path.display(),
        titles.join(", ")
    );
    Err(ReadError::new(path, "folder", why))
}

/// Opens a file, or a folder whose files share one grid, as one dataset. If a file holds several volumes, the path names one of them
/// (`file.h5:/path`). Reads headers, not samples.
///
/// # Errors
/// What is wrong with a file, or which two files of a folder do not fit.
pub fn open_dataset(path: &Path) -> Result<Dataset, ReadError> {
    let location = FileLocation::named(path);
    if let Some(volumes) = open_folder_format(&location) {
        return only(path, volumes?);
    }
    let read = |location: FileLocation| read_file(&location).map(|file| (location, file));
    if !path.is_dir() {
        return join(&title_of(path), vec![read(location)?]);
    }
    let files = list_folder(path)?
        .into_iter()
        .map(read)
        .collect::<Result<Vec<_>, _>>()?;
    assemble(&title_of(path), files)
}

/// Makes one dataset of several files: its time steps if their names are numbered, else its fields.
///
/// # Errors
/// Which two files do not fit, and in what. `files` must not be empty.
pub(super) fn assemble(title: &str, files: Vec<(FileLocation, OpenedFile)>) -> Result<Dataset, ReadError> {
    let (layout, files) = if numbered::are_steps(&files) {
        ("numbered steps", numbered::steps_of(files)?)
    } else {
        ("fields", files)
    };
    Ok(Dataset {
        layout,
        ..join(title, files)?
    })
}

/// Makes one dataset of files that share one grid, with the fields of each.
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
            let show = |g: &super::Geometry| {
                let (frame, unit) = (g.frame.name(), g.unit.map_or("no unit", LengthUnit::symbol));
                format!(
                    "spacing {:?}, origin {:?}, axes {:?}, frame {frame}, {unit}",
                    g.spacing, g.origin, g.direction
                )
            };
            return clash(location, "geometry", show(a), show(b));
        }
        if !file.matches_positions(first) {
            let show = |file: &OpenedFile| match file.uneven {
                Some(_) => "other uneven positions".to_owned(),
                None => "even positions".to_owned(),
            };
            return clash(location, "positions", show(file), show(first));
        }
        if file.steps != first.steps {
            return clash(location, "time steps", file.steps.to_string(), first.steps.to_string());
        }
        let has = |file: &OpenedFile, name: &str| file.fields.iter().any(|field| field.name == name);
        for Field { name, .. } in &file.fields {
            if let Some((earlier, _)) = files[..i].iter().find(|(_, f)| has(f, name)) {
                let why = format!(
                    "the field {name:?} is also in {}, expected different names",
                    earlier.path().display()
                );
                return Err(ReadError::new(location.path(), "file", why));
            }
        }
    }
    let mut notices = Notices::default();
    for (location, file) in &files {
        file.notices.log(location.path());
        notices.extend(file.notices.clone());
    }
    let mut fields: Vec<Field> = files.iter().flat_map(|(_, file)| file.fields.clone()).collect();
    // The first field is the one that is opened: fields of labels go last.
    fields.sort_by_key(Field::is_probably_labels);
    Ok(Dataset {
        id: slug(title),
        title: title.to_owned(),
        layout: "file",
        geometry: first.geometry,
        steps: first.steps,
        uneven: first.uneven.clone(),
        axes: first.axes.clone(),
        times: first.times.clone(),
        notices,
        fields,
        revision: 0,
        rewrites: Vec::new(),
        opening: None,
    })
}

/// Returns a name for URLs: `[a-z0-9-]+`.
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
