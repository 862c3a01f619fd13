//! HTTP client of all stores: which redirects it follows, its time limits, and which response bodies it drops or bounds.

use std::time::Duration;

use async_trait::async_trait;
use futures_util::StreamExt;
use object_store::client::{
    ClientConfigKey, ClientOptions, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse,
    HttpResponseBody, HttpService,
};
use object_store::{BackoffConfig, HeaderMap, HeaderValue, RetryConfig};
use reqwest::redirect::{Attempt, Policy};

/// Maximum consecutive redirects, all of which must stay within the store.
const MAX_REDIRECTS: usize = 5;
/// Maximum bytes of a page of a listing, which has 1000 names at most.
const MAX_LISTING_BYTES: usize = 8 << 20;

/// Time limits and retries.
#[derive(Clone, Debug)]
pub(crate) struct Limits {
    pub(super) connect: Duration,
    /// Maximum time without a byte.
    pub(super) idle: Duration,
    /// Maximum time from the request to the last byte of the response.
    pub(super) whole: Duration,
    pub(super) retry: RetryConfig,
}

impl Default for Limits {
    fn default() -> Self {
        let retry = RetryConfig {
            backoff: BackoffConfig {
                init_backoff: Duration::from_millis(200),
                max_backoff: Duration::from_secs(5),
                base: 2.0,
            },
            max_retries: 4,
            retry_timeout: Duration::from_secs(120),
        };
        Self {
            connect: Duration::from_secs(10),
            idle: Duration::from_secs(30),
            whole: Duration::from_secs(300),
            retry,
        }
    }
}

/// Makes the HTTP clients of a store.
#[derive(Debug)]
pub(super) struct Connector {
    pub(super) limits: Limits,
    /// Credentials in the address.
    pub(super) authorization: Option<HeaderValue>,
    /// Whether the store is on this machine, so that no proxy is used.
    pub(super) is_local: bool,
}

impl HttpConnector for Connector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        // Fails if a provider is already installed, which is then used.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let allow_http = options.get_config_value(&ClientConfigKey::AllowHttp);
        let headers = self.authorization.iter();
        let headers: HeaderMap = headers
            .map(|value| (reqwest::header::AUTHORIZATION, value.clone()))
            .collect();
        let mut client = reqwest::Client::builder()
            .connect_timeout(self.limits.connect)
            .read_timeout(self.limits.idle)
            .timeout(self.limits.whole)
            .https_only(allow_http.as_deref() != Some("true"))
            .default_headers(headers)
            .user_agent(concat!("isopeel/", env!("CARGO_PKG_VERSION")))
            .redirect(Policy::custom(only_within));
        if self.is_local {
            client = client.no_proxy();
        }
        let client = client.build().map_err(|e| object_store::Error::Generic {
            store: "HTTP",
            source: Box::new(e.without_url()),
        })?;
        Ok(HttpClient::new(Service(client)))
    }
}

/// A redirect that was not followed.
#[derive(Debug, thiserror::Error)]
pub(super) enum Redirect {
    #[error("redirected to {0}, expected an answer from the address itself: name the other address, if you trust it")]
    Elsewhere(String),
    #[error("redirected more than {MAX_REDIRECTS} times")]
    TooMany,
}

fn only_within(attempt: Attempt<'_>) -> reqwest::redirect::Action {
    let (from, to) = (&attempt.previous()[0], attempt.url());
    if from.origin() != to.origin() {
        // Its path or query may hold secrets.
        let origin = to.origin().ascii_serialization();
        return attempt.error(Redirect::Elsewhere(origin));
    }
    if attempt.previous().len() > MAX_REDIRECTS {
        return attempt.error(Redirect::TooMany);
    }
    attempt.follow()
}

#[derive(Debug)]
struct Service(reqwest::Client);

#[async_trait]
impl HttpService for Service {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let is_listing = request.uri().query().is_some_and(|query| query.contains("list-type="));
        let (parts, body) = self.0.call(request).await?.into_parts();
        // The stores read bodies of errors and listings as a whole, so errors are dropped and listings are bounded.
        let body = if !parts.status.is_success() {
            Vec::new().into()
        } else if is_listing {
            bounded(body).await?.into()
        } else {
            body
        };
        Ok(HttpResponse::from_parts(parts, body))
    }
}

#[derive(Debug, thiserror::Error)]
#[error("a listing of more than {MAX_LISTING_BYTES} bytes")]
struct ListingTooLong;

async fn bounded(body: HttpResponseBody) -> Result<Vec<u8>, HttpError> {
    let mut bytes = Vec::new();
    let mut stream = body.bytes_stream();
    while let Some(some) = stream.next().await {
        bytes.extend_from_slice(&some?);
        if bytes.len() > MAX_LISTING_BYTES {
            return Err(HttpError::new(HttpErrorKind::Unknown, ListingTooLong));
        }
    }
    Ok(bytes)
}
