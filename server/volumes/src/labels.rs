//! Names and colours of labels, for files that have them.

use serde::{Deserialize, Serialize};

/// Labels of a field that are kept. Files with more are read, and their names are left out beyond this number.
pub const MAX_LABELS: usize = 4096;

/// What a value of a field of labels means.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Label {
    /// Value in the file.
    pub value: i128,
    /// Name for people.
    pub name: Option<String>,
    /// Red, green, blue.
    pub color: Option<[u8; 3]>,
}

impl Label {
    /// Creates a label. An empty name is left out.
    pub fn new(value: impl Into<i128>, name: &str, color: Option<[u8; 3]>) -> Self {
        let name = name.trim();
        Self {
            value: value.into(),
            name: (!name.is_empty()).then(|| name.to_owned()),
            color,
        }
    }
}
