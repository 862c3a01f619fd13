//! Listening socket of the server: an address and port, or a Unix socket that only its user may access.

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

/// Maximum number of unsent bytes that the kernel buffers for a connection, in addition to the bytes in flight. Large enough that the
/// server can refill the buffer of a fast line in time.
#[cfg(target_os = "linux")]
const NOT_SENT_BYTES: u32 = 128 << 10;

/// Prefix of the path of a Unix socket.
const UNIX: &str = "unix:";

/// Address on which the server listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ListenAddress {
    /// An address and port. With port 0, the system assigns a free port.
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
    /// Listens on an address.
    ///
    /// # Errors
    /// Errors of the system; `AddrInUse` if another server listens on this address.
    pub async fn bind(address: &ListenAddress) -> io::Result<Self> {
        match address {
            ListenAddress::Tcp(address) => Ok(Self::Tcp(TcpListener::bind(address).await?)),
            ListenAddress::Unix(path) => {
                let (listener, file) = SocketFile::bind(path)?;
                Ok(Self::Unix(listener, file))
            }
        }
    }

    /// Returns the address of the listener, with the port that the system assigned.
    ///
    /// # Errors
    /// Errors of the system.
    pub fn address(&self) -> io::Result<ListenAddress> {
        match self {
            Self::Tcp(listener) => Ok(ListenAddress::Tcp(listener.local_addr()?)),
            Self::Unix(_, file) => Ok(ListenAddress::Unix(file.path.clone())),
        }
    }

    /// Accepts the next connection, and returns the address of its peer. The peer of a Unix socket is this machine.
    pub(super) async fn accept(&self) -> io::Result<(Socket, IpAddr)> {
        match self {
            Self::Tcp(listener) => {
                let (socket, peer) = listener.accept().await?;
                // Otherwise Nagle's algorithm would delay a small text frame until the chunk before it is acknowledged.
                if let Err(error) = socket.set_nodelay(true) {
                    tracing::debug!(%error, "no TCP_NODELAY");
                }
                // Keeps the kernel's buffer small: the server cannot drop data there when a newer edit supersedes it.
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

/// Maximum bytes of the path of a Unix socket. `sun_path` has 108 bytes on Linux and 104 on other systems, including the terminating zero.
const MAX_SOCKET_PATH: usize = if cfg!(target_os = "linux") { 107 } else { 103 };

/// The file of a Unix socket. Dropping it removes the file, unless another server has replaced the file.
#[derive(Debug)]
pub struct SocketFile {
    path: PathBuf,
    inode: u64,
}

impl SocketFile {
    /// Creates the socket in a folder that no other user may enter, sets its mode to 0600, and then moves it to its path. So no other user
    /// can ever connect.
    fn bind(path: &Path) -> io::Result<(UnixListener, Self)> {
        check_length(path)?;
        check_replaceable(path)?;
        let parent = path.parent().filter(|parent| *parent != Path::new(""));
        let parent = parent.unwrap_or(Path::new("."));
        let private = tempfile::Builder::new().prefix(".").rand_bytes(6).tempdir_in(parent)?;
        let draft = private.path().join("s");
        let listener = UnixListener::bind(&draft)?;
        std::fs::set_permissions(&draft, PermissionsExt::from_mode(0o600))?;
        let inode = std::fs::metadata(&draft)?.ino();
        std::fs::rename(&draft, path)?;
        let path = path.to_owned();
        Ok((listener, Self { path, inode }))
    }
}

/// Checks the length of a path. Clients cannot connect to a socket with a longer path, although the rename would succeed.
fn check_length(path: &Path) -> io::Result<()> {
    let length = path.as_os_str().len();
    if length <= MAX_SOCKET_PATH {
        return Ok(());
    }
    let why = format!("the path of the socket has {length} bytes, expected {MAX_SOCKET_PATH} or fewer");
    Err(io::Error::new(io::ErrorKind::InvalidInput, why))
}

/// Checks that a path is free, or that its file is the socket of a server that has ended.
fn check_replaceable(path: &Path) -> io::Result<()> {
    let metadata = match path.symlink_metadata() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other?,
    };
    if !metadata.file_type().is_socket() {
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
        let is_own = std::fs::symlink_metadata(&self.path).is_ok_and(|metadata| metadata.ino() == self.inode);
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
    /// Sends a response without waiting, and closes the socket. Best effort: a peer that has already sent data may not receive the
    /// response.
    pub(super) fn refuse(self, response: &[u8]) {
        let _ = match self {
            Self::Tcp(socket) => socket.into_std().and_then(|mut socket| socket.write(response)),
            Self::Unix(socket) => socket.into_std().and_then(|mut socket| socket.write(response)),
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
