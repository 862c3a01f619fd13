//! Who may use the server. Each request passes the `gate`: it is for the server's own names alone (`host`), comes from a page of its own
//! origin or an allowed one (`origin`), and shows (`proof`) a `token`, that of the server's start or one of the state folder (`named`), whose
//! owner (`identity`) may do what it asks for (`role`); for a stream also a `ticket`, that somebody with a token has asked for. What browsers may do with the server's own pages is its `policy`.

pub mod gate;
mod host;
mod identity;
mod named;
mod origin;
mod policy;
mod proof;
mod role;
mod ticket;
mod token;

use std::net::SocketAddr;
use std::sync::Arc;

pub use host::PublicUrl;
pub use identity::{Identity, OPERATOR};
pub use named::{NamedToken, NewToken, TokenFile, TokenFileError, TokenWatch};
pub use origin::AllowedOrigin;
pub use policy::content_security_policy;
pub use role::{Role, Roles};
pub use ticket::LIFETIME as TICKET_LIFETIME;
pub use token::{Token, TokenError};

use host::AllowedHosts;
use proof::{CookieName, Proofs};
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
    public_origin: Option<AllowedOrigin>,
    cookie: CookieName,
    /// `None`: everybody may.
    proofs: Option<Proofs>,
    tickets: Tickets,
}

impl Access {
    /// For a server that listens there, is offered at `public` by a proxy, and lets pages of `origins` use it. Everybody may.
    pub fn new(listen: SocketAddr, public: Option<&PublicUrl>, origins: &[AllowedOrigin]) -> Self {
        Self {
            hosts: AllowedHosts::new(listen, public),
            origins: origins.into(),
            frames: Arc::default(),
            public_origin: public.map(|url| url.origin().clone()),
            cookie: CookieName::new(listen.port(), public.is_some_and(PublicUrl::is_https)),
            proofs: None,
            tickets: Tickets::default(),
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

    /// Origins whose pages may use the server, beside its own.
    pub fn origins(&self) -> &[AllowedOrigin] {
        &self.origins
    }
}
