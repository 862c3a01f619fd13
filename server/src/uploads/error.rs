//! Why an upload is refused, or is not there.

use std::io;

use isopeel_volumes::ReadError;

use super::MAX_UPLOADS;
use super::names::NameError;

/// Why a request about uploads fails. Each variant calls for a different reaction of the caller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UploadError {
    /// The user has no such upload.
    #[error("no upload has the id {0:?}, /api/v1/uploads lists those there are")]
    Unknown(String),
    /// The declared files cannot be taken.
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
        /// The upload that it made.
        upload: String,
    },
    /// The user has too many.
    #[error("there are {MAX_UPLOADS} uploads of yours, the most there may be: delete some")]
    TooMany,
    /// The files are more than the user may have.
    #[error(
        "{wanted} bytes, but {used} of your {quota} bytes are taken: expected at most {}, delete uploads that are not needed",
        quota.saturating_sub(*used)
    )]
    OverQuota {
        /// Of the files.
        wanted: u64,
        /// Of the user's other uploads: as declared, or as unpacked if that is more.
        used: u64,
        /// The user's quota, bytes.
        quota: u64,
    },
    /// The contents of a compressed file exceed the user's quota.
    #[error(
        "{file:?} unpacks to more than you may have: {used} of your {quota} bytes are taken, and what is in compressed files counts. \
         Delete uploads that are not needed"
    )]
    UnpacksOverQuota {
        /// Which.
        file: String,
        /// Of the user's uploads, this one too.
        used: u64,
        /// The user's quota, bytes.
        quota: u64,
    },
    /// The disk has not enough space, or it is full.
    #[error("the server's disk has no space for {0} bytes more: try again when others have deleted something")]
    DiskFull(u64),
    /// The offset is not the number of bytes that the upload has.
    #[error("Upload-Offset is {found}, expected {expected}: so many bytes are there")]
    WrongOffset {
        /// The offset that was requested.
        found: u64,
        /// The offset at which it continues.
        expected: u64,
    },
    /// More bytes than were declared.
    #[error("the body passes the end of what was declared, expected at most {left} bytes")]
    TooLong {
        /// Bytes that are missing.
        left: u64,
    },
    /// The body was shorter than announced; the bytes that arrived are kept.
    #[error("the body ended too early: {kept} bytes of the upload are there, go on with them")]
    Interrupted {
        /// Bytes that are there.
        kept: u64,
    },
    /// Another request took its place.
    #[error("another request for this upload has taken the place of this one: {kept} bytes are there")]
    TakenOver {
        /// Bytes that are there.
        kept: u64,
    },
    /// All slots are taken by other requests.
    #[error("as many uploads are being received as may be at a time, try again in a few seconds")]
    Busy,
    /// Another request is at work on the upload.
    #[error("another request is at work on this upload, try again in a few seconds")]
    Locked,
    /// It is a volume already.
    #[error("the upload {0} is finished: nothing can be added to it")]
    Finished(String),
    /// Bytes are missing.
    #[error("{received} of {total} bytes are there, expected all of them: {file:?} is not whole")]
    Incomplete {
        /// Bytes that are there.
        received: u64,
        /// Bytes that were declared.
        total: u64,
        /// The first file that is not whole.
        file: String,
    },
    /// The files cannot be read.
    #[error("{0}")]
    Unreadable(String),
    /// The disk has no space to read them.
    #[error("{0}")]
    NoSpace(String),
    /// The server cannot read or write its files.
    #[error("uploads cannot be kept")]
    Io(#[from] io::Error),
    /// A task failed.
    #[error("reading an upload failed")]
    Panicked(#[from] tokio::task::JoinError),
}

impl UploadError {
    /// Converts an error of writing `bytes` bytes.
    pub(super) fn of_write(error: io::Error, bytes: u64) -> Self {
        if isopeel_volumes::disk::is_full(&error) || error.kind() == io::ErrorKind::FileTooLarge {
            Self::DiskFull(bytes)
        } else {
            Self::Io(error)
        }
    }

    /// Converts an error of reading the files. The text leaves out the server's folder.
    pub(super) fn of_read(error: &ReadError, folder: &str) -> Self {
        let text = error.without_folder().replace(&format!("{folder}/"), "");
        if error.is_of_space() {
            Self::NoSpace(text)
        } else {
            Self::Unreadable(text)
        }
    }
}
