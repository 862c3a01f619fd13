//! Checks the names of declared files. Files keep their names below the folder of their upload, because headers refer to data files by
//! name. Names that could leave this folder, or that look like another name, are refused before anything is created.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of files in an upload. A series of a large scanner has some thousand files. The reader opens each file.
pub const MAX_FILES: usize = 20_000;
/// Maximum number of components in a name: folders and the file itself. OME-Zarr uses at most eight.
const MAX_DEPTH: usize = 12;
/// Maximum bytes of a name with its folders.
const MAX_NAME_BYTES: usize = 1_000;
/// Maximum bytes of a component of a name. Common file systems have this limit.
const MAX_PART_BYTES: usize = 255;

/// A file of an upload.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DeclaredFile {
    /// Name of the file, with the folders that it is in: `scan/0001.dcm`.
    pub name: String,
    /// Size of the file in bytes.
    pub bytes: u64,
}

/// Why the declared files are refused.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NameError {
    /// No files, or too many.
    #[error("{0} files, expected 1 to {MAX_FILES}")]
    Count(usize),
    /// All files are empty.
    #[error("files of 0 bytes in all, expected some samples")]
    Empty,
    /// The sum of the sizes overflows at this file, counted from 0.
    #[error("file {0}: the sizes add up to 2⁶³ bytes or more")]
    Size(usize),
    /// An invalid name.
    #[error("file {file}: {name:?}: {why}")]
    Name {
        /// Number of the file, from 0.
        file: usize,
        /// First characters of the declared name.
        name: String,
        /// What is wrong, or what was expected.
        why: &'static str,
    },
}

/// Checks the number, names and sizes of the files. Returns the sum of their bytes.
pub(super) fn check(files: &[DeclaredFile]) -> Result<u64, NameError> {
    if files.is_empty() || files.len() > MAX_FILES {
        return Err(NameError::Count(files.len()));
    }
    let (mut names, mut folders) = (HashSet::new(), HashSet::new());
    let mut total = 0u64;
    for (file, DeclaredFile { name, bytes }) in files.iter().enumerate() {
        let fail = |why| NameError::Name {
            file,
            name: name.chars().take(80).collect(),
            why,
        };
        if let Some(why) = fault(name) {
            return Err(fail(why));
        }
        // Some file systems do not distinguish upper case from lower case.
        let folded = name.to_lowercase();
        folders.extend(folded.match_indices('/').map(|(end, _)| folded[..end].to_owned()));
        if !names.insert(folded) {
            return Err(fail("a second file of this name, expected different names"));
        }
        total = total
            .checked_add(*bytes)
            .filter(|&total| total < 1 << 63)
            .ok_or(NameError::Size(file))?;
    }
    let file_and_folder = files
        .iter()
        .position(|file| folders.contains(&file.name.to_lowercase()));
    if let Some(file) = file_and_folder {
        return Err(NameError::Name {
            file,
            name: files[file].name.clone(),
            why: "a file and a folder of this name, expected one of them",
        });
    }
    if total == 0 { Err(NameError::Empty) } else { Ok(total) }
}

/// Returns what is wrong with a name; `None` if it is valid.
fn fault(name: &str) -> Option<&'static str> {
    let parts: Vec<&str> = name.split('/').collect();
    if name.is_empty() || name.len() > MAX_NAME_BYTES {
        Some("expected 1 to 1,000 bytes")
    } else if name.chars().any(is_hidden) {
        Some("expected no control characters, no invisible characters, and none that change the direction of text")
    } else if name.contains('\\') {
        Some("expected `/` between folders, and no `\\`")
    } else if parts.iter().any(|part| part.is_empty() || matches!(*part, "." | "..")) {
        Some("expected a relative name, without `..`, `.` and empty parts")
    } else if parts.iter().any(|part| part.len() > MAX_PART_BYTES) {
        Some("expected at most 255 bytes between two `/`")
    } else if parts.len() > MAX_DEPTH {
        Some("expected at most 11 folders below each other")
    } else {
        None
    }
}

/// Whether a character is invisible, or changes the direction in which other characters are displayed.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{e0000}'..='\u{e007f}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}')
}

/// Returns the topmost folder that contains all files, if there is one.
pub(super) fn common_folder(files: &[DeclaredFile]) -> Option<&str> {
    let folder = |file: &'_ DeclaredFile| file.name.split_once('/').map(|(folder, _)| folder.len());
    let length = folder(files.first()?)?;
    let first = &files[0].name[..length];
    let inside = |file: &DeclaredFile| file.name.split_once('/').is_some_and(|(folder, _)| folder == first);
    files.iter().all(inside).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(names: &[&str]) -> Vec<DeclaredFile> {
        let file = |name: &&str| DeclaredFile {
            name: (*name).into(),
            bytes: 1,
        };
        names.iter().map(file).collect()
    }

    #[test]
    fn names_that_lead_elsewhere_or_hide_something_are_refused() {
        for hostile in [
            "",
            "/etc/passwd",
            "../up",
            "a/../../up",
            "a/./b",
            "a//b",
            "a/",
            ".",
            "a\\..\\b",
            "C:\\x",
            "a\0b",
            "a\nb",
            "a\u{1b}[2Jb",
            "gnp.\u{202e}mcd",
            "a\u{200b}b",
            "a\u{61c}b",
            "a\u{e0041}b",
        ] {
            let error = check(&files(&["ok", hostile])).unwrap_err();
            assert!(matches!(error, NameError::Name { file: 1, .. }), "{hostile:?}: {error}");
            assert!(error.to_string().contains("expected"), "{error}");
            assert!(!error.to_string().chars().any(is_hidden), "{error:?}");
        }
        let (deep, long) = ("a/".repeat(12) + "b", "x".repeat(256));
        for name in [deep, long, "y/".repeat(600)] {
            assert!(check(&files(&[&name])).is_err());
        }
        let usual = [
            "x.zarr/.zattrs",
            "x.zarr/0/0.0.0",
            "Größe 1 (a+b).nii.gz",
            "IM0001",
            "-rf",
            "a:b",
        ];
        assert_eq!(check(&files(&usual)), Ok(6));
    }

    #[test]
    fn files_that_cannot_be_beside_each_other_are_refused() {
        for names in [&["a", "A"], &["x/a", "x/a"], &["x", "x/a"], &["X/y/a", "x/Y"]] {
            assert!(matches!(check(&files(names)), Err(NameError::Name { .. })), "{names:?}");
        }
        assert_eq!(check(&[]), Err(NameError::Count(0)));
        assert_eq!(
            check(&files(&vec!["a"; MAX_FILES + 1])),
            Err(NameError::Count(MAX_FILES + 1))
        );
        let sized = |bytes: [u64; 2]| {
            check(&[0, 1].map(|i| DeclaredFile {
                name: format!("{i}"),
                bytes: bytes[i],
            }))
        };
        assert_eq!(sized([u64::MAX, 2]), Err(NameError::Size(0)));
        assert_eq!(sized([1 << 62, 1 << 62]), Err(NameError::Size(1)));
        assert_eq!(sized([0, 0]), Err(NameError::Empty));
    }

    #[test]
    fn the_folder_of_all_files_is_known() {
        assert_eq!(common_folder(&files(&["scan/a", "scan/b/c"])), Some("scan"));
        for names in [
            &["scan/a", "b"][..],
            &["b", "scan/a"],
            &["a/x", "b/x"],
            &["a"],
            &["scan/a", "scans/b"],
        ] {
            assert_eq!(common_folder(&files(names)), None, "{names:?}");
        }
    }
}
