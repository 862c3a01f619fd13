//! Authentication and authorization. The `gate` checks each request:
//!
//! - Its header `Host` names a host of this server (`host`).
//! - It comes from a page of the server, from a page of an allowed origin, or from no page (`origin`).
//! - It carries a `proof` of its sender (`identity`): a `token`, a session or a ticket. A token is the start token, a token of the state
//!   folder (`named`, `watched`) or a delegated one (`delegated`). A session (`signed_in`) begins with a sign-in through an OpenID
//!   Connect issuer (`oidc`, `sign_in`). A `ticket` is for a stream only; a page with a token or a session requests the ticket first.
//!   Servers that share a key accept each other's sessions and delegated tokens (`sealed`).
//! - The sender has a `role` that allows the request.
//! - The rate limits (`rate`) of the token and of the `peer` are not exceeded.
//!
//! The `audit` log records requests and refusals. `policy` restricts what browsers let the pages of the server do. `seats` limits the
//! number of concurrent viewers.

mod audit;
mod delegated;
pub mod gate;
mod host;
mod identity;
mod named;
mod oidc;
mod origin;
mod peer;
mod policy;
mod proof;
mod rate;
mod role;
mod sealed;
mod seats;
mod sign_in;
mod signed_in;
mod ticket;
mod token;
mod watched;

use std::net::SocketAddr;
use std::sync::Arc;

pub use audit::{Audit, AuditError};
pub use delegated::{DEFAULT_SECONDS as DEFAULT_DELEGATED_SECONDS, DelegateError};
pub use host::PublicUrl;
pub use identity::{Identity, OPERATOR};
pub use named::{NamedToken, NewToken, TokenFile, TokenFileError};
pub use oidc::{GroupRoles, Oidc, OidcError, OidcOptions};
pub use origin::AllowedOrigin;
pub use peer::{PeerAddress, TrustedProxy, counted_as, is_trusted};
pub use policy::content_security_policy;
pub use rate::Rates;
pub use role::{Role, Roles};
pub use sealed::SessionKey;
pub use seats::{NoSeat, Occupant, Seat, SeatLimits, Seats, Share};
pub use ticket::LIFETIME as TICKET_LIFETIME;
pub use token::{Token, TokenError};
pub use watched::TokenWatch;

use host::AllowedHosts;
use proof::{Authenticator, CookieFactory};
use rate::RateLimits;
use ticket::Tickets;

/// Authentication and authorization of a server. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Access {
    hosts: AllowedHosts,
    /// Origins whose pages may use the server, in addition to its own.
    origins: Arc<[AllowedOrigin]>,
    /// Origins whose pages may embed the viewer in a frame, in addition to `origins`.
    frames: Arc<[AllowedOrigin]>,
    /// Origins of `--public-url`.
    public_origins: Arc<[AllowedOrigin]>,
    cookies: CookieFactory,
    /// `None` if the server runs without authentication.
    authenticator: Option<Authenticator>,
    tickets: Tickets,
    /// `None` if there are no rate limits.
    rates: Option<RateLimits>,
    proxies: Arc<[TrustedProxy]>,
    audit: Option<Audit>,
    /// `None` if users cannot sign in through an issuer.
    oidc: Option<Oidc>,
}

impl Access {
    /// Creates the access control of a server that listens on `listen`, without authentication. `public` are the addresses of the server at
    /// proxies; the server prints the first of them for users. Pages of `origins` may use the server.
    pub fn new(listen: SocketAddr, public: &[PublicUrl], origins: &[AllowedOrigin]) -> Self {
        Self {
            hosts: AllowedHosts::new(listen, public),
            origins: origins.into(),
            frames: Arc::default(),
            public_origins: public.iter().map(|url| url.origin().clone()).collect(),
            cookies: match public.first() {
                Some(url) => CookieFactory::new(url.place(), url.is_https()),
                None => CookieFactory::new(listen.port().to_string(), false),
            },
            authenticator: None,
            tickets: Tickets::default(),
            rates: None,
            proxies: Arc::default(),
            audit: None,
            oidc: None,
        }
    }

    /// Declares that the server encrypts connections itself, so that its cookie is for HTTPS only.
    #[must_use]
    pub fn with_tls(mut self) -> Self {
        self.cookies = self.cookies.for_https();
        self
    }

    /// Requires authentication. `token` is the start token, which has all roles.
    #[must_use]
    pub fn with_token(mut self, token: &Token) -> Self {
        self.authenticator = Some(Authenticator::new(token));
        self
    }

    /// Also accepts the tokens of a state folder. Has no effect on a server without authentication.
    #[must_use]
    pub fn with_named(mut self, tokens: &TokenWatch) -> Self {
        if let Some(authenticator) = &mut self.authenticator {
            authenticator.add_named(tokens.tokens());
        }
        self
    }

    /// Accepts the sessions and delegated tokens of all servers that have this key. Has no effect on a server without authentication.
    #[must_use]
    pub fn with_session_key(mut self, key: Option<&SessionKey>) -> Self {
        if let (Some(authenticator), Some(key)) = (&mut self.authenticator, key) {
            authenticator.share(key);
        }
        self
    }

    /// Also lets users sign in through an issuer. Has no effect on a server without authentication.
    #[must_use]
    pub fn with_oidc(mut self, oidc: Option<Oidc>) -> Self {
        self.oidc = oidc;
        self
    }

    /// Limits the rate of requests.
    #[must_use]
    pub fn with_rates(mut self, rates: Rates) -> Self {
        self.rates = Some(RateLimits::new(rates));
        self
    }

    /// Trusts these proxies to state the address that a request comes from.
    #[must_use]
    pub fn with_proxies(mut self, proxies: &[TrustedProxy]) -> Self {
        self.proxies = proxies.into();
        self
    }

    /// Adds an audit log.
    #[must_use]
    pub fn with_audit(mut self, audit: Option<Audit>) -> Self {
        self.audit = audit;
        self
    }

    /// Returns the trusted proxies.
    pub fn proxies(&self) -> &Arc<[TrustedProxy]> {
        &self.proxies
    }

    /// Returns the identity of the owner of a token; `None` if the token is not valid.
    pub fn who(&self, token: &str) -> Option<Identity> {
        match &self.authenticator {
            None => Some(Identity::without_token()),
            Some(authenticator) => authenticator.of_token(token),
        }
    }

    /// Also lets pages of these origins embed the viewer in a frame.
    #[must_use]
    pub fn with_frames(mut self, frames: &[AllowedOrigin]) -> Self {
        self.frames = frames.into();
        self
    }

    /// Returns the origins whose pages may embed the viewer in a frame, in addition to the server's own.
    pub fn frame_origins(&self) -> impl Iterator<Item = &AllowedOrigin> {
        self.origins.iter().chain(&*self.frames)
    }

    /// Returns the origins whose pages may use the server, in addition to its own.
    pub fn origins(&self) -> &[AllowedOrigin] {
        &self.origins
    }
}
