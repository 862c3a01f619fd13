//! Receives parts of uploads: limits how many are received at the same time, and writes their bytes to the disk.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use axum::body::Bytes;
use futures_util::{Stream, StreamExt};

use super::error::UploadError;
use super::state::UploadState;
use super::upload::{Upload, Writer};
use super::{Reader, Uploads};
use crate::metrics;

/// Maximum number of parts of all users that are received at the same time. Each occupies a connection and [`BLOCK_BYTES`].
pub(super) const MAX_PARTS: usize = 32;
/// Maximum number of parts of one user that are received at the same time.
pub(super) const MAX_PARTS_OF_USER: usize = 4;
/// Bytes of each write. Large enough for the full speed of a disk.
const BLOCK_BYTES: usize = 1 << 20;

/// A smaller block is written if no bytes arrive for this long. Bytes that are on the disk are not lost with the connection or the server.
const FLUSH_AFTER: Duration = Duration::from_millis(500);

/// Event while a body is received.
enum Event {
    Piece(Bytes),
    /// No bytes have arrived for [`FLUSH_AFTER`].
    Idle,
    End,
    /// The connection was lost.
    Lost,
    /// Another request has taken over the upload.
    TakenOver,
}

impl Uploads {
    /// Returns the number of bytes that the upload has received, and its total number of bytes. Ends a request that is sending a part, so
    /// that the first number does not change any more.
    ///
    /// # Errors
    /// [`UploadError`].
    pub async fn offset(&self, who: Reader<'_>, id: &str) -> Result<(u64, u64), UploadError> {
        let upload = self.find(who, id)?;
        let _writer = upload.take_over().await?;
        let received = upload.status().received;
        Ok((received, upload.total))
    }

    /// Receives a body, and appends it to the upload. Returns the number of bytes that the upload has received then. If the body ends too
    /// early, its first bytes are kept.
    ///
    /// `offset` must be the number of bytes that the upload has. `length` is the number of bytes of the body, if the client has declared
    /// it.
    ///
    /// # Errors
    /// [`UploadError`].
    pub async fn receive<E>(
        &self,
        who: Reader<'_>,
        id: &str,
        offset: u64,
        length: Option<u64>,
        body: impl Stream<Item = Result<Bytes, E>> + Unpin,
    ) -> Result<u64, UploadError> {
        let upload = self.find(who, id)?;
        let writer = upload.take_over().await?;
        let _slot = self.0.parts.enter(who.user())?;
        // Looks the upload up again, because it may have been removed while this request waited to take over.
        let upload = self.find(who, id)?;
        let (state, expected) = {
            let status = upload.status();
            (status.state, status.received)
        };
        if state == UploadState::Ready {
            return Err(UploadError::Finished(id.to_owned()));
        }
        if offset != expected {
            return Err(UploadError::WrongOffset {
                found: offset,
                expected,
            });
        }
        let left = upload.total - offset;
        if length.is_some_and(|length| length > left) {
            return Err(UploadError::TooLong { left });
        }
        append(&upload, writer, body).await
    }
}

/// Appends a body to an upload. Returns the number of bytes that the upload has received then.
async fn append<E>(
    upload: &Arc<Upload>,
    mut writer: Writer,
    mut body: impl Stream<Item = Result<Bytes, E>> + Unpin,
) -> Result<u64, UploadError> {
    let token = writer.token.clone();
    let mut block: Vec<u8> = Vec::new();
    loop {
        let event = tokio::select! {
            () = token.cancelled() => Event::TakenOver,
            piece = body.next() => match piece {
                Some(Ok(piece)) => Event::Piece(piece),
                Some(Err(_)) => Event::Lost,
                None => Event::End,
            },
            () = tokio::time::sleep(FLUSH_AFTER), if !block.is_empty() => Event::Idle,
        };
        let is_idle = matches!(event, Event::Idle);
        let kept = upload.status().received + block.len() as u64;
        let left = upload.total - kept;
        let outcome = match event {
            Event::Piece(piece) if piece.len() as u64 > left => Some(Err(UploadError::TooLong { left })),
            Event::Piece(piece) => {
                block.extend_from_slice(&piece);
                None
            }
            Event::Idle => None,
            Event::End => Some(Ok(kept)),
            Event::TakenOver => Some(Err(UploadError::TakenOver { kept })),
            Event::Lost => Some(Err(UploadError::Interrupted { kept })),
        };
        let is_due = is_idle || outcome.is_some() || block.len() >= BLOCK_BYTES;
        if is_due && !block.is_empty() {
            writer = write_block(upload, writer, std::mem::take(&mut block)).await?;
        }
        if let Some(outcome) = outcome {
            return outcome;
        }
    }
}

/// Appends a block to an upload. A blocking task owns the `Writer` meanwhile. So if the client disconnects, the block is still written, and
/// no other request can write before that.
async fn write_block(upload: &Arc<Upload>, writer: Writer, block: Vec<u8>) -> Result<Writer, UploadError> {
    let upload = Arc::clone(upload);
    let write = move || {
        let offset = upload.status().received;
        let (written, result) = upload.contents.write(offset, &block);
        let mut status = upload.status();
        status.received = offset + written as u64;
        status.used = SystemTime::now();
        metrics::upload_received(written);
        let missing = upload.total - status.received;
        result.map_err(|error| UploadError::of_write(error, missing))?;
        Ok(writer)
    };
    tokio::task::spawn_blocking(write).await?
}
