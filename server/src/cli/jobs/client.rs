//! HTTP client for the job API of a server.

use axum::body::Bytes;
use isopeel_volumes::is_this_machine;
use reqwest::header::{self, HeaderMap, HeaderValue};
use reqwest::{Method, RequestBuilder, Response, StatusCode, Url};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::JobsError;
use crate::access::Token;
use crate::jobs::{JobInfo, ManifestEntry};

/// Client of a server's job API.
pub(super) struct Client {
    server: String,
    http: reqwest::Client,
}

/// Fields of a problem document that the client reads.
#[derive(Deserialize)]
struct Problem {
    code: String,
    detail: String,
}

/// A result that is being downloaded.
pub(super) struct Download {
    response: Response,
    server: String,
}

impl Download {
    /// Returns the next bytes; `None` at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, JobsError> {
        self.response.chunk().await.map_err(|source| JobsError::Connection {
            server: self.server.clone(),
            source,
        })
    }
}

impl Client {
    pub(super) fn new(server: &str, token: Option<&Token>) -> Result<Self, JobsError> {
        let bad = || JobsError::Address(server.to_owned());
        let url: Url = server.parse().map_err(|_| bad())?;
        let host = url.host_str().ok_or_else(bad)?;
        if !matches!(url.scheme(), "http" | "https") {
            return Err(bad());
        }
        // An error is ignored: a provider is already installed.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let mut headers = HeaderMap::new();
        if let Some(token) = token {
            let mut value = HeaderValue::try_from(format!("Bearer {}", token.text())).map_err(|_| bad())?;
            value.set_sensitive(true);
            headers.insert(header::AUTHORIZATION, value);
        }
        let mut http = reqwest::Client::builder().default_headers(headers);
        if is_this_machine(host) {
            http = http.no_proxy();
        }
        let server = server.trim_end_matches('/').to_owned();
        match http.build() {
            Ok(http) => Ok(Self { server, http }),
            Err(source) => Err(JobsError::Connection { server, source }),
        }
    }

    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.http.request(method, format!("{}/api/v1/jobs{path}", self.server))
    }

    /// Converts an error of the HTTP client.
    pub(super) fn connection_error(&self, source: reqwest::Error) -> JobsError {
        JobsError::Connection {
            server: self.server.clone(),
            source,
        }
    }

    /// Sends a request, and returns the response if its status is a success.
    async fn execute(&self, request: RequestBuilder) -> Result<Response, JobsError> {
        let response = request.send().await.map_err(|error| self.connection_error(error))?;
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let text = response.bytes().await.map_err(|error| self.connection_error(error))?;
        match serde_json::from_slice(&text) {
            Ok(Problem { code, detail }) => Err(JobsError::Refused { code, detail }),
            Err(_)
                if matches!(
                    status,
                    StatusCode::BAD_GATEWAY | StatusCode::SERVICE_UNAVAILABLE | StatusCode::GATEWAY_TIMEOUT
                ) =>
            {
                let server = self.server.clone();
                Err(JobsError::Away { server, status })
            }
            Err(_) => Err(JobsError::Answer {
                server: self.server.clone(),
                why: format!("status {status} without a problem document"),
            }),
        }
    }

    /// Parses JSON of the server.
    pub(super) fn parse<T: DeserializeOwned>(&self, text: &[u8]) -> Result<T, JobsError> {
        serde_json::from_slice(text).map_err(|error| JobsError::Answer {
            server: self.server.clone(),
            why: error.to_string(),
        })
    }

    /// Sends a request without a body, and returns the body of the response.
    pub(super) async fn send(&self, method: Method, path: &str) -> Result<Bytes, JobsError> {
        self.body(self.request(method, path)).await
    }

    /// Sends a request, and returns the body of the response if its status is a success.
    async fn body(&self, request: RequestBuilder) -> Result<Bytes, JobsError> {
        let response = self.execute(request).await?;
        response.bytes().await.map_err(|error| self.connection_error(error))
    }

    pub(super) async fn submit(&self, request: Vec<u8>, key: Option<&str>) -> Result<JobInfo, JobsError> {
        let mut submit = self
            .request(Method::POST, "")
            .header(header::CONTENT_TYPE, "application/json");
        if let Some(key) = key {
            submit = submit.header("idempotency-key", key);
        }
        self.parse(&self.body(submit.body(request)).await?)
    }

    pub(super) async fn job(&self, id: &str) -> Result<JobInfo, JobsError> {
        self.parse(&self.send(Method::GET, &format!("/{id}")).await?)
    }

    pub(super) async fn manifest(&self, id: &str) -> Result<Vec<ManifestEntry>, JobsError> {
        self.parse(&self.send(Method::GET, &format!("/{id}/results")).await?)
    }

    /// Begins to download a result.
    pub(super) async fn result(&self, id: &str, extraction: u32) -> Result<Download, JobsError> {
        let request = self.request(Method::GET, &format!("/{id}/results/{extraction}"));
        Ok(Download {
            response: self.execute(request).await?,
            server: self.server.clone(),
        })
    }

    /// Requests the events of a job after the event with id `after`. Returns `None` if the job is finished and has no more events.
    pub(super) async fn events(&self, id: &str, after: &str) -> Result<Option<Response>, JobsError> {
        let request = self
            .request(Method::GET, &format!("/{id}/events"))
            .header("last-event-id", after);
        let response = self.execute(request).await?;
        Ok((response.status() != StatusCode::NO_CONTENT).then_some(response))
    }
}
