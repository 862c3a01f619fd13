//! Sign-ins in progress at an issuer.
//!
//! The browser keeps a secret in a cookie, and the server derives all other values of the sign-in from this secret with a key. So the
//! server stores nothing for a sign-in in progress, and clients who begin thousands of sign-ins cannot make those of other users fail. The
//! server refuses a response of the issuer that arrives in another browser, because the secret is missing.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::hmac::{HMAC_SHA256, Key, sign};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use crate::access::named::now;
use crate::access::sealed::SessionKey;
use crate::access::token::TokenError;

/// Maximum duration of a sign-in. Enough time for a password and a second factor.
pub(in crate::access) const LIFETIME: Duration = Duration::from_secs(600);
/// Maximum number of completed sign-ins that are remembered. The oldest is forgotten first; issuers accept a code only once anyway.
const MAX_USED: usize = 4_096;
const RANDOM_BYTES: usize = 32;

/// The values of a sign-in in progress that are sent to the issuer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PendingSignIn {
    pub nonce: String,
    /// Code verifier of PKCE (RFC 7636).
    pub verifier: String,
}

impl PendingSignIn {
    /// Returns the code challenge of PKCE.
    pub(super) fn challenge(&self) -> String {
        URL_SAFE_NO_PAD.encode(Sha256::digest(&self.verifier))
    }
}

/// The key from which sign-ins are derived, and the completed sign-ins. Clones share both.
#[derive(Clone, Debug)]
pub(super) struct PendingSignIns {
    key: Arc<Key>,
    /// When the server started, and the Unix time in seconds then.
    started: (Instant, u64),
    /// Begin of each completed sign-in in seconds of Unix time, by its state.
    used: Arc<Mutex<HashMap<String, u64>>>,
}

impl PendingSignIns {
    /// Takes the key that servers share, so that a sign-in may begin at one and end at another; else generates a random one.
    pub(super) fn new(shared: Option<&SessionKey>) -> Result<Self, TokenError> {
        let key = match shared {
            Some(shared) => shared.derived("sign-in"),
            None => {
                let mut key = [0; RANDOM_BYTES];
                getrandom::fill(&mut key)?;
                Key::new(HMAC_SHA256, &key)
            }
        };
        Ok(Self {
            key: Arc::new(key),
            started: (Instant::now(), now()),
            used: Arc::default(),
        })
    }

    /// Returns the Unix time in seconds by a monotonic clock, so that sign-ins in progress continue when the clock of the machine is set.
    pub(super) fn now(&self) -> u64 {
        let (instant, unix) = self.started;
        unix.saturating_add(instant.elapsed().as_secs())
    }

    /// Begins a sign-in at `now`, in seconds of Unix time. Returns the secret for the browser, the state, and the other values for the
    /// issuer.
    pub(super) fn begin(&self, now: u64) -> Result<(String, String, PendingSignIn), TokenError> {
        let secret = format!("{}.{now}", random()?);
        let state = self.derive("state", &secret);
        let sign_in = self.derive_sign_in(&secret);
        Ok((secret, state, sign_in))
    }

    /// Completes the sign-in of a secret. Returns `None` if the state does not belong to the secret, the sign-in took longer than
    /// [`LIFETIME`], or the secret was used before.
    pub(super) fn end(&self, secret: &str, state: &str, now: u64) -> Option<PendingSignIn> {
        // Comes first: only a matching state proves that the server has issued this secret, including the time in it.
        let expected = self.derive("state", secret);
        if !bool::from(expected.as_bytes().ct_eq(state.as_bytes())) {
            return None;
        }
        let begun: u64 = secret.rsplit_once('.')?.1.parse().ok()?;
        let is_soon = |begun: u64| now.saturating_sub(begun) < LIFETIME.as_secs();
        if !is_soon(begun) {
            return None;
        }
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        used.retain(|_, begun| is_soon(*begun));
        if used.contains_key(&expected) {
            return None;
        }
        if used.len() >= MAX_USED
            && let Some(oldest) = used
                .iter()
                .min_by_key(|(_, begun)| **begun)
                .map(|(state, _)| state.clone())
        {
            used.remove(&oldest);
        }
        used.insert(expected, begun);
        Some(self.derive_sign_in(secret))
    }

    fn derive_sign_in(&self, secret: &str) -> PendingSignIn {
        PendingSignIn {
            nonce: self.derive("nonce", secret),
            verifier: self.derive("verifier", secret),
        }
    }

    /// Derives the value `name` of a sign-in from its secret.
    fn derive(&self, name: &str, secret: &str) -> String {
        URL_SAFE_NO_PAD.encode(sign(&self.key, format!("{name} {secret}").as_bytes()))
    }
}

/// Returns 256 random bits in base64.
pub(in crate::access) fn random() -> Result<String, TokenError> {
    let mut bytes = [0; RANDOM_BYTES];
    getrandom::fill(&mut bytes)?;
    Ok(URL_SAFE_NO_PAD.encode(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::sealed::tests::key;

    #[test]
    fn who_comes_back_is_who_left_and_once_and_soon() {
        let (pending, now) = (PendingSignIns::new(None).unwrap(), 1_000);
        let (secret, state, trip) = pending.begin(now).unwrap();
        let (other, other_state, other_trip) = pending.begin(now).unwrap();
        assert_ne!(trip, other_trip);
        assert!(trip.verifier.len() >= 43 && trip.nonce != trip.verifier);
        assert_eq!(pending.end(&other, &state, now), None, "another browser");
        assert_eq!(pending.end("", &state, now), None);
        assert_eq!(pending.end(&secret, &state, now), Some(trip));
        assert_eq!(pending.end(&secret, &state, now), None, "once");
        let late = now + LIFETIME.as_secs() + 1;
        assert_eq!(pending.end(&other, &other_state, late), None, "soon");
        let younger = other.replace(".1000", ".1600");
        assert_eq!(
            pending.end(&younger, &other_state, late),
            None,
            "its time is the server's"
        );
        let elsewhere = PendingSignIns::new(None).unwrap();
        assert_eq!(elsewhere.end(&other, &other_state, now), None, "another server");
    }

    #[test]
    fn with_a_shared_key_a_sign_in_ends_at_another_server() {
        let server = |letter: &str| PendingSignIns::new(Some(&key(letter))).unwrap();
        let (one, other) = (server("a"), server("a"));
        let (secret, state, trip) = one.begin(1_000).unwrap();
        assert_eq!(server("b").end(&secret, &state, 1_001), None, "another key");
        assert_eq!(other.end(&secret, &state, 1_000 + LIFETIME.as_secs()), None, "late");
        assert_eq!(other.end(&secret, &state, 1_001), Some(trip));
        assert_eq!(other.end(&secret, &state, 1_002), None, "once");
    }

    #[test]
    fn strangers_who_leave_make_nobody_come_back_in_vain_and_take_no_memory() {
        let (pending, now) = (PendingSignIns::new(None).unwrap(), 1_000);
        let (first, first_state, trip) = pending.begin(now).unwrap();
        for _ in 0..2 * MAX_USED {
            pending.begin(now).unwrap();
        }
        assert!(pending.used.lock().unwrap().is_empty());
        assert_eq!(pending.end(&first, &first_state, now), Some(trip));
        for _ in 0..MAX_USED + 10 {
            let (secret, state, _) = pending.begin(now).unwrap();
            assert!(pending.end(&secret, &state, now).is_some());
        }
        assert!(pending.used.lock().unwrap().len() <= MAX_USED);
    }

    #[test]
    fn the_challenge_is_that_of_the_rfc() {
        // RFC 7636, appendix B.
        let trip = PendingSignIn {
            nonce: String::new(),
            verifier: "dBjftJeZ4CVP-mB92K27uhbUJU1p1r_wW1gFWFOEjXk".into(),
        };
        assert_eq!(trip.challenge(), "E9Melhoa2OwvFrEMTJguCHaoeK1t8URWbuGJSstw-cM");
    }
}
