//! Volumes that jobs wait for or work on: they are not evicted meanwhile, so that two viewers of different volumes do not evict each
//! other's volumes.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use tokio::sync::Notify;

use super::keys::VolumeKey;
use super::lock::lock;

/// The pinned volumes. Clones are cheap.
#[derive(Clone, Default)]
pub(super) struct Pins {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    /// Bytes of each pinned volume, and its number of pins.
    pinned: Mutex<HashMap<VolumeKey, (u64, usize)>>,
    released: Notify,
}

/// Guard that keeps volumes resident until it is dropped.
pub(super) struct Pin {
    shared: Arc<Shared>,
    keys: Vec<VolumeKey>,
}

impl Pins {
    /// Pins volumes of these sizes, all at once, when they fit into `budget` bytes beside those that are pinned; volumes larger than the
    /// budget are pinned when no other volumes are pinned. It pins all or none, so waiters cannot deadlock.
    pub(super) async fn pin(&self, volumes: &[(VolumeKey, u64)], budget: u64) -> Pin {
        loop {
            let released = self.shared.released.notified();
            tokio::pin!(released);
            // Enabled before pins are checked, so that no release in between is missed.
            released.as_mut().enable();
            if let Some(pin) = self.try_pin(volumes, budget) {
                return pin;
            }
            released.await;
        }
    }

    /// As [`Pins::pin`], without waiting; `None` if other pins would have to be released first.
    pub(super) fn try_pin(&self, volumes: &[(VolumeKey, u64)], budget: u64) -> Option<Pin> {
        let mut pinned = lock(&self.shared.pinned);
        let others: u64 = (pinned.iter())
            .filter(|(key, _)| volumes.iter().all(|(new, _)| new != *key))
            .map(|(_, (bytes, _))| bytes)
            .sum();
        let own: u64 = volumes.iter().map(|(_, bytes)| bytes).sum();
        if others > 0 && others.saturating_add(own) > budget {
            return None;
        }
        for (key, bytes) in volumes {
            pinned.entry(key.clone()).or_insert((*bytes, 0)).1 += 1;
        }
        Some(Pin {
            shared: Arc::clone(&self.shared),
            keys: volumes.iter().map(|(key, _)| key.clone()).collect(),
        })
    }

    /// Whether a volume must stay.
    pub(super) fn holds(&self, key: &VolumeKey) -> bool {
        lock(&self.shared.pinned).contains_key(key)
    }
}

impl Drop for Pin {
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
        drop(pinned);
        self.shared.released.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::time::timeout;

    use super::{Pins, VolumeKey};
    use isopeel_volumes::{DatasetKey, StepKey};

    fn key(field: &str) -> VolumeKey {
        VolumeKey {
            step: StepKey {
                dataset: DatasetKey {
                    id: "head".into(),
                    revision: 0,
                },
                step: 0,
                rewrites: 0,
            },
            field: field.into(),
            padded: false,
            mask: None,
        }
    }

    #[tokio::test]
    async fn volumes_that_do_not_fit_together_wait_for_each_other() {
        let pins = Pins::default();
        let first = pins.pin(&[(key("a"), 6)], 10).await;
        let again = pins.pin(&[(key("a"), 6), (key("b"), 4)], 10).await;
        let third = [(key("c"), 5)];
        let wait = pins.pin(&third, 10);
        tokio::pin!(wait);
        assert!(timeout(Duration::from_millis(20), &mut wait).await.is_err());
        drop(again);
        assert!(
            timeout(Duration::from_millis(20), &mut wait).await.is_err(),
            "a is pinned still"
        );
        assert!(pins.holds(&key("a")) && !pins.holds(&key("b")));
        drop(first);
        let third = timeout(Duration::from_secs(5), wait).await;
        assert!(third.is_ok() && pins.holds(&key("c")));
    }

    #[tokio::test]
    async fn what_is_larger_than_the_budget_is_pinned_alone() {
        let pins = Pins::default();
        drop(pins.pin(&[(key("a"), 11)], 10).await);
        assert!(!pins.holds(&key("a")));
    }
}
