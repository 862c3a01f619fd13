//! Pins keep volumes on the device. A pinned volume is not evicted, so two viewers of different volumes do not evict each other's volumes.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use isopeel_kernels::lock;

use super::keys::VolumeKey;

/// The pinned volumes. Clones share them.
#[derive(Clone, Default)]
pub struct Pins {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    /// Bytes and number of pins of each pinned volume.
    pinned: Mutex<HashMap<VolumeKey, (u64, usize)>>,
    /// Called after pins were released.
    on_release: Option<Box<dyn Fn() + Send + Sync>>,
    /// Incremented when volumes were pinned or released.
    changes: AtomicU64,
}

/// Guard that keeps volumes resident until it is dropped.
pub struct Pinned {
    shared: Arc<Shared>,
    keys: Vec<VolumeKey>,
}

impl Pins {
    /// Creates a set of pins that calls `on_release` after some were released.
    pub fn new(on_release: impl Fn() + Send + Sync + 'static) -> Self {
        Self {
            shared: Arc::new(Shared {
                pinned: Mutex::default(),
                on_release: Some(Box::new(on_release)),
                changes: AtomicU64::default(),
            }),
        }
    }

    /// Pins volumes of these sizes in bytes, all or none. They are pinned if they fit into `budget` bytes beside the other pinned volumes,
    /// or if no other volumes are pinned. `None` if other pins must be released first.
    pub fn try_pin(&self, volumes: &[(VolumeKey, u64)], budget: u64) -> Option<Pinned> {
        let mut pinned = lock(&self.shared.pinned);
        let other_bytes: u64 = (pinned.iter())
            .filter(|(key, _)| volumes.iter().all(|(requested, _)| requested != *key))
            .map(|(_, (bytes, _))| bytes)
            .sum();
        let requested_bytes: u64 = volumes.iter().map(|(_, bytes)| bytes).sum();
        if other_bytes > 0 && other_bytes.saturating_add(requested_bytes) > budget {
            return None;
        }
        for (key, bytes) in volumes {
            pinned.entry(key.clone()).or_insert((*bytes, 0)).1 += 1;
        }
        self.shared.changes.fetch_add(1, Ordering::Relaxed);
        Some(Pinned {
            shared: Arc::clone(&self.shared),
            keys: volumes.iter().map(|(key, _)| key.clone()).collect(),
        })
    }

    /// Returns the pinned volumes if they have changed since `changes` was returned, with a number for the next call.
    pub fn changed_since(&self, changes: Option<u64>) -> Option<(Vec<VolumeKey>, u64)> {
        let pinned = lock(&self.shared.pinned);
        let now = self.shared.changes.load(Ordering::Relaxed);
        (changes != Some(now)).then(|| (pinned.keys().cloned().collect(), now))
    }

    /// Replaces the pinned volumes by those of another process.
    pub fn replace(&self, keys: Vec<VolumeKey>) {
        *lock(&self.shared.pinned) = keys.into_iter().map(|key| (key, (0, 1))).collect();
    }

    /// Whether a volume is pinned.
    pub fn holds(&self, key: &VolumeKey) -> bool {
        lock(&self.shared.pinned).contains_key(key)
    }
}

impl Drop for Pinned {
    fn drop(&mut self) {
        let mut pinned = lock(&self.shared.pinned);
        for key in &self.keys {
            if let Some((_, count)) = pinned.get_mut(key) {
                *count -= 1;
                if *count == 0 {
                    pinned.remove(key);
                }
            }
        }
        self.shared.changes.fetch_add(1, Ordering::Relaxed);
        drop(pinned);
        if let Some(on_release) = &self.shared.on_release {
            on_release();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use isopeel_volumes::{VolumeStep, testing};

    use super::*;

    fn key(field: &str) -> VolumeKey {
        let dataset = Arc::new(testing::dataset("head", [5, 6, 7], &["a"]));
        VolumeKey::new(&VolumeStep::new(dataset, 0).expect("a step"), field, false)
    }

    #[test]
    fn volumes_that_do_not_fit_together_are_not_pinned_together() {
        let released = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&released);
        let pins = Pins::new(move || {
            count.fetch_add(1, Ordering::Relaxed);
        });
        let first = pins.try_pin(&[(key("a"), 6)], 10).expect("there is space");
        let again = pins
            .try_pin(&[(key("a"), 6), (key("b"), 4)], 10)
            .expect("there is space");
        let third = [(key("c"), 5)];
        assert!(pins.try_pin(&third, 10).is_none());
        drop(again);
        assert!(pins.try_pin(&third, 10).is_none(), "a is pinned still");
        assert!(pins.holds(&key("a")) && !pins.holds(&key("b")));
        drop(first);
        assert!(pins.try_pin(&third, 10).is_some());
        assert_eq!(released.load(Ordering::Relaxed), 3);
    }

    #[test]
    fn what_is_larger_than_the_budget_is_pinned_alone() {
        let pins = Pins::default();
        drop(pins.try_pin(&[(key("a"), 11)], 10).expect("nothing else is pinned"));
        assert!(!pins.holds(&key("a")));
    }
}
