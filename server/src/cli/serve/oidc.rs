//! Options of `isopeel serve` for sign-in through an OpenID Connect issuer.

use std::path::PathBuf;

use crate::access::{GroupRoles, Oidc, OidcError, OidcOptions, PublicUrl, SessionKey};

/// Arguments of `isopeel serve` about an issuer.
#[derive(Debug, clap::Args)]
pub struct OidcArgs {
    /// Let people sign in by this issuer of OpenID Connect, https://login.example, as it writes itself; beside tokens. Needs --public-url, at which
    /// /api/v1/oidc/callback has to be registered with the issuer
    #[arg(long, value_name = "URL", requires = "oidc_client_id")]
    oidc_issuer: Option<String>,

    /// This server's name at the issuer
    #[arg(long, value_name = "ID")]
    oidc_client_id: Option<String>,

    /// File with the secret that the issuer knows this server by; without it, it is a public client
    #[arg(long, value_name = "FILE")]
    oidc_client_secret_file: Option<PathBuf>,

    /// Scopes that the issuer is asked for; many need "openid profile groups" for groups
    #[arg(long, value_name = "SCOPES", default_value = "openid profile")]
    oidc_scope: String,

    /// Claim of the ID token with the names of somebody's groups; dots lead into it, as in realm_access.roles
    #[arg(long, value_name = "NAME", default_value = "groups")]
    oidc_groups_claim: String,

    /// Roles of a group at the issuer, such as staff=edit,export, or of everybody who signs in, *=view; may be given again
    #[arg(long, value_name = "GROUP=ROLE,...")]
    oidc_role: Vec<GroupRoles>,
}

/// Why sign-in cannot be set up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A required option is missing, or options exclude each other.
    #[error("--oidc-issuer: {0}")]
    Missing(&'static str),
    /// The client secret cannot be read.
    #[error("--oidc-client-secret-file: {0:?} cannot be read")]
    Secret(PathBuf, #[source] std::io::Error),
    /// The configuration of the issuer is invalid.
    #[error(transparent)]
    Issuer(#[from] OidcError),
}

impl OidcArgs {
    /// Returns the file of the client secret.
    pub(super) fn secret_file(&self) -> Option<&PathBuf> {
        self.oidc_client_secret_file.as_ref()
    }

    /// Returns the sign-in of the arguments, if they name an issuer. `is_open` means that the server runs without authentication; `key` is
    /// the one that several servers share.
    pub(super) fn open(
        &self,
        public: Option<&PublicUrl>,
        is_open: bool,
        key: Option<&SessionKey>,
    ) -> Result<Option<Oidc>, Error> {
        let Some(issuer) = &self.oidc_issuer else {
            return Ok(None);
        };
        if is_open {
            return Err(Error::Missing("no token is asked for, so nobody has to sign in"));
        }
        let public = public.ok_or(Error::Missing(
            "expected --public-url, to which the issuer sends browsers back",
        ))?;
        let client_id = self
            .oidc_client_id
            .clone()
            .ok_or(Error::Missing("expected --oidc-client-id"))?;
        let read = |file: &PathBuf| match std::fs::read_to_string(file) {
            Ok(text) => Ok(text.trim().to_owned()),
            Err(error) => Err(Error::Secret(file.clone(), error)),
        };
        let options = OidcOptions {
            issuer: issuer.clone(),
            client_id,
            client_secret: self.oidc_client_secret_file.as_ref().map(read).transpose()?,
            scope: self.oidc_scope.clone(),
            groups_claim: self.oidc_groups_claim.clone(),
            roles: self.oidc_role.clone(),
        };
        Ok(Some(Oidc::new(options, public, key)?))
    }
}
