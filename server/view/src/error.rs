//! Why an edit is refused.

/// Why an edit cannot be applied.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {why}")]
pub struct EditError {
    /// Name of the field in JSON.
    pub field: &'static str,
    /// What was found and what was expected.
    pub why: String,
}

/// Quotes names for an error message.
pub(super) fn quoted(fields: &[&str]) -> String {
    let names: Vec<_> = fields.iter().map(|name| format!("{name:?}")).collect();
    names.join(", ")
}
