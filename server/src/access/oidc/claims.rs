//! Parses and validates ID tokens: signed statements of an issuer about a user (OpenID Connect Core 1.0, sections 2 and 3.1.3.7).

use jsonwebtoken::jwk::{Jwk, JwkSet, PublicKeyUse};
use jsonwebtoken::{DecodingKey, Validation, decode, decode_header};
use serde::Deserialize;
use serde_json::Value;
use subtle::ConstantTimeEq;

use super::signature::{self, ALGORITHMS};
use crate::access::named::now;

/// Maximum difference between the clocks of issuer and server, in seconds.
const LEEWAY: u64 = 30;

/// Maximum length of `sub` by OpenID Connect Core 1.0, section 2.
const MAX_SUB_BYTES: usize = 255;

/// Why an ID token is refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum ClaimsError {
    #[error("the ID token is signed by a key that the issuer does not list")]
    UnknownKey,
    #[error("the ID token is not valid")]
    Token(#[from] jsonwebtoken::errors::Error),
    #[error("the ID token is not valid for this sign-in: {0}")]
    Other(&'static str),
}

/// The statements of an ID token.
#[derive(Debug, Deserialize)]
pub(super) struct Claims {
    /// Id of the user. The issuer never assigns it to another user.
    pub sub: String,
    aud: Audience,
    azp: Option<String>,
    nonce: Option<String>,
    /// Time of issue in seconds of Unix time.
    iat: Option<f64>,
    /// All other claims.
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
    /// [`ClaimsError`]. After [`ClaimsError::UnknownKey`], the caller may retry with newer keys of the issuer.
    pub(super) fn check(token: &str, keys: &JwkSet, expected: &Expected<'_>) -> Result<Self, ClaimsError> {
        signature::install();
        let header = decode_header(token)?;
        if !ALGORITHMS.contains(&header.alg) {
            return Err(ClaimsError::Other("the algorithm is none of RS256, ES256 and PS256"));
        }
        let (algorithm, kid) = (header.alg, header.kid.as_deref());
        let matches_header = |key: &&Jwk| {
            let common = &key.common;
            let name = format!("{algorithm:?}");
            let has_algorithm = common.key_algorithm.is_none_or(|other| other.to_string() == name);
            let is_for_signatures = !matches!(common.public_key_use, Some(PublicKeyUse::Encryption));
            let has_family = DecodingKey::from_jwk(key).is_ok_and(|key| key.family() == algorithm.family());
            let has_id = kid.is_none() || common.key_id.as_deref() == kid;
            is_for_signatures && has_family && has_algorithm && has_id
        };
        let mut candidates = keys.keys.iter().filter(matches_header);
        let key = candidates.next().ok_or(ClaimsError::UnknownKey)?;
        if candidates.next().is_some() {
            return Err(ClaimsError::Other("several keys of the issuer match"));
        }
        let mut validation = Validation::new(algorithm);
        validation.leeway = LEEWAY;
        validation.validate_nbf = true;
        validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
        validation.set_issuer(&[expected.issuer]);
        validation.set_audience(&[expected.client_id]);
        let claims = decode::<Self>(token, &DecodingKey::from_jwk(key)?, &validation)?.claims;
        claims.check_party(expected)?;
        claims.check_subject()?;
        Ok(claims)
    }

    /// Checks the authorized party and the nonce.
    fn check_party(&self, expected: &Expected<'_>) -> Result<(), ClaimsError> {
        let has_many_audiences = matches!(&self.aud, Audience::Many(audiences) if audiences.len() > 1);
        match &self.azp {
            Some(party) if party != expected.client_id => {
                return Err(ClaimsError::Other("the authorized party is another client"));
            }
            None if has_many_audiences => {
                return Err(ClaimsError::Other("it has several audiences, but no authorized party"));
            }
            _ => {}
        }
        let nonce = self.nonce.as_deref().unwrap_or("");
        if !bool::from(nonce.as_bytes().ct_eq(expected.nonce.as_bytes())) {
            return Err(ClaimsError::Other("the nonce differs"));
        }
        Ok(())
    }

    /// Checks `sub` and the time of issue.
    fn check_subject(&self) -> Result<(), ClaimsError> {
        if self.sub.is_empty() || self.sub.len() > MAX_SUB_BYTES || !self.sub.is_ascii() {
            return Err(ClaimsError::Other(
                "sub is empty, not ASCII or longer than 255 characters",
            ));
        }
        if self.iat.is_some_and(|iat| iat > (now() + LEEWAY) as f64) {
            return Err(ClaimsError::Other("the time of issue is in the future"));
        }
        Ok(())
    }

    /// Returns the names in a claim such as `groups` or `realm_access.roles`, whose value is one name or a list. Returns none if the token
    /// does not have this claim.
    pub(super) fn names(&self, claim: &str) -> Vec<&str> {
        let mut parts = claim.split('.');
        let first = parts.next().and_then(|part| self.others.get(part));
        let value = parts.fold(first, |value, part| value?.get(part));
        match value {
            Some(Value::String(name)) => vec![name],
            Some(Value::Array(names)) => names.iter().filter_map(Value::as_str).collect(),
            _ => Vec::new(),
        }
    }
}
