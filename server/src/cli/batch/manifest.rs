//! Outcome of each volume and time step: a line of JSON each, written as soon as it is known, so that the same command can resume.

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
    /// The volume, as it was named.
    pub volume: String,
    /// The time step.
    pub step: u32,
    /// Hash of everything in volume, request and program that determines the file's bytes; `None` if the volume cannot be read or is a
    /// store over a network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity: Option<String>,
    /// Its outcome.
    #[serde(flatten)]
    pub entry: ManifestEntry,
}

/// The manifest of a folder, which no other process writes meanwhile.
pub(super) struct Manifest {
    folder: PathBuf,
    file: File,
    /// Lines of earlier commands, by their files.
    earlier: HashMap<String, Line>,
}

impl Manifest {
    /// Opens the manifest of a folder, and removes temporary files that a killed process has left.
    ///
    /// # Errors
    /// It cannot be read or written, or another process writes it.
    pub(super) fn open(folder: &Path) -> io::Result<Self> {
        let path = folder.join(MANIFEST_FILE);
        let file = File::options().create(true).append(true).open(&path)?;
        match private_folder::lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let why = "another isopeel batch writes to this folder: wait for its end, or name another folder";
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, why));
            }
            // A file system without locks.
            Err(TryLockError::Error(error)) => tracing::warn!(%error, "the manifest cannot be locked"),
        }
        for entry in std::fs::read_dir(folder)?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(BATCH_TEMPORARY) && entry.path().is_file() {
                std::fs::remove_file(entry.path())?;
            }
        }
        let text = std::fs::read(&path)?;
        // The last line may be cut off; lines of jobs have no volume.
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

    /// The line of a file that an earlier command has made of the same input, if the file is still as it was. Reads the file.
    pub(super) fn finished(&self, file: &str, identity: &str) -> Option<Line> {
        let line = self.earlier.get(file)?;
        let is_same = line.entry.state == ExtractionState::Done && line.identity.as_deref() == Some(identity);
        let expected = line.entry.sha256.as_ref().filter(|_| is_same)?;
        (checksum_of(&self.folder.join(file)).as_ref() == Some(expected)).then(|| line.clone())
    }

    /// Whether an earlier command has made a file of that name.
    pub(super) fn names(&self, file: &str) -> bool {
        self.earlier.contains_key(file)
    }

    /// Adds a line.
    pub(super) fn add(&self, line: &Line) -> io::Result<()> {
        let mut text = serde_json::to_vec(line)?;
        text.push(b'\n');
        (&self.file).write_all(&text)
    }

    /// Replaces the added lines by all lines, in order.
    pub(super) fn finish(&self, lines: &[Line]) -> io::Result<()> {
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
        manifest.add(&line("a.stl", ExtractionState::Done, sha256)).unwrap();
        manifest.add(&line("b.stl", ExtractionState::Failed, sha256)).unwrap();
        (&manifest.file).write_all(br#"{"volume":"c.nrrd","st"#).unwrap();
        drop(manifest);
        let manifest = Manifest::open(folder.path()).unwrap();
        assert!(!folder.path().join(format!("{BATCH_TEMPORARY}x")).exists());
        assert!(folder.path().join(".isopeel-x").exists());
        assert_eq!(
            manifest.finished("a.stl", "one"),
            Some(line("a.stl", ExtractionState::Done, sha256))
        );
        assert_eq!(manifest.finished("a.stl", "another"), None);
        assert_eq!(manifest.finished("b.stl", "one"), None);
        std::fs::write(folder.path().join("a.stl"), "abd").unwrap();
        assert_eq!(manifest.finished("a.stl", "one"), None, "the file is another one");
    }
}
