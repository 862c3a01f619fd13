//! What viewers have seen.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hdrhistogram::Histogram;

use crate::Error;

/// The upper bound of the histogram, in microseconds: longer times count as this one.
const LONGEST_US: u64 = 600_000_000;

/// What all viewers have seen.
pub struct Seen {
    /// From when an edit was due to its first commit, in microseconds.
    first_commits: Mutex<Histogram<u64>>,
    pub errors: AtomicU64,
    /// Edits whose viewer's next one was due before their first commit.
    pub overtaken: AtomicU64,
    pub edits: AtomicU64,
    /// Those of them that are done.
    pub done: AtomicU64,
    pub bytes: AtomicU64,
    pub is_over: AtomicBool,
}

impl Seen {
    pub fn new() -> Result<Arc<Self>, Error> {
        Ok(Arc::new(Self {
            first_commits: Mutex::new(Histogram::new_with_bounds(1, LONGEST_US, 3)?),
            errors: AtomicU64::new(0),
            overtaken: AtomicU64::new(0),
            edits: AtomicU64::new(0),
            done: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
        }))
    }

    pub fn committed(&self, after: Duration) {
        let mut histogram = self
            .first_commits
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        histogram.saturating_record(after.as_micros() as u64);
    }

    /// A quantile of the first commits, in milliseconds.
    pub fn quantile(&self, share: f64) -> f64 {
        let histogram = self
            .first_commits
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        histogram.value_at_quantile(share) as f64 / 1e3
    }

    pub fn report(&self, name: &str) {
        println!(
            "{name}: {} edits, first commit p50 {:.0} ms, p99 {:.0} ms, slowest {:.0} ms; {} overtaken, {} errors, {} MB",
            self.edits.load(Ordering::Relaxed),
            self.quantile(0.5),
            self.quantile(0.99),
            self.quantile(1.0),
            self.overtaken.load(Ordering::Relaxed),
            self.errors.load(Ordering::Relaxed),
            self.bytes.load(Ordering::Relaxed) / 1_000_000
        );
    }
}
