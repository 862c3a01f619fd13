//! A connection: handshake, messages to the server, frames from it.

use std::fmt::Display;
use std::net::SocketAddr;

use futures_util::{SinkExt, StreamExt};
use serde::Serialize;
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Bytes, Message, Utf8Bytes};

use crate::error::{Error, ensure};

/// Subprotocol of the handshake.
pub const SUBPROTOCOL: &str = "isopeel.v3";

/// Header of the handshake that names the subprotocol.
const SUBPROTOCOL_HEADER: &str = "sec-websocket-protocol";

/// A frame from the server, not decoded.
#[derive(Clone, Debug, PartialEq)]
pub enum RawFrame {
    /// A message, as JSON.
    Text(Utf8Bytes),
    /// A mesh chunk.
    Chunk(Bytes),
}

/// Returns the request of a handshake. `query` is empty or begins with `?`.
pub fn request(host: impl Display, query: &str, headers: &[(&'static str, &str)]) -> Result<Request, Error> {
    let mut request = format!("ws://{host}/api/v1/stream{query}").into_client_request()?;
    for (name, value) in [(SUBPROTOCOL_HEADER, SUBPROTOCOL)].iter().chain(headers) {
        let value = HeaderValue::from_str(value).map_err(tungstenite::http::Error::from);
        request
            .headers_mut()
            .insert(*name, value.map_err(tungstenite::Error::from)?);
    }
    Ok(request)
}

/// One connection to the stream.
pub struct Connection<S = TcpStream> {
    socket: WebSocketStream<S>,
}

impl Connection {
    /// Connects.
    pub async fn connect(address: SocketAddr) -> Result<Self, Error> {
        Self::connect_with(address, "", &[]).await
    }

    /// Connects with a query, which is empty or begins with `?`, and more headers.
    pub async fn connect_with(
        address: SocketAddr,
        query: &str,
        headers: &[(&'static str, &str)],
    ) -> Result<Self, Error> {
        let request = request(address, query, headers)?;
        Self::handshake(TcpStream::connect(address).await?, request, None).await
    }

    /// Performs the handshake on a TCP connection.
    pub async fn handshake(tcp: TcpStream, request: Request, config: Option<WebSocketConfig>) -> Result<Self, Error> {
        // As browsers do: otherwise a pong waits for the one before.
        tcp.set_nodelay(true)?;
        Self::handshake_on(tcp, request, config).await
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Connection<S> {
    /// Performs the handshake on any byte stream.
    pub async fn handshake_on(stream: S, request: Request, config: Option<WebSocketConfig>) -> Result<Self, Error> {
        let requested = request.headers().get(SUBPROTOCOL_HEADER).cloned();
        let (socket, response) = tokio_tungstenite::client_async_with_config(request, stream, config).await?;
        let chosen = response.headers().get(SUBPROTOCOL_HEADER);
        ensure(chosen == requested.as_ref(), || format!("subprotocol {chosen:?}"))?;
        Ok(Self { socket })
    }

    /// Returns the byte stream below the WebSocket, for clients that send what is no frame.
    pub fn stream_mut(&mut self) -> &mut S {
        self.socket.get_mut()
    }

    /// Returns the socket, for clients that send what the protocol does not allow.
    pub fn into_socket(self) -> WebSocketStream<S> {
        self.socket
    }

    /// Sends a message.
    pub async fn send(&mut self, message: &impl Serialize) -> Result<(), Error> {
        self.send_raw(Message::text(serde_json::to_string(message)?)).await
    }

    /// Sends any frame.
    pub async fn send_raw(&mut self, message: Message) -> Result<(), Error> {
        Ok(self.socket.send(message).await?)
    }

    /// Sends several messages in one flush, faster than a device can work on them.
    pub async fn send_all(&mut self, messages: impl IntoIterator<Item = Value>) -> Result<(), Error> {
        for message in messages {
            self.socket.feed(Message::text(message.to_string())).await?;
        }
        Ok(self.socket.flush().await?)
    }

    /// Returns the next frame, or [`Error::Closed`] at the end of the connection. Pings are answered and left out. Cancel-safe: no
    /// frame is lost.
    pub async fn next(&mut self) -> Result<RawFrame, Error> {
        loop {
            match self.socket.next().await.transpose()? {
                Some(Message::Text(text)) => return Ok(RawFrame::Text(text)),
                Some(Message::Binary(chunk)) => return Ok(RawFrame::Chunk(chunk)),
                Some(Message::Close(reason)) => return Err(Error::Closed(reason.map(|reason| reason.code.into()))),
                Some(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => {}
                None => return Err(Error::Closed(None)),
            }
        }
    }

    /// Returns the next message as JSON; skips chunks.
    pub async fn next_message(&mut self) -> Result<Value, Error> {
        loop {
            if let RawFrame::Text(text) = self.next().await? {
                return Ok(serde_json::from_str(&text)?);
            }
        }
    }

    /// Returns the next message of this type; skips others, except `error`, which is returned as [`Error::Answer`].
    pub async fn until(&mut self, kind: &str) -> Result<Value, Error> {
        loop {
            let message = self.next_message().await?;
            let text = |field: &str| message[field].as_str().unwrap_or_default().to_owned();
            if message["type"] == kind {
                return Ok(message);
            }
            if message["type"] == "error" {
                let (code, message) = (text("code"), text("message"));
                return Err(Error::Answer { code, message });
            }
        }
    }

    /// Returns the code of the close frame; skips all frames before.
    pub async fn close_code(&mut self) -> Result<Option<u16>, Error> {
        loop {
            match self.next().await {
                Ok(_) => {}
                Err(Error::Closed(code)) => return Ok(code),
                Err(error) => return Err(error),
            }
        }
    }

    /// Closes with 1000 and waits for the end of the connection.
    pub async fn close(mut self) -> Result<(), Error> {
        self.socket.close(None).await?;
        while let Some(Ok(_)) = self.socket.next().await {}
        Ok(())
    }
}
