//! Texts of the program in messages, such as names of stages.

/// A text of the program. Fields have this alias, because serde derives for `&'static str` borrow from the message.
pub type StaticText = &'static str;

#[cfg(feature = "serde")]
pub use interning::{deserialize, intern};

#[cfg(feature = "serde")]
mod interning {
    use super::StaticText;
    use crate::lock;
    use serde::de::{Deserialize, Deserializer, Error};
    use std::collections::BTreeSet;
    use std::sync::Mutex;

    /// Maximum number of texts, and bytes of a text: what is interned is never freed.
    const MAX_TEXTS: usize = 4096;
    const MAX_BYTES: usize = 256;

    static TEXTS: Mutex<BTreeSet<StaticText>> = Mutex::new(BTreeSet::new());

    /// Returns a text that is equal and never freed: the one of an earlier call with an equal text, or a copy. `None` if the text is too
    /// long, or if there are too many distinct texts.
    pub fn intern(text: &str) -> Option<StaticText> {
        let mut texts = lock(&TEXTS);
        if let Some(interned) = texts.get(text) {
            return Some(interned);
        }
        if texts.len() >= MAX_TEXTS || text.len() > MAX_BYTES {
            return None;
        }
        let interned: StaticText = Box::leak(text.into());
        texts.insert(interned);
        Some(interned)
    }

    /// Deserializes a text by interning it; for `serde(deserialize_with)`.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<StaticText, D::Error> {
        let text = String::deserialize(deserializer)?;
        intern(&text).ok_or_else(|| {
            let bytes = text.len();
            D::Error::custom(format!(
                "a text of {bytes} bytes, expected one of {MAX_TEXTS} texts of at most {MAX_BYTES} bytes"
            ))
        })
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn equal_texts_are_interned_once() {
            let first = intern(&String::from("minmax")).expect("interned");
            let second = intern(&String::from("minmax")).expect("interned");
            assert_eq!(first, "minmax");
            assert!(std::ptr::eq(first, second));
            assert_eq!(intern(&"x".repeat(MAX_BYTES + 1)), None);
        }
    }
}
