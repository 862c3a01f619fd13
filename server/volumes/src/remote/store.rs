//! A store over a network: requests run on two threads of their own, and callers wait for them.

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use futures_util::StreamExt;
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey};
use object_store::client::{ClientConfigKey, HttpError, HttpErrorKind};
use object_store::http::HttpBuilder;
use object_store::list::{PaginatedListOptions, PaginatedListStore};
use object_store::path::Path as ObjectPath;
use object_store::{ClientOptions, GetOptions, GetRange, ObjectStore};
use tokio::runtime::Runtime;

use super::address::Address;
pub(crate) use super::client::Limits;
use super::client::{Connector, Redirect};
use super::target::Target;
use super::{Fault, Object, Part, is_this_machine};

/// Interval at which a waiting caller checks for cancellation.
const POLL: Duration = Duration::from_millis(50);
/// Maximum bytes that are allocated because a header claims them; the buffer grows with the received bytes beyond that.
const FIRST_BYTES: u64 = 1 << 20;
/// Number of names that are requested at once.
const PAGE: usize = 1000;

/// A store.
#[derive(Debug)]
pub(crate) struct Remote {
    store: Arc<dyn ObjectStore>,
    /// The same store, if it can be listed.
    listed: Option<AmazonS3>,
    /// Prefix of all keys.
    prefix: String,
}

impl Remote {
    /// Opens a store. Sends no request yet.
    pub(crate) fn open(address: &Address, limits: Limits) -> Result<Self, String> {
        match address.target.clone()? {
            Target::Http { url, authorization } => {
                let connector = Connector {
                    is_local: is_this_machine(url.host_str().unwrap_or_default()),
                    authorization,
                    limits: limits.clone(),
                };
                let store = HttpBuilder::new()
                    .with_url(url)
                    .with_client_options(ClientOptions::new().with_allow_http(true))
                    .with_retry(limits.retry)
                    .with_http_connector(connector)
                    .build()
                    .map_err(|error| reason(&error))?;
                Ok(Self {
                    store: Arc::new(store),
                    listed: None,
                    prefix: String::new(),
                })
            }
            Target::S3 { bucket, prefix } => {
                let store = s3(&bucket, limits)?;
                Ok(Self {
                    store: Arc::new(store.clone()),
                    listed: Some(store),
                    prefix,
                })
            }
        }
    }

    fn key(&self, relative: &str) -> String {
        match (self.prefix.as_str(), relative) {
            ("", key) | (key, "") => key.to_owned(),
            (prefix, relative) => format!("{prefix}/{relative}"),
        }
    }

    /// Reads an object, or a part of it, of `limit` bytes at most. Is cancelled when `stop` returns true.
    pub(crate) fn get(&self, relative: &str, part: Part, limit: u64, stop: &dyn Fn() -> bool) -> Result<Object, Fault> {
        let key = ObjectPath::parse(self.key(relative));
        let key = key.map_err(|_| Fault::Other("no key of an object, expected a plain relative path".to_owned()))?;
        let store = Arc::clone(&self.store);
        wait(stop, async move { fetch(&*store, &key, part, limit).await })
    }

    /// Returns the names of what is below a key, up to `limit`; `None` if the store cannot be listed.
    pub(crate) fn folders(&self, relative: &str, limit: usize) -> Option<Result<Vec<String>, Fault>> {
        let store = self.listed.clone()?;
        let mut prefix = self.key(relative);
        if !prefix.is_empty() {
            prefix.push('/');
        }
        Some(wait(&|| false, async move { list(&store, &prefix, limit).await }))
    }
}

fn s3(bucket: &str, limits: Limits) -> Result<AmazonS3, String> {
    let builder = AmazonS3Builder::from_env().with_bucket_name(bucket);
    let endpoint = builder
        .get_config_value(&AmazonS3ConfigKey::Endpoint)
        .unwrap_or_default();
    let allow_http = builder.get_config_value(&AmazonS3ConfigKey::Client(ClientConfigKey::AllowHttp));
    if endpoint.starts_with("http://") && allow_http.as_deref() != Some("true") {
        return Err("the endpoint in the environment is http://, expected https://, or AWS_ALLOW_HTTP=true".to_owned());
    }
    let host = reqwest::Url::parse(&endpoint).ok();
    let connector = Connector {
        is_local: is_this_machine(host.as_ref().and_then(|url| url.host_str()).unwrap_or_default()),
        authorization: None,
        limits: limits.clone(),
    };
    let store = builder.with_retry(limits.retry).with_http_connector(connector);
    store.build().map_err(|error| reason(&error))
}

/// Runs a request on the threads for requests, and waits for its result.
fn wait<T: Send + 'static>(
    stop: &dyn Fn() -> bool,
    request: impl Future<Output = Result<T, Fault>> + Send + 'static,
) -> Result<T, Fault> {
    static RUNTIME: OnceLock<Result<Runtime, String>> = OnceLock::new();
    let start = || {
        let mut runtime = tokio::runtime::Builder::new_multi_thread();
        let runtime = runtime.worker_threads(2).thread_name("remote").enable_all();
        runtime.build().map_err(|e| format!("no threads for requests: {e}"))
    };
    let runtime = RUNTIME.get_or_init(start);
    let runtime = runtime.as_ref().map_err(|why| Fault::Other(why.clone()))?;
    let (reply, answer) = sync_channel(1);
    let task = runtime.spawn(async move {
        // Fails if the caller no longer waits, because it was cancelled.
        let _ = reply.send(request.await);
    });
    loop {
        match answer.recv_timeout(POLL) {
            Ok(result) => return result,
            Err(RecvTimeoutError::Timeout) if !stop() => {}
            Err(RecvTimeoutError::Timeout) => {
                task.abort();
                return Err(Fault::Other("reading was cancelled".to_owned()));
            }
            Err(RecvTimeoutError::Disconnected) => return Err(Fault::Other("the request failed inside".to_owned())),
        }
    }
}

async fn fetch(store: &dyn ObjectStore, key: &ObjectPath, part: Part, limit: u64) -> Result<Object, Fault> {
    let range = match part {
        Part::Whole => None,
        Part::At(range) => Some(GetRange::Bounded(range)),
        Part::End(bytes) => Some(GetRange::Suffix(bytes)),
    };
    let options = GetOptions::new().with_range(range);
    let found = store.get_opts(key, options).await.map_err(|e| fault(&e))?;
    let (size, length) = (found.meta.size, found.range.end - found.range.start);
    if length > limit {
        let why = format!("{length} bytes, expected {limit} at most");
        return Err(Fault::Other(why));
    }
    let mut bytes = Vec::with_capacity(length.min(FIRST_BYTES) as usize);
    let mut stream = found.into_stream();
    while let Some(some) = stream.next().await {
        let some = some.map_err(|e| fault(&e))?;
        if bytes.len() as u64 + some.len() as u64 > length {
            return Err(Fault::Other(format!(
                "more than the {length} bytes that its header says"
            )));
        }
        bytes.extend_from_slice(&some);
    }
    if (bytes.len() as u64) < length {
        let found = bytes.len();
        return Err(Fault::Other(format!("{found} bytes, its header says {length}")));
    }
    Ok(Object { bytes, size })
}

async fn list(store: &AmazonS3, prefix: &str, limit: usize) -> Result<Vec<String>, Fault> {
    let mut names = Vec::new();
    let mut page_token = None;
    // Bounded, as a page may be empty.
    for _ in 0..limit.div_ceil(PAGE) {
        let options = PaginatedListOptions {
            delimiter: Some("/".into()),
            max_keys: Some(PAGE),
            page_token,
            ..PaginatedListOptions::default()
        };
        let page = store
            .list_paginated(Some(prefix), options)
            .await
            .map_err(|e| fault(&e))?;
        let folders = page.result.common_prefixes.iter();
        names.extend(folders.filter_map(|path| path.filename().map(str::to_owned)));
        page_token = page.page_token;
        if page_token.is_none() {
            break;
        }
    }
    names.truncate(limit);
    names.sort();
    Ok(names)
}

fn fault(error: &object_store::Error) -> Fault {
    match error {
        object_store::Error::NotFound { .. } => Fault::Missing,
        object_store::Error::PermissionDenied { .. } => Fault::Forbidden,
        error => Fault::Other(reason(error)),
    }
}

/// Returns the error text without addresses, as these may hold secrets.
fn reason(error: &object_store::Error) -> String {
    let mut innermost: &dyn std::error::Error = error;
    let mut prefix = "";
    while let Some(source) = innermost.source() {
        if let Some(redirect) = source.downcast_ref::<Redirect>() {
            return redirect.to_string();
        }
        if let Some(error) = source.downcast_ref::<HttpError>() {
            prefix = match error.kind() {
                HttpErrorKind::Timeout => return "no answer in time".to_owned(),
                HttpErrorKind::Connect => "no connection: ",
                HttpErrorKind::Request | HttpErrorKind::Interrupted => "the connection ended: ",
                HttpErrorKind::Decode | HttpErrorKind::Unknown | _ => prefix,
            };
        }
        innermost = source;
    }
    let text = innermost.to_string();
    let text = text.trim_end_matches([':', ' ']);
    if text.contains("://") {
        return format!("{prefix}the request failed");
    }
    format!("{prefix}{text}")
}

#[cfg(test)]
mod tests;
