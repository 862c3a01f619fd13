//! Watches paths while a server runs: new and changed files in them update its catalog.
//!
//! A path is opened again when its files have changed and then were the same in two consecutive polls, so that files are probably
//! complete. Incomplete files are skipped as at the start, and are tried again when they change. If a path cannot be opened at all, its
//! datasets stay, and it is retried after ever longer pauses.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::catalog::{Catalog, SharedCatalog, Unreadable, open_path};
use super::open::slug;
use super::{Dataset, Frame, ReadError};

/// Time between two polls.
pub const INTERVAL: Duration = Duration::from_secs(2);

/// Maximum files of a path that are watched, and depth of folders below it.
const MAX_FILES: usize = 1 << 16;
const MAX_DEPTH: usize = 2;

/// Maximum polls between a failure and the next try: about a minute.
const MAX_PAUSE: u32 = 32;

/// Length and time of the last change of each file.
type Stamps = BTreeMap<PathBuf, (u64, Option<SystemTime>)>;

/// A watched path and its datasets.
struct Watched {
    path: PathBuf,
    /// Stamps of the files when the datasets were opened, and at the last poll.
    opened: Option<Stamps>,
    seen: Stamps,
    datasets: Vec<Arc<Dataset>>,
    /// Why the path cannot be read. `None` for a folder that holds no volume yet.
    unreadable: Option<Unreadable>,
    /// Failed tries since the last change, and polls until the next try.
    failures: u32,
    pause: u32,
}

/// The paths of a server.
pub struct Watcher {
    paths: Vec<Watched>,
    demo: Option<Arc<Dataset>>,
    frame: Frame,
    /// Ids by path, slug of the title, and number among the datasets with this slug in the path. A dataset keeps its id.
    ids: BTreeMap<(usize, String, usize), String>,
    catalog: SharedCatalog,
}

impl Watcher {
    /// Opens every path, as [`Catalog::open`]. A folder without volumes is watched for some; any other path that cannot be read is tried
    /// again.
    ///
    /// # Errors
    /// The demo cannot be read.
    pub fn open(paths: &[PathBuf], demo: bool, frame: Frame) -> Result<Self, ReadError> {
        let mut watcher = Self {
            paths: Vec::new(),
            demo: demo.then(super::demo).transpose()?.map(Arc::new),
            frame,
            ids: BTreeMap::new(),
            catalog: SharedCatalog::default(),
        };
        for path in paths {
            let seen = stamps(path);
            let (opened, datasets, unreadable) = match open_path(path) {
                Ok(datasets) => (Some(seen.clone()), datasets, None),
                Err(error) => {
                    tracing::warn!("nothing to offer yet: {error}");
                    let unreadable = (!path.is_dir()).then(|| Unreadable::new(path, &error));
                    (None, Vec::new(), unreadable)
                }
            };
            watcher.paths.push(Watched {
                path: path.clone(),
                opened,
                seen,
                datasets: Vec::new(),
                unreadable,
                failures: 0,
                pause: 0,
            });
            watcher.take(watcher.paths.len() - 1, datasets, &[]);
        }
        watcher.publish();
        Ok(watcher)
    }

    /// Returns the catalog, which later polls update.
    pub fn catalog(&self) -> SharedCatalog {
        self.catalog.clone()
    }

    /// Polls all paths once. Returns whether the catalog has changed.
    pub fn look(&mut self) -> bool {
        let mut changed = false;
        for at in 0..self.paths.len() {
            changed |= self.look_at(at);
        }
        if changed {
            self.publish();
        }
        changed
    }

    fn look_at(&mut self, at: usize) -> bool {
        let watched = &mut self.paths[at];
        let now = stamps(&watched.path);
        let is_stable = now == watched.seen;
        if !is_stable {
            (watched.failures, watched.pause) = (0, 0);
        }
        watched.seen = now;
        if !is_stable || watched.opened.as_ref() == Some(&watched.seen) {
            return false;
        }
        if watched.pause > 0 {
            watched.pause -= 1;
            return false;
        }
        match open_path(&watched.path) {
            Ok(datasets) => {
                let before = watched.opened.replace(watched.seen.clone()).unwrap_or_default();
                let changed = before
                    .into_iter()
                    .filter(|(file, stamp)| watched.seen.get(file) != Some(stamp));
                let changed: Vec<PathBuf> = changed.map(|(file, _)| file).collect();
                (watched.failures, watched.pause) = (0, 0);
                let was_unreadable = watched.unreadable.take().is_some();
                self.take(at, datasets, &changed) || was_unreadable
            }
            Err(error) => {
                if watched.failures == 0 {
                    tracing::warn!("kept as it was, and tried again: {error}");
                }
                watched.failures += 1;
                watched.pause = (1 << watched.failures.min(5)).min(MAX_PAUSE);
                false
            }
        }
    }

    /// Replaces the datasets of a path. `changed`: the files that differ from those of the previous datasets. Returns whether any dataset
    /// differs.
    fn take(&mut self, at: usize, datasets: Vec<Dataset>, changed: &[PathBuf]) -> bool {
        let changed = ChangedFiles::new(changed, &datasets);
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        let mut taken = Vec::new();
        for mut dataset in datasets {
            let base = slug(&dataset.title);
            let number = counts.entry(base.clone()).or_default();
            dataset.id = self.id_of(at, base, *number);
            *number += 1;
            dataset.set_frame(self.frame);
            let before = self.paths[at].datasets.iter().find(|before| before.id == dataset.id);
            taken.push(match before {
                Some(before) => successor(before, dataset, &changed),
                None => Arc::new(dataset),
            });
        }
        let before = std::mem::replace(&mut self.paths[at].datasets, taken);
        let now = &self.paths[at].datasets;
        let changed = before.len() != now.len() || before.iter().zip(now).any(|(a, b)| !Arc::ptr_eq(a, b));
        if changed && !before.is_empty() {
            tracing::info!(path = %self.paths[at].path.display(), volumes = now.len(), "the path has changed");
        }
        changed
    }

    /// Returns the id that a dataset had before, or the first free one.
    fn id_of(&mut self, at: usize, base: String, number: usize) -> String {
        let given: BTreeSet<&String> = self.ids.values().collect();
        let is_free = |id: &String| !given.contains(id) && self.demo.as_ref().is_none_or(|demo| demo.id != *id);
        let candidates = std::iter::once(base.clone()).chain((2u32..).map(|n| format!("{base}-{n}")));
        let free = candidates.into_iter().find(is_free).unwrap_or_default();
        self.ids.entry((at, base, number)).or_insert(free).clone()
    }

    fn publish(&self) {
        let datasets = self
            .paths
            .iter()
            .flat_map(|watched| &watched.datasets)
            .chain(&self.demo);
        let unreadable = self.paths.iter().filter_map(|watched| watched.unreadable.clone());
        let catalog = Catalog::of(datasets.cloned().collect(), unreadable.collect());
        self.catalog.replace(catalog);
    }
}

/// Files that have changed since the previous datasets were opened.
struct ChangedFiles<'a> {
    files: &'a [PathBuf],
    /// Whether one of them holds the samples of no step: a header or an index, which may determine the position of the samples of any step.
    any_step: bool,
}

impl<'a> ChangedFiles<'a> {
    /// `datasets`: all that are opened from the path now.
    fn new(files: &'a [PathBuf], datasets: &[Dataset]) -> Self {
        let is_of = |file: &PathBuf, dataset: &Dataset| (0..dataset.steps).any(|step| holds(dataset, step, file));
        let is_of_a_step = |file: &PathBuf| datasets.iter().any(|dataset| is_of(file, dataset));
        Self {
            files,
            any_step: !files.iter().all(is_of_a_step),
        }
    }

    /// Whether the samples of a step may have changed.
    fn change(&self, dataset: &Dataset, step: u32) -> bool {
        self.any_step || self.files.iter().any(|file| holds(dataset, step, file))
    }
}

/// Whether the samples of a step are read from a file, or from a folder that has it.
fn holds(dataset: &Dataset, step: u32, file: &Path) -> bool {
    let inputs = dataset.fields.iter().flat_map(|field| field.source.inputs(step));
    inputs.into_iter().any(|input| file.starts_with(input.path()))
}

/// Returns the successor of a dataset: the same one, if nothing has changed; one of the same revision, if it has more steps, which counts
/// for each step how often its files were rewritten; else one of the next revision.
fn successor(before: &Arc<Dataset>, mut now: Dataset, changed: &ChangedFiles<'_>) -> Arc<Dataset> {
    now.revision = before.revision;
    let times = |dataset: &Dataset, step: u32| dataset.times.as_ref().map(|times| times.label(step));
    let is_longer = now.steps > before.steps
        && (before.steps == 1 || (0..before.steps).all(|step| times(before, step) == times(&now, step)));
    match now.continues(before) {
        true if changed.files.is_empty() && now.steps == before.steps && now.times == before.times => {
            Arc::clone(before)
        }
        true if is_longer => {
            let rewrites = |step| before.rewrites(step) + u32::from(changed.change(&now, step));
            now.rewrites = (0..before.steps).map(rewrites).collect();
            Arc::new(now)
        }
        _ => {
            now.revision += 1;
            Arc::new(now)
        }
    }
}

/// Returns the stamps of the files of a path, of a folder those in it and in folders below it.
fn stamps(path: &Path) -> Stamps {
    let mut stamps = Stamps::new();
    collect(path, 0, &mut stamps);
    stamps
}

/// Errors are ignored: what cannot be read now may be readable at the next poll.
fn collect(path: &Path, depth: usize, stamps: &mut Stamps) {
    let Ok(metadata) = std::fs::metadata(path) else { return };
    if !metadata.is_dir() {
        stamps.insert(path.to_owned(), (metadata.len(), metadata.modified().ok()));
        return;
    }
    let Ok(entries) = std::fs::read_dir(path) else { return };
    for entry in entries.flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if stamps.len() >= MAX_FILES {
            return;
        }
        if !is_folder || depth < MAX_DEPTH {
            collect(&entry.path(), depth + 1, stamps);
        }
    }
}
