//! ParaView's collections: `.pvd`, a list of `.vti`, `.vtr`, `.pvti` and `.pvtr` files with the time of each (<https://www.paraview.org/Wiki/ParaView/Data_formats>).
//!
//! Files are time steps, in the order of their times; files with the same time are parts of one step. Refused with the reason: other data
//! sets, files outside the collection's folder.

use std::path::{Path, PathBuf};

use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;

use super::xml::{self, GridKind, element::attribute};
use super::{parts, pieces};
use crate::numbered::join_steps;
use crate::{FileLocation, OpenedFile, ReadError, TimeAxis};

/// Maximum bytes of a collection.
const MAX_BYTES: usize = 16 << 20;

/// Maximum files of a collection.
const MAX_FILES: usize = 1 << 16;

/// A file of the collection.
struct Entry {
    time: f64,
    file: String,
}

/// Reads a collection and the headers of its files.
///
/// # Errors
/// What is wrong with the collection, by element or attribute, or with one of its files.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let mut entries = entries(location)?;
    // The sort is stable: parts of a time stay in the order of the list.
    entries.sort_by(|a, b| a.time.total_cmp(&b.time));
    let groups: Vec<&[Entry]> = entries.chunk_by(|a, b| a.time == b.time).collect();
    let times = groups.iter().map(|group| group[0].time).collect();
    let files = groups.iter().map(|group| step(location, group));
    join_steps(files.collect::<Result<_, _>>()?, TimeAxis::listed(times, "", None))
}

/// Opens the files of one time. Also returns the location of the first file.
fn step(location: &FileLocation, group: &[Entry]) -> Result<(FileLocation, OpenedFile), ReadError> {
    let at = |entry: &Entry| Ok(location.sibling(&entry.file, "file")?.packed_by_name());
    let first = at(&group[0])?;
    let opened = match group {
        [one] if is_in_pieces(&one.file) => pieces::open(&first),
        [_] => xml::open(&first),
        several => {
            let part = |entry: &Entry| {
                let file = at(entry)?;
                if is_in_pieces(&entry.file) {
                    let why = format!(
                        "{:?} is one of several files of the time {}, expected .vti files there",
                        entry.file, entry.time
                    );
                    return Err(ReadError::new(location.path(), "file", why));
                }
                let stored = xml::open_piece(&file, GridKind::Image)?;
                Ok((file, stored))
            };
            parts::join(location.path(), several.iter().map(part).collect::<Result<_, _>>()?)
        }
    };
    Ok((first, opened?))
}

/// Lists the files of a collection on disk, as far as it can be read.
pub fn members(collection: &Path) -> Vec<PathBuf> {
    let folder = collection.parent().unwrap_or(Path::new(""));
    let entries = entries(&FileLocation::disk(collection).packed_by_name()).unwrap_or_default();
    entries.into_iter().map(|entry| folder.join(entry.file)).collect()
}

/// Returns the files in the order of the collection; at least one.
fn entries(location: &FileLocation) -> Result<Vec<Entry>, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let bytes = location.open()?.head(MAX_BYTES + 1)?;
    if bytes.len() > MAX_BYTES {
        return Err(fail(
            "file",
            format!("more than {MAX_BYTES} bytes, expected a list of files"),
        ));
    }
    let mut reader = Reader::from_reader(bytes.as_slice());
    reader.config_mut().expand_empty_elements = true;
    let (mut buffer, mut is_collection, mut is_closed, mut entries) = (Vec::new(), false, false, Vec::new());
    loop {
        buffer.clear();
        let event = reader.read_event_into(&mut buffer);
        let event = event.map_err(|e| fail("XML", format!("{e}, at byte {}", reader.error_position())))?;
        match event {
            Event::Start(element) if element.name().as_ref() == "VTKFile" => {
                let kind = attribute(location.path(), &element, "type")?.unwrap_or_default();
                if kind != "Collection" {
                    return Err(fail("type", format!("{kind:?}, expected Collection")));
                }
                is_collection = true;
            }
            Event::Start(element) if is_collection && element.name().as_ref() == "DataSet" => {
                if entries.len() == MAX_FILES {
                    return Err(fail("DataSet", format!("more than {MAX_FILES}, expected fewer files")));
                }
                entries.push(entry(location.path(), &element, entries.len())?);
            }
            Event::End(element) => is_closed |= element.name().as_ref() == "VTKFile",
            Event::Eof => break,
            _ => {}
        }
    }
    if !is_collection {
        return Err(fail("VTKFile", "no such element, expected VTK's XML format".into()));
    }
    if !is_closed {
        return Err(fail("VTKFile", "ends too early, expected the element's end".into()));
    }
    if entries.is_empty() {
        return Err(fail("DataSet", "none, expected one at least".into()));
    }
    Ok(entries)
}

/// Reads an entry. `number`: the number of entries before it.
fn entry(path: &Path, element: &BytesStart<'_>, number: usize) -> Result<Entry, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(path, field, why);
    let file = attribute(path, element, "file")?;
    let file = file.ok_or_else(|| fail("file", "missing, expected the name of a file".to_owned()))?;
    let is_whole = [".vti", ".vtr"]
        .iter()
        .any(|end| file.to_ascii_lowercase().ends_with(end));
    if !is_whole && !is_in_pieces(&file) {
        let why = format!("{file:?}, expected image data or a rectilinear grid, .vti, .pvti, .vtr or .pvtr");
        return Err(fail("file", why));
    }
    let time = match attribute(path, element, "timestep")? {
        None => number as f64,
        Some(text) => {
            let time = text.trim().parse().ok().filter(|time: &f64| time.is_finite());
            time.ok_or_else(|| fail("timestep", format!("{text:?}, expected a number")))?
        }
    };
    Ok(Entry { time, file })
}

fn is_in_pieces(file: &str) -> bool {
    let file = file.to_ascii_lowercase();
    file.ends_with(".pvti") || file.ends_with(".pvtr")
}
