//! Who may use the server. Each request passes the `gate`: it is for the server's own names alone (`host`), comes from a page of its own
//! origin or an allowed one (`origin`), and shows (`proof`) a `token`, that of the server's start or one of the state folder (`named`, `watched`), whose
//! owner (`identity`) may do what it asks for (`role`) or has `lent` some of it, or a session (`signed_in`) that an issuer of OpenID Connect (`oidc`, `sign_in`) has led to; for a stream also a `ticket`, that somebody with a token has asked for. How often it may be asked for is a matter of
//! `rate`, of its token and of the `peer` that it comes from; what was done and what refused is in the `audit` log. What browsers may do with the server's own pages is its `policy`.

mod audit;
pub mod gate;
mod host;
mod identity;
mod lent;
mod named;
mod oidc;
mod origin;
mod peer;
mod policy;
mod proof;
mod rate;
mod role;
mod seats;
mod sign_in;
mod signed_in;
mod ticket;
mod token;
mod watched;

use std::net::SocketAddr;
use std::sync::Arc;

pub use audit::{Audit, AuditError};
pub use host::PublicUrl;
pub use identity::{Identity, OPERATOR};
pub use lent::{DEFAULT_SECONDS as DEFAULT_LENT_SECONDS, LendError};
pub use named::{NamedToken, NewToken, TokenFile, TokenFileError};
pub use oidc::{GroupRoles, Oidc, OidcError, OidcOptions};
pub use origin::AllowedOrigin;
pub use peer::{PeerAddress, TrustedProxy, counted_as, is_trusted};
pub use policy::content_security_policy;
pub use rate::Rates;
pub use role::{Role, Roles};
pub use seats::{NoSeat, Occupant, Seat, SeatLimits, Seats, Share};
pub use ticket::LIFETIME as TICKET_LIFETIME;
pub use token::{Token, TokenError};
pub use watched::TokenWatch;

use host::AllowedHosts;
use proof::{CookieName, Proofs};
use rate::RateLimits;
use ticket::Tickets;

/// Who may use a server. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Access {
    hosts: AllowedHosts,
    /// Origins whose pages may use the server, beside its own.
    origins: Arc<[AllowedOrigin]>,
    /// Origins whose pages may have the viewer in a frame, beside these.
    frames: Arc<[AllowedOrigin]>,
    /// That of `--public-url`.
    public_origins: Arc<[AllowedOrigin]>,
    cookie: CookieName,
    /// `None`: everybody may.
    proofs: Option<Proofs>,
    tickets: Tickets,
    /// `None`: as often as they like.
    rates: Option<RateLimits>,
    proxies: Arc<[TrustedProxy]>,
    audit: Option<Audit>,
    /// `None`: nobody signs in by an issuer.
    oidc: Option<Oidc>,
}

impl Access {
    /// For a server that listens there, is offered at `public` by proxies, the first of them for people, and lets pages of `origins` use it. Everybody
    /// may.
    pub fn new(listen: SocketAddr, public: &[PublicUrl], origins: &[AllowedOrigin]) -> Self {
        Self {
            hosts: AllowedHosts::new(listen, public),
            origins: origins.into(),
            frames: Arc::default(),
            public_origins: public.iter().map(|url| url.origin().clone()).collect(),
            cookie: CookieName::new(listen.port(), public.first().is_some_and(PublicUrl::is_https)),
            proofs: None,
            tickets: Tickets::default(),
            rates: None,
            proxies: Arc::default(),
            audit: None,
            oidc: None,
        }
    }

    /// For a server that encrypts connections itself.
    #[must_use]
    pub fn with_tls(mut self) -> Self {
        self.cookie = self.cookie.by_tls();
        self
    }

    /// For those who have the token, which is for everything.
    #[must_use]
    pub fn with_token(mut self, token: &Token) -> Self {
        self.proofs = Some(Proofs::new(token));
        self
    }

    /// For those too who have a token of a state folder. Where no token is asked for, these are not either.
    #[must_use]
    pub fn with_named(mut self, tokens: &TokenWatch) -> Self {
        if let Some(proofs) = &mut self.proofs {
            proofs.add_named(tokens.tokens());
        }
        self
    }

    /// For those too whom an issuer vouches for. Where no token is asked for, nobody has to sign in.
    #[must_use]
    pub fn with_oidc(mut self, oidc: Option<Oidc>) -> Self {
        self.oidc = oidc;
        self
    }

    /// For those who ask no more often than this.
    #[must_use]
    pub fn with_rates(mut self, rates: Rates) -> Self {
        self.rates = Some(RateLimits::new(rates));
        self
    }

    /// With the word of these proxies for where requests come from.
    #[must_use]
    pub fn with_proxies(mut self, proxies: &[TrustedProxy]) -> Self {
        self.proxies = proxies.into();
        self
    }

    /// With a log of who has done what.
    #[must_use]
    pub fn with_audit(mut self, audit: Option<Audit>) -> Self {
        self.audit = audit;
        self
    }

    /// Proxies whose word is taken.
    pub fn proxies(&self) -> &Arc<[TrustedProxy]> {
        &self.proxies
    }

    /// Whose token this is.
    pub fn who(&self, token: &str) -> Option<Identity> {
        match &self.proofs {
            None => Some(Identity::without_token()),
            Some(proofs) => proofs.of_token(token),
        }
    }

    /// Lets pages of these origins have the viewer in a frame too.
    #[must_use]
    pub fn with_frames(mut self, frames: &[AllowedOrigin]) -> Self {
        self.frames = frames.into();
        self
    }

    /// Origins whose pages may have the viewer in a frame, beside its own.
    pub fn frame_origins(&self) -> impl Iterator<Item = &AllowedOrigin> {
        self.origins.iter().chain(&*self.frames)
    }

    /// Origins whose pages may use the server, beside its own.
    pub fn origins(&self) -> &[AllowedOrigin] {
        &self.origins
    }
}
