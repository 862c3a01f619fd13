//! The manifest of a batch: a line of JSON for each volume and time step. The line is written as soon as the outcome is known, so that a
//! repeated command continues an interrupted batch.

use std::collections::HashMap;
use std::fs::{File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cli::jobs::{MANIFEST_FILE, checksum_of, write_manifest};
use crate::cli::output::BATCH_TEMPORARY;
use crate::jobs::{ExtractionState, ManifestEntry};
use crate::private_folder;

/// A line of the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Line {
    /// Path of the volume as on the command line.
    pub volume: String,
    /// The time step.
    pub step: u32,
    /// Hash of volume, request and program version, which determine the bytes of the file. `None` if the volume cannot be read, or is on a
    /// network store.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity: Option<String>,
    /// The outcome.
    #[serde(flatten)]
    pub entry: ManifestEntry,
}

/// The manifest of an output folder. Its file is locked, so that no other process writes to the folder at the same time.
pub(super) struct Manifest {
    folder: PathBuf,
    file: File,
    /// Lines that earlier commands have written, by file names.
    earlier: HashMap<String, Line>,
}

impl Manifest {
    /// Opens the manifest of a folder, and removes temporary files that a killed process has left.
    ///
    /// # Errors
    /// The manifest cannot be read or written, or another process has locked it.
    pub(super) fn open(folder: &Path) -> io::Result<Self> {
        let path = folder.join(MANIFEST_FILE);
        let file = File::options().create(true).append(true).open(&path)?;
        match private_folder::lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let why = "another isopeel batch writes to this folder: wait for its end, or name another folder";
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, why));
            }
            // Continues without a lock if the file system does not support locks.
            Err(TryLockError::Error(error)) => tracing::warn!(%error, "the manifest cannot be locked"),
        }
        for entry in std::fs::read_dir(folder)?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(BATCH_TEMPORARY) && entry.path().is_file() {
                std::fs::remove_file(entry.path())?;
            }
        }
        let text = std::fs::read(&path)?;
        // Skips a truncated last line, and lines of batch jobs, which name no volume.
        let lines = text
            .split(|&byte| byte == b'\n')
            .flat_map(serde_json::from_slice::<Line>);
        let earlier = lines
            .filter_map(|line| Some((line.entry.file.clone()?, line)))
            .collect();
        let manifest = Self {
            folder: folder.to_owned(),
            file,
            earlier,
        };
        if text.last().is_some_and(|&byte| byte != b'\n') {
            (&manifest.file).write_all(b"\n")?;
        }
        Ok(manifest)
    }

    /// Returns the line of a file that an earlier command has made from input with this identity. Returns `None` if there is no such line,
    /// or if the file has changed since. Reads the whole file to compare its checksum.
    pub(super) fn find_finished(&self, file: &str, identity: &str) -> Option<Line> {
        let line = self.earlier.get(file)?;
        let is_same = line.entry.state == ExtractionState::Done && line.identity.as_deref() == Some(identity);
        let expected = line.entry.sha256.as_ref().filter(|_| is_same)?;
        (checksum_of(&self.folder.join(file)).as_ref() == Some(expected)).then(|| line.clone())
    }

    /// Whether an earlier command has written a line for a file with this name.
    pub(super) fn contains(&self, file: &str) -> bool {
        self.earlier.contains_key(file)
    }

    /// Appends a line.
    ///
    /// # Errors
    /// The manifest cannot be written.
    pub(super) fn append(&self, line: &Line) -> io::Result<()> {
        let mut text = serde_json::to_vec(line)?;
        text.push(b'\n');
        (&self.file).write_all(&text)
    }

    /// Replaces the manifest by these lines.
    ///
    /// # Errors
    /// The manifest cannot be written.
    pub(super) fn rewrite(&self, lines: &[Line]) -> io::Result<()> {
        write_manifest(&self.folder.join(MANIFEST_FILE), lines)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(file: &str, state: ExtractionState, sha256: &str) -> Line {
        Line {
            volume: "a.nrrd".to_owned(),
            step: 0,
            identity: Some("one".to_owned()),
            entry: ManifestEntry {
                state,
                file: Some(file.to_owned()),
                sha256: Some(sha256.to_owned()),
                ..ManifestEntry::waiting(0)
            },
        }
    }

    #[test]
    fn what_is_finished_is_known_from_lines_that_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.stl"), "abc").unwrap();
        std::fs::write(folder.path().join(format!("{BATCH_TEMPORARY}x")), "cut off").unwrap();
        // Of an isopeel extract that runs.
        std::fs::write(folder.path().join(".isopeel-x"), "not complete").unwrap();
        let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let manifest = Manifest::open(folder.path()).unwrap();
        assert!(Manifest::open(folder.path()).is_err(), "it is locked");
        manifest.append(&line("a.stl", ExtractionState::Done, sha256)).unwrap();
        manifest
            .append(&line("b.stl", ExtractionState::Failed, sha256))
            .unwrap();
        (&manifest.file).write_all(br#"{"volume":"c.nrrd","st"#).unwrap();
        drop(manifest);
        let manifest = Manifest::open(folder.path()).unwrap();
        assert!(!folder.path().join(format!("{BATCH_TEMPORARY}x")).exists());
        assert!(folder.path().join(".isopeel-x").exists());
        assert_eq!(
            manifest.find_finished("a.stl", "one"),
            Some(line("a.stl", ExtractionState::Done, sha256))
        );
        assert_eq!(manifest.find_finished("a.stl", "another"), None);
        assert_eq!(manifest.find_finished("b.stl", "one"), None);
        std::fs::write(folder.path().join("a.stl"), "abd").unwrap();
        assert_eq!(manifest.find_finished("a.stl", "one"), None, "the file is another one");
    }
}
