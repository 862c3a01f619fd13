//! Why an edit is refused.

use isopeel_kernels::interned::{self, StaticText};
use serde::{Deserialize, Serialize};

/// Why an edit cannot be applied.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
#[error("{field}: {why}")]
pub struct EditError {
    /// Name of the field in JSON.
    #[serde(deserialize_with = "interned::deserialize")]
    pub field: StaticText,
    /// What was found and what was expected.
    pub why: String,
}

/// Quotes names for an error message.
pub(super) fn quoted(fields: &[&str]) -> String {
    let names: Vec<_> = fields.iter().map(|name| format!("{name:?}")).collect();
    names.join(", ")
}
