//! Host names that the server accepts. With DNS rebinding, a foreign page makes its own host name resolve to this machine, so that the
//! browser lets the page read responses of this server. The server detects this by the name in the header `Host`.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;

use axum::http::header::{HOST, HeaderMap};
use axum::http::uri::Authority;
use axum::http::{StatusCode, Uri};

use super::origin::AllowedOrigin;
use crate::problem::ApiError;

/// Public address of the server at a proxy: `https://volumes.example`, optionally with a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublicUrl {
    origin: AllowedOrigin,
    host: String,
    url: String,
}

impl FromStr for PublicUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = |_| format!("{text:?}, expected http(s)://host[:port][/path], such as https://volumes.example");
        let uri: Uri = text.parse().map_err(|_| refuse(()))?;
        let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else {
            return Err(refuse(()));
        };
        if uri.query().is_some() || text.contains('#') {
            return Err(refuse(()));
        }
        // Browsers omit the default port of the scheme in an origin.
        let implied = if scheme == "https" { ":443" } else { ":80" };
        let bare = authority.as_str().trim_end_matches(implied);
        Ok(Self {
            origin: format!("{scheme}://{bare}").parse().map_err(|_| refuse(()))?,
            host: host_of(authority),
            url: text.trim_end_matches('/').to_owned(),
        })
    }
}

impl PublicUrl {
    /// Returns the origin of the pages at this address.
    pub fn origin(&self) -> &AllowedOrigin {
        &self.origin
    }

    /// Returns port and path of the address, in characters that the name of a cookie may have.
    pub(super) fn place(&self) -> String {
        let uri: Uri = self.url.parse().unwrap_or_default();
        let port = uri.port_u16().unwrap_or(if self.is_https() { 443 } else { 80 });
        let path = uri.path().trim_end_matches('/');
        let path = path.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' });
        format!("{port}{}", path.collect::<String>())
    }

    /// Whether the address has the scheme `https`.
    pub fn is_https(&self) -> bool {
        self.url.starts_with("https:")
    }
}

impl std::fmt::Display for PublicUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.url)
    }
}

/// The host names that the server accepts. Ports are not compared, because a tunnel or a container may map them, and because DNS rebinding
/// cannot change the name.
#[derive(Clone, Debug)]
pub(super) struct AllowedHosts {
    listen: IpAddr,
    public: Vec<String>,
}

impl AllowedHosts {
    pub(super) fn new(listen: SocketAddr, public: &[PublicUrl]) -> Self {
        Self {
            listen: listen.ip().to_canonical(),
            public: public.iter().map(|url| url.host.clone()).collect(),
        }
    }

    fn allows(&self, authority: &str) -> bool {
        let Ok(authority) = authority.parse::<Authority>() else {
            return false;
        };
        if authority.as_str().contains('@') {
            return false;
        }
        let host = host_of(&authority);
        match host.parse::<IpAddr>().map(|address| address.to_canonical()) {
            // DNS rebinding needs a name, so an IP address is safe. A server that listens on all addresses accepts any IP address, because
            // a container or router may map another address to it.
            Ok(address) => address.is_loopback() || address == self.listen || self.listen.is_unspecified(),
            // Safe, because browsers resolve `localhost` and its subdomains to this machine without DNS.
            Err(_) if host == "localhost" || host.ends_with(".localhost") => true,
            Err(_) => self.public.contains(&host),
        }
    }

    /// Checks that a request has exactly one header `Host`, and that the server accepts this host. Also checks the host of the request
    /// target, if the target has one.
    ///
    /// # Errors
    /// 421 if a host is not accepted.
    pub(super) fn check(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        let mut hosts = headers.get_all(HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            return Err(misdirected("no single host"));
        };
        let named = [
            uri.authority().map(|authority| authority.as_str()),
            Some(host.to_str().unwrap_or("?")),
        ];
        match named.into_iter().flatten().find(|host| !self.allows(host)) {
            None => Ok(()),
            Some(host) => Err(misdirected(&format!("{host:?}"))),
        }
    }
}

fn misdirected(host: &str) -> ApiError {
    let message = format!(
        "this server does not answer to {host}: expected localhost, the address it listens on, or a host of --public-url"
    );
    ApiError::new(StatusCode::MISDIRECTED_REQUEST, "foreign-host", message)
}

/// Returns the host in lower case, without the brackets of an IPv6 address or the final dot of a name.
fn host_of(authority: &Authority) -> String {
    let host = authority.host().to_ascii_lowercase();
    let host = host.strip_suffix('.').unwrap_or(&host);
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    bare.unwrap_or(host).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_of_an_address_is_its_port_and_path() {
        for (url, expected) in [
            ("https://volumes.example", "443"),
            ("http://volumes.example/", "80"),
            ("https://volumes.example:8443", "8443"),
            ("https://lab.example/a/volumes/", "443-a-volumes"),
            ("https://lab.example/a.b;c", "443-a-b-c"),
        ] {
            assert_eq!(url.parse::<PublicUrl>().expect("a URL").place(), expected);
        }
    }

    fn hosts(listen: &str, public: &[&str]) -> AllowedHosts {
        let public: Vec<_> = public.iter().map(|url| url.parse().expect("a URL")).collect();
        AllowedHosts::new(listen.parse().expect("an address"), &public)
    }

    #[test]
    fn names_that_can_be_rebound_are_refused() {
        let loopback = hosts("127.0.0.1:8417", &[]);
        let public = hosts(
            "127.0.0.1:8417",
            &["https://Volumes.example:8443/isopeel/", "http://isopeel.lab.svc:8417"],
        );
        let open = hosts("0.0.0.0:8417", &[]);
        let one = hosts("192.0.2.7:80", &[]);
        for (hosts, host, allowed) in [
            (&loopback, "localhost:8417", true),
            (&loopback, "LOCALHOST.:9000", true),
            (&loopback, "viewer.localhost", true),
            (&loopback, "127.0.0.1", true),
            (&loopback, "127.1.2.3:1", true),
            (&loopback, "[::1]:8417", true),
            (&loopback, "[::ffff:127.0.0.1]:8417", true),
            (&loopback, "evil.example", false),
            (&loopback, "localhost.evil.example:8417", false),
            (&loopback, "127.0.0.1.evil.example", false),
            (&loopback, "localhost@evil.example", false),
            (&loopback, "192.0.2.7:8417", false),
            (&loopback, "", false),
            (&public, "volumes.example", true),
            (&public, "volumes.example:8443", true),
            (&public, "isopeel.lab.svc:8417", true),
            (&public, "localhost", true),
            (&public, "other.volumes.example", false),
            (&open, "192.0.2.7:8417", true),
            (&open, "[2001:db8::1]:8417", true),
            (&open, "host.lan:8417", false),
            (&one, "192.0.2.7", true),
            (&one, "192.0.2.8", false),
        ] {
            assert_eq!(hosts.allows(host), allowed, "{host:?} at {hosts:?}");
        }
    }

    #[test]
    fn a_request_has_one_host_and_its_target_no_other() {
        let hosts = hosts("127.0.0.1:8417", &[]);
        let check = |target: &str, named: &[&str]| {
            let mut headers = HeaderMap::new();
            for host in named {
                headers.append(HOST, host.parse().expect("a header"));
            }
            hosts.check(&target.parse().expect("a target"), &headers)
        };
        assert!(check("/", &["localhost"]).is_ok());
        assert!(check("http://localhost/", &["localhost"]).is_ok());
        assert!(check("/", &[]).is_err());
        assert!(check("/", &["localhost", "localhost"]).is_err());
        assert!(check("http://evil.example/", &["localhost"]).is_err());
    }

    #[test]
    fn a_public_url_is_an_address_of_pages() {
        let origin = |text: &str| text.parse::<PublicUrl>().map(|url| url.origin().clone());
        assert_eq!(origin("https://a.example:443/x/"), "https://a.example".parse());
        assert_eq!(origin("http://a.example:8417"), "http://a.example:8417".parse());
        for text in [
            "",
            "a.example",
            "ftp://a.example",
            "https://a.example/?x",
            "https://me@a.example",
            "https://a.example/#x",
        ] {
            let error = text.parse::<PublicUrl>().expect_err(text);
            assert!(error.contains("expected http"), "{error}");
        }
    }
}
