//! The token that lets people and programs in. Pages exchange it for a cookie, so that it stands in no address that is kept or copied.

use std::path::Path;

use axum::http::HeaderValue;
use axum::http::header::{AUTHORIZATION, COOKIE, HeaderMap};
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// Random bytes of a token that the server makes: nobody finds it by trying.
const RANDOM_BYTES: usize = 32;

/// Minimum characters of a token from a file; 32 characters of base64 are 192 bits.
const MIN_LENGTH: usize = 32;

/// Hashed before the token for the value of its cookie, which so says nothing about the token.
const COOKIE_PREFIX: &[u8] = b"isopeel cookie\0";

/// A token. Never logged: it has no `Debug` of its own text.
#[derive(Clone)]
pub struct Token(String);

/// Why there is no token.
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
    /// A new one.
    ///
    /// # Errors
    /// [`TokenError::Random`].
    pub fn random() -> Result<Self, TokenError> {
        let mut bytes = [0; RANDOM_BYTES];
        getrandom::fill(&mut bytes)?;
        Ok(Self(format!("isop_{}", URL_SAFE_NO_PAD.encode(bytes))))
    }

    /// The only line of a file.
    ///
    /// # Errors
    /// [`TokenError`].
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let text = std::fs::read_to_string(path).map_err(|error| TokenError::Read(path.to_owned(), error))?;
        let token = text.trim();
        if token.len() < MIN_LENGTH || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(TokenError::Malformed(path.to_owned()));
        }
        Ok(Self(token.to_owned()))
    }

    /// Its text, for an address.
    pub fn text(&self) -> &str {
        &self.0
    }
}

/// How a request has shown the token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Proof {
    /// In a header that no page of another origin can make a browser send.
    Header,
    /// By the cookie, which a browser sends with every request.
    Cookie,
}

/// Checks tokens and cookies; keeps their hashes alone.
#[derive(Debug)]
pub(super) struct TokenCheck {
    token: [u8; 32],
    cookie: [u8; 32],
    /// Name and value, before the attributes.
    set_cookie: HeaderValue,
    cookie_name: String,
}

impl TokenCheck {
    /// `port` tells the cookies of several servers of a host apart, `is_https` says whether pages come by TLS.
    pub(super) fn new(token: &Token, port: u16, is_https: bool) -> Self {
        let value = URL_SAFE_NO_PAD.encode(
            Sha256::new()
                .chain_update(COOKIE_PREFIX)
                .chain_update(&token.0)
                .finalize(),
        );
        let (prefix, secure) = if is_https { ("__Host-", "; Secure") } else { ("", "") };
        let cookie_name = format!("{prefix}isopeel-{port}");
        let set_cookie = format!("{cookie_name}={value}; Path=/; HttpOnly; SameSite=Lax{secure}");
        Self {
            token: hash(&token.0),
            cookie: hash(&value),
            // Letters, digits and signs of base64.
            set_cookie: HeaderValue::try_from(set_cookie).unwrap_or(HeaderValue::from_static("")),
            cookie_name,
        }
    }

    /// The cookie that stands for the token, where it is the right one.
    pub(super) fn exchange(&self, token: &str) -> Option<HeaderValue> {
        is_equal(&self.token, token).then(|| self.set_cookie.clone())
    }

    /// How a request shows the token, if it does.
    pub(super) fn proof(&self, headers: &HeaderMap) -> Option<Proof> {
        let bearer = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = bearer.and_then(|value| {
            let (scheme, token) = value.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
        });
        if bearer.is_some_and(|token| is_equal(&self.token, token)) {
            return Some(Proof::Header);
        }
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut pairs = cookies
            .flat_map(|value| value.split(';'))
            .filter_map(|pair| pair.trim().split_once('='));
        pairs
            .any(|(name, value)| name == self.cookie_name && is_equal(&self.cookie, value))
            .then_some(Proof::Cookie)
    }
}

fn hash(text: &str) -> [u8; 32] {
    Sha256::digest(text).into()
}

/// In a time that does not depend on where they differ.
fn is_equal(expected: &[u8; 32], text: &str) -> bool {
    hash(text).ct_eq(expected).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: axum::http::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().expect("a header"))])
    }

    #[test]
    fn the_token_and_its_cookie_are_proofs_and_nothing_else_is() {
        let (token, other) = (Token::random().expect("random"), Token::random().expect("random"));
        let check = TokenCheck::new(&token, 8417, false);
        assert!(
            token.text().starts_with("isop_") && token.text().len() == 5 + 43,
            "{}",
            token.text()
        );
        assert_eq!(check.exchange(other.text()), None);
        assert_eq!(check.exchange(""), None);
        let cookie = check.exchange(token.text()).expect("the right token");
        let cookie = cookie.to_str().expect("ASCII");
        let (pair, attributes) = cookie.split_once(';').expect("attributes");
        assert_eq!(attributes, " Path=/; HttpOnly; SameSite=Lax");
        assert!(!pair.contains(token.text()), "the cookie is not the token");
        let (name, value) = pair.split_once('=').expect("a pair");
        for (headers, proof) in [
            (
                with(AUTHORIZATION, &format!("Bearer {}", token.text())),
                Some(Proof::Header),
            ),
            (
                with(AUTHORIZATION, &format!("bearer {}", token.text())),
                Some(Proof::Header),
            ),
            (with(COOKIE, &format!("a=b; {name}={value}; c")), Some(Proof::Cookie)),
            (with(AUTHORIZATION, &format!("Bearer {}", other.text())), None),
            (with(AUTHORIZATION, &format!("Basic {}", token.text())), None),
            (with(AUTHORIZATION, "Bearer"), None),
            (with(COOKIE, &format!("isopeel-8418={value}")), None),
            (with(COOKIE, &format!("{name}={}", token.text())), None),
            (with(COOKIE, &format!("{name}=")), None),
            (HeaderMap::new(), None),
        ] {
            assert_eq!(check.proof(&headers), proof, "{headers:?}");
        }
        assert_eq!(format!("{token:?}"), "Token");
        assert!(!format!("{check:?}").contains(token.text()));
    }

    #[test]
    fn by_tls_the_cookie_is_of_this_host_alone() {
        let token = Token::random().expect("random");
        let cookie = TokenCheck::new(&token, 443, true)
            .exchange(token.text())
            .expect("the right token");
        let cookie = cookie.to_str().expect("ASCII");
        assert!(
            cookie.starts_with("__Host-isopeel-443=") && cookie.ends_with("; Path=/; HttpOnly; SameSite=Lax; Secure"),
            "{cookie}"
        );
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
