//! Reads and validates ID tokens, an issuer's statements about a user (OpenID Connect Core 1.0, sections 2 and 3.1.3.7).

use jsonwebtoken::jwk::{Jwk, JwkSet, PublicKeyUse};
use jsonwebtoken::{DecodingKey, Validation, decode, decode_header};
use serde::Deserialize;
use serde_json::Value;
use subtle::ConstantTimeEq;

use super::signature::{self, ALGORITHMS};
use crate::access::named::now;

/// Maximum difference of clocks, in seconds.
const LEEWAY: u64 = 30;

/// Maximum length of `sub`.
const MAX_SUB_BYTES: usize = 255;

/// Why an ID token is refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum ClaimsError {
    #[error("the ID token is signed by a key that the issuer does not list")]
    UnknownKey,
    #[error("the ID token is not to be believed")]
    Token(#[from] jsonwebtoken::errors::Error),
    #[error("the ID token's {0}, expected that of this sign-in")]
    Other(&'static str),
}

/// The statements of an ID token.
#[derive(Debug, Deserialize)]
pub(super) struct Claims {
    /// The user's id: unique at the issuer, and never reassigned to another user.
    pub sub: String,
    aud: Audience,
    azp: Option<String>,
    nonce: Option<String>,
    /// When it was issued, in seconds of Unix time.
    iat: Option<f64>,
    #[serde(flatten)]
    others: serde_json::Map<String, Value>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Audience {
    One(#[allow(dead_code)] String),
    Many(Vec<String>),
}

/// The values that an ID token must have.
pub(super) struct Expected<'a> {
    pub issuer: &'a str,
    pub client_id: &'a str,
    pub nonce: &'a str,
}

impl Claims {
    /// Checks signature, issuer, audience, authorized party, expiry and nonce.
    ///
    /// # Errors
    /// [`ClaimsError`]; [`ClaimsError::UnknownKey`] if newer keys of the issuer may help.
    pub(super) fn check(token: &str, keys: &JwkSet, expected: &Expected<'_>) -> Result<Self, ClaimsError> {
        signature::install();
        let header = decode_header(token)?;
        if !ALGORITHMS.contains(&header.alg) {
            return Err(ClaimsError::Other("algorithm is none of RS256, ES256 and PS256"));
        }
        let (algorithm, kid) = (header.alg, header.kid.as_deref());
        let fits = |key: &&Jwk| {
            let common = &key.common;
            let is_of = |name: &str| common.key_algorithm.is_none_or(|of| of.to_string() == name);
            let signs = !matches!(common.public_key_use, Some(PublicKeyUse::Encryption));
            let family = DecodingKey::from_jwk(key).is_ok_and(|key| key.family() == algorithm.family());
            signs && family && is_of(&format!("{algorithm:?}")) && (kid.is_none() || common.key_id.as_deref() == kid)
        };
        let mut found = keys.keys.iter().filter(fits);
        let key = found.next().ok_or(ClaimsError::UnknownKey)?;
        if found.next().is_some() {
            return Err(ClaimsError::Other("key is one of several"));
        }
        let mut validation = Validation::new(algorithm);
        validation.leeway = LEEWAY;
        validation.validate_nbf = true;
        validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
        validation.set_issuer(&[expected.issuer]);
        validation.set_audience(&[expected.client_id]);
        let claims = decode::<Self>(token, &DecodingKey::from_jwk(key)?, &validation)?.claims;
        claims.check_party(expected)?;
        claims.check_person()?;
        Ok(claims)
    }

    fn check_party(&self, expected: &Expected<'_>) -> Result<(), ClaimsError> {
        let is_for_many = matches!(&self.aud, Audience::Many(audiences) if audiences.len() > 1);
        match &self.azp {
            Some(party) if party != expected.client_id => {
                return Err(ClaimsError::Other("authorized party is another client"));
            }
            None if is_for_many => {
                return Err(ClaimsError::Other(
                    "audience is of several, of which none is authorized",
                ));
            }
            _ => {}
        }
        let nonce = self.nonce.as_deref().unwrap_or("");
        if !bool::from(nonce.as_bytes().ct_eq(expected.nonce.as_bytes())) {
            return Err(ClaimsError::Other("nonce is another one"));
        }
        Ok(())
    }

    /// Checks `sub` and the time of issue. The maximum length of `sub` is that of OpenID Connect Core 1.0, section 2.
    fn check_person(&self) -> Result<(), ClaimsError> {
        if self.sub.is_empty() || self.sub.len() > MAX_SUB_BYTES || !self.sub.is_ascii() {
            return Err(ClaimsError::Other(
                "sub is empty, not ASCII or longer than 255 characters",
            ));
        }
        if self.iat.is_some_and(|iat| iat > (now() + LEEWAY) as f64) {
            return Err(ClaimsError::Other("time of issue is in the future"));
        }
        Ok(())
    }

    /// Returns the names in a claim such as `groups` or `realm_access.roles`, which has one name or a list. Without the claim there are
    /// none.
    pub(super) fn names(&self, claim: &str) -> Vec<&str> {
        let mut parts = claim.split('.');
        let first = parts.next().and_then(|part| self.others.get(part));
        let found = parts.fold(first, |value, part| value?.get(part));
        match found {
            Some(Value::String(name)) => vec![name],
            Some(Value::Array(names)) => names.iter().filter_map(Value::as_str).collect(),
            _ => Vec::new(),
        }
    }
}
