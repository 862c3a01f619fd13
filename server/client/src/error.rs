//! Errors of a client.

use tokio_tungstenite::tungstenite;

use crate::chunk::ChunkError;

/// Why a client cannot continue.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The TCP connection failed.
    #[error("the connection failed")]
    Connection(#[from] std::io::Error),
    /// The server answered the handshake with another status than 101.
    #[error("the server refused the handshake with status {status}")]
    Refused {
        /// HTTP status.
        status: u16,
        /// Body of the response.
        body: Vec<u8>,
    },
    /// The WebSocket failed.
    #[error("the WebSocket failed")]
    Socket(#[source] Box<tungstenite::Error>),
    /// The server closed the connection, with this code.
    #[error("the server closed the connection{}", .0.map(|code| format!(" with code {code}")).unwrap_or_default())]
    Closed(Option<u16>),
    /// The server answered with an `error`.
    #[error("the server answered with the error {code}: {message}")]
    Answer {
        /// Code of section 5.
        code: String,
        /// Text for people.
        message: String,
    },
    /// A text frame is not JSON, or not a message of section 3.
    #[error("a text frame is no message of the protocol")]
    Message(#[from] serde_json::Error),
    /// A binary frame is not a mesh chunk of section 4.
    #[error("a binary frame is no chunk of the protocol")]
    Chunk(#[from] ChunkError),
    /// A frame that the protocol does not allow at this point, or with these values.
    #[error("the server violated the protocol: {0}")]
    Violation(String),
}

impl From<tungstenite::Error> for Error {
    fn from(error: tungstenite::Error) -> Self {
        match error {
            tungstenite::Error::Http(response) => Self::Refused {
                status: response.status().as_u16(),
                body: response.into_body().unwrap_or_default(),
            },
            tungstenite::Error::Io(error) => Self::Connection(error),
            error => Self::Socket(Box::new(error)),
        }
    }
}

/// Returns a violation unless the condition holds.
pub fn ensure(condition: bool, violation: impl FnOnce() -> String) -> Result<(), Error> {
    if condition {
        Ok(())
    } else {
        Err(Error::Violation(violation()))
    }
}
