//! Volumes that are folders of many files, for the tests of their formats.

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

use isopeel::volumes::{Dataset, ReadError, open_dataset};

/// Path in the folder, and content.
pub type StoredFile = (PathBuf, Vec<u8>);

/// Where a fixture is.
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

    /// The folder as it was written, but for one file. What the last case changed is put back by the next, since a case that fails has no end.
    pub fn with(&self, at: usize, bytes: &[u8]) -> &tempfile::TempDir {
        let write = |at: usize, bytes: &[u8]| {
            fs::write(self.folder.path().join(self.name).join(&self.files[at].0), bytes).unwrap();
        };
        let last = self.changed.replace(at);
        write(last, &self.files[last].1);
        write(at, bytes);
        &self.folder
    }

    /// Its files as they were written.
    pub fn files(&self) -> &[StoredFile] {
        &self.files
    }
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
