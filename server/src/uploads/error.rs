//! Errors of requests about uploads.

use std::io;

use isopeel_volumes::ReadError;

use super::MAX_UPLOADS;
use super::names::NameError;

/// Why a request about uploads fails. Each variant needs a different response of the caller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UploadError {
    /// The user has no such upload.
    #[error(
        "no upload of yours has the id {0:?} on this server, /api/v1/uploads lists those there are; an upload belongs to the server that took it"
    )]
    Unknown(String),
    /// The declared files are invalid.
    #[error(transparent)]
    Files(#[from] NameError),
    /// The key is too long, or not ASCII.
    #[error("an idempotency key of {0} bytes, expected 1 to 255 visible ASCII characters")]
    BadKey(usize),
    /// The key belongs to other files.
    #[error(
        "the idempotency key was used for other files, which are upload {upload}: expected a new key, or the same files"
    )]
    KeyReused {
        /// Id of the upload that the first request with this key created.
        upload: String,
    },
    /// The user has too many uploads.
    #[error("you have {MAX_UPLOADS} uploads, the maximum: delete some")]
    TooMany,
    /// The declared files exceed the rest of the user's quota.
    #[error(
        "{wanted} bytes, but {used} of your {quota} bytes are taken: expected at most {}, delete uploads that are not needed",
        quota.saturating_sub(*used)
    )]
    OverQuota {
        /// Bytes of the declared files.
        wanted: u64,
        /// Bytes of the user's other uploads: of the declared files, or of their unpacked contents if these are larger.
        used: u64,
        /// Quota of the user in bytes.
        quota: u64,
    },
    /// The contents of a compressed file exceed the user's quota.
    #[error(
        "{file:?} unpacks to more than you may have: {used} of your {quota} bytes are taken, and what is in compressed files counts. \
         Delete uploads that are not needed"
    )]
    UnpacksOverQuota {
        /// Name of the file.
        file: String,
        /// Bytes of the user's uploads, including this one.
        used: u64,
        /// Quota of the user in bytes.
        quota: u64,
    },
    /// The disk has no space for this number of bytes.
    #[error("the server's disk has no space for {0} bytes more: try again after uploads were deleted")]
    DiskFull(u64),
    /// The offset is not the number of bytes that the upload has.
    #[error("Upload-Offset is {found}, expected {expected}, the number of bytes that were received")]
    WrongOffset {
        /// Offset in the request.
        found: u64,
        /// Offset at which the upload continues.
        expected: u64,
    },
    /// The body has more bytes than the declared files.
    #[error("the body has more bytes than the declared files, expected at most {left}")]
    TooLong {
        /// Bytes that the upload has not received yet.
        left: u64,
    },
    /// The body is shorter than its declared length. The bytes that have arrived are kept.
    #[error("the body ended too early: {kept} bytes of the upload were received, continue there")]
    Interrupted {
        /// Bytes that the upload has received.
        kept: u64,
    },
    /// Another request has taken over the upload.
    #[error("another request has taken over this upload: {kept} bytes were received")]
    TakenOver {
        /// Bytes that the upload has received.
        kept: u64,
    },
    /// Other requests occupy all slots.
    #[error("too many uploads are being received, try again in a few seconds")]
    Busy,
    /// Another request writes to the upload or reads it.
    #[error("another request uses this upload, try again in a few seconds")]
    Locked,
    /// The upload is already complete and served as volumes.
    #[error("the upload {0} is finished: nothing can be added to it")]
    Finished(String),
    /// The upload has not received all of its bytes.
    #[error("{received} of {total} bytes are there, expected all of them: {file:?} is not whole")]
    Incomplete {
        /// Bytes that the upload has received.
        received: u64,
        /// Bytes of the declared files.
        total: u64,
        /// Name of the first incomplete file.
        file: String,
    },
    /// The files cannot be read as volumes.
    #[error("{0}")]
    Unreadable(String),
    /// The disk has no space for unpacked files.
    #[error("{0}")]
    NoSpace(String),
    /// The server cannot read or write the folder of uploads.
    #[error("the folder of uploads cannot be read or written")]
    Io(#[from] io::Error),
    /// A blocking task panicked.
    #[error("reading an upload failed")]
    Panicked(#[from] tokio::task::JoinError),
}

impl UploadError {
    /// Converts an error of a write of `bytes` bytes.
    pub(super) fn of_write(error: io::Error, bytes: u64) -> Self {
        if isopeel_volumes::disk::is_full(&error) || error.kind() == io::ErrorKind::FileTooLarge {
            Self::DiskFull(bytes)
        } else {
            Self::Io(error)
        }
    }

    /// Converts an error of reading the files. Removes the path of the server's `folder` from the message.
    pub(super) fn of_read(error: &ReadError, folder: &str) -> Self {
        let text = error.without_folder().replace(&format!("{folder}/"), "");
        if error.is_of_space() {
            Self::NoSpace(text)
        } else {
            Self::Unreadable(text)
        }
    }
}
