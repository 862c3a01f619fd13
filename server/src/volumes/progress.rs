//! How far reading has come.

use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that were read of a file; written by the threads that read, seen by others.
#[derive(Debug, Default)]
pub struct ReadProgress(AtomicU64);

impl ReadProgress {
    /// Bytes so far.
    pub fn bytes(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// More were read.
    pub fn add(&self, bytes: u64) {
        self.0.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Starts over, or ends.
    pub fn set(&self, bytes: u64) {
        self.0.store(bytes, Ordering::Relaxed);
    }
}
