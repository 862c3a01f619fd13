//! Listener of a server: an address and port, or a Unix socket, whose file only its user may access.

use std::fmt;
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::str::FromStr;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};

/// Unsent bytes that the system buffers for a connection beyond those that it may send now; a fast line is refilled before they run out.
#[cfg(target_os = "linux")]
const NOT_SENT_BYTES: u32 = 128 << 10;

/// Prefix of the path of a Unix socket.
const UNIX: &str = "unix:";

/// Address that a server is to listen on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ListenAddress {
    /// An address and port; port 0 is a free one.
    Tcp(SocketAddr),
    /// The path of a Unix socket.
    Unix(PathBuf),
}

impl FromStr for ListenAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix(UNIX) {
            Some("") => Err(format!(
                "{text:?}, expected a path, such as unix:/run/user/1000/isopeel.sock"
            )),
            Some(path) => Ok(Self::Unix(path.into())),
            None => text
                .parse()
                .map(Self::Tcp)
                .map_err(|_| format!("{text:?}, expected an address and port, 127.0.0.1:8417, or unix:PATH")),
        }
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

/// A listening socket.
#[derive(Debug)]
pub enum Listener {
    /// At an address and port.
    Tcp(TcpListener),
    /// At a Unix socket.
    Unix(UnixListener, SocketFile),
}

impl From<TcpListener> for Listener {
    fn from(listener: TcpListener) -> Self {
        Self::Tcp(listener)
    }
}

impl Listener {
    /// Listens there.
    ///
    /// # Errors
    /// Those of the system; `AddrInUse` if another server listens there.
    pub async fn bind(address: &ListenAddress) -> io::Result<Self> {
        match address {
            ListenAddress::Tcp(address) => Ok(Self::Tcp(TcpListener::bind(address).await?)),
            ListenAddress::Unix(path) => {
                let (listener, file) = SocketFile::bind(path)?;
                Ok(Self::Unix(listener, file))
            }
        }
    }

    /// Returns the address that it listens on, with the port that the system assigned.
    ///
    /// # Errors
    /// Those of the system.
    pub fn address(&self) -> io::Result<ListenAddress> {
        match self {
            Self::Tcp(listener) => Ok(ListenAddress::Tcp(listener.local_addr()?)),
            Self::Unix(_, file) => Ok(ListenAddress::Unix(file.path.clone())),
        }
    }

    /// Accepts the next connection and returns its peer; a Unix socket's is this machine.
    pub(super) async fn accept(&self) -> io::Result<(Socket, IpAddr)> {
        match self {
            Self::Tcp(listener) => {
                let (socket, peer) = listener.accept().await?;
                // Else a small text frame would wait for the acknowledgement of the chunk before it.
                if let Err(error) = socket.set_nodelay(true) {
                    tracing::debug!(%error, "no TCP_NODELAY");
                }
                // Data that the system holds unsent cannot be dropped any more when a newer edit supersedes it.
                #[cfg(target_os = "linux")]
                if let Err(error) = socket2::SockRef::from(&socket).set_tcp_notsent_lowat(NOT_SENT_BYTES) {
                    tracing::debug!(%error, "no TCP_NOTSENT_LOWAT");
                }
                Ok((Socket::Tcp(socket), peer.ip()))
            }
            Self::Unix(listener, _) => {
                let (socket, _) = listener.accept().await?;
                Ok((Socket::Unix(socket), Ipv4Addr::LOCALHOST.into()))
            }
        }
    }
}

/// Maximum bytes of a socket's path: including the terminating zero, `sun_path` has 108 bytes, and 104 on systems other than Linux.
const MAX_SOCKET_PATH: usize = if cfg!(target_os = "linux") { 107 } else { 103 };

/// The file of a Unix socket. Dropping it removes the file, if it is still this server's.
#[derive(Debug)]
pub struct SocketFile {
    path: PathBuf,
    inode: u64,
}

impl SocketFile {
    /// Makes the socket in a folder that no other user may enter, and moves it to its path once its mode is 0600: at no moment can another
    /// user connect.
    fn bind(path: &Path) -> io::Result<(UnixListener, Self)> {
        check_length(path)?;
        make_way(path)?;
        let parent = path.parent().filter(|parent| *parent != Path::new(""));
        let parent = parent.unwrap_or(Path::new("."));
        let private = tempfile::Builder::new().prefix(".").rand_bytes(6).tempdir_in(parent)?;
        let made = private.path().join("s");
        let listener = UnixListener::bind(&made)?;
        std::fs::set_permissions(&made, PermissionsExt::from_mode(0o600))?;
        let inode = std::fs::metadata(&made)?.ino();
        std::fs::rename(&made, path)?;
        let path = path.to_owned();
        Ok((listener, Self { path, inode }))
    }
}

/// Checks that clients can name a socket: the system does not accept longer paths.
fn check_length(path: &Path) -> io::Result<()> {
    let length = path.as_os_str().len();
    if length <= MAX_SOCKET_PATH {
        return Ok(());
    }
    let why = format!("the path of the socket has {length} bytes, expected {MAX_SOCKET_PATH} or fewer");
    Err(io::Error::new(io::ErrorKind::InvalidInput, why))
}

/// Checks that a path is free, or has the socket of a server that has ended, which may be replaced.
fn make_way(path: &Path) -> io::Result<()> {
    let found = match path.symlink_metadata() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other?,
    };
    if !found.file_type().is_socket() {
        let why = "there is a file that is no socket, expected none";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, why));
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => Err(io::ErrorKind::AddrInUse.into()),
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
        Err(error) => Err(error),
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        let is_own = std::fs::symlink_metadata(&self.path).is_ok_and(|found| found.ino() == self.inode);
        if is_own && let Err(error) = std::fs::remove_file(&self.path) {
            tracing::debug!(%error, "the socket's file stays");
        }
    }
}

/// A connection.
pub(super) enum Socket {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Socket {
    /// Sends an answer and closes. Best effort, without waiting: if the peer has already sent data, it may miss the answer.
    pub(super) fn refuse(self, answer: &[u8]) {
        let _ = match self {
            Self::Tcp(socket) => socket.into_std().and_then(|mut socket| socket.write(answer)),
            Self::Unix(socket) => socket.into_std().and_then(|mut socket| socket.write(answer)),
        };
    }
}

impl AsyncRead for Socket {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, to: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(socket) => Pin::new(socket).poll_read(context, to),
            Self::Unix(socket) => Pin::new(socket).poll_read(context, to),
        }
    }
}

impl AsyncWrite for Socket {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Tcp(socket) => Pin::new(socket).poll_write(context, bytes),
            Self::Unix(socket) => Pin::new(socket).poll_write(context, bytes),
        }
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Tcp(socket) => Pin::new(socket).poll_write_vectored(context, parts),
            Self::Unix(socket) => Pin::new(socket).poll_write_vectored(context, parts),
        }
    }

    fn is_write_vectored(&self) -> bool {
        match self {
            Self::Tcp(socket) => socket.is_write_vectored(),
            Self::Unix(socket) => socket.is_write_vectored(),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(socket) => Pin::new(socket).poll_flush(context),
            Self::Unix(socket) => Pin::new(socket).poll_flush(context),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(socket) => Pin::new(socket).poll_shutdown(context),
            Self::Unix(socket) => Pin::new(socket).poll_shutdown(context),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_port_or_a_path() {
        let address = |text: &str| text.parse::<ListenAddress>();
        for text in ["127.0.0.1:8417", "[::1]:0", "unix:/run/isopeel.sock", "unix:here"] {
            assert_eq!(address(text).unwrap().to_string(), text);
        }
        for text in ["", "8417", "localhost:8417", "unix:"] {
            assert!(address(text).unwrap_err().contains("expected"), "{text:?}");
        }
    }

    #[tokio::test]
    async fn a_socket_is_its_users_alone_and_of_one_server() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let address = ListenAddress::Unix(path.clone());
        let listener = Listener::bind(&address).await.unwrap();
        assert_eq!(listener.address().unwrap(), address);
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            1,
            "nothing beside it"
        );
        let long = ListenAddress::Unix(folder.path().join("s".repeat(120)));
        let long = Listener::bind(&long).await.unwrap_err().to_string();
        assert!(long.contains("bytes, expected 10"), "{long}");
        let second = Listener::bind(&address).await.unwrap_err();
        assert_eq!(second.kind(), io::ErrorKind::AddrInUse);
        let (accepted, connected) = tokio::join!(listener.accept(), UnixStream::connect(&path));
        assert!(accepted.unwrap().1.is_loopback() && connected.is_ok());
        drop(listener);
        assert!(!path.exists());
        // Of a process that was killed.
        drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
        assert!(path.exists());
        let listener = Listener::bind(&address).await.unwrap();
        // The file at the path is not this server's any more: it must not remove it.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, b"other").unwrap();
        drop(listener);
        assert!(path.exists());
        let taken = Listener::bind(&address).await.unwrap_err();
        assert_eq!(taken.kind(), io::ErrorKind::AlreadyExists);
    }
}
