//! People on their way to an issuer and back. A browser keeps a secret in a cookie of its own, whose hash is the `state` that goes round: what comes back
//! to another browser is of no use there.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};

use crate::access::token::TokenError;

/// How long somebody may be away: time for a password and a second factor.
pub(in crate::access) const LIFETIME: Duration = Duration::from_secs(600);
/// Maximum of those who are away, 200 bytes each. Of more the first who went come back in vain.
const MAX_AWAY: usize = 4_096;
const RANDOM_BYTES: usize = 32;

/// What is kept of somebody who is away.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Trip {
    pub nonce: String,
    /// PKCE's code verifier (RFC 7636).
    pub verifier: String,
    begun: Instant,
}

impl Trip {
    /// PKCE's code challenge.
    pub(super) fn challenge(&self) -> String {
        digest(&self.verifier)
    }
}

/// All of them, by the state of each. Clones are the same.
#[derive(Clone, Debug, Default)]
pub(super) struct Pending(Arc<Mutex<HashMap<String, Trip>>>);

impl Pending {
    /// Somebody leaves: the secret for their browser, the state, and what is kept.
    pub(super) fn begin(&self, now: Instant) -> Result<(String, String, Trip), TokenError> {
        let (secret, trip) = (
            random()?,
            Trip {
                nonce: random()?,
                verifier: random()?,
                begun: now,
            },
        );
        let state = digest(&secret);
        let mut trips = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        trips.retain(|_, trip| now.duration_since(trip.begun) < LIFETIME);
        if trips.len() >= MAX_AWAY
            && let Some(first) = trips
                .iter()
                .min_by_key(|(_, trip)| trip.begun)
                .map(|(state, _)| state.clone())
        {
            trips.remove(&first);
        }
        trips.insert(state.clone(), trip.clone());
        Ok((secret, state, trip))
    }

    /// Somebody is back, with this secret in their browser: once.
    pub(super) fn end(&self, secret: &str, state: &str, now: Instant) -> Option<Trip> {
        if digest(secret) != state {
            return None;
        }
        let trip = self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(state)?;
        (now.duration_since(trip.begun) < LIFETIME).then_some(trip)
    }
}

pub(in crate::access) fn random() -> Result<String, TokenError> {
    let mut bytes = [0; RANDOM_BYTES];
    getrandom::fill(&mut bytes)?;
    Ok(URL_SAFE_NO_PAD.encode(bytes))
}

fn digest(text: &str) -> String {
    URL_SAFE_NO_PAD.encode(Sha256::digest(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_back_is_who_left_and_once_and_soon() {
        let (pending, now) = (Pending::default(), Instant::now());
        let (secret, state, trip) = pending.begin(now).unwrap();
        let (other, other_state, _) = pending.begin(now).unwrap();
        assert_eq!(pending.end(&other, &state, now), None, "another browser");
        assert_eq!(pending.end("", &state, now), None);
        assert_eq!(pending.end(&secret, &state, now), Some(trip));
        assert_eq!(pending.end(&secret, &state, now), None, "once");
        assert_eq!(pending.end(&other, &other_state, now + LIFETIME), None, "soon");
    }

    #[test]
    fn many_who_leave_take_no_more_memory() {
        let (pending, now) = (Pending::default(), Instant::now());
        let (first, first_state, _) = pending.begin(now).unwrap();
        let later = now + Duration::from_secs(1);
        let mut last = None;
        for _ in 0..MAX_AWAY {
            last = Some(pending.begin(later).unwrap());
        }
        let (secret, state, _) = last.unwrap();
        assert!(pending.end(&secret, &state, later).is_some());
        assert_eq!(pending.end(&first, &first_state, later), None);
        assert!(pending.0.lock().unwrap().len() <= MAX_AWAY);
    }

    #[test]
    fn the_challenge_is_that_of_the_rfc() {
        // RFC 7636, appendix B.
        let trip = Trip {
            nonce: String::new(),
            verifier: "dBjftJeZ4CVP-mB92K27uhbUJU1p1r_wW1gFWFOEjXk".into(),
            begun: Instant::now(),
        };
        assert_eq!(trip.challenge(), "E9Melhoa2OwvFrEMTJguCHaoeK1t8URWbuGJSstw-cM");
    }
}
