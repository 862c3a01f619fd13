//! Partial histograms, shared by all callers that need the same one.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use isopeel_extraction::{HistogramKey, lock};
use isopeel_kernels::HistogramWork;

/// Maximum number of partial histograms, 4 KiB each, including those without a caller.
const MAX_UNFINISHED: usize = 256;

/// Histograms in the making.
#[derive(Default)]
pub(super) struct Unfinished {
    works: Mutex<HashMap<HistogramKey, Arc<tokio::sync::Mutex<HistogramWork>>>>,
}

impl Unfinished {
    /// Returns the work on a histogram. The caller that continues the work holds its lock.
    pub(super) fn of(&self, key: &HistogramKey) -> Arc<tokio::sync::Mutex<HistogramWork>> {
        let mut works = lock(&self.works);
        if works.len() >= MAX_UNFINISHED && !works.contains_key(key) {
            works.retain(|_, work| Arc::strong_count(work) > 1);
        }
        Arc::clone(works.entry(key.clone()).or_default())
    }

    pub(super) fn forget(&self, key: &HistogramKey) {
        lock(&self.works).remove(key);
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
        let unfinished = Unfinished::default();
        let held = unfinished.of(&key(0));
        for n in 1..3 * MAX_UNFINISHED {
            unfinished.of(&key(n));
        }
        assert!(lock(&unfinished.works).len() <= MAX_UNFINISHED);
        assert!(Arc::ptr_eq(&held, &unfinished.of(&key(0))));
        unfinished.forget(&key(0));
        assert!(!Arc::ptr_eq(&held, &unfinished.of(&key(0))));
    }
}
