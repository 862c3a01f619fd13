//! Callers that wait until volumes can be pinned.

use std::sync::Arc;

use isopeel_extraction::{Pinned, Pins, VolumeKey};
use tokio::sync::Notify;

/// The pinned volumes, and a notification when pins are released.
pub(super) struct WaitingPins {
    pub pins: Pins,
    released: Arc<Notify>,
}

impl Default for WaitingPins {
    fn default() -> Self {
        let released = Arc::new(Notify::new());
        let notify = Arc::clone(&released);
        Self {
            pins: Pins::new(move || notify.notify_waiters()),
            released,
        }
    }
}

impl WaitingPins {
    /// Waits until [`Pins::try_pin`] succeeds. All volumes are pinned at once or none, so callers cannot deadlock.
    pub(super) async fn pin(&self, volumes: &[(VolumeKey, u64)], budget: u64) -> Pinned {
        loop {
            let released = self.released.notified();
            tokio::pin!(released);
            // Enabled before `try_pin` is called, so that no release after a failed call is missed.
            released.as_mut().enable();
            if let Some(pin) = self.pins.try_pin(volumes, budget) {
                return pin;
            }
            released.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use isopeel_volumes::{VolumeStep, testing};
    use tokio::time::timeout;

    use super::*;

    fn key(field: &str) -> VolumeKey {
        let dataset = Arc::new(testing::dataset("head", [5, 6, 7], &["a"]));
        VolumeKey::new(&VolumeStep::new(dataset, 0).expect("a step"), field, false)
    }

    #[tokio::test]
    async fn a_caller_waits_until_there_is_space() {
        let waiting = WaitingPins::default();
        let first = waiting.pin(&[(key("a"), 6)], 10).await;
        let second = [(key("c"), 5)];
        let wait = waiting.pin(&second, 10);
        tokio::pin!(wait);
        assert!(timeout(Duration::from_millis(20), &mut wait).await.is_err());
        drop(first);
        let second = timeout(Duration::from_secs(5), wait).await;
        assert!(second.is_ok() && waiting.pins.holds(&key("c")));
    }
}
