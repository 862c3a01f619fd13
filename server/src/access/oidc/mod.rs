//! Sign-in through an OpenID Connect issuer: the authorization code flow with PKCE (RFC 7636). A user whose sign-in the issuer confirms
//! gets the roles that their groups have here, and a session of their own ([`super::signed_in`]).

mod claims;
mod pending;
mod provider;
mod signature;

#[cfg(test)]
mod tests;

use std::str::FromStr;
use std::sync::Arc;
use std::time::Instant;

use axum::http::StatusCode;
use reqwest::Url;

use self::claims::{Claims, ClaimsError, Expected};
use self::pending::PendingSignIns;
use self::provider::{Exchange, Provider, ProviderError, form_value, is_safe};
use super::PublicUrl;
use super::role::{Role, Roles};
use super::token::TokenError;
use crate::problem::ApiError;

pub(super) use pending::{LIFETIME as TRIP_LIFETIME, random};

/// Lifetime of a signed-in user's session: a working day.
pub(super) const SESSION_SECONDS: u64 = 10 * 3600;
/// The path that the issuer redirects browsers to, below the address of the server.
const CALLBACK: &str = "api/v1/oidc/callback";

/// Roles of a group at the issuer. On the command line: `GROUP=view,export`. The group `*` stands for all users.
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
    /// The issuer's address is invalid.
    #[error("--oidc-issuer {0:?}: expected an address such as https://login.example, as the issuer itself writes it")]
    Issuer(String),
    /// No group is given a role, so no user could do anything.
    #[error("--oidc-role: expected one or more, such as staff=edit,export, or *=view for everybody")]
    NoRoles,
    /// Requests cannot be sent.
    #[error("requests to the issuer cannot be sent")]
    Requests(#[source] reqwest::Error),
    /// The system has no random numbers for the key of sign-ins.
    #[error(transparent)]
    Random(TokenError),
}

/// The operator's configuration of an issuer.
#[derive(Clone)]
pub struct OidcOptions {
    /// Address of the issuer, as the issuer itself writes it.
    pub issuer: String,
    /// This server's client id at the issuer.
    pub client_id: String,
    /// The client secret; `None` for a public client.
    pub client_secret: Option<String>,
    /// The scopes to request, including `openid`. Some issuers have groups in a scope of their own; others refuse unknown scopes.
    pub scope: String,
    /// The claim that has the names of groups; dots separate the names of nested objects.
    pub groups_claim: String,
    /// Roles of groups.
    pub roles: Vec<GroupRoles>,
}

/// Leaves out the client secret.
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
    /// Address at which browsers find the server, with a slash at its end.
    home: Arc<str>,
}

/// A user whose sign-in the issuer has confirmed.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ConfirmedUser {
    pub user: String,
    pub roles: Roles,
}

impl Oidc {
    /// Creates the sign-in of a server that browsers find at `public`.
    ///
    /// # Errors
    /// [`OidcError`]. The issuer is not contacted here, so an unreachable one fails only when a user signs in.
    pub fn new(options: OidcOptions, public: &PublicUrl) -> Result<Self, OidcError> {
        let bad = || OidcError::Issuer(options.issuer.clone());
        let address: Url = options.issuer.parse().map_err(|_| bad())?;
        if !is_safe(&address) || address.query().is_some() || address.fragment().is_some() {
            return Err(bad());
        }
        if options.roles.is_empty() {
            return Err(OidcError::NoRoles);
        }
        let provider = Provider::new(options.issuer.clone()).map_err(|error| match error {
            ProviderError::Away(error) => OidcError::Requests(error),
            _ => bad(),
        })?;
        let home = public.to_string();
        Ok(Self {
            options: Arc::new(options),
            provider: Arc::new(provider),
            pending: PendingSignIns::new().map_err(OidcError::Random)?,
            home: format!("{}/", home.trim_end_matches('/')).into(),
        })
    }

    /// Returns the issuer, which is shown to users who sign in there.
    pub fn issuer(&self) -> &str {
        &self.options.issuer
    }

    /// Returns the address at which browsers find the server.
    pub fn home(&self) -> &str {
        &self.home
    }

    /// Begins a sign-in. Returns the issuer's address to which the browser is sent, and a secret that the browser brings back.
    pub(super) async fn begin(&self) -> Result<(String, String), ApiError> {
        let (metadata, _) = self.provider.metadata(false).await.map_err(away)?;
        let (secret, state, trip) = self.pending.begin(Instant::now()).map_err(no_random)?;
        let redirect = self.redirect();
        let mut address = metadata.authorization_endpoint.0;
        address
            .query_pairs_mut()
            .append_pair("response_type", "code")
            .append_pair("client_id", &self.options.client_id)
            .append_pair("redirect_uri", &redirect)
            .append_pair("scope", &self.options.scope)
            .append_pair("state", &state)
            .append_pair("nonce", &trip.nonce)
            .append_pair("code_challenge", &trip.challenge())
            .append_pair("code_challenge_method", "S256");
        Ok((address.into(), secret))
    }

    /// Completes a sign-in, after the browser has returned from the issuer with a code, a state and its secret.
    pub(super) async fn end(&self, secret: Option<&str>, state: &str, code: &str) -> Result<ConfirmedUser, ApiError> {
        let trip = secret.and_then(|secret| self.pending.end(secret, state, Instant::now()));
        let trip = trip.ok_or_else(|| {
            refused("this sign-in began in another browser, was used, or took longer than ten minutes")
        })?;
        let (metadata, keys) = self.provider.metadata(false).await.map_err(away)?;
        let redirect = self.redirect();
        let exchange = Exchange {
            client_id: &self.options.client_id,
            client_secret: self.options.client_secret.as_deref(),
            code,
            verifier: &trip.verifier,
            redirect: &redirect,
        };
        let token = self.provider.exchange(&metadata, &exchange).await.map_err(away)?;
        let expected = Expected {
            issuer: &self.options.issuer,
            client_id: &self.options.client_id,
            nonce: &trip.nonce,
        };
        let claims = match Claims::check(&token, &keys, &expected) {
            // The issuer may have new keys.
            Err(ClaimsError::UnknownKey) => {
                let (_, keys) = self.provider.metadata(true).await.map_err(away)?;
                Claims::check(&token, &keys, &expected)
            }
            checked => checked,
        };
        let claims = claims.map_err(|error| {
            refused("the issuer's word for you is not to be believed, the server's log says why").because(error)
        })?;
        self.vouched(&claims)
    }

    fn vouched(&self, claims: &Claims) -> Result<ConfirmedUser, ApiError> {
        let groups = claims.names(&self.options.groups_claim);
        let of_mine = self
            .options
            .roles
            .iter()
            .filter(|of| of.group == "*" || groups.contains(&of.group.as_str()));
        let roles: Vec<Role> = of_mine.flat_map(|of| Vec::from(of.roles)).collect();
        if roles.is_empty() {
            let message = "you are signed in, but none of your groups has a role here: who runs the server gives them with --oidc-role";
            return Err(ApiError::new(StatusCode::FORBIDDEN, "forbidden", message));
        }
        Ok(ConfirmedUser {
            // The prefix separates these users from those of named tokens, who may have the same name.
            user: format!("oidc:{}", claims.sub),
            roles: roles.into(),
        })
    }

    /// Returns the address at which the user also signs out at the issuer (RP-Initiated Logout 1.0). `None` if the issuer states none or
    /// cannot be reached.
    pub(super) async fn sign_out(&self) -> Option<String> {
        let (metadata, _) = self.provider.metadata(false).await.ok()?;
        let mut address = metadata.end_session_endpoint?.0;
        address
            .query_pairs_mut()
            .append_pair("client_id", &self.options.client_id)
            .append_pair("post_logout_redirect_uri", &self.home);
        Some(address.into())
    }

    /// Returns the home address with words that the page shows.
    pub(super) fn home_with(&self, words: &str) -> String {
        format!("{}#sign-in-failed={}", self.home, form_value(words))
    }

    fn redirect(&self) -> String {
        format!("{}{CALLBACK}", self.home)
    }
}

fn refused(message: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", message)
}

fn away(error: ProviderError) -> ApiError {
    let message = "the issuer cannot be asked now, the server's log says why: try again, or use a token";
    ApiError::new(StatusCode::BAD_GATEWAY, "issuer", message).because(error)
}

fn no_random(error: TokenError) -> ApiError {
    ApiError::internal(error)
}
