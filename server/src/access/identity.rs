//! The authenticated sender of a request.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use isopeel_volumes::Reader;
use tokio::sync::watch;

use super::named::{NamedToken, NamedTokens, now};
use super::peer::counted_as;
use super::role::{Role, Roles};
use super::signed_in::SignedIn;
use crate::problem::ApiError;

/// The user who started the server. They own the start token; on a server without authentication they own everything.
pub const OPERATOR: &str = "operator";

/// Interval at which the expiry of a token is checked. One timer would be wrong if the system clock is set or the machine sleeps.
const LOOK: Duration = Duration::from_secs(1);

/// An authenticated user. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Identity {
    user: Arc<str>,
    token: Arc<str>,
    roles: Roles,
    holds: Holds,
    address: Option<IpAddr>,
}

/// How long an identity stays valid.
#[derive(Clone, Debug)]
enum Holds {
    /// For as long as the server runs.
    Always,
    /// Until the token expires, is revoked or changed.
    Named(Arc<NamedToken>, watch::Receiver<Arc<NamedTokens>>),
    /// Until the session ends.
    SignedIn(SignedIn),
    /// For minutes, and at most as long as the token that delegated it is valid.
    Delegated(Delegated),
}

/// A token that its lender has delegated. Its holder acts as the lender's user. Clones are the same token.
#[derive(Clone, Debug)]
pub(super) struct Delegated {
    pub id: Arc<str>,
    pub roles: Roles,
    /// Time at which it expires, in seconds of Unix time.
    pub expires: u64,
    pub lender: Arc<Identity>,
}

impl Delegated {
    pub(super) fn is_valid(&self) -> bool {
        now() < self.expires && self.lender.is_valid()
    }
}

impl Identity {
    /// The user who started the server; `token` is the public name of their credential.
    pub(super) fn of_start(token: &str) -> Self {
        Self {
            user: OPERATOR.into(),
            token: token.into(),
            roles: Roles::ALL,
            holds: Holds::Always,
            address: None,
        }
    }

    /// Every user of a server without authentication.
    pub fn without_token() -> Self {
        Self::of_start("none")
    }

    pub(super) fn of_named(token: Arc<NamedToken>, tokens: watch::Receiver<Arc<NamedTokens>>) -> Self {
        Self {
            user: token.user.as_str().into(),
            token: token.id.as_str().into(),
            roles: token.roles,
            holds: Holds::Named(token, tokens),
            address: None,
        }
    }

    /// A user who has signed in through an OpenID Connect issuer.
    pub(super) fn of_signed_in(session: SignedIn) -> Self {
        Self {
            user: Arc::clone(&session.user),
            token: Arc::clone(&session.name),
            roles: session.roles,
            holds: Holds::SignedIn(session),
            address: None,
        }
    }

    /// The holder of a delegated token. They see the same volumes as the lender's user.
    pub(super) fn of_lent(lent: Delegated) -> Self {
        Self {
            user: Arc::clone(&lent.lender.user),
            token: Arc::clone(&lent.id),
            roles: lent.roles,
            holds: Holds::Delegated(lent),
            address: None,
        }
    }

    /// The user who owns the token. Jobs and uploads belong to the user, not to the token.
    pub fn user(&self) -> &str {
        &self.user
    }

    /// The public part of the token, or the public name of a signed-in user's session. It is `start` for the start token, and `none` on a
    /// server without authentication.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Whether the token is one of the state folder.
    pub(super) fn is_named(&self) -> bool {
        matches!(self.holds, Holds::Named(..))
    }

    /// Returns the same identity with the address that a request comes from.
    #[must_use]
    pub(super) fn at(self, peer: Option<IpAddr>) -> Self {
        let address = peer.map(counted_as);
        Self { address, ..self }
    }

    /// Returns the address that a request comes from, if it is known; for IPv6 its network.
    pub fn address(&self) -> Option<IpAddr> {
        self.address
    }

    /// Whether the token was delegated.
    pub(super) fn is_delegated(&self) -> bool {
        matches!(self.holds, Holds::Delegated(..))
    }

    /// Returns the seconds until the token or session expires; `None` if it has no expiry.
    pub fn expires_seconds(&self) -> Option<u64> {
        let expires = match &self.holds {
            Holds::Always => return None,
            Holds::Named(token, _) => token.expires?,
            Holds::SignedIn(session) => session.expires,
            Holds::Delegated(lent) => {
                let own = lent.expires.saturating_sub(now());
                return Some(lent.lender.expires_seconds().map_or(own, |seconds| seconds.min(own)));
            }
        };
        Some(expires.saturating_sub(now()))
    }

    /// Returns the roles of the user.
    pub fn roles(&self) -> Roles {
        self.roles
    }

    /// Whether the user has a role, or one that includes it.
    pub fn may(&self, role: Role) -> bool {
        self.roles.include(role)
    }

    /// Returns a filter for the volumes that the user sees. An administrator sees those of all users.
    pub fn reader(&self) -> Reader<'_> {
        Reader::new(&self.user, self.may(Role::Admin))
    }

    /// Returns the user, if the limits per user apply to them. They do not apply to administrators.
    pub fn limited_user(&self) -> Option<&str> {
        (!self.may(Role::Admin)).then_some(&*self.user)
    }

    /// Whether the token or session is still valid.
    pub(super) fn is_valid(&self) -> bool {
        match &self.holds {
            Holds::Always => true,
            Holds::Named(token, tokens) => {
                let is_there = tokens.borrow().get(&token.id) == Some(token);
                is_there && !token.has_expired(now())
            }
            Holds::SignedIn(session) => session.is_valid(),
            Holds::Delegated(lent) => lent.is_valid(),
        }
    }

    /// Resolves when the token has expired, was revoked or changed, or its owner has signed out.
    pub async fn ended(&self) {
        let (token, tokens) = match &self.holds {
            Holds::Always => return std::future::pending().await,
            Holds::Named(token, tokens) => (token, tokens),
            Holds::SignedIn(session) => {
                while session.is_valid() {
                    tokio::select! {
                        () = session.ended.cancelled() => {}
                        () = tokio::time::sleep(LOOK) => {}
                    }
                }
                return;
            }
            Holds::Delegated(lent) => {
                let lender = Box::pin(lent.lender.ended());
                let own = async {
                    while lent.is_valid() {
                        tokio::time::sleep(LOOK).await;
                    }
                };
                tokio::select! {
                    () = lender => {}
                    () = own => {}
                }
                return;
            }
        };
        let mut tokens = tokens.clone();
        loop {
            tokens.mark_unchanged();
            if !self.is_valid() {
                return;
            }
            tokio::select! {
                changed = tokens.changed() => if changed.is_err() {
                    // The server is shutting down.
                    return std::future::pending().await;
                },
                () = tokio::time::sleep(LOOK), if token.expires.is_some() => {}
            }
        }
    }
}

/// Extracts the identity that the gate has attached to the request. Fails if the request has not passed the gate.
impl<S: Sync> FromRequestParts<S> for Identity {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let found = parts.extensions.get::<Self>().cloned();
        found.ok_or_else(|| ApiError::internal("a request has passed no gate"))
    }
}
