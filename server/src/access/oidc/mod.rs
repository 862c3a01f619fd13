//! Sign-in through an OpenID Connect issuer: the authorization code flow with PKCE (RFC 7636). After a confirmed sign-in, the user has a
//! session ([`super::signed_in`]) with the roles that the server's configuration gives to the user's groups.

mod claims;
mod pending;
mod provider;
mod signature;

#[cfg(test)]
mod tests;

use std::str::FromStr;
use std::sync::Arc;

use axum::http::StatusCode;
use reqwest::Url;

use self::claims::{Claims, ClaimsError, Expected};
use self::pending::PendingSignIns;
use self::provider::{Exchange, Provider, ProviderError, form_value, is_safe};
use super::PublicUrl;
use super::role::{Role, Roles};
use super::sealed::SessionKey;
use super::token::TokenError;
use crate::problem::ApiError;

pub(super) use pending::{LIFETIME as SIGN_IN_LIFETIME, random};

/// Lifetime of a session in seconds: a working day.
pub(super) const SESSION_SECONDS: u64 = 10 * 3600;
/// Path to which the issuer redirects browsers, below the address of the server.
const CALLBACK: &str = "api/v1/oidc/callback";

/// The roles that the members of a group get. Written as `GROUP=view,export` on the command line. The group `*` stands for all users.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupRoles {
    group: String,
    roles: Roles,
}

impl FromStr for GroupRoles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (group, roles) = text
            .rsplit_once('=')
            .filter(|(group, _)| !group.is_empty())
            .ok_or_else(|| format!("{text:?}, expected a group and its roles, such as staff=edit,export"))?;
        let roles: Vec<Role> = roles.split(',').map(str::parse).collect::<Result<_, _>>()?;
        Ok(Self {
            group: group.into(),
            roles: roles.into(),
        })
    }
}

/// Why sign-in through an issuer is not available.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OidcError {
    /// The address of the issuer is invalid.
    #[error("--oidc-issuer {0:?}: expected an address such as https://login.example, as the issuer itself writes it")]
    Issuer(String),
    /// No group has a role, so no user could do anything.
    #[error("--oidc-role: expected one or more, such as staff=edit,export, or *=view for everybody")]
    NoRoles,
    /// The HTTP client cannot be created.
    #[error("requests to the issuer cannot be sent")]
    Requests(#[source] reqwest::Error),
    /// The system has no random numbers for the key of sign-ins in progress.
    #[error(transparent)]
    Random(TokenError),
}

/// Configuration of an issuer.
#[derive(Clone)]
pub struct OidcOptions {
    /// Address of the issuer, as the issuer itself writes it.
    pub issuer: String,
    /// This server's client id at the issuer.
    pub client_id: String,
    /// The client secret; `None` for a public client.
    pub client_secret: Option<String>,
    /// The scopes to request, separated by spaces, including `openid`. Some issuers have a separate scope for groups; others refuse unknown
    /// scopes.
    pub scope: String,
    /// The claim with the names of groups. Dots separate the names of nested objects.
    pub groups_claim: String,
    /// Roles of groups.
    pub roles: Vec<GroupRoles>,
}

/// Leaves out the client secret, so that it is never logged.
impl std::fmt::Debug for OidcOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OidcOptions")
            .field("issuer", &self.issuer)
            .finish_non_exhaustive()
    }
}

/// Sign-in through an issuer. Clones are cheap.
#[derive(Clone, Debug)]
pub struct Oidc {
    options: Arc<OidcOptions>,
    provider: Arc<Provider>,
    pending: PendingSignIns,
    /// Public address of the server, with a slash at its end.
    home: Arc<str>,
}

/// A user whose sign-in the issuer has confirmed.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ConfirmedUser {
    pub user: String,
    pub roles: Roles,
}

impl Oidc {
    /// Creates the sign-in of a server with the address `public`. Sends no request to the issuer. `key` is the one that the servers at this
    /// address share, if there are several.
    ///
    /// # Errors
    /// [`OidcError`]. An unreachable issuer is not an error here, but fails when a user signs in.
    pub fn new(options: OidcOptions, public: &PublicUrl, key: Option<&SessionKey>) -> Result<Self, OidcError> {
        let bad = || OidcError::Issuer(options.issuer.clone());
        let address: Url = options.issuer.parse().map_err(|_| bad())?;
        if !is_safe(&address) || address.query().is_some() || address.fragment().is_some() {
            return Err(bad());
        }
        if options.roles.is_empty() {
            return Err(OidcError::NoRoles);
        }
        let provider = Provider::new(options.issuer.clone()).map_err(|error| match error {
            ProviderError::Unreachable(error) => OidcError::Requests(error),
            _ => bad(),
        })?;
        let home = public.to_string();
        Ok(Self {
            options: Arc::new(options),
            provider: Arc::new(provider),
            pending: PendingSignIns::new(key).map_err(OidcError::Random)?,
            home: format!("{}/", home.trim_end_matches('/')).into(),
        })
    }

    /// Returns the address of the issuer, which the page shows.
    pub fn issuer(&self) -> &str {
        &self.options.issuer
    }

    /// Returns the public address of the server, with a slash at its end.
    pub fn home(&self) -> &str {
        &self.home
    }

    /// Begins a sign-in. Returns the address of the issuer to which the browser is redirected, and a secret for the cookie of the sign-in.
    pub(super) async fn begin(&self) -> Result<(String, String), ApiError> {
        let (metadata, _) = self.provider.metadata(false).await.map_err(issuer_error)?;
        let (secret, state, sign_in) = self.pending.begin(self.pending.now()).map_err(no_random)?;
        let redirect = self.redirect();
        let mut address = metadata.authorization_endpoint.0;
        address
            .query_pairs_mut()
            .append_pair("response_type", "code")
            .append_pair("client_id", &self.options.client_id)
            .append_pair("redirect_uri", &redirect)
            .append_pair("scope", &self.options.scope)
            .append_pair("state", &state)
            .append_pair("nonce", &sign_in.nonce)
            .append_pair("code_challenge", &sign_in.challenge())
            .append_pair("code_challenge_method", "S256");
        Ok((address.into(), secret))
    }

    /// Completes a sign-in after the browser has returned from the issuer with a code, a state and the secret of its cookie.
    pub(super) async fn end(&self, secret: Option<&str>, state: &str, code: &str) -> Result<ConfirmedUser, ApiError> {
        let sign_in = secret.and_then(|secret| self.pending.end(secret, state, self.pending.now()));
        let sign_in = sign_in.ok_or_else(|| {
            refused("this sign-in began in another browser, was used, or took longer than ten minutes")
        })?;
        let (metadata, keys) = self.provider.metadata(false).await.map_err(issuer_error)?;
        let redirect = self.redirect();
        let exchange = Exchange {
            client_id: &self.options.client_id,
            client_secret: self.options.client_secret.as_deref(),
            code,
            verifier: &sign_in.verifier,
            redirect: &redirect,
        };
        let token = self
            .provider
            .exchange(&metadata, &exchange)
            .await
            .map_err(issuer_error)?;
        let expected = Expected {
            issuer: &self.options.issuer,
            client_id: &self.options.client_id,
            nonce: &sign_in.nonce,
        };
        let claims = match Claims::check(&token, &keys, &expected) {
            // Retries with a fresh list of keys, because the issuer may have a new key since the list was cached.
            Err(ClaimsError::UnknownKey) => {
                let (_, keys) = self.provider.metadata(true).await.map_err(issuer_error)?;
                Claims::check(&token, &keys, &expected)
            }
            checked => checked,
        };
        let claims = claims.map_err(|error| {
            refused("the ID token of the issuer is not valid, the server's log says why").because(error)
        })?;
        self.confirmed_user(&claims)
    }

    /// Returns the user of valid claims.
    ///
    /// # Errors
    /// No group of the user has a role.
    fn confirmed_user(&self, claims: &Claims) -> Result<ConfirmedUser, ApiError> {
        let groups = claims.names(&self.options.groups_claim);
        let matching = self
            .options
            .roles
            .iter()
            .filter(|entry| entry.group == "*" || groups.contains(&entry.group.as_str()));
        let roles: Vec<Role> = matching.flat_map(|entry| Vec::from(entry.roles)).collect();
        if roles.is_empty() {
            let message = "you are signed in, but none of your groups has a role on this server: its operator gives roles with --oidc-role";
            return Err(ApiError::new(StatusCode::FORBIDDEN, "forbidden", message));
        }
        Ok(ConfirmedUser {
            // The prefix distinguishes these users from users of named tokens, whose names could be the same.
            user: format!("oidc:{}", claims.sub),
            roles: roles.into(),
        })
    }

    /// Returns the address at which the user also signs out at the issuer (RP-Initiated Logout 1.0). Returns `None` if the issuer has no
    /// such address or cannot be reached.
    pub(super) async fn sign_out(&self) -> Option<String> {
        let (metadata, _) = self.provider.metadata(false).await.ok()?;
        let mut address = metadata.end_session_endpoint?.0;
        address
            .query_pairs_mut()
            .append_pair("client_id", &self.options.client_id)
            .append_pair("post_logout_redirect_uri", &self.home);
        Some(address.into())
    }

    /// Returns the address of the page with the reason of a failed sign-in, which the page shows.
    pub(super) fn home_with(&self, reason: &str) -> String {
        format!("{}#sign-in-failed={}", self.home, form_value(reason))
    }

    /// Returns the address to which the issuer redirects browsers.
    fn redirect(&self) -> String {
        format!("{}{CALLBACK}", self.home)
    }
}

fn refused(message: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", message)
}

fn issuer_error(error: ProviderError) -> ApiError {
    let message = "the request to the issuer failed, the server's log says why: try again, or use a token";
    ApiError::new(StatusCode::BAD_GATEWAY, "issuer", message).because(error)
}

fn no_random(error: TokenError) -> ApiError {
    ApiError::internal(error)
}
