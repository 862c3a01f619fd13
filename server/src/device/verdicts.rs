//! What was found out about devices, kept on disk: one file for each device, driver version and build of isopeel.

use std::path::{Path, PathBuf};

use isopeel_kernels::device::POCL;
use serde::{Deserialize, Serialize};

use super::cache::pocl_folder;
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
    /// Where PoCL keeps compiled kernels. A verdict on its devices counts while the kernels are there that the check compiled: without them
    /// the device's thread would compile each kernel when it first needs it, and all viewers would wait.
    kernels: Option<PathBuf>,
}

impl Verdicts {
    pub fn new(folder: Option<&Path>) -> Self {
        Self {
            folder: folder.map(|folder| folder.join("devices")),
            kernels: pocl_folder(),
        }
    }

    fn path(&self, device: &DeviceId) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}.json", name_of(device))))
    }

    /// The file that lies beside the compiled kernels of a device of PoCL.
    fn marker(&self, device: &DeviceId) -> Option<PathBuf> {
        let folder = self.kernels.as_ref().filter(|_| device.platform == POCL)?;
        Some(folder.join(format!("isopeel-{}", name_of(device))))
    }

    /// How this device passed.
    pub fn find(&self, device: &DeviceId) -> Option<Workaround> {
        let bytes = std::fs::read(self.path(device)?).ok()?;
        let verdict: Verdict = serde_json::from_slice(&bytes).ok()?;
        let is_of = DeviceId {
            index: device.index,
            ..verdict.device
        } == *device
            && verdict.build == build()
            && self.marker(device).is_none_or(|marker| marker.exists());
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
        if let Some(marker) = self.marker(device) {
            std::fs::write(marker, "")?;
        }
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

fn name_of(device: &DeviceId) -> String {
    let build = build();
    let named = [&device.platform, &device.name, &device.driver, &build];
    let text = named.map(|part| part.as_str()).join("\n");
    format!("{:016x}", xxhash_rust::xxh3::xxh3_64(text.as_bytes()))
}

fn build() -> String {
    format!("{} {:016x}", env!("CARGO_PKG_VERSION"), isopeel_kernels::build_id())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(platform: &str) -> DeviceId {
        let text = serde_json::json!({"index": 0, "platform": platform, "name": "pthread", "driver": "3.1"});
        serde_json::from_value(text).expect("a device")
    }

    #[test]
    fn a_verdict_on_pocl_counts_while_the_kernels_are_there_that_the_check_compiled() {
        let parent = tempfile::tempdir().expect("a folder");
        let kernels = parent.path().join("kernels");
        std::fs::create_dir(&kernels).expect("a folder");
        let verdicts = Verdicts {
            folder: Some(parent.path().join("devices")),
            kernels: Some(kernels.clone()),
        };
        let (pocl, other) = (device(POCL), device("NVIDIA CUDA"));
        for device in [&pocl, &other] {
            verdicts.keep(device, Workaround::None).expect("kept");
            assert_eq!(verdicts.find(device), Some(Workaround::None));
        }
        std::fs::remove_dir_all(&kernels).expect("removed");
        assert_eq!(verdicts.find(&pocl), None);
        assert_eq!(verdicts.find(&other), Some(Workaround::None));
    }
}
