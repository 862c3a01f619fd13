//! Progress and cancellation of reading.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::ReadError;

const CANCELLED: &str = "reading was cancelled";

/// Bytes that were read of a file. The reading threads update it; other threads watch it and may cancel the reading.
#[derive(Debug, Default)]
pub struct ReadProgress {
    bytes: AtomicU64,
    cancelled: AtomicBool,
}

impl ReadProgress {
    /// Bytes so far.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Adds bytes that were read.
    pub fn add(&self, bytes: u64) {
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Resets progress and cancellation.
    pub fn restart(&self) {
        self.bytes.store(0, Ordering::Relaxed);
        self.cancelled.store(false, Ordering::Relaxed);
    }

    /// Requests cancellation: reading soon ends with an error.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether it was cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// Called by readers before each piece of a file at `path`.
    ///
    /// # Errors
    /// The reading was cancelled.
    pub fn go_on(&self, path: &Path) -> Result<(), ReadError> {
        if self.is_cancelled() {
            return Err(ReadError::new(path, "data", CANCELLED));
        }
        Ok(())
    }

    /// As [`Self::go_on`], for streams.
    pub(super) fn go_on_reading(&self) -> io::Result<()> {
        if self.is_cancelled() {
            return Err(io::Error::other(CANCELLED));
        }
        Ok(())
    }
}
