//! Private volumes: each belongs to one user and comes and goes while the server runs. Public volumes are in the catalog.

use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::SystemTime;

use futures_channel::oneshot;
use futures_util::FutureExt;
use futures_util::future::Shared;

use super::Dataset;

/// The user on whose behalf volumes are looked up.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a> {
    user: &'a str,
    sees_all: bool,
}

impl<'a> Reader<'a> {
    /// A user, who sees their own volumes beside the public ones; with `sees_all` also those of other users.
    pub const fn new(user: &'a str, sees_all: bool) -> Self {
        Self { user, sees_all }
    }

    /// A reader who sees all volumes. For callers that have checked the user's rights before.
    pub const fn of_all() -> Self {
        Self::new("", true)
    }

    /// Returns the user's name.
    pub const fn user(&self) -> &'a str {
        self.user
    }

    /// Whether this reader may see the volumes of `owner`.
    pub fn sees(&self, owner: &str) -> bool {
        self.sees_all || self.user == owner
    }
}

/// A volume and its owner.
#[derive(Debug)]
struct PrivateVolume {
    owner: Arc<str>,
    dataset: Arc<Dataset>,
    /// Dropped when the volume is removed, which completes `removed`.
    removal: Mutex<Option<oneshot::Sender<Infallible>>>,
    removed: Shared<oneshot::Receiver<Infallible>>,
    used: Mutex<SystemTime>,
}

impl PrivateVolume {
    fn new(owner: Arc<str>, dataset: Arc<Dataset>, used: SystemTime) -> Self {
        let (removal, removed) = oneshot::channel();
        Self {
            owner,
            dataset,
            removal: Mutex::new(Some(removal)),
            removed: removed.shared(),
            used: Mutex::new(used),
        }
    }

    fn remove(&self) {
        *self.removal.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn touch(&self) {
        *self.used.lock().unwrap_or_else(PoisonError::into_inner) = SystemTime::now();
    }
}

/// Marks a volume as used while it exists, and updates the time of last use when dropped. For a public volume it does nothing.
#[derive(Clone, Debug, Default)]
pub struct Lease(Option<Arc<PrivateVolume>>);

impl Lease {
    /// Completes when the volume is removed; never for a public volume.
    pub async fn removed(&self) {
        match &self.0 {
            Some(volume) => {
                let Err(oneshot::Canceled) = volume.removed.clone().await;
            }
            None => std::future::pending().await,
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        if let Some(volume) = &self.0 {
            volume.touch();
        }
    }
}

/// The private volumes of a server. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct PrivateVolumes {
    /// Locked only for lookups and changes.
    volumes: Arc<RwLock<Vec<Arc<PrivateVolume>>>>,
}

impl PrivateVolumes {
    /// Adds volumes of a user. No other volume may have their ids. `used`: time of their last use.
    pub fn add(&self, owner: &str, datasets: impl IntoIterator<Item = Arc<Dataset>>, used: SystemTime) {
        let owner: Arc<str> = owner.into();
        let mut volumes = self.volumes.write().unwrap_or_else(PoisonError::into_inner);
        volumes.extend(
            datasets
                .into_iter()
                .map(|dataset| Arc::new(PrivateVolume::new(Arc::clone(&owner), dataset, used))),
        );
    }

    /// Removes a volume and notifies the holders of leases on it. Holders of the dataset keep it.
    pub fn remove(&self, id: &str) {
        let mut volumes = self.volumes.write().unwrap_or_else(PoisonError::into_inner);
        volumes.retain(|volume| {
            let stays = volume.dataset.id != id;
            if !stays {
                volume.remove();
            }
            stays
        });
    }

    /// Returns the volumes that the reader may see, in the order in which they were added.
    pub(super) fn list(&self, who: Reader<'_>) -> Vec<Arc<Dataset>> {
        let volumes = self.volumes.read().unwrap_or_else(PoisonError::into_inner);
        let seen = volumes.iter().filter(|volume| who.sees(&volume.owner));
        seen.map(|volume| Arc::clone(&volume.dataset)).collect()
    }

    /// Returns the volume with this id, if the reader may see it. Sets its time of last use to now.
    pub(super) fn find(&self, id: &str, who: Reader<'_>) -> Option<Arc<Dataset>> {
        let volume = self.get(id).filter(|volume| who.sees(&volume.owner))?;
        volume.touch();
        Some(Arc::clone(&volume.dataset))
    }

    /// Whether there is a volume with this id.
    pub fn contains(&self, id: &str) -> bool {
        self.get(id).is_some()
    }

    /// Returns a lease on the volume with this id: the volume counts as used while the lease exists.
    pub fn lease(&self, id: &str) -> Lease {
        Lease(self.get(id))
    }

    /// Returns the time of the last use of a volume: now while a lease on it exists. `None` if no volume has this id.
    pub fn last_used(&self, id: &str) -> Option<SystemTime> {
        let volume = self.get(id)?;
        // One reference is the list's, the other the one just made; all others are leases.
        if Arc::strong_count(&volume) > 2 {
            return Some(SystemTime::now());
        }
        Some(*volume.used.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn get(&self, id: &str) -> Option<Arc<PrivateVolume>> {
        let volumes = self.volumes.read().unwrap_or_else(PoisonError::into_inner);
        volumes.iter().find(|volume| volume.dataset.id == id).map(Arc::clone)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::{Catalog, SharedCatalog, demo};
    use super::*;

    const ANN: Reader<'static> = Reader::new("ann", false);
    const BOB: Reader<'static> = Reader::new("bob", false);
    const ADMIN: Reader<'static> = Reader::new("root", true);

    fn named(id: &str) -> Arc<Dataset> {
        let mut dataset = demo().unwrap();
        dataset.id = id.into();
        Arc::new(dataset)
    }

    #[test]
    fn what_is_private_is_its_owners_and_whoever_sees_all() {
        let mut public = Catalog::default();
        public.add(demo().unwrap());
        let shared = SharedCatalog::from(public);
        shared.private().add("ann", [named("upload-1")], SystemTime::now());
        let ids = |who| -> Vec<String> { shared.list(who).iter().map(|dataset| dataset.id.clone()).collect() };
        for who in [ANN, ADMIN] {
            assert_eq!(ids(who), ["mni152", "upload-1"]);
            assert!(shared.find("upload-1", who).is_some() && shared.find("mni152", who).is_some());
        }
        assert_eq!(ids(BOB), ["mni152"]);
        assert!(shared.find("upload-1", BOB).is_none() && shared.find("mni152", BOB).is_some());
        assert!(shared.now().get("upload-1").is_none(), "it is in no list of all");
        // Replacing the catalog does not change private volumes.
        shared.replace(Catalog::default());
        assert_eq!(ids(ANN), ["upload-1"]);
    }

    #[tokio::test]
    async fn who_looks_at_a_volume_uses_it_and_learns_that_it_is_gone() {
        let shared = SharedCatalog::default();
        shared
            .private()
            .add("ann", [named("upload-1"), named("upload-2")], SystemTime::now());
        let private = shared.private();
        let added = private.last_used("upload-1").unwrap();
        let lease = private.lease("upload-1");
        std::thread::sleep(Duration::from_millis(5));
        assert!(private.last_used("upload-1").unwrap() > added, "somebody looks at it");
        assert!(private.last_used("upload-2").unwrap() <= private.last_used("upload-1").unwrap());
        drop(lease.clone());
        private.remove("upload-1");
        lease.removed().await;
        assert_eq!(private.last_used("upload-1"), None);
        assert!(shared.find("upload-1", ANN).is_none() && shared.find("upload-2", ANN).is_some());
        let public = tokio::time::timeout(Duration::from_millis(5), private.lease("mni152").removed()).await;
        assert!(public.is_err(), "what is public is not removed");
    }
}
