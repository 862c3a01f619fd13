//! Why the server closes a connection. Normative: `PROTOCOL.md`, section 5.

/// Why the server closes a connection; the codes are those of the table in `PROTOCOL.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseCode {
    /// The server shuts down.
    Shutdown = 1001,
    /// A frame that violates the WebSocket protocol.
    Protocol = 1002,
    /// A binary frame from the client.
    Binary = 1003,
    /// A text frame that is not UTF-8.
    NotText = 1007,
    /// A message over [`MAX_MESSAGE_BYTES`](super::MAX_MESSAGE_BYTES).
    TooLong = 1009,
    /// Too many malformed messages in a row.
    Malformed = 4000,
    /// A frame was not taken within the deadline.
    SlowReader = 4001,
    /// The server has its maximum of viewers.
    TooManyViewers = 4002,
    /// No frame for too long, not even a pong.
    Silent = 4003,
    /// The token that let the client in has expired, or was revoked.
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
