//! Why an edit is refused.

/// An edit that cannot be applied: which field of it, and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {why}")]
pub struct EditError {
    /// Name of the field, as it travels.
    pub field: &'static str,
    /// What was found and what was expected.
    pub why: String,
}
