//! Cache of histograms.

use std::sync::{Arc, Mutex};

use isopeel_kernels::{Histogram, lock};

use super::keys::HistogramKey;
use super::residency::Lru;

/// Maximum number of cached histograms of 2 KiB each: enough for every field and feature of a dataset of some hundred steps.
const CACHED_HISTOGRAMS: u64 = 2048;

/// Cache of histograms. Clones share it.
#[derive(Clone)]
pub struct HistogramCache(Arc<Mutex<Lru<HistogramKey, Histogram>>>);

impl Default for HistogramCache {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Lru::new(CACHED_HISTOGRAMS))))
    }
}

impl HistogramCache {
    /// Returns a histogram, and marks it as used.
    pub fn get(&self, key: &HistogramKey) -> Option<Histogram> {
        lock(&self.0).get(key).cloned()
    }

    /// Returns a histogram without marking it as used.
    pub fn peek(&self, key: &HistogramKey) -> Option<Histogram> {
        lock(&self.0).peek(key).cloned()
    }

    /// Adds a histogram.
    pub fn insert(&self, key: HistogramKey, histogram: Histogram) {
        lock(&self.0).insert(key, 1, histogram);
    }
}
