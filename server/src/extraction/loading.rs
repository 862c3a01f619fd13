//! Loads of fields: one at a time for each field, and how far those are that an open volume waits for.

use std::sync::{Arc, Mutex};

use super::keys::VolumeKey;
use super::worker_state::lock;
use crate::volumes::ReadProgress;

/// The load of one field.
#[derive(Default)]
pub(super) struct FieldLoad {
    /// Held by who loads it, so that two callers load it once.
    pub turn: Arc<tokio::sync::Mutex<()>>,
    /// Of the running load, or the last one.
    pub progress: Arc<ReadProgress>,
}

/// How much of a volume's files was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadProgress {
    /// Bytes read so far.
    pub bytes: u64,
    /// Bytes to read.
    pub total_bytes: u64,
}

/// Sees the loads that a [`super::DeviceWorker`] makes for one caller, or waits for.
pub struct LoadWatch {
    /// The fields that were not resident to begin with.
    fields: Mutex<Vec<WatchedField>>,
}

struct WatchedField {
    key: VolumeKey,
    stored_bytes: u64,
    /// Once its load was asked for.
    progress: Option<Arc<ReadProgress>>,
}

impl LoadWatch {
    /// Of fields that have to be read, with the bytes that their files have.
    pub(super) fn new(fields: impl IntoIterator<Item = (VolumeKey, u64)>) -> Self {
        let watched = |(key, stored_bytes)| WatchedField {
            key,
            stored_bytes,
            progress: None,
        };
        Self {
            fields: Mutex::new(fields.into_iter().map(watched).collect()),
        }
    }

    /// A field is being loaded.
    pub(super) fn follow(&self, key: &VolumeKey, progress: &Arc<ReadProgress>) {
        let mut fields = lock(&self.fields);
        if let Some(field) = fields.iter_mut().find(|field| field.key == *key) {
            field.progress = Some(Arc::clone(progress));
        }
    }

    /// How far all loads together are, now.
    pub fn progress(&self) -> LoadProgress {
        let fields = lock(&self.fields);
        let read = |field: &WatchedField| {
            let bytes = field.progress.as_ref().map_or(0, |progress| progress.bytes());
            // A decoder may read a few bytes twice.
            bytes.min(field.stored_bytes)
        };
        LoadProgress {
            bytes: fields.iter().map(read).sum(),
            total_bytes: fields.iter().map(|field| field.stored_bytes).sum(),
        }
    }
}
