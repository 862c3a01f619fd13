//! Partial histograms, shared by all callers that need the same one.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_extraction::{HistogramKey, lock};
use isopeel_kernels::HistogramWork;

/// Maximum number of partial histograms, including those without a caller. Each takes 4 KiB.
const MAX_UNFINISHED: usize = 256;

/// Histograms that are being made.
#[derive(Default)]
pub(super) struct UnfinishedHistograms {
    by_key: Mutex<HashMap<HistogramKey, Arc<tokio::sync::Mutex<HistogramWork>>>>,
}

impl UnfinishedHistograms {
    /// Returns the work on a histogram, or begins it. The caller that continues the work must hold its lock.
    pub(super) fn get_or_begin(&self, key: &HistogramKey) -> Arc<tokio::sync::Mutex<HistogramWork>> {
        let mut by_key = lock(&self.by_key);
        if by_key.len() >= MAX_UNFINISHED && !by_key.contains_key(key) {
            by_key.retain(|_, work| Arc::strong_count(work) > 1);
        }
        Arc::clone(by_key.entry(key.clone()).or_default())
    }

    pub(super) fn remove(&self, key: &HistogramKey) {
        lock(&self.by_key).remove(key);
    }
}

#[cfg(test)]
mod tests {
    use isopeel_view::FeatureName;
    use isopeel_volumes::{VolumeStep, testing};

    use super::*;

    #[test]
    fn only_so_many_are_remembered_and_none_that_is_being_made_is_forgotten() {
        let dataset = Arc::new(testing::dataset("head", [5, 6, 7], &["density"]));
        let volume = VolumeStep::new(dataset, 0).expect("a step");
        let key = |n: usize| HistogramKey::new(&volume, &format!("{n}*density"), &FeatureName::None);
        let unfinished = UnfinishedHistograms::default();
        let held = unfinished.get_or_begin(&key(0));
        for n in 1..3 * MAX_UNFINISHED {
            unfinished.get_or_begin(&key(n));
        }
        assert!(lock(&unfinished.by_key).len() <= MAX_UNFINISHED);
        assert!(Arc::ptr_eq(&held, &unfinished.get_or_begin(&key(0))));
        unfinished.remove(&key(0));
        assert!(!Arc::ptr_eq(&held, &unfinished.get_or_begin(&key(0))));
    }
}
