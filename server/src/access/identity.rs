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

/// Name of the user who started the server, and who owns the start token. On a server without authentication, all requests are of this
/// user.
pub const OPERATOR: &str = "operator";

/// Interval at which the expiry of a token is checked. A single timer would be wrong after the system clock was set or the machine has
/// slept.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// An authenticated user. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Identity {
    user: Arc<str>,
    token: Arc<str>,
    roles: Roles,
    validity: Validity,
    /// Address that the request comes from.
    address: Option<IpAddr>,
}

/// How long an identity stays valid.
#[derive(Clone, Debug)]
enum Validity {
    /// Until the server ends.
    Always,
    /// Until the token expires, is revoked or changed.
    Named(Arc<NamedToken>, watch::Receiver<Arc<NamedTokens>>),
    /// Until the session ends.
    SignedIn(SignedIn),
    /// Until the delegated token or the token of its lender expires.
    Delegated(Delegated),
}

/// A delegated token. Its holder acts as the user of the lender.
#[derive(Clone, Debug)]
pub(super) struct Delegated {
    pub id: Arc<str>,
    pub roles: Roles,
    /// Expiry in seconds of Unix time.
    pub expires: u64,
    pub lender: Arc<Identity>,
}

impl Delegated {
    pub(super) fn is_valid(&self) -> bool {
        now() < self.expires && self.lender.is_valid()
    }
}

/// What an identity was proved by.
#[derive(Clone, Debug)]
pub(super) enum Credential {
    Start,
    Named(Arc<NamedToken>),
    SignedIn(SignedIn),
    Delegated,
}

impl Identity {
    /// Returns the identity of the user who started the server. `token` is the public name of the credential.
    pub(super) fn of_start(token: &str) -> Self {
        Self {
            user: OPERATOR.into(),
            token: token.into(),
            roles: Roles::ALL,
            validity: Validity::Always,
            address: None,
        }
    }

    /// Returns the identity of every user of a server without authentication.
    pub fn without_token() -> Self {
        Self::of_start("none")
    }

    /// Returns the identity of the owner of a named token. `tokens` tells when the token is revoked.
    pub(super) fn of_named(token: Arc<NamedToken>, tokens: watch::Receiver<Arc<NamedTokens>>) -> Self {
        Self {
            user: token.user.as_str().into(),
            token: token.id.as_str().into(),
            roles: token.roles,
            validity: Validity::Named(token, tokens),
            address: None,
        }
    }

    /// Returns the identity of a user who has signed in through an OpenID Connect issuer.
    pub(super) fn of_signed_in(session: SignedIn) -> Self {
        Self {
            user: Arc::clone(&session.user),
            token: Arc::clone(&session.name),
            roles: session.roles,
            validity: Validity::SignedIn(session),
            address: None,
        }
    }

    /// Returns the identity of the holder of a delegated token, who sees the same volumes as the user of the lender.
    pub(super) fn of_delegated(token: Delegated) -> Self {
        Self {
            user: Arc::clone(&token.lender.user),
            token: Arc::clone(&token.id),
            roles: token.roles,
            validity: Validity::Delegated(token),
            address: None,
        }
    }

    /// Returns the user who owns the token. Jobs and uploads belong to the user, not to the token.
    pub fn user(&self) -> &str {
        &self.user
    }

    /// Returns the public part of the token, or the public name of a signed-in user's session. Returns `start` for the start token, and
    /// `none` on a server without authentication.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Whether the token is a named token of the state folder.
    pub(super) fn is_named(&self) -> bool {
        matches!(self.validity, Validity::Named(..))
    }

    /// Returns what this identity was proved by.
    pub(super) fn credential(&self) -> Credential {
        match &self.validity {
            Validity::Always => Credential::Start,
            Validity::Named(token, _) => Credential::Named(Arc::clone(token)),
            Validity::SignedIn(session) => Credential::SignedIn(session.clone()),
            Validity::Delegated(_) => Credential::Delegated,
        }
    }

    /// Returns the same identity with the address that a request comes from.
    #[must_use]
    pub(super) fn at(self, peer: Option<IpAddr>) -> Self {
        let address = peer.map(counted_as);
        Self { address, ..self }
    }

    /// Returns the address that the request comes from, if it is known. An IPv6 address is replaced by its /64 network.
    pub fn address(&self) -> Option<IpAddr> {
        self.address
    }

    /// Whether the token was delegated.
    pub(super) fn is_delegated(&self) -> bool {
        matches!(self.validity, Validity::Delegated(..))
    }

    /// Returns the seconds until the token or session expires; `None` if it has no expiry.
    pub fn expires_seconds(&self) -> Option<u64> {
        let expires = match &self.validity {
            Validity::Always => return None,
            Validity::Named(token, _) => token.expires?,
            Validity::SignedIn(session) => session.expires,
            Validity::Delegated(token) => {
                let own = token.expires.saturating_sub(now());
                return Some(token.lender.expires_seconds().map_or(own, |seconds| seconds.min(own)));
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

    /// Returns a filter for the volumes that the user sees. An administrator sees the volumes of all users.
    pub fn reader(&self) -> Reader<'_> {
        Reader::new(&self.user, self.may(Role::Admin))
    }

    /// Returns the user if limits per user apply; `None` for administrators, who are exempt.
    pub fn limited_user(&self) -> Option<&str> {
        (!self.may(Role::Admin)).then_some(&*self.user)
    }

    /// Whether the token or session is still valid.
    pub(super) fn is_valid(&self) -> bool {
        match &self.validity {
            Validity::Always => true,
            Validity::Named(token, tokens) => {
                let is_unchanged = tokens.borrow().get(&token.id) == Some(token);
                is_unchanged && !token.has_expired(now())
            }
            Validity::SignedIn(session) => session.is_valid(),
            Validity::Delegated(token) => token.is_valid(),
        }
    }

    /// Resolves when the token has expired, was revoked or changed, or its owner has signed out.
    pub async fn ended(&self) {
        let (token, tokens) = match &self.validity {
            Validity::Always => return std::future::pending().await,
            Validity::Named(token, tokens) => (token, tokens),
            Validity::SignedIn(session) => {
                while session.is_valid() {
                    tokio::select! {
                        () = session.ended.cancelled() => {}
                        () = tokio::time::sleep(CHECK_INTERVAL) => {}
                    }
                }
                return;
            }
            Validity::Delegated(token) => {
                // Boxed, because the future is recursive.
                let lender = Box::pin(token.lender.ended());
                let own = async {
                    while token.is_valid() {
                        tokio::time::sleep(CHECK_INTERVAL).await;
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
                    // The sender was dropped, because the server shuts down.
                    return std::future::pending().await;
                },
                () = tokio::time::sleep(CHECK_INTERVAL), if token.expires.is_some() => {}
            }
        }
    }
}

/// Extracts the identity that the gate has attached to the request. Fails if the request has not passed the gate.
impl<S: Sync> FromRequestParts<S> for Identity {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let identity = parts.extensions.get::<Self>().cloned();
        identity.ok_or_else(|| ApiError::internal("a request has passed no gate"))
    }
}
