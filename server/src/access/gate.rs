//! Middleware that checks every request: its host, the origin of its page, its token and its rate. Handlers find the [`Identity`] of the
//! sender in the extensions of the request.

use std::net::IpAddr;
use std::time::{Duration, Instant};

use axum::extract::{Request, State};
use axum::http::header::{HeaderMap, HeaderName, ORIGIN};
use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::identity::Identity;
use super::peer::{self, PeerAddress};
use super::proof::Proof;
use super::rate;
use super::role::{RequiredAccess, Role, required_access};
use super::ticket::{self, LIFETIME as TICKET_LIFETIME, TicketError};
use super::{Access, origin};
use crate::problem::ApiError;

const STREAM_PATH: &str = "/api/v1/stream";

/// Paths of the liveness and readiness probes.
const PROBES: [&str; 2] = ["/healthz", "/readyz"];

/// Header in which browsers state whether a page of the same site or of another site sends the request.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Passes an admitted request to its handler, and answers any other request with an error.
pub async fn admit(State(access): State<Access>, mut request: Request, next: Next) -> Response {
    let peer = request.extensions().get().map(|&PeerAddress(address)| address);
    let peer = peer.map(|peer| peer::client(peer, request.headers(), &access.proxies));
    let (method, path) = (request.method(), request.uri().path());
    let mut pending = access.audit.as_ref().map(|audit| audit.begin(method, path, peer));
    let identified = access
        .charge_peer(peer, rate::cost(method, path))
        .and_then(|()| access.identify(method, request.uri(), request.headers()));
    if let (Some(pending), Ok(Some(who))) = (&mut pending, &identified) {
        pending.set_identity(who);
    }
    let admitted = identified.and_then(|who| {
        access.authorize(who.as_ref(), method, path)?;
        Ok(who)
    });
    let mut response = match admitted {
        Ok(who) => {
            if let Some(who) = who {
                request.extensions_mut().insert(who.at(peer));
            }
            next.run(request).await
        }
        Err(error) => error.into_response(),
    };
    if response.status() == StatusCode::UNAUTHORIZED
        && let (Some(rates), Some(peer)) = (&access.rates, peer)
        && let Err(wait) = rates.charge_unauthenticated(peer)
    {
        response = too_many(wait, "no or a wrong token at your address").into_response();
    }
    if let Some(pending) = pending {
        pending.answered(&response);
    }
    response
}

impl Access {
    /// Charges the cost of a request to the rate limit of its peer.
    fn charge_peer(&self, peer: Option<IpAddr>, cost: u32) -> Result<(), ApiError> {
        let (Some(rates), Some(peer)) = (&self.rates, peer) else {
            return Ok(());
        };
        let charged = rates.charge_peer(peer, cost);
        charged.map_err(|wait| too_many(wait, "your address"))
    }

    /// Identifies the sender of a request; `None` if the request needs no authentication.
    fn identify(&self, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<Option<Identity>, ApiError> {
        let path = uri.path();
        let required = required_access(method, path);
        // The check of the host exempts probes, because they use an IP address or a name inside their cluster. Their response is a single
        // word.
        let is_probe = PROBES.contains(&path) && matches!(*method, Method::GET | Method::HEAD);
        if !is_probe {
            self.hosts.check(uri, headers)?;
        }
        // The files of the page and the probes need no authentication, because they are not secret.
        if !path.starts_with("/api/") && required == RequiredAccess::Nothing {
            return Ok(None);
        }
        let is_write = !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
        let is_public_read = required == RequiredAccess::Nothing && !is_write;
        if !is_public_read {
            self.check_origin(headers, is_write || path == STREAM_PATH)?;
        }
        if required == RequiredAccess::Nothing || *method == Method::OPTIONS {
            return Ok(None);
        }
        let Some(authenticator) = &self.authenticator else {
            return Ok(Some(Identity::without_token()));
        };
        let ticket = uri.query().filter(|_| path == STREAM_PATH).and_then(ticket::in_query);
        let (proof, who) = match ticket {
            Some(ticket) => {
                let who = self.tickets.take(ticket, headers.get(ORIGIN), Instant::now());
                (Proof::Ticket, who.ok_or_else(bad_ticket)?)
            }
            None => authenticator.find(headers, &self.cookies).ok_or_else(unauthorized)?,
        };
        // Browsers attach the cookie to requests of any page. So a request that relies on the cookie must state the origin of its page.
        if proof == Proof::Cookie && (is_write || path == STREAM_PATH) && !headers.contains_key(ORIGIN) {
            return Err(foreign("no page that is named"));
        }
        Ok(Some(who))
    }

    /// Refuses a request of a page that may not use this server. `is_always_checked` is true for requests that change something, and for
    /// streams, which browsers let any page open. Other requests are checked only if the browser states that they come from another site.
    fn check_origin(&self, headers: &HeaderMap, is_always_checked: bool) -> Result<(), ApiError> {
        let is_cross_site = headers.get(FETCH_SITE).is_some_and(|site| site == "cross-site");
        if !is_always_checked && !is_cross_site {
            return Ok(());
        }
        origin::check(headers, self).map_err(|origin| foreign(&origin))?;
        // Browsers send no `Origin` with requests for an image or a link in a page of another site.
        if is_cross_site && !headers.contains_key(ORIGIN) {
            return Err(foreign("another site"));
        }
        Ok(())
    }

    /// Checks whether the sender's roles and rate limit allow a request.
    fn authorize(&self, who: Option<&Identity>, method: &Method, path: &str) -> Result<(), ApiError> {
        let Some(who) = who else { return Ok(()) };
        if let RequiredAccess::OneOf(roles) = required_access(method, path)
            && !roles.iter().any(|&role| who.may(role))
        {
            return Err(forbidden(who, roles));
        }
        // Without authentication, only the rate limit of the peer applies.
        match &self.rates {
            Some(rates) if self.authenticator.is_some() => {
                let charged = rates.charge_token(who.token(), rate::cost(method, path));
                charged.map_err(|wait| too_many(wait, "this token"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the header that sets the cookie for a token; `None` if the server runs without authentication.
    ///
    /// # Errors
    /// The token is unknown, or it is a delegated token, for which the server issues no cookies.
    pub fn exchange(&self, token: &str) -> Result<Option<HeaderValue>, ApiError> {
        let Some(authenticator) = &self.authenticator else {
            return Ok(None);
        };
        let who = authenticator.of_token(token).ok_or_else(unauthorized)?;
        if who.is_delegated() {
            let message = "this token is a delegated one, for which there is no cookie: send it as `Authorization: Bearer` with each request";
            return Err(ApiError::new(StatusCode::FORBIDDEN, "lent-token", message));
        }
        Ok(Some(self.cookies.set_for_token(token, &who)))
    }

    /// Issues a ticket for a stream. The ticket is valid for a page of this origin; without an origin, for a client that is not a page.
    ///
    /// # Errors
    /// Too many tickets are unused.
    pub fn issue_ticket(&self, who: &Identity, origin: Option<&HeaderValue>) -> Result<String, ApiError> {
        let issued = self.tickets.issue(who, origin, Instant::now());
        issued.map_err(|error| match error {
            TicketError::TooMany(_) => {
                ApiError::new(StatusCode::TOO_MANY_REQUESTS, "too-many-tickets", error.to_string())
                    .retry_after(TICKET_LIFETIME)
            }
            TicketError::Random(error) => ApiError::internal(error),
        })
    }
}

fn too_many(wait: Duration, whose: &str) -> ApiError {
    let message = format!(
        "too many requests with {whose}, expected fewer: try again in {:.1} s; --rate-peer and --rate-token say how many may be",
        wait.as_secs_f64()
    );
    ApiError::new(StatusCode::TOO_MANY_REQUESTS, "too-many-requests", message).retry_after(wait)
}

fn bad_ticket() -> ApiError {
    let message = "the ticket is unknown, was used, has expired or is of another page's: POST /api/v1/tickets makes one for each stream";
    ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", message)
}

fn forbidden(who: &Identity, roles: &[Role]) -> ApiError {
    let expected: Vec<&str> = roles.iter().map(|role| role.name()).collect();
    let message = format!(
        "this token is for {}, expected one for {}: who runs the server makes others",
        who.roles(),
        expected.join(" or "),
    );
    ApiError::new(StatusCode::FORBIDDEN, "forbidden", message)
}

fn foreign(origin: &str) -> ApiError {
    let message =
        format!("a page of {origin:?} may not use this server, expected its own or one that --allow-origin names");
    ApiError::new(StatusCode::FORBIDDEN, "foreign-origin", message)
}

fn unauthorized() -> ApiError {
    let message = "a token is missing, wrong, expired or revoked: open the address that the server printed when it started, or send `Authorization: Bearer TOKEN`; a server that runs with --no-auth asks for none";
    ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{NewToken, Token, TokenFile, TokenWatch};

    struct Case {
        access: Access,
        token: String,
        cookie: String,
    }

    fn case() -> Case {
        let token = Token::random().expect("random");
        let friend = "https://viewer.example".parse().expect("an origin");
        let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[friend]).with_token(&token);
        let cookie = access
            .exchange(token.text())
            .expect("the right token")
            .expect("a cookie");
        let cookie = cookie
            .to_str()
            .expect("ASCII")
            .split(';')
            .next()
            .expect("a pair")
            .to_owned();
        Case {
            access,
            token: format!("Bearer {}", token.text()),
            cookie,
        }
    }

    /// The status of a refusal, or 200 if the request is accepted.
    fn status(access: &Access, method: &Method, path: &str, headers: &[(&'static str, &str)]) -> u16 {
        let mut all = HeaderMap::from_iter([(axum::http::header::HOST, HeaderValue::from_static("localhost:8417"))]);
        for (name, value) in headers {
            all.insert(*name, value.parse().expect("a header"));
        }
        let uri: Uri = path.parse().expect("a path");
        let checked = access
            .identify(method, &uri, &all)
            .and_then(|who| access.authorize(who.as_ref(), method, uri.path()));
        checked.map_or_else(|error| error.status().as_u16(), |()| 200)
    }

    const OWN: (&str, &str) = ("origin", "http://localhost:8417");
    const EVIL: (&str, &str) = ("origin", "https://evil.example");
    const FRIEND: (&str, &str) = ("origin", "https://viewer.example");
    const CROSS: (&str, &str) = ("sec-fetch-site", "cross-site");

    #[test]
    fn a_request_shows_the_token_and_a_cookie_the_page_too() {
        let Case { access, token, cookie } = case();
        let (bearer, cookie) = (("authorization", token.as_str()), ("cookie", cookie.as_str()));
        let (get, post) = (Method::GET, Method::POST);
        for (method, path, headers, expected) in [
            (&get, "/", &[][..], 200),
            (&get, "/assets/index.js", &[], 200),
            (&get, "/healthz", &[], 200),
            (&get, "/metrics", &[], 401),
            (&get, "/metrics", &[bearer], 200),
            (&get, "/api/v1/openapi.json", &[], 200),
            (&get, "/api/v1/volumes", &[], 401),
            (&get, "/api/v1/volumes", &[bearer], 200),
            (&get, "/api/v1/volumes", &[cookie], 200),
            (&get, "/api/v1/volumes", &[cookie, CROSS], 403),
            (&get, "/api/v1/volumes", &[bearer, CROSS, FRIEND], 200),
            (&post, "/api/v1/session", &[], 200),
            (&post, "/api/v1/session", &[OWN], 200),
            (&post, "/api/v1/session", &[EVIL], 403),
            (&get, "/api/v1/session", &[], 401),
            (&post, "/api/v1/extract", &[], 401),
            (&post, "/api/v1/extract", &[bearer], 200),
            (&post, "/api/v1/extract", &[cookie, OWN], 200),
            (&post, "/api/v1/extract", &[cookie], 403),
            (&post, "/api/v1/extract", &[cookie, EVIL], 403),
            (&get, "/api/v1/stream", &[], 401),
            (&get, "/api/v1/stream", &[bearer], 200),
            (&get, "/api/v1/stream", &[cookie, OWN], 200),
            (&get, "/api/v1/stream", &[cookie, EVIL], 403),
            (&get, "/api/v1/stream", &[cookie], 403),
        ] {
            assert_eq!(
                status(&access, method, path, headers),
                expected,
                "{method} {path} {headers:?}"
            );
        }
    }

    #[test]
    fn probes_may_ask_for_any_host_and_nothing_else_may() {
        let Case { access, token, .. } = case();
        let foreign: HeaderMap = [
            (axum::http::header::HOST, "10.1.2.3.nip.example:8417"),
            (axum::http::header::AUTHORIZATION, &token),
        ]
        .into_iter()
        .map(|(name, value)| (name, value.parse().expect("a header")))
        .collect();
        for (method, path, expected) in [
            (Method::GET, "/healthz", 200),
            (Method::HEAD, "/readyz", 200),
            (Method::POST, "/healthz", 421),
            (Method::GET, "/healthz/", 421),
            (Method::GET, "/metrics", 421),
            (Method::GET, "/", 421),
            (Method::GET, "/api/v1/volumes", 421),
        ] {
            let uri: Uri = path.parse().expect("a path");
            let found = access.identify(&method, &uri, &foreign);
            let status = found.map_or_else(|error| error.status().as_u16(), |_| 200);
            assert_eq!(status, expected, "{method} {path}");
        }
    }

    #[test]
    fn without_a_token_foreign_pages_still_start_no_work() {
        let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]);
        let (get, post) = (Method::GET, Method::POST);
        for (method, path, headers, expected) in [
            (&get, "/api/v1/volumes/head/slices", &[][..], 200),
            (&get, "/api/v1/volumes/head/slices", &[CROSS], 403),
            (
                &get,
                "/api/v1/volumes/head/slices",
                &[("sec-fetch-site", "same-origin")],
                200,
            ),
            (&post, "/api/v1/extract", &[], 200),
            (&post, "/api/v1/extract", &[OWN], 200),
            (&post, "/api/v1/extract", &[EVIL], 403),
            (&get, "/api/v1/stream", &[EVIL], 403),
            (&get, "/api/v1/stream", &[OWN], 200),
        ] {
            assert_eq!(
                status(&access, method, path, headers),
                expected,
                "{method} {path} {headers:?}"
            );
        }
        assert_eq!(access.exchange("any").expect("no token is asked for"), None);
    }

    /// Each role allows the requests that docs/security.md lists.
    #[test]
    fn each_role_may_do_its_own() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = TokenFile::in_folder(folder.path());
        let tokens = Role::ALL.map(|role| {
            let roles = vec![role].into();
            let new = NewToken {
                user: "ann".into(),
                roles,
                lifetime: None,
            };
            file.create(new).expect("a token").0
        });
        let access = case().access.with_named(&TokenWatch::open(file).expect("tokens"));
        let (get, post, delete) = (Method::GET, Method::POST, Method::DELETE);
        for (method, path, allowed) in [
            (&get, "/api/v1/openapi.json", "view edit export upload push admin"),
            (&get, "/api/v1/session", "view edit export upload push admin"),
            (&get, "/api/v1/volumes", "view edit export admin"),
            (&get, "/api/v1/volumes/head", "view edit export admin"),
            (&get, "/api/v1/volumes/head/slices", "view edit admin"),
            (&get, "/api/v1/volumes/head/overview", "view edit admin"),
            (&get, "/api/v1/stream", "view edit admin"),
            (&post, "/api/v1/embed-tokens", "view edit admin"),
            (&get, "/api/v1/embed", "view edit export upload push admin"),
            (&post, "/api/v1/embed", "admin"),
            (&post, "/api/v1/extract", "export admin"),
            (&post, "/api/v1/jobs", "export admin"),
            (&get, "/api/v1/jobs/1/results/0", "export admin"),
            (&delete, "/api/v1/jobs/1", "export admin"),
            (&post, "/api/v1/uploads", "upload admin"),
            (&Method::PATCH, "/api/v1/uploads/1", "upload admin"),
            (&Method::HEAD, "/api/v1/uploads/1", "upload admin"),
            (&post, "/api/v1/uploads/1/finish", "upload admin"),
            (&delete, "/api/v1/uploads/1", "upload admin"),
            (&get, "/api/v1/memory", "admin"),
            (&get, "/api/v1/devices", "admin"),
            (&get, "/metrics", "admin"),
        ] {
            for (role, token) in Role::ALL.into_iter().zip(&tokens) {
                let bearer = format!("Bearer {}", token.text());
                let expected = if allowed.split(' ').any(|name| name == role.name()) {
                    200
                } else {
                    403
                };
                let found = status(&access, method, path, &[("authorization", &bearer)]);
                assert_eq!(found, expected, "{method} {path} with {}", role.name());
            }
        }
    }
}
