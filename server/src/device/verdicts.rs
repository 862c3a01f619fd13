//! What was found out about devices, kept on disk: one file for each device, driver version and build of isopeel.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::setup::{DeviceId, Workaround};
use crate::private_folder;

/// A device that passed the check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Verdict {
    /// The device; its index may have changed since.
    pub device: DeviceId,
    /// Build of isopeel ([`isopeel_kernels::build_id`]).
    pub build: String,
    /// How the device passed.
    pub workaround: Workaround,
}

/// Keeps verdicts in a folder; without one, forgets them.
pub(super) struct Verdicts {
    folder: Option<PathBuf>,
}

impl Verdicts {
    pub fn new(folder: Option<&Path>) -> Self {
        Self {
            folder: folder.map(|folder| folder.join("devices")),
        }
    }

    fn path(&self, device: &DeviceId) -> Option<PathBuf> {
        let build = build();
        let named = [&device.platform, &device.name, &device.driver, &build];
        let text = named.map(|part| part.as_str()).join("\n");
        let hash = xxhash_rust::xxh3::xxh3_64(text.as_bytes());
        Some(self.folder.as_ref()?.join(format!("{hash:016x}.json")))
    }

    /// How this device passed.
    pub fn find(&self, device: &DeviceId) -> Option<Workaround> {
        let bytes = std::fs::read(self.path(device)?).ok()?;
        let verdict: Verdict = serde_json::from_slice(&bytes).ok()?;
        let is_of = DeviceId {
            index: device.index,
            ..verdict.device
        } == *device
            && verdict.build == build();
        is_of.then_some(verdict.workaround)
    }

    /// Keeps how a device passed. Failures are not kept: their cause may be gone the next time.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn keep(&self, device: &DeviceId, workaround: Workaround) -> std::io::Result<()> {
        let (Some(path), Some(folder)) = (self.path(device), &self.folder) else {
            return Ok(());
        };
        private_folder::make(folder)?;
        let verdict = Verdict {
            device: device.clone(),
            build: build(),
            workaround,
        };
        // Whole or not at all, as other processes read it.
        let file = tempfile::NamedTempFile::new_in(folder)?;
        serde_json::to_writer(&file, &verdict)?;
        file.persist(path)?;
        Ok(())
    }

    /// Forgets a device.
    pub fn forget(&self, device: &DeviceId) {
        if let Some(path) = self.path(device) {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn build() -> String {
    format!("{} {:016x}", env!("CARGO_PKG_VERSION"), isopeel_kernels::build_id())
}
