//! A folder of slices: TIFF files of one page each, whose names differ in one number.

use std::path::{Path, PathBuf};

use super::super::super::beneath::is_link_out;
use super::super::super::{FileLocation, ReadError};
use super::super::{FolderVolume, Format};
use super::source::Pages;
use super::stack::{Resolution, Stack};
use super::{Opened, ome, read_pages, volume};

/// Slices of a folder, by their numbers.
struct Series {
    /// The common part of their names, without the separator before the number.
    name: String,
    files: Vec<(u64, FileLocation)>,
}

/// Whether a folder has such slices. Reads the directories of the first file.
pub fn holds(folder: &Path) -> bool {
    let Some(series) = series(folder) else {
        return several_numbers(folder).is_some();
    };
    read_pages(&series.files[0].1).is_ok_and(|opened| is_slice(&opened))
}

/// Opens the folder as one volume.
///
/// # Errors
/// A number is missing, or a file does not fit the others.
pub fn open(location: &FileLocation) -> Result<Vec<FolderVolume>, ReadError> {
    let folder = location.path();
    let fail = |why: String| ReadError::new(folder, "folder", why);
    if let Some((first, last, count)) = several_numbers(folder) {
        return Err(fail(format!(
            "names of slices differ in {count} numbers, from {first:?} to {last:?}, expected one: put the slices of each channel or time into a \
             folder of its own"
        )));
    }
    let series =
        series(folder).ok_or_else(|| fail("no slices, expected TIFF files whose names differ in one number".into()))?;
    if let Some(part) = location.part() {
        return Err(fail(format!(
            "{part:?} is named in it, expected no name: its slices are one volume"
        )));
    }
    check_numbers(&series).map_err(fail)?;
    let mut files: Vec<Pages> = Vec::new();
    let mut descriptions: Vec<(Option<String>, Resolution)> = Vec::new();
    let mut stack = Stack::of_pages(series.files.len());
    for (_, file) in &series.files {
        let opened = read_pages(file)?;
        if !is_slice(&opened) {
            let why = format!(
                "{} pages, expected one, as the other slices in its folder",
                opened.pages.pages.len()
            );
            return Err(ReadError::new(file.path(), "pages", why));
        }
        if files.is_empty() {
            stack.missing = opened.missing;
        }
        stack.tell_of_orientation(opened.orientation);
        descriptions.push((opened.description, opened.resolution));
        files.push(opened.pages);
    }
    stack.planes = (0..files.len()).map(|file| (file, 0)).collect();
    describe_slices(&mut stack, &descriptions).map_err(fail)?;
    let mut file = volume(location, &stack, files)?;
    if let [field] = file.fields.as_mut_slice() {
        field.name.clone_from(&series.name);
    }
    Ok(vec![FolderVolume {
        title: series.name,
        file,
    }])
}

/// Evaluates ImageJ's descriptions of slices that it has written one by one.
fn describe_slices(stack: &mut Stack, slices: &[(Option<String>, Resolution)]) -> Result<(), String> {
    let of_imagej = |(description, _): &(Option<String>, Resolution)| {
        let text = description.as_deref().filter(|text| text.starts_with("ImageJ="));
        let mut slice = Stack::of_pages(1);
        slice.calibrate_imagej(text.unwrap_or_default());
        (slice.calibration, slice.value_unit)
    };
    let Some(((description, resolution), others)) = slices.split_first() else {
        return Ok(());
    };
    let first = of_imagej(&slices[0]);
    if let Some(other) = others.iter().position(|other| of_imagej(other) != first) {
        return Err(format!(
            "slice {} has another calibration of values than the first one, expected the same in all",
            other + 2
        ));
    }
    if let Some(text) = description.as_deref().filter(|text| text.starts_with("ImageJ=")) {
        stack.place_imagej(text, *resolution);
        stack.calibrate_imagej(text);
    }
    Ok(())
}

/// Refuses missing numbers and duplicates.
fn check_numbers(series: &Series) -> Result<(), String> {
    for pair in series.files.windows(2) {
        let [(number, file), (next, other)] = pair else {
            continue;
        };
        let (file, other) = (file.path().display(), other.path().display());
        match next - number {
            0 => {
                return Err(format!(
                    "{file} and {other} have one number, expected one slice for each"
                ));
            }
            1 => {}
            _ => {
                let missing = number + 1;
                return Err(format!(
                    "no slice {missing} after {file}, expected every number up to the last"
                ));
            }
        }
    }
    Ok(())
}

/// Whether a file is a single slice, and not a volume or a part of one.
fn is_slice(opened: &Opened) -> bool {
    let description = opened.description.as_deref().unwrap_or_default();
    let is_stack = description
        .lines()
        .any(|line| line.strip_prefix("images=").is_some_and(|n| n.trim() != "1"));
    opened.pages.pages.len() == 1 && !is_stack && !ome::is_ome(description)
}

/// If the names of TIFF slices differ in several numbers, returns the first and the last name, and the count of these numbers.
fn several_numbers(folder: &Path) -> Option<(String, String, usize)> {
    let files = tiff_files(folder)?;
    let (first, others) = files.split_first()?;
    let is_number = |part: &Part| matches!(part, Part::Number(_));
    let same_kind = |other: &Vec<Part>| {
        let fits = |(a, b): (&Part, &Part)| a == b || is_number(a) && is_number(b);
        other.len() == first.0.len() && first.0.iter().zip(other).all(fits)
    };
    if others.len() < 3 || !others.iter().all(|(parts, _)| same_kind(parts)) {
        return None;
    }
    let differs = |i: &usize| others.iter().any(|(parts, _)| parts[*i] != first.0[*i]);
    let count = (0..first.0.len()).filter(differs).count();
    let opened = read_pages(&FileLocation::disk(&first.1).beneath(folder)).ok()?;
    let name = |path: &PathBuf| Some(path.file_name()?.to_string_lossy().into_owned());
    (count > 1 && is_slice(&opened)).then_some((name(&first.1)?, name(&others.last()?.1)?, count))
}

/// Returns the TIFF files of a folder, sorted by the parts of their names.
fn tiff_files(folder: &Path) -> Option<Vec<(Vec<Part>, PathBuf)>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).ok()? {
        let entry = entry.ok()?;
        let path = entry.path();
        let name = path.file_name()?.to_str()?.to_owned();
        let is_tiff = Format::of(&path).is_some_and(|format| format.endings.contains(&".tif"));
        if is_tiff && !name.starts_with('.') && path.is_file() && !is_link_out(folder, &entry) {
            files.push((parts(&name), path));
        }
    }
    files.sort();
    Some(files)
}

/// Returns the TIFF files of a folder, ordered by the number in which their names differ; `None` if the names differ in anything else.
fn series(folder: &Path) -> Option<Series> {
    let files = tiff_files(folder)?;
    let (first, others) = files.split_first()?;
    let at = (0..first.0.len()).find(|&i| others.iter().any(|other| other.0.get(i) != Some(&first.0[i])))?;
    let same = |other: &Vec<Part>| {
        let differs = |i: usize| i != at && other[i] != first.0[i];
        other.len() == first.0.len() && !(0..other.len()).any(differs)
    };
    if !others.iter().all(|(parts, _)| same(parts)) {
        return None;
    }
    let number = |parts: &[Part]| match parts[at] {
        Part::Number(number) => Some(number),
        Part::Text(_) => None,
    };
    let before: String = first.0[..at].iter().map(Part::text).collect();
    let name = before.trim_end_matches(['_', '-', '.', ' ']);
    let folder_name = || {
        folder
            .canonicalize()
            .ok()
            .and_then(|f| Some(f.file_name()?.to_string_lossy().into_owned()))
    };
    let mut numbered = Vec::new();
    for (parts, path) in &files {
        numbered.push((number(parts)?, FileLocation::disk(path).beneath(folder)));
    }
    numbered.sort_by_key(|(number, _)| *number);
    Some(Series {
        name: if name.is_empty() {
            folder_name().unwrap_or("slices".into())
        } else {
            name.to_owned()
        },
        files: numbered,
    })
}

/// A part of a name.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Text(String),
    Number(u64),
}

impl Part {
    fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(number) => number.to_string(),
        }
    }
}

/// Splits a name into numbers and the text between them. A number above 64 bits is text.
fn parts(name: &str) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let is_digit = first.is_ascii_digit();
        let end = rest
            .find(|c: char| c.is_ascii_digit() != is_digit)
            .unwrap_or(rest.len());
        let (part, after) = rest.split_at(end);
        parts.push(part.parse().map_or_else(|_| Part::Text(part.to_owned()), Part::Number));
        rest = after;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(names: &[&str]) -> Option<(String, Vec<u64>)> {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let series = series(folder.path())?;
        Some((
            series.name,
            series.files.into_iter().map(|(number, _)| number).collect(),
        ))
    }

    #[test]
    fn slices_are_in_the_order_of_the_number_that_differs() {
        let (name, order) = numbers(&["run2_9.tif", "run2_10.tif", "run2_0011.tif", "notes.txt"]).unwrap();
        assert_eq!((name.as_str(), order.as_slice()), ("run2", &[9, 10, 11][..]));
    }

    #[test]
    fn names_that_differ_in_more_are_no_series() {
        assert!(numbers(&["a1.tif", "b2.tif"]).is_none());
        assert!(numbers(&["c1_z1.tif", "c2_z2.tif"]).is_none());
        assert!(numbers(&["a1.tif"]).is_none());
        assert!(numbers(&["a1.tif", "a1b.tif"]).is_none());
        assert!(numbers(&[]).is_none());
    }
}
