//! Names of files in errors.

use std::path::{Path, PathBuf};

use super::super::super::ReadError;

/// The requested file or folder, and the number of a file in it. Names of files in a folder of images may be those of patients, so errors
/// give the folder, and the number of the file in the order of the names.
#[derive(Clone, Debug)]
pub struct FileLabel {
    pub asked: PathBuf,
    pub number: Option<usize>,
}

impl FileLabel {
    /// Label of a file that was requested itself, or of a folder as a whole.
    pub fn of(asked: &Path) -> Self {
        Self {
            asked: asked.to_owned(),
            number: None,
        }
    }

    pub fn error(&self, field: &str, why: impl Into<String>) -> ReadError {
        let field = match self.number {
            Some(number) => format!("file {number} by name: {field}"),
            None => field.to_owned(),
        };
        ReadError::new(&self.asked, field, why)
    }
}
