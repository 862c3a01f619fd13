//! How a request authenticates its sender: a token in a header, or a cookie.

use std::sync::Arc;

use axum::http::HeaderValue;
use axum::http::header::{AUTHORIZATION, COOKIE, HeaderMap};
use tokio::sync::watch;

use super::delegated::{DelegatedTokens, Lender};
use super::identity::Identity;
use super::named::{NamedToken, NamedTokens, now};
use super::sealed::SessionKey;
use super::signed_in::Sessions;
use super::token::{Hash, Token, cookie_value, id_of};

/// Prefix of a session's secret in a cookie, followed by a dot. It differs from all ids of tokens, because these are hexadecimal.
const SIGNED_IN: &str = "oidc";

/// How a request has authenticated its sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Proof {
    /// A token in a header. Pages of other origins cannot make a browser send this header.
    Header,
    /// The cookie, which a browser sends with every request.
    Cookie,
    /// A ticket in the address of a stream.
    Ticket,
}

/// Checks tokens and cookies, of which it stores only hashes.
#[derive(Clone, Debug)]
pub(super) struct Authenticator {
    /// Hash of the start token: the token of the user who started the server, which has all roles.
    start_token: Hash,
    /// Hash of the cookie for the start token.
    start_cookie: Hash,
    /// Identity of the owner of the start token.
    start: Identity,
    /// Named tokens, which the server reloads when the token file in its state folder changes; `None` without a state folder.
    named: Option<watch::Receiver<Arc<NamedTokens>>>,
    /// Sessions of users who have signed in through an issuer.
    sessions: Sessions,
    delegated: DelegatedTokens,
}

impl Authenticator {
    pub(super) fn new(token: &Token) -> Self {
        Self {
            start_token: Hash::of(token.text()),
            start_cookie: Hash::of(&cookie_value(token.text())),
            start: Identity::of_start("start"),
            named: None,
            sessions: Sessions::default(),
            delegated: DelegatedTokens::default(),
        }
    }

    /// Returns the sessions of signed-in users.
    pub(super) fn sessions(&self) -> &Sessions {
        &self.sessions
    }

    /// Returns the delegated tokens.
    pub(super) fn delegated(&self) -> &DelegatedTokens {
        &self.delegated
    }

    pub(super) fn add_named(&mut self, named: watch::Receiver<Arc<NamedTokens>>) {
        self.named = Some(named);
    }

    /// Accepts the sessions and delegated tokens of all servers that have this key.
    pub(super) fn share(&mut self, key: &SessionKey) {
        self.sessions = std::mem::take(&mut self.sessions).with_key(key.clone());
        self.delegated = std::mem::take(&mut self.delegated).with_key(key.clone());
    }

    /// Returns the identity of a token's owner; `None` if the token is not valid.
    pub(super) fn of_token(&self, token: &str) -> Option<Identity> {
        if self.start_token.matches(token) {
            return Some(self.start.clone());
        }
        let id = id_of(token)?;
        let named = self.of_named(id, |named| named.sha256.matches(token));
        let delegated = || self.delegated.find(id, token).map(Identity::of_delegated);
        named.or_else(delegated).or_else(|| self.of_sealed(id, token))
    }

    /// Returns the owner of a delegated token that another server has made, if its lender's token is valid here.
    fn of_sealed(&self, id: &str, token: &str) -> Option<Identity> {
        let sealed = self.delegated.unseal(id, token)?;
        let lender = match &sealed.lender {
            Lender::Start => self.start.clone(),
            Lender::Named(id) => self.of_named(id, |_| true)?,
            Lender::SignedIn {
                user,
                roles,
                name,
                expires,
            } => Identity::of_signed_in(self.sessions.named(name, user, *roles, *expires)?),
        };
        let delegated = sealed.of_lender(lender);
        delegated.is_valid().then(|| Identity::of_delegated(delegated))
    }

    /// Returns the identity that the value of a cookie stands for; `None` if the value is not valid.
    fn of_cookie(&self, value: &str) -> Option<Identity> {
        match value.split_once('.') {
            None => self.start_cookie.matches(value).then(|| self.start.clone()),
            Some((SIGNED_IN, secret)) => self.sessions.find(secret).map(Identity::of_signed_in),
            Some((id, value)) => self.of_named(id, |named| named.cookie.matches(value)),
        }
    }

    /// Returns the identity of the owner of a named token, if the token has not expired and its secret `is_correct`.
    fn of_named(&self, id: &str, is_correct: impl FnOnce(&NamedToken) -> bool) -> Option<Identity> {
        let tokens = self.named.as_ref()?;
        let token = Arc::clone(tokens.borrow().get(id)?);
        (is_correct(&token) && !token.has_expired(now())).then(|| Identity::of_named(token, tokens.clone()))
    }

    /// Returns how a request authenticates its sender, and the sender; `None` if the request has no valid proof.
    pub(super) fn find(&self, headers: &HeaderMap, cookies: &CookieFactory) -> Option<(Proof, Identity)> {
        let bearer = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = bearer.and_then(|value| {
            let (scheme, token) = value.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
        });
        if let Some(who) = bearer.and_then(|token| self.of_token(token)) {
            return Some((Proof::Header, who));
        }
        values_of_cookies(headers, &cookies.name)
            .find_map(|value| self.of_cookie(value))
            .map(|who| (Proof::Cookie, who))
    }
}

/// Returns the values of all cookies with this name.
fn values_of_cookies<'a>(headers: &'a HeaderMap, name: &'a str) -> impl Iterator<Item = &'a str> {
    let values = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let pairs = values.flat_map(|value| value.split(';'));
    let pairs = pairs.filter_map(|pair| pair.trim().split_once('='));
    pairs.filter_map(move |(other, value)| (other == name).then_some(value))
}

/// Creates the cookies of a server, and finds them in requests.
#[derive(Clone, Debug)]
pub(super) struct CookieFactory {
    name: Arc<str>,
    place: Arc<str>,
    is_https: bool,
}

impl CookieFactory {
    /// Creates the factory of a server. `place` distinguishes several servers on one host, because cookies are shared by all ports: the port
    /// of the server, or port and path of its public address, which is the same for all servers behind one proxy. `is_https` is whether
    /// browsers reach the server by HTTPS.
    pub(super) fn new(place: impl Into<Arc<str>>, is_https: bool) -> Self {
        let (prefix, place) = (if is_https { "__Host-" } else { "" }, place.into());
        Self {
            name: format!("{prefix}isopeel-{place}").into(),
            place,
            is_https,
        }
    }

    /// Returns the same with the attributes for HTTPS: the prefix `__Host-` and `Secure`.
    pub(super) fn for_https(&self) -> Self {
        Self::new(Arc::clone(&self.place), true)
    }

    /// Returns the `Set-Cookie` header with which a browser authenticates as the owner of `token`.
    pub(super) fn set_for_token(&self, token: &str, who: &Identity) -> HeaderValue {
        let value = cookie_value(token);
        // The value of a named token begins with its id, by which the server finds the hash of the cookie.
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

    /// Returns the secret of the session from the cookies of a request.
    pub(super) fn session<'a>(&'a self, headers: &'a HeaderMap) -> Option<&'a str> {
        values_of_cookies(headers, &self.name).find_map(|value| value.strip_prefix(SIGNED_IN)?.strip_prefix('.'))
    }

    /// Returns the header that sets the cookie of a sign-in in progress, which the browser stores for `seconds`.
    pub(super) fn of_sign_in(&self, secret: &str, seconds: u64) -> HeaderValue {
        self.header(&self.sign_in_name(), secret, &format!("; Max-Age={seconds}"))
    }

    /// Returns the secret of a sign-in in progress from the cookies of a request.
    pub(super) fn sign_in_secret(&self, headers: &HeaderMap) -> Option<String> {
        values_of_cookies(headers, &self.sign_in_name())
            .next()
            .map(str::to_owned)
    }

    /// Returns the name of the cookie of a sign-in in progress.
    fn sign_in_name(&self) -> String {
        format!("{}-oidc", self.name)
    }

    fn header(&self, name: &str, value: &str, age: &str) -> HeaderValue {
        let secure = if self.is_https { "; Secure" } else { "" };
        let cookie = format!("{name}={value}; Path=/; HttpOnly; SameSite=Lax{age}{secure}");
        // Cannot fail: all characters of the cookie are valid in a header.
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
    fn only_the_token_and_its_cookie_authenticate() {
        let (token, other) = (Token::random().expect("random"), Token::random().expect("random"));
        let (authenticator, cookies) = (Authenticator::new(&token), CookieFactory::new("8417", false));
        assert!(authenticator.of_token(other.text()).is_none() && authenticator.of_token("").is_none());
        let who = authenticator.of_token(token.text()).expect("the right token");
        let cookie = cookies.set_for_token(token.text(), &who);
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
            let found = authenticator.find(&headers, &cookies);
            assert_eq!(found.map(|(proof, _)| proof), proof, "{headers:?}");
        }
        assert!(!format!("{authenticator:?}").contains(token.text()));
    }

    #[test]
    fn over_https_the_cookie_is_for_this_host_only() {
        let token = Token::random().expect("random");
        let cookie = CookieFactory::new("443", false)
            .for_https()
            .set_for_token(token.text(), &Identity::without_token());
        let cookie = cookie.to_str().expect("ASCII");
        assert!(
            cookie.starts_with("__Host-isopeel-443=") && cookie.ends_with("; Path=/; HttpOnly; SameSite=Lax; Secure"),
            "{cookie}"
        );
    }
}
