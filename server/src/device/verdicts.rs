//! Verdicts on devices, stored on disk. Each combination of device, driver version, compiler version, work-group method of PoCL and build
//! of isopeel has one file. Several devices of the same model have separate files, numbered in the order of the device list.

use std::path::{Path, PathBuf};

use isopeel_kernels::DeviceInfo;
use isopeel_kernels::device::POCL;
use serde::{Deserialize, Serialize};

use super::cache::pocl_folder;
use super::setup::{DeviceId, POCL_METHOD, Workaround};
use crate::private_folder;

/// The verdict on a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Verdict {
    /// The device; its index may have changed since.
    device: DeviceId,
    /// Build of isopeel ([`isopeel_kernels::build_id`]).
    build: String,
    outcome: Outcome,
    /// Names of the sample types whose programs were checked.
    types: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Outcome {
    /// The device passed with this workaround.
    Passed(Workaround),
    /// The device failed with all workarounds. The report has a line for each.
    Refused(String),
}

/// Stores verdicts in a folder. Stores nothing without a folder.
pub(super) struct Verdicts {
    folder: Option<PathBuf>,
    /// Folder in which PoCL caches compiled kernels. A verdict on a PoCL device is valid only while this folder has the kernels that the
    /// check compiled. Otherwise the device's thread would compile each kernel at its first use, and all viewers would wait.
    kernels: Option<PathBuf>,
    /// The listed devices.
    devices: Vec<DeviceId>,
}

impl Verdicts {
    pub fn new(folder: Option<&Path>, listed: &[DeviceInfo]) -> Self {
        Self {
            folder: folder.map(|folder| folder.join("devices")),
            kernels: pocl_folder(),
            devices: listed.iter().map(DeviceId::new).collect(),
        }
    }

    /// Returns the path of the file with the verdict on a device; `None` without a folder.
    fn path(&self, device: &DeviceId) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}.json", self.name_of(device))))
    }

    /// Returns the name of the file with the verdict on a device, without its extension.
    fn name_of(&self, device: &DeviceId) -> String {
        let is_before = |other: &&DeviceId| other.index < device.index && other.is_same_model(device);
        let ordinal = self.devices.iter().filter(is_before).count().to_string();
        let method = std::env::var(POCL_METHOD).unwrap_or_default();
        let text = [&device.model()[..], &[&ordinal, &build(), &method]]
            .concat()
            .join("\n");
        format!("{:016x}", xxhash_rust::xxh3::xxh3_64(text.as_bytes()))
    }

    /// Returns the path of a marker file in PoCL's cache. It exists while the cache has the kernels of this PoCL device. `None` for other
    /// devices.
    fn marker(&self, device: &DeviceId) -> Option<PathBuf> {
        let folder = self.kernels.as_ref().filter(|_| device.platform == POCL)?;
        Some(folder.join(format!("isopeel-{}", self.name_of(device))))
    }

    /// Returns the workaround with which this device passed for all of these sample types; `None` if there is no valid verdict.
    pub fn find(&self, device: &DeviceId, types: &[String]) -> Option<Workaround> {
        let (workaround, passed) = self.passed(device)?;
        includes(&passed, types).then_some(workaround)
    }

    /// Returns the workaround with which this device passed, and the sample types that passed.
    fn passed(&self, device: &DeviceId) -> Option<(Workaround, Vec<String>)> {
        let verdict = self.read(device)?;
        let has_kernels = self.marker(device).is_none_or(|marker| marker.exists());
        match verdict.outcome {
            Outcome::Passed(workaround) if has_kernels => Some((workaround, verdict.types)),
            _ => None,
        }
    }

    /// Returns the report on a refused device, if all sample types of the refusal are among `types`.
    pub fn refusal(&self, device: &DeviceId, types: &[String]) -> Option<String> {
        let (report, refused) = self.refused(device)?;
        includes(types, &refused).then_some(report)
    }

    /// Returns the report on a refused device, and the sample types for which it failed.
    fn refused(&self, device: &DeviceId) -> Option<(String, Vec<String>)> {
        let verdict = self.read(device)?;
        match verdict.outcome {
            Outcome::Refused(report) => Some((report, verdict.types)),
            Outcome::Passed(_) => None,
        }
    }

    fn read(&self, device: &DeviceId) -> Option<Verdict> {
        let bytes = std::fs::read(self.path(device)?).ok()?;
        let verdict: Verdict = serde_json::from_slice(&bytes).ok()?;
        let is_valid = verdict.device.is_same_model(device) && verdict.build == build();
        is_valid.then_some(verdict)
    }

    /// Stores that a device passed with a workaround. Adds the sample types of an earlier verdict with the same workaround.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn keep(&self, device: &DeviceId, workaround: Workaround, types: &[String]) -> std::io::Result<()> {
        let before = self.passed(device).filter(|(before, _)| *before == workaround);
        let mut types = [types, &before.map_or_else(Vec::new, |(_, types)| types)].concat();
        types.sort();
        types.dedup();
        if self.folder.is_some()
            && let Some(marker) = self.marker(device)
        {
            std::fs::write(marker, "")?;
        }
        self.write(device, Outcome::Passed(workaround), types)
    }

    /// Stores that a device failed with all workarounds.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn refuse(&self, device: &DeviceId, report: String, types: &[String]) -> std::io::Result<()> {
        // Keeps the smaller set of types if a stored refusal has one: a device that failed for a subset fails for all of `types` too.
        let fewer = self.refused(device).filter(|(_, fewer)| includes(types, fewer));
        let types = fewer.map_or_else(|| types.to_vec(), |(_, fewer)| fewer);
        self.write(device, Outcome::Refused(report), types)
    }

    fn write(&self, device: &DeviceId, outcome: Outcome, types: Vec<String>) -> std::io::Result<()> {
        let (Some(path), Some(folder)) = (self.path(device), &self.folder) else {
            return Ok(());
        };
        private_folder::make(folder)?;
        let verdict = Verdict {
            device: device.clone(),
            build: build(),
            outcome,
            types,
        };
        // Replaces the file atomically, because other processes may read it.
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

/// Whether all names in `subset` are in `names`.
fn includes(names: &[String], subset: &[String]) -> bool {
    subset.iter().all(|name| names.contains(name))
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
            devices: Vec::new(),
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
            devices: Vec::new(),
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

    #[test]
    fn a_refusal_counts_for_its_types_until_the_device_passes_or_its_driver_changes() {
        let parent = tempfile::tempdir().expect("a folder");
        let verdicts = Verdicts {
            folder: Some(parent.path().join("devices")),
            // Without the kernels of PoCL: a refusal needs none.
            kernels: Some(parent.path().join("missing")),
            devices: Vec::new(),
        };
        let device = device(POCL);
        let [bytes, floats] = ["u8", "f32"].map(|name| vec![name.to_owned()]);
        let both = [bytes.clone(), floats.clone()].concat();
        verdicts.refuse(&device, "crashes".to_owned(), &floats).expect("kept");
        assert_eq!(verdicts.find(&device, &floats), None);
        for types in [&floats, &both] {
            assert_eq!(verdicts.refusal(&device, types).as_deref(), Some("crashes"));
        }
        verdicts.refuse(&device, "crashes".to_owned(), &both).expect("kept");
        assert!(verdicts.refusal(&device, &floats).is_some());
        assert_eq!(verdicts.refusal(&device, &bytes), None);
        let newer = DeviceId {
            driver: "3.2".to_owned(),
            ..device.clone()
        };
        assert_eq!(verdicts.refusal(&newer, &floats), None);
        std::fs::create_dir(parent.path().join("missing")).expect("a folder");
        verdicts.keep(&device, Workaround::None, &floats).expect("kept");
        assert_eq!(verdicts.refusal(&device, &floats), None);
        verdicts.refuse(&device, "crashes".to_owned(), &floats).expect("kept");
        verdicts.forget(&device);
        assert_eq!(verdicts.refusal(&device, &floats), None);
    }

    #[test]
    fn devices_of_one_kind_have_their_own_verdicts() {
        let parent = tempfile::tempdir().expect("a folder");
        let first = device("NVIDIA CUDA");
        let second = DeviceId {
            index: 1,
            ..first.clone()
        };
        let verdicts = Verdicts {
            folder: Some(parent.path().join("devices")),
            kernels: None,
            devices: vec![first.clone(), second.clone()],
        };
        let types = ["f32".to_owned()];
        verdicts.refuse(&first, "crashes".to_owned(), &types).expect("kept");
        verdicts.keep(&second, Workaround::None, &types).expect("kept");
        assert_eq!(verdicts.find(&first, &types), None);
        assert!(verdicts.refusal(&first, &types).is_some());
        assert_eq!(verdicts.find(&second, &types), Some(Workaround::None));
    }
}
