//! Fetches chunks from a store over a network, several at once.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;

use crate::{ReadError, ReadProgress};

/// Maximum requests in flight.
const MAX_REQUESTS: u64 = 16;

/// The reading of a time step: its progress, and whether it failed.
pub(super) struct Work<'a> {
    pub(super) progress: &'a ReadProgress,
    /// Whether another chunk has failed.
    failed: AtomicBool,
}

impl<'a> Work<'a> {
    pub(super) fn new(progress: &'a ReadProgress) -> Self {
        Self {
            progress,
            failed: AtomicBool::new(false),
        }
    }

    /// Whether reading has failed or was cancelled, so that no further chunk is fetched.
    pub(super) fn is_over(&self) -> bool {
        self.progress.is_cancelled() || self.failed.load(Ordering::Relaxed)
    }

    /// Fetches `count` chunks by their numbers, several at once, and passes them to `take` in the order of arrival. `shown` is for
    /// messages.
    pub(super) fn get_ahead<T: Send>(
        &self,
        shown: &Path,
        count: u64,
        at_once: u64,
        get: impl Fn(u64) -> Result<T, ReadError> + Sync,
        mut take: impl FnMut(Vec<T>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        let next = AtomicU64::new(0);
        let threads = at_once.clamp(1, MAX_REQUESTS);
        std::thread::scope(|scope| {
            // A rendezvous channel: each thread holds at most one chunk.
            let (send, receive) = sync_channel(0);
            for _ in 0..threads.min(count) {
                let (send, next, get) = (send.clone(), &next, &get);
                scope.spawn(move || {
                    while !self.is_over() {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        // Sending fails if another chunk had an error: the receiver has been dropped.
                        if number >= count || send.send(get(number)).is_err() {
                            break;
                        }
                    }
                });
            }
            drop(send);
            while let Ok(first) = receive.recv() {
                let more = receive.try_iter().take(threads as usize - 1);
                let some: Result<Vec<T>, _> = std::iter::once(first).chain(more).collect();
                if let Err(error) = some.and_then(&mut take) {
                    self.failed.store(true, Ordering::Relaxed);
                    return Err(error);
                }
            }
            self.progress.go_on(shown)
        })
    }
}
