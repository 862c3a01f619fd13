//! Cache of overviews, and the overviews that are being made. All callers of the same overview share the work on it. The work ends when the
//! last of these callers leaves.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, Weak};

use isopeel_extraction::{Lru, VolumeKey, lock};
use isopeel_kernels::{Overview, OverviewMode, OverviewWork};

/// Maximum number of values along each axis. A value takes a byte, so an overview takes at most 2 MiB, which a browser can draw without a
/// GPU.
const OVERVIEW_SIDE: u32 = 128;

/// Maximum bytes of cached overviews: some time steps of a field, in both modes.
const MAX_CACHED_BYTES: u64 = 32 << 20;

/// Key of an overview: its volume and its mode.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct OverviewKey {
    pub volume: VolumeKey,
    pub mode: OverviewMode,
}

/// Overviews that are cached, and those that are being made.
pub(super) struct Overviews {
    cached: Mutex<Lru<OverviewKey, Arc<Overview>>>,
    /// Unfinished work by key, at most 24 MiB each. The callers own it, so it ends with the last of them.
    unfinished: Mutex<HashMap<OverviewKey, Weak<UnfinishedOverview>>>,
}

/// Work on an overview, shared by all callers of its key.
pub(super) struct UnfinishedOverview {
    pub work: Mutex<OverviewWork>,
    /// Held by the caller that runs the work. The others wait for the result; if that caller leaves, one of them continues.
    pub running: tokio::sync::Mutex<()>,
    /// Permit to make this overview, which is released when the last caller is gone.
    _permit: Box<dyn Send + Sync>,
}

impl Default for Overviews {
    fn default() -> Self {
        Self {
            cached: Mutex::new(Lru::new(MAX_CACHED_BYTES)),
            unfinished: Mutex::default(),
        }
    }
}

impl Overviews {
    pub(super) fn cached(&self, key: &OverviewKey) -> Option<Arc<Overview>> {
        lock(&self.cached).get(key).cloned()
    }

    pub(super) fn insert(&self, key: OverviewKey, overview: &Arc<Overview>) {
        lock(&self.cached).insert(key, overview.codes.len() as u64, Arc::clone(overview));
    }

    /// Returns the work on an overview. If there is none, begins it with the permit that `admit` returns.
    ///
    /// # Errors
    /// The errors of `admit`.
    pub(super) fn unfinished<P: Send + Sync + 'static, E>(
        &self,
        key: &OverviewKey,
        samples: [u32; 3],
        admit: impl FnOnce() -> Result<P, E>,
    ) -> Result<Arc<UnfinishedOverview>, E> {
        let mut by_key = lock(&self.unfinished);
        by_key.retain(|_, unfinished| unfinished.strong_count() > 0);
        if let Some(unfinished) = by_key.get(key).and_then(Weak::upgrade) {
            return Ok(unfinished);
        }
        let unfinished = Arc::new(UnfinishedOverview {
            _permit: Box::new(admit()?),
            work: Mutex::new(OverviewWork::new(samples, key.mode, OVERVIEW_SIDE)),
            running: tokio::sync::Mutex::default(),
        });
        by_key.insert(key.clone(), Arc::downgrade(&unfinished));
        Ok(unfinished)
    }
}

#[cfg(test)]
mod tests {
    use isopeel_volumes::{VolumeStep, testing};

    use super::*;

    fn key(field: &str) -> OverviewKey {
        let dataset = Arc::new(testing::dataset("head", [5, 6, 7], &["density"]));
        let volume = VolumeStep::new(dataset, 0).expect("a step");
        OverviewKey {
            volume: VolumeKey::new(&volume, field, false),
            mode: OverviewMode::Mean,
        }
    }

    #[test]
    fn callers_share_work_and_its_place_which_end_with_the_last_of_them() {
        let overviews = Overviews::default();
        let place = Arc::new(());
        let admitted = |field: &str| {
            let admit = || Ok::<_, String>(Arc::clone(&place));
            overviews.unfinished(&key(field), [5, 6, 7], admit).expect("a place")
        };
        let refused = |field: &str| {
            let admit = || Err::<(), _>("no place".to_owned());
            overviews.unfinished(&key(field), [5, 6, 7], admit)
        };
        let first = admitted("density");
        assert!(Arc::ptr_eq(&first, &refused("density").expect("the same work")));
        assert_eq!(refused("2*density").err().as_deref(), Some("no place"));
        assert!(!Arc::ptr_eq(&first, &admitted("2*density")));
        assert_eq!(lock(&overviews.unfinished).len(), 2);
        assert_eq!(Arc::strong_count(&place), 2);
        drop(first);
        assert_eq!(Arc::strong_count(&place), 1);
        admitted("3*density");
        assert_eq!(lock(&overviews.unfinished).len(), 1);
    }

    #[test]
    fn only_so_many_are_cached() {
        let overviews = Overviews::default();
        let overview = Arc::new(Overview {
            dims: [OVERVIEW_SIDE; 3],
            factors: [1; 3],
            range: [0.0; 2],
            codes: vec![0; OVERVIEW_SIDE.pow(3) as usize],
        });
        for n in 0..20 {
            overviews.insert(key(&format!("{n}*density")), &overview);
        }
        assert_eq!(lock(&overviews.cached).entries(), 16);
        assert!(overviews.cached(&key("19*density")).is_some());
        assert!(overviews.cached(&key("3*density")).is_none());
    }
}
