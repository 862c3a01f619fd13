//! Secrets that several servers accept. A sealed secret states what it stands for, with an authentication code of a key that the servers
//! share, so that a server accepts one that another server has issued.

use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::hmac::{HMAC_SHA256, Key, sign, verify};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::token::Token;

/// The key that the servers behind one proxy share. Clones are cheap.
#[derive(Clone, Debug)]
pub struct SessionKey(Arc<Key>);

impl SessionKey {
    /// Returns the key of a secret, which its file holds in one line as that of a token.
    pub fn of(secret: &Token) -> Self {
        Self(Arc::new(Key::new(HMAC_SHA256, secret.text().as_bytes())))
    }

    /// Derives a key for one purpose.
    pub(super) fn derived(&self, purpose: &str) -> Key {
        Key::new(HMAC_SHA256, sign(&self.0, purpose.as_bytes()).as_ref())
    }

    /// Returns a secret that states `contents`, which can be read without the key.
    ///
    /// # Errors
    /// The contents have no JSON.
    pub(super) fn seal(&self, purpose: &str, contents: &impl Serialize) -> serde_json::Result<String> {
        let text = serde_json::to_vec(contents)?;
        let code = sign(&self.derived(purpose), &text);
        let [text, code] = [&text[..], code.as_ref()].map(|bytes| URL_SAFE_NO_PAD.encode(bytes));
        Ok(format!("{text}.{code}"))
    }

    /// Returns what a secret states; `None` if it was not sealed with this key for this purpose.
    pub(super) fn open<T: DeserializeOwned>(&self, purpose: &str, secret: &str) -> Option<T> {
        let (text, code) = secret.split_once('.')?;
        let text = URL_SAFE_NO_PAD.decode(text).ok()?;
        let code = URL_SAFE_NO_PAD.decode(code).ok()?;
        verify(&self.derived(purpose), &text, &code).ok()?;
        serde_json::from_slice(&text).ok()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The same key each time for the same letter.
    pub(in crate::access) fn key(letter: &str) -> SessionKey {
        SessionKey::of(&Token::of_text(&letter.repeat(32)).expect("a secret"))
    }

    #[test]
    fn what_is_sealed_is_read_with_the_same_key_for_the_same_purpose_alone() {
        let sealed = key("a").seal("session", &("ann", 7)).expect("JSON");
        let open = |key: &SessionKey, purpose, secret: &str| key.open::<(String, u32)>(purpose, secret);
        assert_eq!(open(&key("a"), "session", &sealed), Some(("ann".into(), 7)));
        assert_eq!(open(&key("b"), "session", &sealed), None, "another key");
        assert_eq!(open(&key("a"), "token", &sealed), None, "another purpose");
        let forged = key("b").seal("session", &("eve", 7)).expect("JSON");
        let (text, _) = forged.split_once('.').expect("two parts");
        let (_, code) = sealed.split_once('.').expect("two parts");
        assert_eq!(open(&key("a"), "session", &format!("{text}.{code}")), None);
        for broken in ["", ".", &sealed[1..], &sealed[..sealed.len() - 1], text] {
            assert_eq!(open(&key("a"), "session", broken), None, "{broken}");
        }
        assert!(!format!("{:?}", key("a")).contains("aaaa"));
    }
}
