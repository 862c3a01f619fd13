//! Volumes that are folders of many files, for the tests of their formats.

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

use isopeel_volumes::{Dataset, ReadError, open_dataset};
use proptest::prelude::*;
use proptest::sample::Index;

use crate::bounds::within;
use crate::changed;

/// Path in the folder, and content.
pub type StoredFile = (PathBuf, Vec<u8>);

/// Path of a fixture.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures/volumes")
        .join(name)
}

/// Files of a folder, sorted by path.
pub fn files(folder: &Path) -> Vec<StoredFile> {
    fn walk(root: &Path, folder: &Path, out: &mut Vec<StoredFile>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(root, &path, out);
            } else {
                out.push((path.strip_prefix(root).unwrap().to_owned(), fs::read(&path).unwrap()));
            }
        }
    }
    let mut out = Vec::new();
    walk(folder, folder, &mut out);
    out.sort();
    out
}

/// Writes a folder of that name into a new one.
pub fn write(name: &str, files: &[StoredFile]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (path, bytes) in files {
        let path = folder.path().join(name).join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder
}

/// A folder on a disk, of which one file after the other is changed: writing all of them for each case would take most of its time.
pub struct Changing<'a> {
    folder: tempfile::TempDir,
    name: &'a str,
    files: Vec<StoredFile>,
    /// The file that was changed last.
    changed: Cell<usize>,
}

impl<'a> Changing<'a> {
    /// Writes a folder of that name.
    pub fn new(name: &'a str, files: Vec<StoredFile>) -> Self {
        Self {
            folder: write(name, &files),
            name,
            files,
            changed: Cell::new(0),
        }
    }

    /// Returns the folder as it was written, except for the file `at`. Restores the file that the last case changed first: a case that
    /// fails cannot do so itself.
    fn with(&self, at: usize, bytes: &[u8]) -> &tempfile::TempDir {
        let write = |at: usize, bytes: &[u8]| {
            fs::write(self.folder.path().join(self.name).join(&self.files[at].0), bytes).unwrap();
        };
        let last = self.changed.replace(at);
        write(last, &self.files[last].1);
        write(at, bytes);
        &self.folder
    }
}

/// For each of `cases` random cases of a format, changes bytes of one file of one of these folders, perhaps truncates it, and reads the
/// folder.
pub fn change_bytes<T>(
    format: &str,
    cases: u32,
    folders: &[Changing<'_>],
    bytes: impl Strategy<Value = Vec<changed::Change>>,
    read: impl Fn(&tempfile::TempDir) -> T,
) {
    let strategy = (0..folders.len(), any::<Index>(), bytes, changed::cut());
    changed::each(format, cases, &strategy, |(which, file, changes, cut)| {
        let folder = &folders[which];
        let at = file.index(folder.files.len());
        let mut bytes = folder.files[at].1.clone();
        changed::change_and_cut(&mut bytes, changes, cut);
        let folder = folder.with(at, &bytes);
        let _ = within(64 << 20, || read(folder));
    });
}

/// The same with digits of the file at an index, of each folder's own.
pub fn change_digits<T>(
    format: &str,
    cases: u32,
    folders: &[Changing<'_>],
    file: impl Fn(&[StoredFile]) -> usize,
    read: impl Fn(&tempfile::TempDir) -> T,
) {
    let strategy = (0..folders.len(), changed::digits());
    changed::each(format, cases, &strategy, |(which, changes)| {
        let folder = &folders[which];
        let at = file(&folder.files);
        let mut bytes = folder.files[at].1.clone();
        changed::change_digits(&mut bytes, changes);
        let folder = folder.with(at, &bytes);
        let _ = within(64 << 20, || read(folder));
    });
}

/// Opens that folder, and reads the first step of all fields.
pub fn read(folder: &tempfile::TempDir, name: &str) -> Result<Dataset, ReadError> {
    let dataset = open_dataset(&folder.path().join(name))?;
    for field in &dataset.fields {
        let samples = field.source.load(0)?;
        assert_eq!(samples.len() as u64, dataset.geometry.sample_count());
        assert_eq!(samples.sample_type(), field.sample_type);
    }
    Ok(dataset)
}
