//! Who may use the server. Each request passes the `gate`: it is for the server's own names alone (`host`), comes from a page of its own
//! origin or an allowed one (`origin`), and shows the `token`. What browsers may do with the server's own pages is its `policy`.

pub mod gate;
mod host;
mod origin;
mod policy;
mod token;

use std::net::SocketAddr;
use std::sync::Arc;

pub use host::PublicUrl;
pub use origin::AllowedOrigin;
pub use policy::content_security_policy;
pub use token::{Token, TokenError};

use host::AllowedHosts;
use token::TokenCheck;

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
    port: u16,
    is_https: bool,
    /// `None`: everybody may.
    token: Option<Arc<TokenCheck>>,
}

impl Access {
    /// For a server that listens there, is offered at `public` by a proxy, and lets pages of `origins` use it. Everybody may.
    pub fn new(listen: SocketAddr, public: Option<&PublicUrl>, origins: &[AllowedOrigin]) -> Self {
        Self {
            hosts: AllowedHosts::new(listen, public),
            origins: origins.into(),
            frames: Arc::default(),
            public_origin: public.map(|url| url.origin().clone()),
            port: listen.port(),
            is_https: public.is_some_and(PublicUrl::is_https),
            token: None,
        }
    }

    /// For those who have the token.
    #[must_use]
    pub fn with_token(mut self, token: &Token) -> Self {
        self.token = Some(Arc::new(TokenCheck::new(token, self.port, self.is_https)));
        self
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
