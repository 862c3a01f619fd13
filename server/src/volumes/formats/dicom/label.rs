//! How errors name a file.

use std::path::{Path, PathBuf};

use super::super::super::ReadError;

/// The file or folder that was asked for, and which file of it. Names in a folder of images may be those of patients,
/// so that an error says the folder, and the number of the file among all in the order of their names.
#[derive(Clone, Debug)]
pub struct FileLabel {
    pub asked: PathBuf,
    pub number: Option<usize>,
}

impl FileLabel {
    /// A file that was asked for itself, or a folder as a whole.
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
