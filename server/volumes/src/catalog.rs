//! The datasets of a server, by id.
//!
//! Every path given to `isopeel serve` is one dataset: a file, or a folder whose files share one grid. If the files of a folder do not
//! share one grid, each is a dataset of its own (`extract` and `info` need one dataset and refuse such a folder). An unreadable file in
//! a folder is skipped with a notice. If a path cannot be read, the server serves the others and lists the path with the reason.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use super::location::title_of;
use super::open::{assemble, join, list_folder, open_dataset, open_folder_format, read_file};
use super::private::{PrivateVolumes, Reader};
use super::{Dataset, FileLocation, Frame, Notices, OpenedFile, ReadError};

/// Datasets with unique ids, in the order of their paths.
#[derive(Clone, Debug, Default)]
pub struct Catalog {
    datasets: Vec<Arc<Dataset>>,
    unreadable: Vec<Unreadable>,
}

/// A path that was given to the server and that it cannot read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unreadable {
    /// Last component of the path: clients do not see the names of folders.
    pub name: String,
    /// What is wrong with it.
    pub reason: String,
}

impl Unreadable {
    pub(super) fn new(path: &Path, error: &ReadError) -> Self {
        let name = path.file_name().unwrap_or(path.as_os_str());
        let name = name.to_string_lossy().into_owned();
        let reason = error.without_folder();
        let reason = reason.strip_prefix(&format!("{name}: ")).unwrap_or(&reason).to_owned();
        Self { name, reason }
    }
}

impl Catalog {
    /// Opens every path, then the embedded demo if `demo` is set. Reads headers, not samples. A path that cannot be read is listed as
    /// [unreadable](Self::unreadable), if another one can be read.
    ///
    /// # Errors
    /// What is wrong with the first path, if none of them can be read.
    pub fn open(paths: &[PathBuf], demo: bool) -> Result<Self, ReadError> {
        let mut catalog = Self::default();
        let mut first = None;
        for path in paths {
            match open_path(path) {
                Ok(datasets) => datasets.into_iter().for_each(|d| catalog.add(d)),
                Err(error) => {
                    tracing::error!("not served: {error}");
                    catalog.unreadable.push(Unreadable::new(path, &error));
                    first.get_or_insert(error);
                }
            }
        }
        if let Some(error) = first.filter(|_| catalog.datasets.is_empty()) {
            return Err(error);
        }
        if demo {
            catalog.add(super::demo()?);
        }
        Ok(catalog)
    }

    /// Datasets whose ids differ, and paths that cannot be read.
    pub(super) fn of(datasets: Vec<Arc<Dataset>>, unreadable: Vec<Unreadable>) -> Self {
        Self { datasets, unreadable }
    }

    /// The paths that cannot be read, in the order in which they were named.
    pub fn unreadable(&self) -> &[Unreadable] {
        &self.unreadable
    }

    /// The same datasets with their positions in another frame, as [`Dataset::set_frame`].
    #[must_use]
    pub fn in_frame(mut self, frame: Frame) -> Self {
        for dataset in &mut self.datasets {
            let dataset = Arc::make_mut(dataset);
            dataset.set_frame(frame);
        }
        self
    }

    /// Adds a dataset. If its id exists, the first free one of `-2`, `-3`, … is appended.
    pub fn add(&mut self, mut dataset: Dataset) {
        let taken: HashSet<&str> = self.datasets.iter().map(|d| d.id.as_str()).collect();
        if taken.contains(dataset.id.as_str()) {
            let free = (2u32..)
                .map(|n| format!("{}-{n}", dataset.id))
                .find(|id| !taken.contains(id.as_str()));
            dataset.id = free.unwrap_or_default();
        }
        self.datasets.push(Arc::new(dataset));
    }

    /// All datasets, in the order of their paths, the demo last.
    pub fn datasets(&self) -> &[Arc<Dataset>] {
        &self.datasets
    }

    /// Returns the dataset with this id.
    pub fn get(&self, id: &str) -> Option<&Arc<Dataset>> {
        self.datasets.iter().find(|d| d.id == id)
    }
}

/// The public catalog of a running server, which may be replaced, and the private volumes. Clones are cheap and share both.
#[derive(Clone, Debug, Default)]
pub struct SharedCatalog {
    /// Locked only while the pointer is read or replaced.
    current: Arc<RwLock<Arc<Catalog>>>,
    private: PrivateVolumes,
}

impl From<Catalog> for SharedCatalog {
    fn from(catalog: Catalog) -> Self {
        Self {
            current: Arc::new(RwLock::new(Arc::new(catalog))),
            private: PrivateVolumes::default(),
        }
    }
}

impl SharedCatalog {
    /// Returns the dataset with this id, if the reader may see it.
    pub fn find(&self, id: &str, who: Reader<'_>) -> Option<Arc<Dataset>> {
        let public = self.now().get(id).map(Arc::clone);
        public.or_else(|| self.private.find(id, who))
    }

    /// Returns all datasets that the reader may see: the public catalog's first, then private ones.
    pub fn list(&self, who: Reader<'_>) -> Vec<Arc<Dataset>> {
        let mut datasets = self.now().datasets().to_vec();
        datasets.extend(self.private.list(who));
        datasets
    }

    /// Returns the private volumes.
    pub fn private(&self) -> &PrivateVolumes {
        &self.private
    }

    /// Returns a snapshot of the public catalog.
    pub fn now(&self) -> Arc<Catalog> {
        Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Replaces the public catalog. Holders of a dataset of the previous catalog keep it.
    pub fn replace(&self, catalog: Catalog) {
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(catalog);
    }
}

/// Opens the datasets of a path: one, or several if the files of a folder do not share one grid.
///
/// # Errors
/// What is wrong with the path.
pub fn open_path(path: &Path) -> Result<Vec<Dataset>, ReadError> {
    if let Some(volumes) = open_folder_format(&FileLocation::named(path)) {
        volumes
    } else if path.is_dir() {
        open_folder(path)
    } else {
        Ok(vec![open_dataset(path)?])
    }
}

/// Opens each volume of a path on its own, with its own path, so that a file that cannot be read does not keep the others from being
/// read.
pub fn open_each(path: &Path) -> Vec<(PathBuf, Result<Dataset, ReadError>)> {
    let named = |error| vec![(path.to_owned(), Err(error))];
    let numbered = |n: usize| PathBuf::from(format!("{}:{n}", path.display()));
    match open_folder_format(&FileLocation::named(path)) {
        Some(Err(error)) => named(error),
        Some(Ok(mut volumes)) if volumes.len() == 1 => vec![(path.to_owned(), Ok(volumes.remove(0)))],
        Some(Ok(volumes)) => (1..).map(numbered).zip(volumes.into_iter().map(Ok)).collect(),
        None if path.is_dir() => match list_folder(path) {
            Err(error) => named(error),
            Ok(files) => {
                let open = |location: FileLocation| {
                    let opened = read_file(&location);
                    let opened = opened.and_then(|file| join(&location.stem(), vec![(location.clone(), file)]));
                    (location.path().to_owned(), opened)
                };
                files.into_iter().map(open).collect()
            }
        },
        None => vec![(path.to_owned(), open_dataset(path))],
    }
}

fn open_folder(folder: &Path) -> Result<Vec<Dataset>, ReadError> {
    let mut files = Vec::new();
    let mut last_error = None;
    let mut passed_over = Notices::default();
    for location in list_folder(folder)? {
        match read_file(&location) {
            Ok(file) => files.push((location, file)),
            Err(error) => {
                passed_over.add(format!(
                    "a file of its folder is passed over: {}",
                    error.without_folder()
                ));
                last_error = Some(error);
            }
        }
    }
    if files.is_empty() {
        // Reached only if every file failed: `list_folder` returns no empty list.
        return last_error.map_or(Ok(Vec::new()), Err);
    }
    let mut datasets = match assemble(&title_of(folder), files.clone()) {
        Ok(dataset) => vec![dataset],
        Err(clash) => {
            passed_over.add(format!(
                "each file of its folder is a volume of its own: {}",
                clash.without_folder()
            ));
            let alone = |(location, file): (FileLocation, OpenedFile)| join(&location.stem(), vec![(location, file)]);
            files.into_iter().map(alone).collect::<Result<_, _>>()?
        }
    };
    passed_over.log(folder);
    for dataset in &mut datasets {
        dataset.notices.extend(passed_over.clone());
    }
    Ok(datasets)
}
