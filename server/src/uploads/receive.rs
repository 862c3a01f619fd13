//! Receives parts of uploads: limits how many there are at a time, and writes them to the disk.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use axum::body::Bytes;
use futures_util::{Stream, StreamExt};

use super::error::UploadError;
use super::state::UploadState;
use super::upload::{Upload, Writer};
use super::{Reader, Uploads};
use crate::metrics;

/// Maximum parts that are received at a time, of all users: each holds a connection and [`BLOCK_BYTES`].
pub(super) const MAX_PARTS: usize = 32;
/// The same of one user.
pub(super) const MAX_PARTS_OF_USER: usize = 4;
/// Bytes that are written at once: large enough that a disk is as fast as it can be.
const BLOCK_BYTES: usize = 1 << 20;

/// If no bytes arrive for this long, those received so far are written: they then count even if the connection or the server ends.
const PAUSE: Duration = Duration::from_millis(500);

/// Event while a body is received.
enum Event {
    Piece(Bytes),
    Pause,
    End,
    Lost,
    TakenOver,
}

impl Uploads {
    /// Returns the bytes that are there, and the bytes in all. Ends a request that is sending a part, so that the number stays the same.
    ///
    /// # Errors
    /// [`UploadError`].
    pub async fn offset(&self, who: Reader<'_>, id: &str) -> Result<(u64, u64), UploadError> {
        let upload = self.find(who, id)?;
        let _writer = upload.take_over().await?;
        let received = upload.status().received;
        Ok((received, upload.total))
    }

    /// Receives the bytes that follow those already there, and returns how many there are afterwards. If the body ends too early, the bytes
    /// that came are kept.
    ///
    /// `length`: bytes of the body, if that is known.
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
        // It may have been removed meanwhile.
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
        take(&upload, writer, body).await
    }
}

/// Appends a body to the upload.
async fn take<E>(
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
            () = tokio::time::sleep(PAUSE), if !block.is_empty() => Event::Pause,
        };
        let is_pause = matches!(event, Event::Pause);
        let kept = upload.status().received + block.len() as u64;
        let left = upload.total - kept;
        let end = match event {
            Event::Piece(piece) if piece.len() as u64 > left => Some(Err(UploadError::TooLong { left })),
            Event::Piece(piece) => {
                block.extend_from_slice(&piece);
                None
            }
            Event::Pause => None,
            Event::End => Some(Ok(kept)),
            Event::TakenOver => Some(Err(UploadError::TakenOver { kept })),
            Event::Lost => Some(Err(UploadError::Interrupted { kept })),
        };
        let is_due = is_pause || end.is_some() || block.len() >= BLOCK_BYTES;
        if is_due && !block.is_empty() {
            writer = store(upload, writer, std::mem::take(&mut block)).await?;
        }
        if let Some(end) = end {
            return end;
        }
    }
}

/// Writes bytes behind those that are there. They are written even if the client disconnects meanwhile: the blocking task holds the only
/// `Writer`, so no other request can write first.
async fn store(upload: &Arc<Upload>, writer: Writer, block: Vec<u8>) -> Result<Writer, UploadError> {
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
