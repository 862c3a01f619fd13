//! Verdicts on devices, kept on disk: one file for each device, version of its driver and compiler, method of PoCL and build of isopeel.

use std::path::{Path, PathBuf};

use isopeel_kernels::device::POCL;
use serde::{Deserialize, Serialize};

use super::cache::pocl_folder;
use super::setup::{DeviceId, POCL_METHOD, Workaround};
use crate::private_folder;

/// A device that passed the check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Verdict {
    /// The device; its index may have changed since.
    pub device: DeviceId,
    /// Build of isopeel ([`isopeel_kernels::build_id`]).
    pub build: String,
    /// Way to use the device in which it passed.
    pub workaround: Workaround,
    /// Names of the sample types whose programs passed.
    pub types: Vec<String>,
}

/// Keeps verdicts in a folder; without a folder, keeps none.
pub(super) struct Verdicts {
    folder: Option<PathBuf>,
    /// Folder in which PoCL caches compiled kernels. A verdict on a PoCL device is valid only while the kernels that the check compiled are
    /// in it: without them the device's thread would compile each kernel at its first use, and all viewers would wait.
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

    /// Returns the file that marks that the kernels of a PoCL device are in PoCL's cache; `None` for other devices.
    fn marker(&self, device: &DeviceId) -> Option<PathBuf> {
        let folder = self.kernels.as_ref().filter(|_| device.platform == POCL)?;
        Some(folder.join(format!("isopeel-{}", name_of(device))))
    }

    /// Returns the way in which this device passed with all of these sample types; `None` if there is no valid verdict.
    pub fn find(&self, device: &DeviceId, types: &[String]) -> Option<Workaround> {
        let verdict = self.read(device)?;
        let has_all = types.iter().all(|one| verdict.types.contains(one));
        has_all.then_some(verdict.workaround)
    }

    fn read(&self, device: &DeviceId) -> Option<Verdict> {
        let bytes = std::fs::read(self.path(device)?).ok()?;
        let verdict: Verdict = serde_json::from_slice(&bytes).ok()?;
        let is_valid = verdict.device.is_like(device)
            && verdict.build == build()
            && self.marker(device).is_none_or(|marker| marker.exists());
        is_valid.then_some(verdict)
    }

    /// Stores how a device passed. Failures are not stored, because their cause may be temporary. For the same reason a device is tried
    /// twice before a workaround for such a failure is stored.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn keep(&self, device: &DeviceId, workaround: Workaround, types: &[String]) -> std::io::Result<()> {
        let (Some(path), Some(folder)) = (self.path(device), &self.folder) else {
            return Ok(());
        };
        let before = self.read(device).filter(|before| before.workaround == workaround);
        let mut types = [types, &before.map_or_else(Vec::new, |before| before.types)].concat();
        types.sort();
        types.dedup();
        if let Some(marker) = self.marker(device) {
            std::fs::write(marker, "")?;
        }
        private_folder::make(folder)?;
        let verdict = Verdict {
            device: device.clone(),
            build: build(),
            workaround,
            types,
        };
        // Written atomically, because other processes read it.
        let file = tempfile::NamedTempFile::new_in(folder)?;
        serde_json::to_writer(&file, &verdict)?;
        file.persist(path)?;
        Ok(())
    }

    /// Removes the verdict on a device.
    pub fn forget(&self, device: &DeviceId) {
        if let Some(path) = self.path(device) {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn name_of(device: &DeviceId) -> String {
    let method = std::env::var(POCL_METHOD).unwrap_or_default();
    let text = [&device.kind()[..], &[&build(), &method]].concat().join("\n");
    format!("{:016x}", xxhash_rust::xxh3::xxh3_64(text.as_bytes()))
}

fn build() -> String {
    format!("{} {:016x}", env!("CARGO_PKG_VERSION"), isopeel_kernels::build_id())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(platform: &str) -> DeviceId {
        let text = serde_json::json!({"index": 0, "platform": platform, "platform_version": "OpenCL 3.0", "name": "pthread", "driver": "3.1"});
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
        let types = ["f32".to_owned()];
        for device in [&pocl, &other] {
            verdicts.keep(device, Workaround::None, &types).expect("kept");
            assert_eq!(verdicts.find(device, &types), Some(Workaround::None));
        }
        std::fs::remove_dir_all(&kernels).expect("removed");
        assert_eq!(verdicts.find(&pocl, &types), None);
        assert_eq!(verdicts.find(&other, &types), Some(Workaround::None));
    }

    #[test]
    fn a_verdict_counts_for_the_types_that_passed() {
        let parent = tempfile::tempdir().expect("a folder");
        let verdicts = Verdicts {
            folder: Some(parent.path().join("devices")),
            kernels: None,
        };
        let device = device("NVIDIA CUDA");
        let [bytes, floats] = ["u8", "f32"].map(|name| vec![name.to_owned()]);
        let both = [bytes.clone(), floats.clone()].concat();
        verdicts.keep(&device, Workaround::None, &floats).expect("kept");
        assert_eq!(verdicts.find(&device, &both), None);
        verdicts.keep(&device, Workaround::None, &bytes).expect("kept");
        assert_eq!(verdicts.find(&device, &both), Some(Workaround::None));
        // Another way to use the device is proven for what passed in that way alone.
        verdicts.keep(&device, Workaround::OtherKernels, &bytes).expect("kept");
        assert_eq!(verdicts.find(&device, &both), None);
        assert_eq!(verdicts.find(&device, &bytes), Some(Workaround::OtherKernels));
    }
}
