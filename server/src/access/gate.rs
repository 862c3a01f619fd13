//! The gate before every request: its host, the page that it comes from, and the token.

use axum::extract::{Request, State};
use axum::http::header::{HeaderMap, HeaderName, ORIGIN};
use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::token::Proof;
use super::{Access, origin};
use crate::problem::ApiError;

/// Where a token is exchanged for a cookie, by POST.
pub const SESSION_PATH: &str = "/api/v1/session";
const STREAM_PATH: &str = "/api/v1/stream";
const DESCRIPTION_PATH: &str = "/api/v1/openapi.json";

/// What browsers say of the page that a request comes from.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Lets requests through that may use the server.
pub async fn admit(State(access): State<Access>, request: Request, next: Next) -> Response {
    match access.check(request.method(), request.uri(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refused) => refused.into_response(),
    }
}

impl Access {
    fn check(&self, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        self.hosts.check(uri, headers)?;
        let path = uri.path();
        // What the page is made of is no secret, nor is whether the server lives.
        if !path.starts_with("/api/") || path == DESCRIPTION_PATH {
            return Ok(());
        }
        let changes = !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
        let from_elsewhere = headers.get(FETCH_SITE).is_some_and(|site| site == "cross-site");
        if changes || from_elsewhere || path == STREAM_PATH {
            origin::check(headers, self).map_err(|origin| foreign(&origin))?;
            // A picture or a link in a foreign page, which browsers send without its origin.
            if from_elsewhere && !headers.contains_key(ORIGIN) {
                return Err(foreign("another site"));
            }
        }
        let is_exchange = path == SESSION_PATH && *method == Method::POST;
        let Some(token) = self
            .token
            .as_ref()
            .filter(|_| !is_exchange && *method != Method::OPTIONS)
        else {
            return Ok(());
        };
        match token.proof(headers) {
            Some(Proof::Header) => Ok(()),
            // A browser sends the cookie whoever asks it to, and says who does.
            Some(Proof::Cookie) if (changes || path == STREAM_PATH) && !headers.contains_key(ORIGIN) => {
                Err(foreign("no page that is named"))
            }
            Some(Proof::Cookie) => Ok(()),
            None => Err(unauthorized()),
        }
    }

    /// The cookie that stands for a token; `None` where none is asked for.
    ///
    /// # Errors
    /// It is not the server's token.
    pub fn exchange(&self, token: &str) -> Result<Option<HeaderValue>, ApiError> {
        match &self.token {
            None => Ok(None),
            Some(check) => check.exchange(token).map(Some).ok_or_else(unauthorized),
        }
    }
}

fn foreign(origin: &str) -> ApiError {
    let message =
        format!("a page of {origin:?} may not use this server, expected its own or one that --allow-origin names");
    ApiError::new(StatusCode::FORBIDDEN, "foreign-origin", message)
}

fn unauthorized() -> ApiError {
    let message = "a token is missing or wrong: open the address that the server printed when it started, or send `Authorization: Bearer TOKEN`; a server that runs with --no-auth asks for none";
    ApiError::new(StatusCode::UNAUTHORIZED, "unauthorized", message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::Token;

    struct Case {
        access: Access,
        token: String,
        cookie: String,
    }

    fn case() -> Case {
        let token = Token::random().expect("random");
        let friend = "https://viewer.example".parse().expect("an origin");
        let access = Access::new(([127, 0, 0, 1], 8417).into(), None, &[friend]).with_token(&token);
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

    /// The status of a refusal, 200 where there is none.
    fn status(access: &Access, method: &Method, path: &str, headers: &[(&'static str, &str)]) -> u16 {
        let mut all = HeaderMap::from_iter([(axum::http::header::HOST, HeaderValue::from_static("localhost:8417"))]);
        for (name, value) in headers {
            all.insert(*name, value.parse().expect("a header"));
        }
        let checked = access.check(method, &path.parse().expect("a path"), &all);
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
    fn without_a_token_foreign_pages_still_start_no_work() {
        let access = Access::new(([127, 0, 0, 1], 8417).into(), None, &[]);
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
}
