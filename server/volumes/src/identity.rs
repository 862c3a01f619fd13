//! Identity of the files that time steps are read from: size, time of the last change and hash of each. A batch job whose files change
//! while it runs would mix the surfaces of two volumes, so it ends as `input-changed`.
//!
//! The hash is XXH3 with 128 bits: of a whole file up to [`WHOLE_BYTES`]; of a longer file, of [`BLOCKS`] blocks, evenly spaced from its
//! first byte to its last. It detects replaced files; it does not resist an attacker who makes two files with one hash.

use std::collections::{BTreeSet, HashMap};
use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use super::{Dataset, DatasetKey, VolumeStep};

/// A file up to this size is hashed as a whole: that takes less than a tenth of a second.
const WHOLE_BYTES: u64 = 64 << 20;
/// Number of blocks of a longer file that are hashed, 64 MiB in all.
const BLOCKS: u64 = 64;
const BLOCK_BYTES: u64 = 1 << 20;
/// Maximum bytes that are hashed for an export, which takes a tenth of a second: the hash only identifies the source of the surface.
const QUICK_BYTES: u64 = 256 << 20;
/// Maximum files of a job, chunks of a Zarr folder among them: they are kept by name, some 100 bytes each.
const MAX_FILES: usize = 100_000;

/// Size and time of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    size: u64,
    /// Nanoseconds since 1970.
    modified: i64,
}

/// One file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Pinned {
    path: PathBuf,
    stamp: Stamp,
    /// Hexadecimal.
    hash: String,
}

/// The files of time steps, and what their headers stated when they were hashed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputIdentity {
    files: Vec<Pinned>,
    /// Hash of grid and fields.
    header: String,
}

/// Why an input is not that of a job, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file has changed.
    #[error("{file}: {what} since {since}")]
    Changed {
        /// Its name, without its folder.
        file: String,
        /// What has changed.
        what: &'static str,
        /// The time of the earlier check, for the message.
        since: &'static str,
    },
    /// A file cannot be read.
    #[error("{file} cannot be read")]
    Unreadable {
        /// Its name, without its folder.
        file: String,
        /// Why not.
        source: io::Error,
    },
    /// A store over a network says neither what it holds nor when that changes.
    #[error(
        "volume {0:?} is read over a network, expected one in files of the server's machine: nothing else can be pinned"
    )]
    Network(String),
    /// More files than are kept.
    #[error("the job reads more than {MAX_FILES} files, expected fewer time steps or larger chunks")]
    TooManyFiles,
}

/// Stamps of the files of a server's volumes when they were first seen. Detects files that changed after their headers were read and before
/// they are pinned by a job.
#[derive(Debug, Default)]
pub struct SeenFiles(Mutex<HashMap<SeenFile, Stamp>>);

/// A file of a dataset, with the rewrite counts of the dataset's steps.
type SeenFile = (DatasetKey, Vec<u32>, PathBuf);

const SINCE_OPENED: &str = "it was opened, start again";
const SINCE_SUBMITTED: &str = "the job was submitted";

impl SeenFiles {
    /// Records the files of a dataset that were not seen before. Ignores errors: they are reported when a job is submitted.
    pub fn note(&self, dataset: &Dataset) {
        for input in inputs(dataset, 0..dataset.steps).into_iter().flatten() {
            let mut paths = BTreeSet::new();
            let _ = add_files(input, &mut paths).and_then(|()| self.check(dataset, &paths));
        }
    }

    /// Checks that files of a dataset are as they were when they were first seen.
    fn check(&self, dataset: &Dataset, paths: &BTreeSet<PathBuf>) -> Result<(), IdentityError> {
        for path in paths {
            let now = stamp(path)?;
            let mut seen = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let before = seen
                .entry((dataset.key(), dataset.rewrites.clone(), path.clone()))
                .or_insert_with(|| now.clone());
            compare(path, before, &now, SINCE_OPENED)?;
        }
        Ok(())
    }
}

impl InputIdentity {
    /// Returns the identity of the files of these time steps as they are now. Reads the files.
    ///
    /// # Errors
    /// [`IdentityError`].
    pub fn of(dataset: &Dataset, steps: &BTreeSet<u32>, seen: &SeenFiles) -> Result<Self, IdentityError> {
        let mut paths = BTreeSet::new();
        for input in inputs(dataset, steps.iter().copied())? {
            add_files(input, &mut paths)?;
        }
        seen.check(dataset, &paths)?;
        let pin = |path: PathBuf| {
            let (stamp, hash) = (stamp(&path)?, hash(&path)?);
            Ok(Pinned { path, stamp, hash })
        };
        Ok(Self {
            files: paths.into_iter().map(pin).collect::<Result<_, _>>()?,
            header: header(dataset),
        })
    }

    /// Returns [`InputIdentity::content`] of [`InputIdentity::of`] if reading the files takes little time. `None` for a store over a
    /// network, for files that cannot be read, and for files with more than [`QUICK_BYTES`] to be hashed, as most folders of Zarr.
    pub fn quick_content(volume: &VolumeStep) -> Option<String> {
        let (dataset, mut paths) = (volume.dataset(), BTreeSet::new());
        for input in inputs(dataset, std::iter::once(volume.step())).ok()? {
            add_files(input, &mut paths).ok()?;
        }
        let mut left = QUICK_BYTES;
        for path in &paths {
            left = left.checked_sub(stamp(path).ok()?.size.min(WHOLE_BYTES))?;
        }
        let steps = BTreeSet::from([volume.step()]);
        let identity = Self::of(dataset, &steps, &SeenFiles::default()).ok()?;
        Some(identity.content())
    }

    /// Returns a hash of all contents, which does not depend on the files' paths.
    pub fn content(&self) -> String {
        let mut hasher = Xxh3::new();
        for hash in self.files.iter().map(|pinned| &pinned.hash).chain([&self.header]) {
            hasher.update(hash.as_bytes());
        }
        hex(&hasher)
    }

    /// Checks that all files have the same size and time as before.
    ///
    /// # Errors
    /// [`IdentityError::Changed`] or [`IdentityError::Unreadable`].
    pub fn check_stamps(&self, dataset: &Dataset) -> Result<(), IdentityError> {
        if self.header != header(dataset) {
            return Err(IdentityError::Changed {
                file: dataset.id.clone(),
                what: "its grid or its fields changed",
                since: SINCE_SUBMITTED,
            });
        }
        for pinned in &self.files {
            compare(&pinned.path, &pinned.stamp, &stamp(&pinned.path)?, SINCE_SUBMITTED)?;
        }
        Ok(())
    }

    /// As [`InputIdentity::check_stamps`]; also checks that the files have the same content.
    ///
    /// # Errors
    /// [`IdentityError::Changed`] or [`IdentityError::Unreadable`].
    pub fn check(&self, dataset: &Dataset) -> Result<(), IdentityError> {
        self.check_stamps(dataset)?;
        for pinned in &self.files {
            if hash(&pinned.path)? != pinned.hash {
                return Err(IdentityError::Changed {
                    file: name(&pinned.path),
                    what: "its content changed",
                    since: SINCE_SUBMITTED,
                });
            }
        }
        Ok(())
    }
}

fn compare(path: &Path, before: &Stamp, now: &Stamp, since: &'static str) -> Result<(), IdentityError> {
    let what = if before.size != now.size {
        "its size changed"
    } else if before.modified != now.modified {
        "it was written"
    } else {
        return Ok(());
    };
    Err(IdentityError::Changed {
        file: name(path),
        what,
        since,
    })
}

/// Returns a hash of grid and fields: headers may change these while the samples stay the same.
fn header(dataset: &Dataset) -> String {
    let fields = dataset.fields.iter();
    let fields: Vec<_> = fields.map(|f| (&f.name, &f.stored_type, f.missing)).collect();
    let mut hasher = Xxh3::new();
    hasher.update(format!("{:?} {fields:?}", dataset.geometry).as_bytes());
    if let Some(uneven) = &dataset.uneven {
        hasher.update(format!("{uneven:?}").as_bytes());
    }
    hex(&hasher)
}

/// Returns the files and folders that time steps are read from, each once: a Zarr folder holds all steps.
fn inputs(dataset: &Dataset, steps: impl Iterator<Item = u32>) -> Result<BTreeSet<PathBuf>, IdentityError> {
    let mut found = BTreeSet::new();
    for step in steps {
        for input in dataset.fields.iter().flat_map(|field| field.source.inputs(step)) {
            if input.address().is_some() {
                return Err(IdentityError::Network(dataset.id.clone()));
            }
            // Files in memory are a part of the program, as the demo.
            if !input.is_in_memory() {
                found.insert(input.path().to_owned());
            }
        }
    }
    Ok(found)
}

/// Adds a file, or all files below a folder.
fn add_files(input: PathBuf, paths: &mut BTreeSet<PathBuf>) -> Result<(), IdentityError> {
    let mut open = vec![input];
    while let Some(path) = open.pop() {
        if !path.is_dir() {
            paths.insert(path);
            if paths.len() > MAX_FILES {
                return Err(IdentityError::TooManyFiles);
            }
            continue;
        }
        let fail = |source| unreadable(&path, source);
        for entry in std::fs::read_dir(&path).map_err(fail)? {
            open.push(entry.map_err(fail)?.path());
        }
        if paths.len() + open.len() > MAX_FILES {
            return Err(IdentityError::TooManyFiles);
        }
    }
    Ok(())
}

fn stamp(path: &Path) -> Result<Stamp, IdentityError> {
    let of = |metadata: Metadata| {
        let modified = metadata.modified()?;
        let since = modified.duration_since(UNIX_EPOCH);
        let nanoseconds = since.map_or_else(|before| -(before.duration().as_nanos() as i64), |d| d.as_nanos() as i64);
        Ok(Stamp {
            size: metadata.len(),
            modified: nanoseconds,
        })
    };
    std::fs::metadata(path)
        .and_then(of)
        .map_err(|source| unreadable(path, source))
}

fn hash(path: &Path) -> Result<String, IdentityError> {
    let hashed = || {
        let mut file = File::open(path)?;
        let (size, mut hasher) = (file.metadata()?.len(), Xxh3::new());
        let mut block = vec![0; BLOCK_BYTES as usize];
        if size <= WHOLE_BYTES {
            loop {
                match file.read(&mut block)? {
                    0 => break,
                    read => hasher.update(&block[..read]),
                }
            }
        } else {
            for i in 0..BLOCKS {
                let at = u128::from(size - BLOCK_BYTES) * u128::from(i) / u128::from(BLOCKS - 1);
                file.read_exact_at(&mut block, at as u64)?;
                hasher.update(&block);
            }
        }
        Ok(hex(&hasher))
    };
    hashed().map_err(|source| unreadable(path, source))
}

fn hex(hasher: &Xxh3) -> String {
    format!("{:032x}", hasher.digest128())
}

fn unreadable(path: &Path, source: io::Error) -> IdentityError {
    IdentityError::Unreadable {
        file: name(path),
        source,
    }
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;
    use crate::open_dataset;

    /// 2³ bytes in a text header's file of their own.
    fn volume(folder: &Path) -> (PathBuf, Dataset) {
        let header = folder.join("a.nhdr");
        let text = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\ndata file: a.raw\n\n";
        std::fs::write(&header, text).unwrap();
        let data = folder.join("a.raw");
        std::fs::write(&data, [1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
        (data, open_dataset(&header).unwrap())
    }

    fn set_time(path: &Path, time: SystemTime) {
        File::options()
            .write(true)
            .open(path)
            .unwrap()
            .set_modified(time)
            .unwrap();
    }

    #[test]
    fn each_change_of_a_file_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let (data, dataset) = volume(folder.path());
        let time = std::fs::metadata(&data).unwrap().modified().unwrap();
        let identity = InputIdentity::of(&dataset, &BTreeSet::from([0]), &SeenFiles::default()).unwrap();
        let text = serde_json::to_string(&identity).unwrap();
        assert_eq!(serde_json::from_str::<InputIdentity>(&text).unwrap(), identity);
        identity.check(&dataset).unwrap();
        let found = |expected: &str, stamps_alone: bool| {
            for checked in [identity.check(&dataset), identity.check_stamps(&dataset)]
                .into_iter()
                .take(1 + usize::from(stamps_alone))
            {
                let error = checked.unwrap_err().to_string();
                assert_eq!(error, expected);
            }
        };

        set_time(&data, time + Duration::from_nanos(1_000));
        found("a.raw: it was written since the job was submitted", true);
        std::fs::write(&data, [1, 2, 3, 4, 5, 6, 7, 9]).unwrap();
        set_time(&data, time);
        identity.check_stamps(&dataset).unwrap();
        found("a.raw: its content changed since the job was submitted", false);
        std::fs::write(&data, [1; 9]).unwrap();
        found("a.raw: its size changed since the job was submitted", true);
        std::fs::remove_file(&data).unwrap();
        found("a.raw cannot be read", true);
    }

    #[test]
    fn another_grid_is_another_input() {
        let folder = tempfile::tempdir().unwrap();
        let (_, mut dataset) = volume(folder.path());
        let identity = InputIdentity::of(&dataset, &BTreeSet::from([0]), &SeenFiles::default()).unwrap();
        dataset.geometry.spacing[2] = 3.0;
        let error = identity.check(&dataset).unwrap_err().to_string();
        assert_eq!(error, "a: its grid or its fields changed since the job was submitted");
    }

    #[test]
    fn a_file_that_changed_after_it_was_opened_is_not_pinned() {
        let folder = tempfile::tempdir().unwrap();
        let (data, dataset) = volume(folder.path());
        let seen = SeenFiles::default();
        seen.note(&dataset);
        InputIdentity::of(&dataset, &BTreeSet::from([0]), &seen).unwrap();
        std::fs::write(&data, [1; 9]).unwrap();
        let error = InputIdentity::of(&dataset, &BTreeSet::from([0]), &seen)
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("a.raw: its size changed since it was opened"),
            "{error}"
        );
    }

    #[test]
    fn of_a_long_file_blocks_from_the_first_byte_to_the_last_are_hashed() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let size = WHOLE_BYTES + 5;
        // Sparse: it takes no space.
        file.as_file().set_len(size).unwrap();
        let empty = hash(file.path()).unwrap();
        for at in [0, size - 1] {
            file.as_file().write_at(&[1], at).unwrap();
            let changed = hash(file.path()).unwrap();
            assert_ne!(changed, empty, "byte {at}");
            file.as_file().write_at(&[0], at).unwrap();
        }
        assert_eq!(hash(file.path()).unwrap(), empty);
    }
}
