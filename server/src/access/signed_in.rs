//! Sessions of users who have signed in through an issuer. The browser has the secret of its session in a cookie.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use data_encoding::HEXLOWER;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use tokio_util::sync::CancellationToken;

use super::named::now;
use super::oidc::random;
use super::role::Roles;
use super::sealed::SessionKey;
use super::token::TokenError;

/// Maximum number of sessions, some 300 bytes each. A further one ends the oldest.
const MAX_SESSIONS: usize = 10_000;
/// Maximum number of sessions of one user, on several devices. A further one ends the oldest session of this user.
const MAX_OF_USER: usize = 16;
/// Bytes of the public name of a session: the first bytes of the hash of its secret.
const NAME_BYTES: usize = 6;
/// Maximum number of sessions that are remembered as ended, so that their secrets are refused. Only sealed secrets need this.
const MAX_ENDED: usize = 65_536;
/// What the secrets of sessions are sealed for.
const PURPOSE: &str = "session";

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

/// What the secret of a session states, if servers share a key.
#[derive(Serialize, Deserialize)]
struct SealedSession {
    /// Makes each secret different.
    random: String,
    user: String,
    roles: Roles,
    expires: u64,
}

/// All sessions, by the hashes of their secrets. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Sessions {
    store: Arc<Mutex<Store>>,
    /// If there is a key, secrets that another server has sealed with it are accepted.
    key: Option<SessionKey>,
}

#[derive(Debug, Default)]
struct Store {
    sessions: HashMap<[u8; 32], SignedIn>,
    /// Expiry of each ended session whose secret is sealed.
    ended: HashMap<[u8; 32], u64>,
}

impl Store {
    /// Begins a session. Ends the oldest one if there are too many.
    fn begin(&mut self, hash: [u8; 32], user: &str, roles: Roles, expires: u64) -> SignedIn {
        let session = SignedIn {
            user: user.into(),
            roles,
            name: name_of(&hash).into(),
            expires,
            ended: CancellationToken::new(),
        };
        let sessions = &mut self.sessions;
        sessions.retain(|_, session| session.is_valid());
        let own = sessions.values().filter(|session| *session.user == *user).count();
        let may_end = |session: &SignedIn| own < MAX_OF_USER || *session.user == *user;
        if own >= MAX_OF_USER || sessions.len() >= MAX_SESSIONS {
            let candidates = sessions.iter().filter(|(_, session)| may_end(session));
            let oldest = candidates
                .min_by_key(|(_, session)| session.expires)
                .map(|(hash, _)| *hash);
            if let Some(oldest) = oldest {
                self.end(&oldest);
            }
        }
        self.sessions.insert(hash, session.clone());
        session
    }

    /// Ends a session, and remembers that it has ended. Returns false if there is no such session.
    fn end(&mut self, hash: &[u8; 32]) -> bool {
        let Some(session) = self.sessions.remove(hash) else {
            return false;
        };
        session.ended.cancel();
        let now = now();
        self.ended.retain(|_, expires| *expires > now);
        if self.ended.len() < MAX_ENDED {
            self.ended.insert(*hash, session.expires);
        }
        true
    }
}

impl Sessions {
    /// Accepts the sessions of all servers that have this key.
    pub(super) fn with_key(self, key: SessionKey) -> Self {
        let key = Some(key);
        Self { key, ..self }
    }

    /// Returns the secret of a new session.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub(super) fn secret(&self, user: &str, roles: Roles, seconds: u64) -> Result<String, TokenError> {
        let random = random()?;
        let Some(key) = &self.key else {
            return Ok(random);
        };
        let sealed = SealedSession {
            random: random.clone(),
            user: user.to_owned(),
            roles,
            expires: now().saturating_add(seconds),
        };
        // Cannot fail: serde_json fails only for maps whose keys are not strings. A secret that is not sealed is this server's alone.
        Ok(key.seal(PURPOSE, &sealed).unwrap_or(random))
    }

    /// Begins a session with this secret, which expires after `seconds`.
    pub(super) fn begin(&self, secret: &str, user: &str, roles: Roles, seconds: u64) {
        let expires = now().saturating_add(seconds);
        self.lock().begin(hash_of(secret), user, roles, expires);
    }

    /// Returns the session of a secret, if it is still valid. The first time that a secret of another server is shown, begins its session
    /// here.
    pub(super) fn find(&self, secret: &str) -> Option<SignedIn> {
        let hash = hash_of(secret);
        let mut store = self.lock();
        if let Some(session) = store.sessions.get(&hash) {
            return session.is_valid().then(|| session.clone());
        }
        if store.ended.contains_key(&hash) {
            return None;
        }
        let sealed: SealedSession = self.key.as_ref()?.open(PURPOSE, secret)?;
        let is_valid = now() < sealed.expires;
        is_valid.then(|| store.begin(hash, &sealed.user, sealed.roles, sealed.expires))
    }

    /// Returns the session with a public name, as a token states it that the session has delegated at another server; `None` if it has ended
    /// here.
    pub(super) fn named(&self, name: &str, user: &str, roles: Roles, expires: u64) -> Option<SignedIn> {
        let begin = HEXLOWER.decode(name.as_bytes()).ok()?;
        let store = self.lock();
        let has_ended = store.ended.keys().any(|hash| hash[..NAME_BYTES] == begin[..]);
        let begun = store.sessions.values().find(|session| *session.name == *name);
        let stated = || SignedIn {
            user: user.into(),
            roles,
            name: name.into(),
            expires,
            ended: CancellationToken::new(),
        };
        (!has_ended).then(|| begun.cloned().unwrap_or_else(stated))
    }

    /// Ends a session and its streams. Returns false if there is no such session.
    pub(super) fn end(&self, secret: &str) -> bool {
        // Begins it, if it is another server's.
        self.find(secret);
        self.lock().end(&hash_of(secret))
    }

    fn lock(&self) -> MutexGuard<'_, Store> {
        self.store.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the public name of a session.
fn name_of(hash: &[u8; 32]) -> String {
    HEXLOWER.encode(&hash[..NAME_BYTES])
}

fn hash_of(secret: &str) -> [u8; 32] {
    Sha256::digest(secret).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::Role;
    use crate::access::sealed::tests::key;

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
        assert_eq!(sessions.lock().sessions.len(), 1 + MAX_OF_USER);
    }

    #[test]
    fn a_session_of_one_server_is_valid_at_others_with_its_key() {
        let server = |letter: &str| Sessions::default().with_key(key(letter));
        let (one, other, foreign) = (server("a"), server("a"), server("b"));
        let roles = Roles::from(vec![Role::Edit]);
        let secret = one.secret("ann", roles, 60).unwrap();
        one.begin(&secret, "ann", roles, 60);
        let (here, there) = (one.find(&secret).unwrap(), other.find(&secret).unwrap());
        assert_eq!((&*there.user, there.roles), ("ann", roles));
        assert_eq!((&here.name, here.expires), (&there.name, there.expires));
        assert!(foreign.find(&secret).is_none() && Sessions::default().find(&secret).is_none());
        assert_ne!(one.secret("ann", roles, 60).unwrap(), secret);
        // Signing out ends it at the server that is asked, also if another server has begun it.
        assert!(other.end(&secret) && there.ended.is_cancelled());
        assert!(other.find(&secret).is_none(), "it has ended here");
        assert!(one.find(&secret).is_some(), "the other server is not told");
        let late = one.secret("ann", roles, 0).unwrap();
        assert!(other.find(&late).is_none(), "it is over");
    }

    #[test]
    fn a_session_that_a_newer_one_has_ended_is_not_begun_again() {
        let sessions = Sessions::default().with_key(key("a"));
        let roles = Roles::from(vec![Role::View]);
        let secrets: Vec<_> = (0..=MAX_OF_USER as u64)
            .map(|n| sessions.secret("ann", roles, 60 + n).unwrap())
            .collect();
        for secret in &secrets {
            sessions.find(secret).unwrap();
        }
        assert!(sessions.find(&secrets[0]).is_none() && sessions.find(&secrets[1]).is_some());
    }
}
