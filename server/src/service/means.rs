//! Measured times of a device.

use std::sync::Mutex;

use isopeel_extraction::lock;

/// Weight of a new value in a mean. The mean follows a change within some twenty values.
const WEIGHT: f64 = 0.125;

/// Exponential moving average of measured values.
#[derive(Default)]
pub(super) struct Mean(Mutex<Option<f64>>);

impl Mean {
    /// Adds a value.
    pub(super) fn add(&self, value: f64) {
        let mut mean = lock(&self.0);
        *mean = Some(mean.map_or(value, |old| old + WEIGHT * (value - old)));
    }

    /// Returns the mean; `None` before the first value.
    pub(super) fn get(&self) -> Option<f64> {
        *lock(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_follows_a_change_and_ignores_one_outlier() {
        let mean = Mean::default();
        assert_eq!(mean.get(), None);
        mean.add(1.0);
        assert_eq!(mean.get(), Some(1.0));
        mean.add(2.0);
        assert_eq!(mean.get(), Some(1.125));
        (0..40).for_each(|_| mean.add(3.0));
        assert!(mean.get().is_some_and(|mean| (mean - 3.0).abs() < 0.02));
    }
}
