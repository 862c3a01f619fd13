//! Opens the volumes that the arguments name, and assigns a name for its files to each volume.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use isopeel_volumes::{Dataset, ReadError, open_each};

use super::BatchError;
use crate::export::safe_name;

/// An input volume.
pub(super) struct Input {
    /// Path as the user has written it.
    pub path: PathBuf,
    /// Name of the files of this volume, without step and extension. No other input has the same name.
    pub name: String,
    /// The volume, whose samples are not read yet, or the error of its header.
    pub dataset: Result<Dataset, ReadError>,
}

/// Opens the volumes of all arguments, in their order. Skips repeated paths.
///
/// # Errors
/// A pattern is invalid, or no file matches it.
pub(super) fn open_all(arguments: &[PathBuf]) -> Result<Vec<Input>, BatchError> {
    let mut seen = HashSet::new();
    let mut opened = Vec::new();
    for argument in arguments {
        for path in expand(argument)? {
            opened.extend(
                open_each(&path)
                    .into_iter()
                    .filter(|(path, _)| seen.insert(path.clone())),
            );
        }
    }
    let titled = opened.iter().map(|(path, dataset)| {
        let title = dataset
            .as_ref()
            .map_or_else(|_| title_of(path), |dataset| dataset.title.clone());
        (path.as_path(), title)
    });
    let names = distinct_names(&titled.collect::<Vec<_>>());
    let inputs = opened.into_iter().zip(names);
    Ok(inputs
        .map(|((path, dataset), name)| Input { path, name, dataset })
        .collect())
}

fn title_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the files that match an argument with `*`, `?` or `[`. Returns an existing path, an address, or any other argument as it is.
fn expand(argument: &Path) -> Result<Vec<PathBuf>, BatchError> {
    let pattern = argument.to_string_lossy();
    let is_pattern = !argument.exists() && !pattern.contains("://") && pattern.contains(['*', '?', '[']);
    if !is_pattern {
        return Ok(vec![argument.to_owned()]);
    }
    let matches = glob::glob(&pattern).map_err(|source| BatchError::Pattern {
        pattern: pattern.clone().into_owned(),
        source,
    })?;
    // Skips paths that cannot be accessed.
    let paths: Vec<PathBuf> = matches.flatten().collect();
    if paths.is_empty() {
        return Err(BatchError::NoMatch(pattern.into_owned()));
    }
    Ok(paths)
}

/// Returns distinct file names for volumes with these paths and titles. A name is the title, preceded by the names of as many folders as
/// are necessary.
fn distinct_names(titled: &[(&Path, String)]) -> Vec<String> {
    let deepest = titled
        .iter()
        .map(|(path, _)| path.components().count())
        .max()
        .unwrap_or(0);
    let mut names: Vec<String> = titled
        .iter()
        .map(|(path, title)| qualified_name(path, title, 0))
        .collect();
    for folders in 1..=deepest {
        let mut counts: HashMap<String, usize> = HashMap::new();
        names
            .iter()
            .for_each(|name| *counts.entry(fold_case(name)).or_default() += 1);
        if counts.values().all(|&count| count == 1) {
            return names;
        }
        for (name, (path, title)) in names.iter_mut().zip(titled) {
            if counts[&fold_case(name)] > 1 {
                *name = qualified_name(path, title, folders);
            }
        }
    }
    // Folders cannot distinguish several volumes in one file, or names that are equal after `safe_name`.
    number_duplicates(&mut names);
    names
}

/// Returns a title, preceded by the names of the `folders` innermost folders of the path, as a name for files.
fn qualified_name(path: &Path, title: &str, folders: usize) -> String {
    let parents = path.parent().into_iter().flat_map(Path::components);
    let parents: Vec<String> = parents
        .map(|part| part.as_os_str().to_string_lossy().into_owned())
        .collect();
    let innermost = parents[parents.len().saturating_sub(folders)..]
        .iter()
        .map(String::as_str);
    let parts: Vec<String> = innermost.chain([title]).map(safe_name).collect();
    parts.join("-")
}

/// Appends `-2`, `-3` and so on to names that are equal to an earlier name.
fn number_duplicates(names: &mut [String]) {
    let mut taken = HashSet::new();
    for name in names {
        let numbered = (2..).map(|n| format!("{name}-{n}"));
        let unused = std::iter::once(name.clone())
            .chain(numbered)
            .find(|name| taken.insert(fold_case(name)));
        *name = unused.unwrap_or_default();
    }
}

/// Returns a key for comparing file names: the name in lower case, because some file systems ignore case.
pub(super) fn fold_case(name: &str) -> String {
    name.to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(paths: &[&str]) -> Vec<String> {
        let title = |path: &str| Path::new(path).file_stem().unwrap().to_string_lossy().into_owned();
        let titled: Vec<_> = paths.iter().map(|path| (Path::new(*path), title(path))).collect();
        distinct_names(&titled)
    }

    #[test]
    fn equal_names_are_told_apart_by_their_folders() {
        assert_eq!(names(&["a/x.nrrd", "b/y.nrrd"]), ["x", "y"]);
        assert_eq!(
            names(&["s/01/anat.nrrd", "s/02/anat.nrrd", "s/02/t1.nrrd"]),
            ["01-anat", "02-anat", "t1"]
        );
        assert_eq!(
            names(&["p/01/t/anat.nrrd", "q/01/t/anat.nrrd"]),
            ["p-01-t-anat", "q-01-t-anat"]
        );
        assert_eq!(names(&["ä.nrrd", "ö.nrrd", "_.nrrd"]), ["_", "_-2", "_-3"]);
        assert_eq!(names(&["Head.nrrd", "head.nrrd"]), ["Head", "head-2"]);
    }

    #[test]
    fn patterns_are_expanded_and_each_file_is_opened_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            let text = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n12345678";
            std::fs::write(&path, text).unwrap();
            path
        };
        let (a, _b) = (file("a.nrrd"), file("b.nrrd"));
        std::fs::write(folder.path().join("c.nrrd"), "no volume").unwrap();
        std::fs::write(folder.path().join("d.txt"), "none of the volumes").unwrap();
        let opened = |arguments: &[PathBuf]| {
            let inputs = open_all(arguments).unwrap();
            let described = inputs.iter().map(|input| (input.name.clone(), input.dataset.is_ok()));
            described.collect::<Vec<_>>()
        };
        let all = [("a", true), ("b", true), ("c.nrrd", false)].map(|(name, opens)| (name.to_owned(), opens));
        assert_eq!(opened(&[folder.path().join("*.nrrd"), a]), all);
        assert_eq!(opened(&[folder.path().to_owned()]), all);
        let none = open_all(&[folder.path().join("*.mha")]).map(|_| ()).unwrap_err();
        assert!(none.to_string().ends_with("*.mha\" matches no file"), "{none}");
        assert!(matches!(
            open_all(&[folder.path().join("**x")]),
            Err(BatchError::Pattern { .. })
        ));
    }
}
