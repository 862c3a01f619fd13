//! One connection: a task that reads, a task that writes, and the session between them. Only the session interprets messages.

use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message};
use futures_util::{Sink, SinkExt, Stream, StreamExt};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tokio_tungstenite::tungstenite;
use tokio_tungstenite::tungstenite::error::ProtocolError;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use super::Common;
use super::backend::Backend;
use super::session::{Incoming, Outgoing, Session, StepTimes};
use crate::access::Identity;
use crate::metrics;
use crate::wire::messages::{CloseCode, MAX_MESSAGE_BYTES};

/// Capacity of the queue between reader and session, in messages. Messages wait in the queue only if the client does not read the server's
/// messages. When the queue is full, TCP gives back-pressure.
const INBOX: usize = 16;
/// Capacity of the queue between session and writer, in frames. It is small, because a newer edit cannot drop frames from this queue, but
/// large enough that small frames share a write to the network.
const OUTGOING: usize = 32;

/// Number of bytes after which no further frame is added to a write. All frames of a write have one deadline. A line that cannot take that
/// many bytes before the deadline is too slow to use.
const WRITE_BYTES: usize = 64 << 10;

/// Maximum messages that are read per [`WINDOW`], including pings and pongs: several times as many as a slider sends that is dragged on a
/// fast screen. If a client sends more, TCP gives back-pressure, so that reading messages of this client does not slow down other viewers.
const MAX_WINDOW_MESSAGES: u32 = 50;
/// The window of [`MAX_WINDOW_MESSAGES`].
const WINDOW: Duration = Duration::from_millis(100);

/// Time between the close frame and the end of a connection that cannot be read any more. If the connection ended at once with unread
/// bytes, it would be reset, and the client could lose the close frame.
const LINGER: Duration = Duration::from_secs(1);

/// Time to send the waiting frames and the close frame after a token has ended.
const TOKEN_GRACE: Duration = Duration::from_secs(2);

/// Deadlines of a connection.
#[derive(Clone, Copy, Debug)]
pub struct Deadlines {
    /// Deadline of one write: a frame, or several small ones.
    pub send: Duration,
    /// Interval between two pings.
    pub ping: Duration,
    /// Time without a frame from the client, pongs included, after which the client counts as gone.
    pub silence: Duration,
    /// Deadline of the close handshake.
    pub close: Duration,
    /// Target times for the steps of a surface.
    pub steps: StepTimes,
}

impl Default for Deadlines {
    /// Returns the deadlines of `PROTOCOL.md`.
    fn default() -> Self {
        Self {
            send: Duration::from_secs(20),
            ping: Duration::from_secs(30),
            silence: Duration::from_secs(90),
            close: Duration::from_secs(5),
            steps: StepTimes::default(),
        }
    }
}

/// Serves one viewer until the connection ends.
pub(super) async fn serve<S, B>(
    socket: S,
    backend: B,
    common: Common,
    who: Identity,
    deadlines: Deadlines,
    shutdown: CancellationToken,
) where
    S: Stream<Item = Result<Message, axum::Error>> + Sink<Message, Error = axum::Error> + Send + 'static,
    B: Backend,
{
    let (sink, stream) = socket.split();
    let (to_session, inbox) = mpsc::channel(INBOX);
    let (outgoing, to_writer) = mpsc::channel(OUTGOING);
    let reader = AbortOnDropHandle::new(tokio::spawn(read(stream, to_session, deadlines.silence)));
    let writer = AbortOnDropHandle::new(tokio::spawn(write(sink, to_writer, deadlines)));
    let session = Session::new(backend, deadlines.steps, common, who.clone());
    let served = async {
        session.run(inbox, outgoing, shutdown).await;
        // The writer sends the remaining frames, within its deadlines. Then the reader waits for the client's close frame: closing at once
        // could reset the connection and lose what was sent.
        let _ = writer.await;
        let _ = timeout(deadlines.close, reader).await;
    };
    tokio::select! {
        () = served => {}
        // A client that does not read could otherwise keep the connection open for the sum of the deadlines of all waiting frames.
        () = async { who.ended().await; sleep(TOKEN_GRACE).await } => tracing::debug!("closed: the token has ended"),
    }
}

/// Passes messages to the session. After the end of the session, reads and drops messages until the client closes.
async fn read<S>(mut stream: S, session: mpsc::Sender<Incoming>, silence: Duration)
where
    S: Stream<Item = Result<Message, axum::Error>> + Unpin,
{
    let mut window = interval(WINDOW);
    window.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut read_in_window = 0;
    loop {
        let incoming = match timeout(silence, stream.next()).await {
            Err(_) => Some(Incoming::Fault(CloseCode::Silent)),
            Ok(None) => return,
            // After an error the connection cannot be read any more.
            Ok(Some(Err(error))) => {
                if let Some(code) = violation(error) {
                    let _ = session.send(Incoming::Fault(code)).await;
                    sleep(LINGER).await;
                }
                return;
            }
            Ok(Some(Ok(message))) => incoming(message),
        };
        if let Some(incoming) = incoming {
            // Sending fails when the session has ended: further messages are dropped.
            let _ = session.send(incoming).await;
        }
        read_in_window += 1;
        if read_in_window >= MAX_WINDOW_MESSAGES {
            window.tick().await;
            read_in_window = 0;
        }
    }
}

/// Converts a message for the session; `None` if the session ignores messages of this kind.
fn incoming(message: Message) -> Option<Incoming> {
    match message {
        Message::Text(text) if text.len() > MAX_MESSAGE_BYTES => Some(Incoming::Fault(CloseCode::TooLong)),
        Message::Text(text) => Some(Incoming::Text(text.as_str().to_owned())),
        Message::Binary(_) => Some(Incoming::Fault(CloseCode::Binary)),
        // Pongs with another payload belong to the pings that keep the connection alive.
        Message::Pong(payload) => <[u8; 4]>::try_from(&payload[..])
            .ok()
            .map(|number| Incoming::Pong(u32::from_le_bytes(number))),
        // Answered by axum; after a close frame the stream ends.
        Message::Ping(_) | Message::Close(_) => None,
    }
}

/// Returns the close code for a violation of the protocol; `None` if the connection was lost.
fn violation(error: axum::Error) -> Option<CloseCode> {
    match error.into_inner().downcast_ref()? {
        tungstenite::Error::Protocol(ProtocolError::ResetWithoutClosingHandshake) => None,
        tungstenite::Error::Protocol(_) => Some(CloseCode::Protocol),
        tungstenite::Error::Utf8(_) => Some(CloseCode::NotText),
        tungstenite::Error::Capacity(_) => Some(CloseCode::TooLong),
        _ => None,
    }
}

/// Sends the session's frames in batches, each within a deadline, and pings.
async fn write<S>(mut sink: S, mut frames: mpsc::Receiver<Outgoing>, deadlines: Deadlines)
where
    S: Sink<Message, Error = axum::Error> + Unpin,
{
    let mut ping = interval(deadlines.ping);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ping.reset();
    loop {
        let first = tokio::select! {
            frame = frames.recv() => match frame {
                None => return,
                Some(frame) => to_message(frame),
            },
            _ = ping.tick() => Ok(Message::Ping(Default::default())),
        };
        match timeout(deadlines.send, send(&mut sink, first, &mut frames)).await {
            Ok(Ok(None)) => {}
            Ok(Ok(Some(code))) => return close(sink, code, deadlines.close).await,
            Ok(Err(_)) => return,
            Err(_) => {
                // The session ends when this queue closes, before the close frame is sent.
                drop(frames);
                tracing::info!("slow reader closed");
                return close(sink, CloseCode::SlowReader, deadlines.close).await;
            }
        }
    }
}

/// Sends a message and those that wait behind it, up to [`WRITE_BYTES`]. If one of them closes the connection, returns the close code.
async fn send<S>(
    sink: &mut S,
    first: Result<Message, CloseCode>,
    frames: &mut mpsc::Receiver<Outgoing>,
) -> Result<Option<CloseCode>, axum::Error>
where
    S: Sink<Message, Error = axum::Error> + Unpin,
{
    let (mut next, mut chunk_bytes, mut text_bytes) = (Some(first), 0, 0);
    while let Some(message) = next {
        let message = match message {
            Ok(message) => message,
            Err(code) => return Ok(Some(code)),
        };
        match &message {
            Message::Binary(bytes) => chunk_bytes += bytes.len(),
            Message::Text(text) => text_bytes += text.len(),
            Message::Ping(_) | Message::Pong(_) | Message::Close(_) => {}
        }
        sink.feed(message).await?;
        let has_space = chunk_bytes + text_bytes < WRITE_BYTES;
        next = has_space.then(|| frames.try_recv().ok()).flatten().map(to_message);
    }
    // Flushes only when the queue is empty, because a coarse prefix consists of thousands of frames of some hundred bytes. So these frames
    // are sent together.
    if frames.is_empty() {
        sink.flush().await?;
    }
    metrics::sent(chunk_bytes, text_bytes);
    Ok(None)
}

/// Converts a frame to a message, or to the code with which to close the connection.
fn to_message(frame: Outgoing) -> Result<Message, CloseCode> {
    Ok(match frame {
        Outgoing::Text(text) => Message::Text(text.into()),
        Outgoing::Binary(bytes) => Message::Binary(bytes),
        Outgoing::Ping(number) => Message::Ping(number.to_le_bytes().to_vec().into()),
        Outgoing::Close(code) => return Err(code),
    })
}

async fn close<S>(mut sink: S, code: CloseCode, deadline: Duration)
where
    S: Sink<Message, Error = axum::Error> + Unpin,
{
    let frame = CloseFrame {
        code: code as u16,
        reason: code.reason().into(),
    };
    // The connection ends whether or not the close frame was sent.
    let _ = timeout(deadline, sink.send(Message::Close(Some(frame)))).await;
}

/// Closes a connection that the server does not accept.
pub(super) async fn refuse<S>(socket: S, code: CloseCode, deadlines: Deadlines)
where
    S: Stream<Item = Result<Message, axum::Error>> + Sink<Message, Error = axum::Error> + Unpin,
{
    let (sink, mut stream) = socket.split();
    close(sink, code, deadlines.close).await;
    let drained = async { while let Some(Ok(_)) = stream.next().await {} };
    let _ = timeout(deadlines.close, drained).await;
}
