//! A server that encrypts connections itself: its page's cookie, a stream, and another certificate while it runs.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_client::{Connection, request};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use crate::support::{command, process};

/// A certificate for `localhost`, and its key.
struct Files {
    certificate: PathBuf,
    key: PathBuf,
}

impl Files {
    fn in_folder(folder: &Path) -> Self {
        Self {
            certificate: folder.join("server.crt"),
            key: folder.join("server.key"),
        }
    }

    /// Writes new ones; the certificate.
    fn renew(&self) -> CertificateDer<'static> {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
        std::fs::write(&self.certificate, made.cert.pem()).expect("written");
        std::fs::write(&self.key, made.signing_key.serialize_pem()).expect("written");
        CertificateDer::from_pem_slice(made.cert.pem().as_bytes()).expect("a certificate")
    }

    fn options(&self) -> [&str; 4] {
        let [certificate, key] = [&self.certificate, &self.key].map(|path| path.to_str().expect("UTF-8"));
        ["--tls-cert", certificate, "--tls-key", key]
    }
}

/// A connection whose certificate is this one.
async fn connect(address: SocketAddr, certificate: &CertificateDer<'static>) -> std::io::Result<TlsStream<TcpStream>> {
    let mut roots = RootCertStore::empty();
    roots.add(certificate.clone()).expect("a certificate");
    let provider = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").expect("a name");
    let tcp = TcpStream::connect(address).await.expect("the server listens");
    TlsConnector::from(Arc::new(config)).connect(name, tcp).await
}

/// The answer to a request, head and body.
async fn said(socket: &mut TlsStream<TcpStream>, request: &str) -> String {
    socket.write_all(request.as_bytes()).await.expect("sent");
    let mut answer = String::new();
    socket.read_to_string(&mut answer).await.expect("text");
    answer
}

const HEALTH: &str = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";

#[tokio::test]
async fn connections_are_encrypted_and_the_certificate_is_renewed() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = Files::in_folder(folder.path());
    let first = files.renew();
    let Some((server, printed)) = process::begin(&[], &files.options()) else {
        return;
    };
    let address = server.address;
    assert!(printed.starts_with("https://127.0.0.1:"), "{printed}");
    let token = printed.split("/#token=").nth(1).expect("a token");
    let mut socket = connect(address, &first).await.expect("its certificate");
    assert!(said(&mut socket, HEALTH).await.ends_with("ok\n"));

    // The cookie is for encrypted connections alone, and lets the page open a stream.
    let body = json!({"token": token}).to_string();
    let exchange = format!(
        "POST /api/v1/session HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let answer = said(&mut connect(address, &first).await.expect("a connection"), &exchange).await;
    let cookie = answer.lines().find_map(|line| line.strip_prefix("set-cookie: "));
    let cookie = cookie.unwrap_or_else(|| panic!("no cookie in {answer}"));
    let name = format!("__Host-isopeel-{}=", address.port());
    assert!(
        cookie.starts_with(&name) && cookie.ends_with("; Path=/; HttpOnly; SameSite=Lax; Secure"),
        "{cookie}"
    );
    let pair = cookie.split(';').next().expect("a pair");
    let headers = [("origin", "https://localhost"), ("cookie", pair)];
    let request = request("localhost", "", &headers).expect("a request");
    let socket = connect(address, &first).await.expect("a connection");
    let stream = Connection::handshake_on(socket, request, None).await.expect("a stream");

    // A half-written file has no effect. A complete one is used from then on; open connections stay open.
    std::fs::write(&files.certificate, "-----BEGIN CERTIFICATE-----\n").expect("written");
    server.signal("HUP");
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(connect(address, &first).await.is_ok(), "the old certificate stays");
    let second = files.renew();
    server.signal("HUP");
    let start = Instant::now();
    while connect(address, &second).await.is_err() {
        assert!(
            start.elapsed() < Duration::from_secs(5),
            "the certificate is not renewed"
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(connect(address, &first).await.is_err(), "the old certificate is gone");
    stream.close().await.expect("the stream is open still");
    server.signal("TERM");
    assert!(server.ended_within(Duration::from_secs(10)).success());
}

#[tokio::test]
async fn half_requests_cost_little_by_tls_too() {
    const COUNT: u64 = 400;
    let folder = tempfile::tempdir().expect("a folder");
    let files = Files::in_folder(folder.path());
    let certificate = files.renew();
    let Some((server, _)) = process::begin(&[], &files.options()) else {
        return;
    };
    // The first-time work is done, and the device is open.
    let ready = HEALTH.replace("healthz", "readyz");
    let start = Instant::now();
    while !said(
        &mut connect(server.address, &certificate).await.expect("a connection"),
        &ready,
    )
    .await
    .ends_with("ready\n")
    {
        assert!(start.elapsed() < Duration::from_secs(120), "the device is not ready");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let before = server.resident_bytes();
    let mut waiting = Vec::new();
    for _ in 0..COUNT {
        let mut socket = connect(server.address, &certificate).await.expect("a connection");
        let begun = format!("GET / HTTP/1.1\r\nHost: localhost\r\nX: {}", "x".repeat(200));
        socket.write_all(begun.as_bytes()).await.expect("sent");
        waiting.push(socket);
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    let each = server.resident_bytes().saturating_sub(before) / COUNT;
    println!("{each} bytes for each half request by TLS");
    assert!(each <= 32 << 10, "{each} bytes for each half request by TLS");
}

#[test]
fn files_that_are_no_certificate_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = Files::in_folder(folder.path());
    let serve = |options: &[&str]| command::fail([&["serve", "--listen", "127.0.0.1:0"], options].concat());
    let said = serve(&files.options());
    assert!(said.contains("cannot read") && said.contains("server.crt"), "{said}");
    files.renew();
    std::fs::write(&files.key, "no key").expect("written");
    let said = serve(&files.options());
    assert!(said.contains("server.key has no private key: expected PEM"), "{said}");
    let said = serve(&files.options()[..2]);
    assert!(said.contains("--tls-key"), "{said}");
}
