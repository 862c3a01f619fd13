//! Requests to an issuer, and its metadata (OpenID Connect Discovery 1.0). The server contacts the issuer only when a user signs in or out,
//! so that an unreachable issuer does not delay other requests.

use std::time::{Duration, Instant};

use jsonwebtoken::jwk::JwkSet;
use reqwest::header::ACCEPT;
use reqwest::{Client, RequestBuilder, StatusCode, Url};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio::sync::Mutex;

use crate::error::chain;

/// Maximum time for a response of the issuer.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum bytes of a response. Metadata and keys have some kilobytes.
const MAX_RESPONSE_BYTES: usize = 1 << 20;
/// Lifetime of the cached metadata and keys.
const LIFETIME: Duration = Duration::from_secs(3600);

/// Why a request to the issuer failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum ProviderError {
    #[error("the issuer does not answer")]
    Unreachable(#[from] reqwest::Error),
    #[error("the issuer answers a request for {what} with status {status}")]
    Status { what: &'static str, status: StatusCode },
    #[error("the issuer answers a request for {what} with more than {MAX_RESPONSE_BYTES} bytes")]
    TooLong { what: &'static str },
    #[error("the issuer answers a request for {what} with invalid JSON or missing values")]
    Malformed {
        what: &'static str,
        #[source]
        source: serde_json::Error,
    },
    /// A concurrent sign-in has sent the same request, which failed.
    #[error("the same request of another sign-in failed: {0}")]
    Failed(String),
    #[error("the metadata of the issuer names the issuer {found:?}, expected {expected:?}")]
    OtherIssuer { found: String, expected: String },
}

/// An address of the issuer. It has the scheme `https`, or is on this machine.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
pub(super) struct Endpoint(pub Url);

impl TryFrom<String> for Endpoint {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let address = text.parse().ok().filter(is_safe);
        address
            .map(Self)
            .ok_or_else(|| format!("{text:?}, expected an address with https"))
    }
}

/// The issuer's metadata.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Metadata {
    issuer: String,
    pub authorization_endpoint: Endpoint,
    token_endpoint: Endpoint,
    jwks_uri: Endpoint,
    pub end_session_endpoint: Option<Endpoint>,
    #[serde(default)]
    token_endpoint_auth_methods_supported: Vec<String>,
}

/// Values of the request that exchanges a code for an ID token.
pub(super) struct Exchange<'a> {
    pub client_id: &'a str,
    pub client_secret: Option<&'a str>,
    pub code: &'a str,
    /// Code verifier of PKCE.
    pub verifier: &'a str,
    /// Address to which the issuer has redirected the browser.
    pub redirect: &'a str,
}

#[derive(Deserialize)]
struct Tokens {
    id_token: String,
}

/// An issuer, with its cached metadata and keys.
#[derive(Debug)]
pub(super) struct Provider {
    issuer: String,
    http: Client,
    /// Locked during a request to the issuer, so that concurrent sign-ins share one request.
    pub(super) cache: Mutex<Cache>,
}

/// The latest metadata and keys of an issuer, and the latest failure.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// Time of the response, metadata and keys.
    pub answer: Option<(Instant, Metadata, JwkSet)>,
    /// Time and reason of the failure; `None` if the last request succeeded.
    failure: Option<(Instant, String)>,
}

impl Provider {
    pub(super) fn new(issuer: String) -> Result<Self, ProviderError> {
        // Fails if the process has installed a provider of cryptography already, which may stay.
        let _ = rustls::crypto::ring::default_provider().install_default();
        // Does not follow redirects, because they could lead to another server.
        let http = Client::builder()
            .timeout(TIMEOUT)
            .redirect(reqwest::redirect::Policy::none());
        Ok(Self {
            issuer,
            http: http.build()?,
            cache: Mutex::default(),
        })
    }

    /// Returns metadata and keys of the issuer. Uses the cache unless it has expired, or the caller knows that it `is_stale`.
    pub(super) async fn metadata(&self, is_stale: bool) -> Result<(Metadata, JwkSet), ProviderError> {
        let arrived = Instant::now();
        let mut cache = self.cache.lock().await;
        if let Some((since, metadata, keys)) = &cache.answer
            && since.elapsed() < LIFETIME
            // Another call has fetched it while this one waited for the lock.
            && (!is_stale || *since >= arrived)
        {
            return Ok((metadata.clone(), keys.clone()));
        }
        // Does not repeat a request that has failed while this call waited for the lock.
        if let Some((when, why)) = &cache.failure
            && *when >= arrived
        {
            return Err(ProviderError::Failed(why.clone()));
        }
        let fetched = self.fetch_metadata().await;
        cache.failure = fetched.as_ref().err().map(|error| (Instant::now(), chain(error)));
        let (metadata, keys) = fetched?;
        cache.answer = Some((Instant::now(), metadata.clone(), keys.clone()));
        Ok((metadata, keys))
    }

    async fn fetch_metadata(&self) -> Result<(Metadata, JwkSet), ProviderError> {
        let address = format!("{}/.well-known/openid-configuration", self.issuer.trim_end_matches('/'));
        let metadata: Metadata = get(self.http.get(address), "its metadata").await?;
        if metadata.issuer != self.issuer {
            return Err(ProviderError::OtherIssuer {
                found: metadata.issuer,
                expected: self.issuer.clone(),
            });
        }
        let keys: JwkSet = get(self.http.get(metadata.jwks_uri.0.clone()), "its keys").await?;
        Ok((metadata, keys))
    }

    /// Exchanges a code for an ID token.
    pub(super) async fn exchange(&self, metadata: &Metadata, values: &Exchange<'_>) -> Result<String, ProviderError> {
        let mut form = vec![
            ("grant_type", "authorization_code"),
            ("code", values.code),
            ("code_verifier", values.verifier),
            ("redirect_uri", values.redirect),
        ];
        let methods = &metadata.token_endpoint_auth_methods_supported;
        let is_secret_in_form = methods.iter().any(|method| method == "client_secret_post")
            && !methods.iter().any(|method| method == "client_secret_basic");
        let mut request = self.http.post(metadata.token_endpoint.0.clone());
        match values.client_secret {
            Some(secret) if is_secret_in_form => {
                form.extend([("client_id", values.client_id), ("client_secret", secret)]);
            }
            // RFC 6749, section 2.3.1, demands the encoding of a form.
            Some(secret) => request = request.basic_auth(form_value(values.client_id), Some(form_value(secret))),
            None => form.push(("client_id", values.client_id)),
        }
        let body = form.iter().map(|(name, value)| format!("{name}={}", form_value(value)));
        let request = request
            .header("content-type", "application/x-www-form-urlencoded")
            .body(body.collect::<Vec<_>>().join("&"));
        let tokens: Tokens = get(request, "an ID token").await?;
        Ok(tokens.id_token)
    }
}

/// Whether an address has the scheme `https`, or is on this machine.
pub(super) fn is_safe(address: &Url) -> bool {
    let is_local = matches!(address.host_str(), Some("localhost" | "127.0.0.1" | "[::1]"));
    address.scheme() == "https" || (address.scheme() == "http" && is_local)
}

/// Encodes a value of `application/x-www-form-urlencoded`.
pub(super) fn form_value(text: &str) -> String {
    percent_encoding::utf8_percent_encode(text, percent_encoding::NON_ALPHANUMERIC).to_string()
}

/// Sends a request, and parses the JSON of the response. `what` names the requested value in errors.
async fn get<T: DeserializeOwned>(request: RequestBuilder, what: &'static str) -> Result<T, ProviderError> {
    let mut response = request.header(ACCEPT, "application/json").send().await?;
    let status = response.status();
    if !status.is_success() {
        return Err(ProviderError::Status { what, status });
    }
    let mut bytes = Vec::new();
    while let Some(chunk) = response.chunk().await? {
        if bytes.len() + chunk.len() > MAX_RESPONSE_BYTES {
            return Err(ProviderError::TooLong { what });
        }
        bytes.extend(chunk);
    }
    serde_json::from_slice(&bytes).map_err(|source| ProviderError::Malformed { what, source })
}
