//! An issuer's metadata (OpenID Connect Discovery 1.0) and the requests to it. The issuer is contacted only when a user signs in or out:
//! if it cannot be reached, other requests do not wait for it.

use std::time::{Duration, Instant};

use jsonwebtoken::jwk::JwkSet;
use reqwest::header::ACCEPT;
use reqwest::{Client, RequestBuilder, StatusCode, Url};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio::sync::Mutex;

use crate::error::chain;

/// Maximum time for an answer of the issuer.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum bytes of an answer, which has keys and addresses.
const MAX_ANSWER_BYTES: usize = 1 << 20;
/// How long the issuer's metadata and keys are cached.
const LIFETIME: Duration = Duration::from_secs(3600);

/// Why a request to the issuer failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum ProviderError {
    #[error("the issuer does not answer")]
    Away(#[from] reqwest::Error),
    #[error("the issuer answers {what} with {status}")]
    Status { what: &'static str, status: StatusCode },
    #[error("the issuer's answer to {what} is longer than {MAX_ANSWER_BYTES} bytes")]
    TooLong { what: &'static str },
    #[error("the issuer's answer to {what} is not what it should be")]
    Malformed {
        what: &'static str,
        #[source]
        source: serde_json::Error,
    },
    #[error("the issuer was asked for another sign-in, in vain: {0}")]
    Failed(String),
    #[error("the issuer calls itself {found:?}, expected {expected:?}")]
    OtherIssuer { found: String, expected: String },
}

/// An address of the issuer. It must be encrypted or on this machine.
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

/// Values that are sent to exchange a code for an ID token.
pub(super) struct Exchange<'a> {
    pub client_id: &'a str,
    pub client_secret: Option<&'a str>,
    pub code: &'a str,
    pub verifier: &'a str,
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
    /// Locked during a request to the issuer, so that concurrent sign-ins send one request.
    pub(super) known: Mutex<Known>,
}

/// The last answer or failure of an issuer, with its time.
#[derive(Debug, Default)]
pub(super) struct Known {
    pub answer: Option<(Instant, Metadata, JwkSet)>,
    /// When the last request failed, and why; `None` if it succeeded.
    failure: Option<(Instant, String)>,
}

impl Provider {
    pub(super) fn new(issuer: String) -> Result<Self, ProviderError> {
        // Fails if the process already has a default provider, which is fine.
        let _ = rustls::crypto::ring::default_provider().install_default();
        // Do not follow redirections: they could lead to another server.
        let http = Client::builder()
            .timeout(TIMEOUT)
            .redirect(reqwest::redirect::Policy::none());
        Ok(Self {
            issuer,
            http: http.build()?,
            known: Mutex::default(),
        })
    }

    /// Returns the issuer's metadata and keys. They come from the cache unless it has expired, or the caller states that it is `stale`.
    pub(super) async fn metadata(&self, stale: bool) -> Result<(Metadata, JwkSet), ProviderError> {
        let arrived = Instant::now();
        let mut known = self.known.lock().await;
        if let Some((since, metadata, keys)) = &known.answer
            && since.elapsed() < LIFETIME
            && !stale
        {
            return Ok((metadata.clone(), keys.clone()));
        }
        // A request has failed while this one waited for the lock, so it is not repeated.
        if let Some((when, why)) = &known.failure
            && *when >= arrived
        {
            return Err(ProviderError::Failed(why.clone()));
        }
        let asked = self.ask().await;
        known.failure = asked.as_ref().err().map(|error| (Instant::now(), chain(error)));
        let (metadata, keys) = asked?;
        known.answer = Some((Instant::now(), metadata.clone(), keys.clone()));
        Ok((metadata, keys))
    }

    async fn ask(&self) -> Result<(Metadata, JwkSet), ProviderError> {
        let address = format!("{}/.well-known/openid-configuration", self.issuer.trim_end_matches('/'));
        let metadata: Metadata = get(self.http.get(address), "where it is").await?;
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
    pub(super) async fn exchange(&self, metadata: &Metadata, what: &Exchange<'_>) -> Result<String, ProviderError> {
        let mut form = vec![
            ("grant_type", "authorization_code"),
            ("code", what.code),
            ("code_verifier", what.verifier),
            ("redirect_uri", what.redirect),
        ];
        let methods = &metadata.token_endpoint_auth_methods_supported;
        let in_form = methods.iter().any(|method| method == "client_secret_post")
            && !methods.iter().any(|method| method == "client_secret_basic");
        let mut request = self.http.post(metadata.token_endpoint.0.clone());
        match what.client_secret {
            Some(secret) if in_form => form.extend([("client_id", what.client_id), ("client_secret", secret)]),
            // Encoded as in a form, by RFC 6749, section 2.3.1.
            Some(secret) => request = request.basic_auth(form_value(what.client_id), Some(form_value(secret))),
            None => form.push(("client_id", what.client_id)),
        }
        let body = form.iter().map(|(name, value)| format!("{name}={}", form_value(value)));
        let request = request
            .header("content-type", "application/x-www-form-urlencoded")
            .body(body.collect::<Vec<_>>().join("&"));
        let tokens: Tokens = get(request, "a code").await?;
        Ok(tokens.id_token)
    }
}

/// Whether an address is encrypted, or on this machine.
pub(super) fn is_safe(address: &Url) -> bool {
    let is_here = matches!(address.host_str(), Some("localhost" | "127.0.0.1" | "[::1]"));
    address.scheme() == "https" || (address.scheme() == "http" && is_here)
}

/// Encodes a value of `application/x-www-form-urlencoded`.
pub(super) fn form_value(text: &str) -> String {
    percent_encoding::utf8_percent_encode(text, percent_encoding::NON_ALPHANUMERIC).to_string()
}

async fn get<T: DeserializeOwned>(request: RequestBuilder, what: &'static str) -> Result<T, ProviderError> {
    let mut response = request.header(ACCEPT, "application/json").send().await?;
    let status = response.status();
    if !status.is_success() {
        return Err(ProviderError::Status { what, status });
    }
    let mut bytes = Vec::new();
    while let Some(chunk) = response.chunk().await? {
        if bytes.len() + chunk.len() > MAX_ANSWER_BYTES {
            return Err(ProviderError::TooLong { what });
        }
        bytes.extend(chunk);
    }
    serde_json::from_slice(&bytes).map_err(|source| ProviderError::Malformed { what, source })
}
