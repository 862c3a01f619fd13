//! Begins and ends the sessions of users who sign in through an issuer.

use axum::http::{HeaderMap, HeaderValue};

use super::Access;
use super::identity::Identity;
use super::oidc::{Oidc, SESSION_SECONDS, SIGN_IN_LIFETIME};
use crate::problem::ApiError;

impl Access {
    /// Returns the issuer through which users sign in.
    pub fn oidc(&self) -> Option<&Oidc> {
        self.oidc.as_ref()
    }

    /// Begins a sign-in. Returns the address of the issuer to which the browser is redirected, and the header that sets the cookie of the
    /// sign-in.
    ///
    /// # Errors
    /// The server has no issuer, or the issuer cannot be reached.
    pub async fn begin_sign_in(&self) -> Result<(String, HeaderValue), ApiError> {
        let oidc = self
            .oidc
            .as_ref()
            .ok_or_else(|| ApiError::not_found("/api/v1/oidc/login"))?;
        let (address, secret) = oidc.begin().await?;
        Ok((address, self.cookies.of_sign_in(&secret, SIGN_IN_LIFETIME.as_secs())))
    }

    /// Completes a sign-in after the browser has returned from the issuer with a code. Returns the user, and two headers: one sets the
    /// cookie of the new session, and one removes the cookie of the sign-in.
    ///
    /// # Errors
    /// The server has no issuer, the issuer does not confirm the sign-in, or the user has no role on this server.
    pub async fn end_sign_in(
        &self,
        headers: &HeaderMap,
        state: &str,
        code: &str,
    ) -> Result<(Identity, [HeaderValue; 2]), ApiError> {
        let (Some(oidc), Some(authenticator)) = (&self.oidc, &self.authenticator) else {
            return Err(ApiError::not_found("/api/v1/oidc/callback"));
        };
        let secret = self.cookies.sign_in_secret(headers);
        let confirmed = oidc.end(secret.as_deref(), state, code).await?;
        let sessions = authenticator.sessions();
        let secret = sessions.secret(&confirmed.user, confirmed.roles, SESSION_SECONDS);
        let secret = secret.map_err(ApiError::internal)?;
        sessions.begin(&secret, &confirmed.user, confirmed.roles, SESSION_SECONDS);
        let who = sessions.find(&secret).map(Identity::of_signed_in);
        let who = who.ok_or_else(|| ApiError::internal("a session that just began has ended"))?;
        Ok((who, [self.cookies.of_session(&secret), self.cookies.of_sign_in("", 0)]))
    }

    /// Returns the address of the page with the reason of a failed sign-in, which the page shows.
    pub fn sign_in_failed(&self, why: &ApiError) -> String {
        let oidc = self.oidc.as_ref();
        oidc.map_or_else(|| "/".to_owned(), |oidc| oidc.home_with(&why.to_string()))
    }

    /// Ends the session of a request's cookie, if there is one. Returns the address at which the user also signs out at the issuer, and the
    /// header that removes the cookie.
    pub async fn sign_out(&self, headers: &HeaderMap) -> (Option<String>, HeaderValue) {
        let secret = self.cookies.session(headers);
        let has_ended = match (&self.authenticator, secret) {
            (Some(authenticator), Some(secret)) => authenticator.sessions().end(secret),
            _ => false,
        };
        let issuer_address = match &self.oidc {
            Some(oidc) if has_ended => oidc.sign_out().await,
            _ => None,
        };
        (issuer_address, self.cookies.gone())
    }
}
