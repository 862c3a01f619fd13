//! Who asks.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use tokio::sync::watch;

use super::named::{NamedToken, NamedTokens, now};
use super::peer::counted_as;
use super::role::{Role, Roles};
use super::signed_in::SignedIn;
use crate::problem::ApiError;
use crate::volumes::Reader;

/// The user of whoever started the server: the token of its start is theirs, and all is where none is asked for.
pub const OPERATOR: &str = "operator";

/// The time of day may be set, and a machine may sleep: a token that expires is looked at this often.
const LOOK: Duration = Duration::from_secs(1);

/// Who has shown a token. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Identity {
    user: Arc<str>,
    token: Arc<str>,
    roles: Roles,
    holds: Holds,
    address: Option<IpAddr>,
}

/// How long somebody is who they are.
#[derive(Clone, Debug)]
enum Holds {
    /// For as long as the server runs.
    Always,
    /// Until the token expires, is revoked or changed.
    Named(Arc<NamedToken>, watch::Receiver<Arc<NamedTokens>>),
    /// Until the session ends.
    SignedIn(SignedIn),
    /// For minutes, and no longer than the token that it was made with.
    Lent(Lent),
}

/// Somebody's token, for somebody else. Clones are the same.
#[derive(Clone, Debug)]
pub(super) struct Lent {
    pub id: Arc<str>,
    pub roles: Roles,
    /// In seconds of Unix time.
    pub expires: u64,
    pub lender: Arc<Identity>,
}

impl Lent {
    pub(super) fn is_valid(&self) -> bool {
        now() < self.expires && self.lender.is_valid()
    }
}

impl Identity {
    /// Whoever started the server; `token` says how they are known.
    pub(super) fn of_start(token: &str) -> Self {
        Self {
            user: OPERATOR.into(),
            token: token.into(),
            roles: Roles::ALL,
            holds: Holds::Always,
            address: None,
        }
    }

    /// Whoever uses a server that asks for no token.
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

    /// Somebody whom an issuer has vouched for.
    pub(super) fn of_signed_in(session: SignedIn) -> Self {
        Self {
            user: Arc::clone(&session.user),
            token: Arc::clone(&session.name),
            roles: session.roles,
            holds: Holds::SignedIn(session),
            address: None,
        }
    }

    /// Somebody who was lent a token: what they see is the lender's.
    pub(super) fn of_lent(lent: Lent) -> Self {
        Self {
            user: Arc::clone(&lent.lender.user),
            token: Arc::clone(&lent.id),
            roles: lent.roles,
            holds: Holds::Lent(lent),
            address: None,
        }
    }

    /// Whose token it is: what they own is theirs with another token too.
    pub fn user(&self) -> &str {
        &self.user
    }

    /// The public part of the token, or of the session of who has signed in; `start` for that of the server's start, `none` where none is asked for.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Whether the token is one of the state folder.
    pub(super) fn is_named(&self) -> bool {
        matches!(self.holds, Holds::Named(..))
    }

    /// The same, with the address that a request comes from.
    #[must_use]
    pub(super) fn at(self, peer: Option<IpAddr>) -> Self {
        let address = peer.map(counted_as);
        Self { address, ..self }
    }

    /// The address that a request comes from, if it is known; of IPv6 the network.
    pub fn address(&self) -> Option<IpAddr> {
        self.address
    }

    /// Whether the token was lent.
    pub(super) fn is_lent(&self) -> bool {
        matches!(self.holds, Holds::Lent(..))
    }

    /// After how many seconds the token is of no use any more; `None` where that is not known.
    pub fn expires_seconds(&self) -> Option<u64> {
        let expires = match &self.holds {
            Holds::Always => return None,
            Holds::Named(token, _) => token.expires?,
            Holds::SignedIn(session) => session.expires,
            Holds::Lent(lent) => {
                let own = lent.expires.saturating_sub(now());
                return Some(lent.lender.expires_seconds().map_or(own, |seconds| seconds.min(own)));
            }
        };
        Some(expires.saturating_sub(now()))
    }

    /// What they may do.
    pub fn roles(&self) -> Roles {
        self.roles
    }

    /// Whether they may do what a role is for.
    pub fn may(&self, role: Role) -> bool {
        self.roles.include(role)
    }

    /// The volumes that they see: an administrator sees those of all users.
    pub fn reader(&self) -> Reader<'_> {
        Reader::new(&self.user, self.may(Role::Admin))
    }

    /// The user, if limits of one user are for them: an administrator has none.
    pub fn limited_user(&self) -> Option<&str> {
        (!self.may(Role::Admin)).then_some(&*self.user)
    }

    /// Whether the token holds still.
    pub(super) fn is_valid(&self) -> bool {
        match &self.holds {
            Holds::Always => true,
            Holds::Named(token, tokens) => {
                let is_there = tokens.borrow().get(&token.id) == Some(token);
                is_there && !token.has_expired(now())
            }
            Holds::SignedIn(session) => session.is_valid(),
            Holds::Lent(lent) => lent.is_valid(),
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
            Holds::Lent(lent) => {
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
                    // The server ends.
                    return std::future::pending().await;
                },
                () = tokio::time::sleep(LOOK), if token.expires.is_some() => {}
            }
        }
    }
}

/// As the gate has left it. Behind no gate there is nobody.
impl<S: Sync> FromRequestParts<S> for Identity {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let found = parts.extensions.get::<Self>().cloned();
        found.ok_or_else(|| ApiError::internal("a request has passed no gate"))
    }
}
