//! Who may use the server: requests for its own names alone (`host`), and pages of its own origin or an allowed one (`origin`). What
//! browsers may do with its own pages (`policy`).

pub mod host;
pub mod origin;
mod policy;

use std::net::SocketAddr;
use std::sync::Arc;

pub use host::{PublicUrl, check_host};
pub use origin::AllowedOrigin;
pub use policy::content_security_policy;

use host::AllowedHosts;

/// Who may use a server. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Access {
    hosts: AllowedHosts,
    /// Origins whose pages may use the server, beside its own.
    origins: Arc<[AllowedOrigin]>,
    /// That of `--public-url`.
    public_origin: Option<AllowedOrigin>,
}

impl Access {
    /// For a server that listens there, is offered at `public` by a proxy, and lets pages of `origins` use it.
    pub fn new(listen: SocketAddr, public: Option<&PublicUrl>, origins: &[AllowedOrigin]) -> Self {
        Self {
            hosts: AllowedHosts::new(listen, public),
            origins: origins.into(),
            public_origin: public.map(|url| url.origin().clone()),
        }
    }

    /// Origins whose pages may use the server, beside its own.
    pub fn origins(&self) -> &[AllowedOrigin] {
        &self.origins
    }
}
