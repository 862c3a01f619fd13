//! What users should know about a volume beside its grid: copyright, and what a reader repaired, assumed or could not keep.

use std::path::Path;

use serde::{Deserialize, Serialize};

/// Maximum number of texts. More of one kind would add no information.
const MAX_TEXTS: usize = 16;

/// Sentences about a volume, each once, in the order in which they were found.
///
/// Each repair or assumption of a reader adds one. Users see them in the list of volumes, in descriptions, in the viewer and in exports.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notices {
    texts: Vec<String>,
    /// Number of further texts.
    left_out: usize,
}

impl Notices {
    /// A list with one text.
    pub fn of(text: impl Into<String>) -> Self {
        let mut notices = Self::default();
        notices.add(text);
        notices
    }

    /// Adds a text, unless the list has it already.
    pub fn add(&mut self, text: impl Into<String>) {
        let text = text.into();
        if self.texts.contains(&text) {
            return;
        }
        if self.texts.len() < MAX_TEXTS {
            self.texts.push(text);
        } else {
            self.left_out += 1;
        }
    }

    /// Adds all texts of another list.
    pub fn extend(&mut self, others: Self) {
        others.texts.into_iter().for_each(|text| self.add(text));
        self.left_out += others.left_out;
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.texts.is_empty()
    }

    /// Returns the texts, and a line with the number of further ones.
    pub fn lines(&self) -> impl Iterator<Item = String> + '_ {
        let more = (self.left_out > 0).then(|| format!("and {} more notices", self.left_out));
        self.texts.iter().cloned().chain(more)
    }

    /// Returns all texts, one a line.
    pub fn text(&self) -> Option<String> {
        (!self.is_empty()).then(|| self.lines().collect::<Vec<_>>().join("\n"))
    }

    /// Writes the texts to the log.
    pub(super) fn log(&self, path: &Path) {
        for line in self.lines() {
            tracing::warn!(path = %path.display(), "{line}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_there_once_and_not_without_end() {
        let mut notices = Notices::of("a");
        notices.extend(Notices::of("b"));
        notices.add("a");
        assert_eq!(notices.text().as_deref(), Some("a\nb"));
        (0..40).for_each(|n| notices.add(n.to_string()));
        assert_eq!(notices.lines().count(), MAX_TEXTS + 1);
        assert!(notices.text().unwrap().ends_with("and 26 more notices"));
        assert_eq!(Notices::default().text(), None);
    }
}
