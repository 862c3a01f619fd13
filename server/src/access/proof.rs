//! How a request authenticates its sender: a token in a header, or a cookie.

use std::sync::Arc;

use axum::http::HeaderValue;
use axum::http::header::{AUTHORIZATION, COOKIE, HeaderMap};
use tokio::sync::watch;

use super::delegated::DelegatedTokens;
use super::identity::Identity;
use super::named::{NamedToken, NamedTokens, now};
use super::signed_in::Sessions;
use super::token::{Hash, Token, cookie_value, id_of};

/// Prefix of a session's secret in a cookie; a dot follows it. It cannot be the id of a token, because these are hexadecimal.
const SIGNED_IN: &str = "oidc";

/// How a request has authenticated its sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Proof {
    /// A token in a header. No page of another origin can make a browser send this header.
    Header,
    /// The cookie, which a browser sends with every request.
    Cookie,
    /// A ticket for a stream, from the page that opens it.
    Ticket,
}

/// Checks tokens and cookies; keeps only their hashes.
#[derive(Clone, Debug)]
pub(super) struct Proofs {
    token: Hash,
    cookie: Hash,
    start: Identity,
    /// Tokens of a state folder.
    named: Option<watch::Receiver<Arc<NamedTokens>>>,
    /// Sessions of users who have signed in through an issuer.
    sessions: Sessions,
    /// Delegated tokens.
    lent: DelegatedTokens,
}

impl Proofs {
    pub(super) fn new(token: &Token) -> Self {
        Self {
            token: Hash::of(token.text()),
            cookie: Hash::of(&cookie_value(token.text())),
            start: Identity::of_start("start"),
            named: None,
            sessions: Sessions::default(),
            lent: DelegatedTokens::default(),
        }
    }

    /// Sessions of signed-in users.
    pub(super) fn sessions(&self) -> &Sessions {
        &self.sessions
    }

    /// Returns the delegated tokens.
    pub(super) fn lent(&self) -> &DelegatedTokens {
        &self.lent
    }

    pub(super) fn add_named(&mut self, named: watch::Receiver<Arc<NamedTokens>>) {
        self.named = Some(named);
    }

    /// Returns the identity of a token's owner; `None` if the token is not valid.
    pub(super) fn of_token(&self, token: &str) -> Option<Identity> {
        if self.token.is_of(token) {
            return Some(self.start.clone());
        }
        let id = id_of(token)?;
        let named = self.of_named(id, |named| named.sha256.is_of(token));
        named.or_else(|| self.lent.find(id, token).map(Identity::of_lent))
    }

    /// Returns the identity that a cookie's value stands for; `None` if it is not valid.
    fn of_cookie(&self, value: &str) -> Option<Identity> {
        match value.split_once('.') {
            None => self.cookie.is_of(value).then(|| self.start.clone()),
            Some((SIGNED_IN, secret)) => self.sessions.find(secret).map(Identity::of_signed_in),
            Some((id, value)) => self.of_named(id, |named| named.cookie.is_of(value)),
        }
    }

    fn of_named(&self, id: &str, is_right: impl FnOnce(&NamedToken) -> bool) -> Option<Identity> {
        let tokens = self.named.as_ref()?;
        let found = Arc::clone(tokens.borrow().get(id)?);
        (is_right(&found) && !found.has_expired(now())).then(|| Identity::of_named(found, tokens.clone()))
    }

    /// Returns how a request authenticates, and its sender; `None` if it does not authenticate.
    pub(super) fn find(&self, headers: &HeaderMap, cookie: &CookieName) -> Option<(Proof, Identity)> {
        let bearer = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = bearer.and_then(|value| {
            let (scheme, token) = value.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
        });
        if let Some(found) = bearer.and_then(|token| self.of_token(token)) {
            return Some((Proof::Header, found));
        }
        cookies(headers, &cookie.name)
            .find_map(|value| self.of_cookie(value))
            .map(|found| (Proof::Cookie, found))
    }
}

/// Returns the values of all cookies of this name.
fn cookies<'a>(headers: &'a HeaderMap, name: &'a str) -> impl Iterator<Item = &'a str> {
    let values = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let pairs = values.flat_map(|value| value.split(';'));
    let pairs = pairs.filter_map(|pair| pair.trim().split_once('='));
    pairs.filter_map(move |(found, value)| (found == name).then_some(value))
}

/// The name of a server's cookies.
#[derive(Clone, Debug)]
pub(super) struct CookieName {
    name: Arc<str>,
    port: u16,
    is_https: bool,
}

impl CookieName {
    /// `port` distinguishes the cookies of several servers on one host. `is_https`: whether browsers reach the server by HTTPS.
    pub(super) fn new(port: u16, is_https: bool) -> Self {
        let prefix = if is_https { "__Host-" } else { "" };
        Self {
            name: format!("{prefix}isopeel-{port}").into(),
            port,
            is_https,
        }
    }

    /// Returns the name for the same server with TLS.
    pub(super) fn by_tls(&self) -> Self {
        Self::new(self.port, true)
    }

    /// Returns the header that sets the cookie which stands for a token.
    pub(super) fn of(&self, token: &str, who: &Identity) -> HeaderValue {
        let value = cookie_value(token);
        // The id selects the hash that the cookie is compared with.
        let value = match who.is_named() {
            true => format!("{}.{value}", who.token()),
            false => value,
        };
        self.header(&self.name, &value, "")
    }

    /// Returns the header that sets the cookie of a session.
    pub(super) fn of_session(&self, secret: &str) -> HeaderValue {
        self.header(&self.name, &format!("{SIGNED_IN}.{secret}"), "")
    }

    /// Returns the header that removes the cookie.
    pub(super) fn gone(&self) -> HeaderValue {
        self.header(&self.name, "", "; Max-Age=0")
    }

    /// Returns the secret of a page's session.
    pub(super) fn session<'a>(&'a self, headers: &'a HeaderMap) -> Option<&'a str> {
        cookies(headers, &self.name).find_map(|value| value.strip_prefix(SIGNED_IN)?.strip_prefix('.'))
    }

    /// The header that stores the secret of a sign-in in the user's browser for `seconds`.
    pub(super) fn of_trip(&self, secret: &str, seconds: u64) -> HeaderValue {
        self.header(&self.trip(), secret, &format!("; Max-Age={seconds}"))
    }

    /// The secret of a sign-in, from the browser's cookie.
    pub(super) fn trip_secret(&self, headers: &HeaderMap) -> Option<String> {
        cookies(headers, &self.trip()).next().map(str::to_owned)
    }

    fn trip(&self) -> String {
        format!("{}-oidc", self.name)
    }

    fn header(&self, name: &str, value: &str, age: &str) -> HeaderValue {
        let secure = if self.is_https { "; Secure" } else { "" };
        let cookie = format!("{name}={value}; Path=/; HttpOnly; SameSite=Lax{age}{secure}");
        // Cannot fail: the cookie consists of letters, digits and signs of base64.
        HeaderValue::try_from(cookie).unwrap_or(HeaderValue::from_static(""))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: axum::http::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().expect("a header"))])
    }

    #[test]
    fn the_token_and_its_cookie_are_proofs_and_nothing_else_is() {
        let (token, other) = (Token::random().expect("random"), Token::random().expect("random"));
        let (proofs, cookies) = (Proofs::new(&token), CookieName::new(8417, false));
        assert!(proofs.of_token(other.text()).is_none() && proofs.of_token("").is_none());
        let who = proofs.of_token(token.text()).expect("the right token");
        let cookie = cookies.of(token.text(), &who);
        let cookie = cookie.to_str().expect("ASCII");
        let (pair, attributes) = cookie.split_once(';').expect("attributes");
        assert_eq!(attributes, " Path=/; HttpOnly; SameSite=Lax");
        assert!(!pair.contains(token.text()), "the cookie is not the token");
        let (name, value) = pair.split_once('=').expect("a pair");
        for (headers, proof) in [
            (
                with(AUTHORIZATION, &format!("Bearer {}", token.text())),
                Some(Proof::Header),
            ),
            (
                with(AUTHORIZATION, &format!("bearer {}", token.text())),
                Some(Proof::Header),
            ),
            (with(COOKIE, &format!("a=b; {name}={value}; c")), Some(Proof::Cookie)),
            (with(AUTHORIZATION, &format!("Bearer {}", other.text())), None),
            (with(AUTHORIZATION, &format!("Basic {}", token.text())), None),
            (with(AUTHORIZATION, "Bearer"), None),
            (with(COOKIE, &format!("isopeel-8418={value}")), None),
            (with(COOKIE, &format!("{name}={}", token.text())), None),
            (with(COOKIE, &format!("{name}=a.{value}")), None),
            (with(COOKIE, &format!("{name}=")), None),
            (HeaderMap::new(), None),
        ] {
            let found = proofs.find(&headers, &cookies);
            assert_eq!(found.map(|(proof, _)| proof), proof, "{headers:?}");
        }
        assert!(!format!("{proofs:?}").contains(token.text()));
    }

    #[test]
    fn by_tls_the_cookie_is_of_this_host_alone() {
        let token = Token::random().expect("random");
        let cookie = CookieName::new(443, false)
            .by_tls()
            .of(token.text(), &Identity::without_token());
        let cookie = cookie.to_str().expect("ASCII");
        assert!(
            cookie.starts_with("__Host-isopeel-443=") && cookie.ends_with("; Path=/; HttpOnly; SameSite=Lax; Secure"),
            "{cookie}"
        );
    }
}
