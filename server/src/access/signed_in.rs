//! Sessions of users who have signed in through an issuer. The browser has the secret of its session in a cookie.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};
use tokio_util::sync::CancellationToken;

use super::named::now;
use super::role::Roles;

/// Maximum number of sessions, some 300 bytes each. A further one ends the oldest.
const MAX_SESSIONS: usize = 10_000;
/// Maximum number of sessions of one user, on several devices. A further one ends the oldest session of this user.
const MAX_OF_USER: usize = 16;
/// Bytes of the public name of a session: the first bytes of the hash of its secret.
const NAME_BYTES: usize = 6;

/// The session of a signed-in user. Clones are cheap.
#[derive(Clone, Debug)]
pub(super) struct SignedIn {
    pub user: Arc<str>,
    pub roles: Roles,
    /// Public name of the session, for logs. It reveals nothing about the secret.
    pub name: Arc<str>,
    /// Expiry in seconds of Unix time.
    pub expires: u64,
    /// Cancelled when the user signs out, or when a newer session ends this one.
    pub ended: CancellationToken,
}

impl SignedIn {
    pub(super) fn is_valid(&self) -> bool {
        !self.ended.is_cancelled() && now() < self.expires
    }
}

/// All sessions, by the hashes of their secrets. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Sessions(Arc<Mutex<HashMap<[u8; 32], SignedIn>>>);

impl Sessions {
    /// Begins a session with this secret, which expires after `seconds`.
    pub(super) fn begin(&self, secret: &str, user: &str, roles: Roles, seconds: u64) {
        let hash: [u8; 32] = Sha256::digest(secret).into();
        let session = SignedIn {
            user: user.into(),
            roles,
            name: HEXLOWER.encode(&hash[..NAME_BYTES]).into(),
            expires: now().saturating_add(seconds),
            ended: CancellationToken::new(),
        };
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.retain(|_, session| session.is_valid());
        let own = sessions.values().filter(|session| *session.user == *user).count();
        let may_end = |session: &SignedIn| own < MAX_OF_USER || *session.user == *user;
        if own >= MAX_OF_USER || sessions.len() >= MAX_SESSIONS {
            let candidates = sessions.iter().filter(|(_, session)| may_end(session));
            let oldest = candidates
                .min_by_key(|(_, session)| session.expires)
                .map(|(hash, _)| *hash);
            if let Some(oldest) = oldest.and_then(|hash| sessions.remove(&hash)) {
                oldest.ended.cancel();
            }
        }
        sessions.insert(hash, session);
    }

    /// Returns the session of a secret, if it is still valid.
    pub(super) fn find(&self, secret: &str) -> Option<SignedIn> {
        let hash: [u8; 32] = Sha256::digest(secret).into();
        let sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.get(&hash).filter(|session| session.is_valid()).cloned()
    }

    /// Ends a session and its streams. Returns false if there is no such session.
    pub(super) fn end(&self, secret: &str) -> bool {
        let hash: [u8; 32] = Sha256::digest(secret).into();
        let ended = self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&hash);
        ended.is_some_and(|session| {
            session.ended.cancel();
            true
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::Role;

    #[test]
    fn a_session_is_its_secret_until_it_ends() {
        let sessions = Sessions::default();
        let roles = Roles::from(vec![Role::Edit]);
        sessions.begin("secret", "ann", roles, 60);
        let found = sessions.find("secret").unwrap();
        assert_eq!((&*found.user, found.roles), ("ann", roles));
        assert!(sessions.find("other").is_none());
        assert!(sessions.end("secret") && !sessions.end("secret"));
        assert!(found.ended.is_cancelled() && !found.is_valid() && sessions.find("secret").is_none());
        sessions.begin("short", "ann", roles, 0);
        assert!(sessions.find("short").is_none(), "it is over");
    }

    #[test]
    fn who_signs_in_again_and_again_ends_no_session_of_others() {
        let sessions = Sessions::default();
        let roles = Roles::from(vec![Role::View]);
        sessions.begin("of bob", "bob", roles, 1);
        for number in 0..2 * MAX_OF_USER as u64 {
            sessions.begin(&format!("{number}"), "ann", roles, 60 + number);
        }
        assert!(sessions.find("of bob").is_some());
        assert!(sessions.find("0").is_none() && sessions.find("31").is_some());
        assert_eq!(sessions.0.lock().unwrap().len(), 1 + MAX_OF_USER);
    }
}
