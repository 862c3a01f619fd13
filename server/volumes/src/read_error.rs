//! Why a file cannot be read.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::disk;

/// What is wrong with a file: which file, which field of it, what was found and what was expected.
#[derive(Debug, thiserror::Error, Serialize, Deserialize)]
#[error("{}: {field}: {why}", path.display())]
pub struct ReadError {
    /// File at fault.
    #[serde(with = "path_bytes")]
    pub path: PathBuf,
    /// Field of its header, or `data`.
    pub field: String,
    /// What was found and what was expected.
    pub why: String,
    /// Whether reading once more may succeed: the samples need another type, or the file changed while it was read.
    pub can_retry: bool,
    /// The cause, if there is one.
    #[source]
    #[serde(with = "cause")]
    pub source: Option<std::io::Error>,
}

impl ReadError {
    /// Returns a copy, for another caller that waited for the same file. Of the cause, it has kind and text.
    pub fn duplicate(&self) -> Self {
        let source = self.source.as_ref();
        Self {
            path: self.path.clone(),
            field: self.field.clone(),
            why: self.why.clone(),
            can_retry: self.can_retry,
            source: source.map(|source| std::io::Error::new(source.kind(), source.to_string())),
        }
    }

    /// An error in the file's content.
    pub fn new(path: &Path, field: impl Into<String>, why: impl Into<String>) -> Self {
        Self {
            path: path.to_owned(),
            field: field.into(),
            why: why.into(),
            can_retry: false,
            source: None,
        }
    }

    /// Returns the message for a client: without the folder of the file.
    pub fn without_folder(&self) -> String {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let why = self
            .path
            .parent()
            .map_or(self.why.clone(), |folder| self.why_in(folder));
        format!("{name}: {}: {why}", self.field)
    }

    /// Returns the error with paths relative to a folder.
    #[must_use]
    pub fn in_folder(self, folder: &Path) -> Self {
        let path = self.path.strip_prefix(folder).unwrap_or(&self.path).to_owned();
        let why = self.why_in(folder);
        Self { path, why, ..self }
    }

    fn why_in(&self, folder: &Path) -> String {
        let folder = format!("{}/", folder.display());
        match folder.len() {
            2.. => self.why.replace(&folder, ""),
            _ => self.why.clone(),
        }
    }

    /// Whether the server's disk lacked space: no fault of the file.
    pub fn is_of_space(&self) -> bool {
        self.source.as_ref().is_some_and(disk::is_full)
    }

    /// An error of the operating system.
    pub fn io(path: &Path, field: impl Into<String>, why: impl Into<String>, source: std::io::Error) -> Self {
        Self {
            source: Some(source),
            ..Self::new(path, field, why)
        }
    }
}

/// A path as its bytes, which need not be Unicode.
mod path_bytes {
    use std::ffi::OsString;
    use std::os::unix::ffi::{OsStrExt, OsStringExt};
    use std::path::{Path, PathBuf};

    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(path.as_os_str().as_bytes())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<PathBuf, D::Error> {
        Ok(OsString::from_vec(Vec::deserialize(deserializer)?).into())
    }
}

/// A cause as its text, and whether it is that of a full disk.
mod cause {
    use std::io;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::disk;

    pub fn serialize<S: Serializer>(cause: &Option<io::Error>, serializer: S) -> Result<S::Ok, S::Error> {
        let form = cause.as_ref().map(|error| (error.to_string(), disk::is_full(error)));
        form.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<io::Error>, D::Error> {
        let form = Option::<(String, bool)>::deserialize(deserializer)?;
        Ok(form.map(|(text, is_full)| match is_full {
            true => io::Error::new(io::ErrorKind::StorageFull, text),
            false => io::Error::other(text),
        }))
    }
}
