//! Why the server closes a connection. `PROTOCOL.md`, section 5, is normative.

/// Why the server closes a connection. The values are the close codes of WebSocket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseCode {
    /// The server shuts down.
    Shutdown = 1001,
    /// The client has sent a frame that violates the WebSocket protocol.
    Protocol = 1002,
    /// The client has sent a binary frame.
    Binary = 1003,
    /// The client has sent a text frame that is not UTF-8.
    NotText = 1007,
    /// The client has sent a message of more than [`MAX_MESSAGE_BYTES`](super::MAX_MESSAGE_BYTES).
    TooLong = 1009,
    /// The client has sent [`MAX_MALFORMED`](super::MAX_MALFORMED) consecutive malformed messages.
    Malformed = 4000,
    /// The client did not read a frame within the deadline.
    SlowReader = 4001,
    /// The server has its maximum number of viewers.
    TooManyViewers = 4002,
    /// The client has sent no frame for too long, not even a pong.
    Silent = 4003,
    /// The client's token has expired or was revoked.
    TokenEnded = 4004,
}

impl CloseCode {
    /// The reason in the close frame.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Shutdown => "the server shuts down",
            Self::Protocol => "not a frame of the WebSocket protocol",
            Self::NotText => "text that is not UTF-8",
            Self::Binary => "binary frame, expected text",
            Self::TooLong => "message too long, expected at most 64 KiB",
            Self::Malformed => "too many malformed messages",
            Self::SlowReader => "a frame could not be handed over in time",
            Self::TooManyViewers => "too many viewers, try again later",
            Self::Silent => "nothing heard for too long",
            Self::TokenEnded => "the token has expired or was revoked",
        }
    }
}
