//! Tokens, by which users and programs authenticate. A page exchanges the token in its address for a cookie, so that bookmarks and copied
//! addresses do not contain tokens.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use data_encoding::HEXLOWER;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// Random bytes of a generated token: 256 bits, which cannot be guessed.
const RANDOM_BYTES: usize = 32;

/// Random bytes of the id of a token. The id is not secret. Two of a thousand tokens have the same id with a probability of 1 in 500
/// million.
const ID_BYTES: usize = 6;

/// Prefix of a generated token, before its id.
const PREFIX: &str = "isop_";

/// Minimum characters of a token from a file; 32 characters of base64 are 192 bits.
const MIN_LENGTH: usize = 32;

/// Prefix in the hash that is the value of a cookie, so that this value differs from the stored hash of the token.
const COOKIE_PREFIX: &[u8] = b"isopeel cookie\0";

/// A token. Its `Debug` output does not contain its text, so that it is never logged.
#[derive(Clone)]
pub struct Token(String);

/// Why a token cannot be read or generated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// The file cannot be read.
    #[error("cannot read the token in {0:?}")]
    Read(std::path::PathBuf, #[source] std::io::Error),
    /// The file has no token.
    #[error(
        "{0:?} has no token, expected one line of {MIN_LENGTH} or more letters, digits and signs, such as `openssl rand -hex 32` prints"
    )]
    Malformed(std::path::PathBuf),
    /// The system has no random numbers.
    #[error("no random numbers for a token")]
    Random(#[from] getrandom::Error),
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

impl Token {
    /// Generates a token: `isop_`, an id, `_`, and 256 random bits.
    ///
    /// # Errors
    /// [`TokenError::Random`].
    pub fn random() -> Result<Self, TokenError> {
        let (mut id, mut bytes) = ([0; ID_BYTES], [0; RANDOM_BYTES]);
        getrandom::fill(&mut id)?;
        getrandom::fill(&mut bytes)?;
        let (id, secret) = (HEXLOWER.encode(&id), URL_SAFE_NO_PAD.encode(bytes));
        Ok(Self(format!("{PREFIX}{id}_{secret}")))
    }

    /// Returns a token with the id of this one and another secret.
    pub(super) fn with_secret(&self, secret: &str) -> Self {
        Self(format!("{PREFIX}{}_{secret}", self.id().unwrap_or_default()))
    }

    /// Reads the token from a file that contains nothing else.
    ///
    /// # Errors
    /// [`TokenError`].
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let text = std::fs::read_to_string(path).map_err(|error| TokenError::Read(path.to_owned(), error))?;
        Self::of_text(text.trim()).ok_or_else(|| TokenError::Malformed(path.to_owned()))
    }

    /// Converts a text to a token. Returns `None` if the text is too short or has characters other than visible ASCII.
    pub fn of_text(text: &str) -> Option<Self> {
        let is_valid = text.len() >= MIN_LENGTH && text.bytes().all(|byte| byte.is_ascii_graphic());
        is_valid.then(|| Self(text.to_owned()))
    }

    /// Returns the secret text of the token.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Returns the public part of the token; `None` if the token does not begin with `isop_` and an id.
    pub fn id(&self) -> Option<&str> {
        id_of(&self.0)
    }
}

/// Returns the public part of a token.
pub(super) fn id_of(token: &str) -> Option<&str> {
    Some(token.strip_prefix(PREFIX)?.split_once('_')?.0)
}

/// Returns the secret part of a token.
pub(super) fn secret_of(token: &str) -> Option<&str> {
    Some(token.strip_prefix(PREFIX)?.split_once('_')?.1)
}

/// Returns the value of the cookie that stands for a token: a hash, from which the token cannot be derived.
pub(super) fn cookie_value(token: &str) -> String {
    let hash = Sha256::new().chain_update(COOKIE_PREFIX).chain_update(token);
    URL_SAFE_NO_PAD.encode(hash.finalize())
}

/// SHA-256 of a secret, compared in constant time.
#[derive(Clone, Copy)]
pub(super) struct Hash([u8; 32]);

impl Hash {
    pub(super) fn of(secret: &str) -> Self {
        Self(Sha256::digest(secret).into())
    }

    /// Whether this is the hash of `secret`.
    pub(super) fn matches(&self, secret: &str) -> bool {
        *self == Self::of(secret)
    }
}

impl PartialEq for Hash {
    fn eq(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }
}

impl Eq for Hash {}

impl std::fmt::Debug for Hash {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Hash")
    }
}

impl Serialize for Hash {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&HEXLOWER.encode(&self.0))
    }
}

impl<'de> Deserialize<'de> for Hash {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        let bytes = HEXLOWER.decode(text.as_bytes()).ok();
        let bytes = bytes.and_then(|bytes| bytes.try_into().ok());
        bytes
            .map(Self)
            .ok_or_else(|| D::Error::custom("a hash, expected 64 hexadecimal digits in lower case"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_has_a_public_id_and_256_random_bits() {
        let (token, other) = (Token::random().expect("random"), Token::random().expect("random"));
        let id = token.id().expect("an id");
        assert_eq!(
            (id.len(), token.text().len()),
            (12, 5 + 12 + 1 + 43),
            "{}",
            token.text()
        );
        assert!(token.text().starts_with(&format!("isop_{id}_")), "{}", token.text());
        assert_ne!(token.text(), other.text());
        assert_eq!(format!("{token:?}"), "Token");
        assert_eq!(id_of("0123456789abcdef0123456789abcdef"), None);
    }

    #[test]
    fn a_hash_is_of_one_secret_and_is_not_printed() {
        let hash = Hash::of("a");
        assert!(hash.matches("a") && !hash.matches("b") && hash != Hash::of("b"));
        assert_eq!(format!("{hash:?}"), "Hash");
        let text = serde_json::to_string(&hash).expect("JSON");
        assert_eq!(text.len(), 2 + 64);
        assert_eq!(serde_json::from_str::<Hash>(&text).expect("a hash"), hash);
        assert!(serde_json::from_str::<Hash>("\"00\"").is_err());
    }

    #[test]
    fn a_file_has_one_long_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("token");
        assert!(matches!(Token::read(&path), Err(TokenError::Read(..))));
        for (text, is_token) in [
            ("0123456789abcdef0123456789abcdef\n", true),
            ("0123456789abcdef", false),
            ("0123456789abcdef 0123456789abcdef", false),
            ("", false),
        ] {
            std::fs::write(&path, text).expect("written");
            assert_eq!(Token::read(&path).is_ok(), is_token, "{text:?}");
        }
    }
}
