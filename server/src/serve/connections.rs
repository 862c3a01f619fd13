//! Accepts connections, with or without TLS, and limits their number, memory and time. `axum::serve` has no such limits: a client that
//! never completes its request would hold a connection forever.

use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper::{Request, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;

use super::listener::{Listener, Socket};
use super::read_pace::ReadPace;
use super::tls::Tls;
use crate::access::{PeerAddress, TrustedProxy, counted_as, is_trusted};
use crate::stream::MAX_VIEWERS;

/// Limits of connections.
#[derive(Clone, Copy, Debug)]
pub struct ConnectionLimits {
    /// Maximum number of open connections, including streams. Further connections wait in the backlog of the listening socket.
    pub all: usize,
    /// Maximum number of open connections of one peer. A peer is an IPv4 address or a /64 network of IPv6. The server answers further
    /// connections with 503 and closes them.
    pub per_peer: usize,
    /// Time limit for the head of a request. A connection without a request is closed after the same time.
    pub head: Duration,
}

/// Maximum number of files that a server has open in addition to its connections.
const OTHER_FILES: usize = 256;

/// Maximum number of connections: one for the stream of each viewer, and as many for other requests.
const MAX_CONNECTIONS: usize = 2 * MAX_VIEWERS;

/// Usual limit of open files of a process.
const USUAL_FILES: usize = 1024;

impl ConnectionLimits {
    /// Raises the limit of open files of this process as far as necessary and allowed, and derives the limits from it.
    pub fn of_process() -> Self {
        let wanted = (MAX_CONNECTIONS + OTHER_FILES) as u64;
        let files = rlimit::increase_nofile_limit(wanted).map_or(USUAL_FILES, |files| files as usize);
        let limits = Self::of_files(files);
        if limits.all < MAX_CONNECTIONS {
            tracing::info!(
                files,
                connections = limits.all,
                "the system limits open files, and with them connections"
            );
        }
        limits
    }

    /// Derives the limits from a maximum number of open files.
    fn of_files(files: usize) -> Self {
        // One peer gets five eighths: a browser opens six connections and a stream for each tab, and many clients may share an address.
        let all = files.saturating_sub(OTHER_FILES).clamp(1, MAX_CONNECTIONS);
        Self {
            all,
            per_peer: (all * 5 / 8).max(1),
            head: Duration::from_secs(10),
        }
    }
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self::of_files(USUAL_FILES)
    }
}

/// Maximum bytes of a request's head, and of the buffers for reading and writing ahead.
const BUFFER_BYTES: usize = 16 * 1024;

/// Pause after an accept that failed because the system is out of files or memory.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Response to a peer with too many connections.
const TOO_MANY: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 10\r\nConnection: close\r\nContent-Type: text/plain\r\n\
    Content-Length: 43\r\n\r\ntoo many connections from your address now\n";

/// Serves connections until `stop` is cancelled, then until all running requests have their responses. Dropping the future closes all
/// connections.
pub(super) async fn serve(
    listener: Listener,
    app: Router,
    limits: ConnectionLimits,
    proxies: Arc<[TrustedProxy]>,
    tls: Option<Arc<Tls>>,
    stop: CancellationToken,
) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(limits.head)
        .max_buf_size(BUFFER_BYTES);
    let peers = Arc::new(Peers::new(limits, proxies));
    let mut connections = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            () = stop.cancelled() => break,
            Some(_) = connections.join_next() => continue,
            accepted = accept(&listener, &peers) => accepted,
        };
        let Some(socket) = accepted else { continue };
        let connection = Connection {
            http: http.clone(),
            peer: PeerAddress(socket.address),
            is_stream: Arc::clone(&socket.is_stream),
            app: app.clone(),
            stop: stop.clone(),
        };
        match &tls {
            None => connections.spawn(connection.serve(socket)),
            Some(tls) => connections.spawn(connection.serve_tls(socket, tls.acceptor(), limits.head)),
        };
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
}

/// What the server needs to serve a connection, apart from its socket.
struct Connection {
    http: http1::Builder,
    peer: PeerAddress,
    is_stream: Arc<AtomicBool>,
    app: Router,
    stop: CancellationToken,
}

impl Connection {
    /// Completes the TLS handshake within `limit`, then serves the connection.
    async fn serve_tls(self, socket: Counted, acceptor: TlsAcceptor, limit: Duration) {
        let handshake = tokio::select! {
            () = self.stop.cancelled() => return,
            handshake = timeout(limit, acceptor.accept(socket)) => handshake,
        };
        match handshake {
            Ok(Ok(socket)) => self.serve(socket).await,
            Ok(Err(error)) => tracing::debug!(%error, "no TLS"),
            Err(_) => tracing::debug!("no TLS in {} s", limit.as_secs()),
        }
    }

    /// Serves a connection until it is closed. If `stop` is cancelled, closes the connection after the current request.
    async fn serve<I>(self, socket: I)
    where
        I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let (peer, app) = (self.peer, TowerToHyperService::new(self.app));
        let is_stream = self.is_stream;
        let service = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(peer);
            let (response, is_stream) = (app.call(request), Arc::clone(&is_stream));
            async move {
                let response = response.await;
                if matches!(&response, Ok(response) if response.status() == StatusCode::SWITCHING_PROTOCOLS) {
                    is_stream.store(true, Ordering::Relaxed);
                }
                response
            }
        });
        let connection = self
            .http
            .serve_connection(TokioIo::new(socket), service)
            .with_upgrades();
        let mut connection = std::pin::pin!(connection);
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = self.stop.cancelled() => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(error = crate::error::chain(&error), "a connection ended");
        }
    }
}

/// Accepts the next connection. Returns `None` if the system could not accept it, or if the server refused it.
async fn accept(listener: &Listener, peers: &Arc<Peers>) -> Option<Counted> {
    let permit = Arc::clone(&peers.all).acquire_owned().await.ok()?;
    let (socket, peer) = match listener.accept().await {
        Ok(accepted) => accepted,
        Err(error) => {
            tracing::warn!(%error, "a connection could not be accepted");
            tokio::time::sleep(ACCEPT_PAUSE).await;
            return None;
        }
    };
    let Some(guard) = peers.admit(peer, permit) else {
        tracing::debug!(%peer, "too many connections of one peer");
        socket.refuse(TOO_MANY);
        return None;
    };
    Some(Counted {
        socket,
        address: peer,
        is_stream: Arc::default(),
        pace: ReadPace::default(),
        _guard: guard,
    })
}

/// Counts of connections, in total and by peer.
struct Peers {
    /// One permit for each connection that may be open.
    all: Arc<Semaphore>,
    per_peer: usize,
    /// Trusted proxies. They have no limit per peer, because they carry many clients.
    proxies: Arc<[TrustedProxy]>,
    counts: Mutex<HashMap<IpAddr, usize>>,
}

impl Peers {
    fn new(limits: ConnectionLimits, proxies: Arc<[TrustedProxy]>) -> Self {
        Self {
            all: Arc::new(Semaphore::new(limits.all)),
            per_peer: limits.per_peer,
            proxies,
            counts: Mutex::default(),
        }
    }

    /// Counts a connection; `None` if the peer has its maximum number of connections.
    fn admit(self: &Arc<Self>, address: IpAddr, permit: OwnedSemaphorePermit) -> Option<PeerGuard> {
        let peer = counted_as(address);
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(peer).or_default();
        if *count >= self.per_peer && !is_trusted(&self.proxies, address) {
            return None;
        }
        *count += 1;
        Some(PeerGuard {
            peers: Arc::clone(self),
            peer,
            _permit: permit,
        })
    }
}

/// Guard of one counted connection. Dropping the guard ends the count and returns the permit.
struct PeerGuard {
    peers: Arc<Peers>,
    peer: IpAddr,
    _permit: OwnedSemaphorePermit,
}

impl Drop for PeerGuard {
    fn drop(&mut self) {
        let mut counts = self.peers.counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.peer);
            }
        }
    }
}

/// A socket of a counted connection. After the connection has become a stream, the rate of reads is limited.
struct Counted {
    socket: Socket,
    address: IpAddr,
    is_stream: Arc<AtomicBool>,
    pace: ReadPace,
    _guard: PeerGuard,
}

impl AsyncRead for Counted {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, to: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if !self.is_stream.load(Ordering::Relaxed) {
            return Pin::new(&mut self.socket).poll_read(context, to);
        }
        std::task::ready!(self.pace.poll(context));
        let before = to.filled().len();
        let read = Pin::new(&mut self.socket).poll_read(context, to);
        let bytes = to.filled().len() - before;
        if bytes > 0 {
            self.pace.record_read(bytes, Instant::now());
        }
        read
    }
}

impl AsyncWrite for Counted {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write_vectored(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use axum::routing::get;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::{TcpListener, TcpStream};
    use tokio::time::Instant;

    use super::*;

    async fn start(limits: ConnectionLimits) -> std::net::SocketAddr {
        start_with(limits, &[], None).await
    }

    async fn start_with(
        limits: ConnectionLimits,
        proxies: &[TrustedProxy],
        tls: Option<Arc<Tls>>,
    ) -> std::net::SocketAddr {
        let proxies = proxies.into();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let app = Router::new().route("/", get(async || "here"));
        tokio::spawn(serve(
            listener.into(),
            app,
            limits,
            proxies,
            tls,
            CancellationToken::new(),
        ));
        address
    }

    async fn answer(mut socket: TcpStream) -> String {
        let mut text = String::new();
        // Text that was read before a reset counts.
        let _ = socket.read_to_string(&mut text).await;
        text
    }

    const SHORT: Duration = Duration::from_millis(300);

    #[tokio::test]
    async fn a_head_that_does_not_end_is_given_up() {
        let address = start(ConnectionLimits {
            head: SHORT,
            ..ConnectionLimits::default()
        })
        .await;
        for begun in ["", "GET / HTTP/1.1\r\nHost: localhost\r\n"] {
            let mut socket = TcpStream::connect(address).await.unwrap();
            let start = Instant::now();
            socket.write_all(begun.as_bytes()).await.unwrap();
            let said = tokio::time::timeout(Duration::from_secs(5), answer(socket))
                .await
                .unwrap();
            assert!(!said.contains("here"), "{said}");
            assert!(start.elapsed() >= SHORT, "{:?} for {begun:?}", start.elapsed());
        }
    }

    #[tokio::test]
    async fn a_handshake_that_does_not_end_is_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = crate::serve::tls::made_in(folder.path(), "a");
        let limits = ConnectionLimits {
            head: SHORT,
            ..ConnectionLimits::default()
        };
        let address = start_with(limits, &[], Some(Arc::new(Tls::open(&certificate, &key).unwrap()))).await;
        // Nothing, the beginning of a handshake, and bytes that are not a handshake.
        for begun in [
            &b""[..],
            b"\x16\x03\x01\x02\x00\x01\x00",
            b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        ] {
            let mut socket = TcpStream::connect(address).await.unwrap();
            socket.write_all(begun).await.unwrap();
            let mut said = Vec::new();
            let read = timeout(Duration::from_secs(5), socket.read_to_end(&mut said)).await;
            // A connection that was reset has ended too.
            assert!(read.is_ok(), "open after {begun:?}");
            assert!(!said.windows(4).any(|part| part == b"here"), "{begun:?}");
        }
    }

    #[tokio::test]
    async fn one_peer_has_its_share_and_what_ended_counts_no_more() {
        let address = start(ConnectionLimits {
            per_peer: 2,
            ..ConnectionLimits::default()
        })
        .await;
        let request = b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        let idle = [
            TcpStream::connect(address).await.unwrap(),
            TcpStream::connect(address).await.unwrap(),
        ];
        let refused = answer(TcpStream::connect(address).await.unwrap()).await;
        assert!(refused.starts_with("HTTP/1.1 503"), "{refused}");
        assert!(
            refused.ends_with("\r\n\r\ntoo many connections from your address now\n"),
            "{refused}"
        );
        drop(idle);
        let served = async {
            loop {
                let mut socket = TcpStream::connect(address).await.unwrap();
                let _ = socket.write_all(request).await;
                let said = answer(socket).await;
                if said.ends_with("here") {
                    return said;
                }
            }
        };
        tokio::time::timeout(Duration::from_secs(5), served)
            .await
            .expect("another one may come");
    }

    #[tokio::test]
    async fn a_head_has_a_longest() {
        let address = start(ConnectionLimits::default()).await;
        let mut socket = TcpStream::connect(address).await.unwrap();
        let head = format!(
            "GET / HTTP/1.1\r\nHost: localhost\r\nA: {}\r\n\r\n",
            "a".repeat(BUFFER_BYTES)
        );
        let _ = socket.write_all(head.as_bytes()).await;
        let said = answer(socket).await;
        assert!(said.is_empty() || said.starts_with("HTTP/1.1 431"), "{said}");
    }

    #[tokio::test]
    async fn a_trusted_proxy_has_no_share() {
        let limits = ConnectionLimits {
            per_peer: 1,
            ..ConnectionLimits::default()
        };
        let proxy = "127.0.0.0/8".parse().unwrap();
        let address = start_with(limits, &[proxy], None).await;
        let _idle = TcpStream::connect(address).await.unwrap();
        let mut socket = TcpStream::connect(address).await.unwrap();
        let request = b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        socket.write_all(request).await.unwrap();
        let said = answer(socket).await;
        assert!(said.ends_with("here"), "{said}");
    }
}
