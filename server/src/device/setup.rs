//! Identity of a device, and the workarounds for known faults of its driver.

use isopeel_kernels::{DeviceInfo, DeviceKind, SampleType, Tuning};
use serde::{Deserialize, Serialize};

/// Identifies a device in requests to child processes and in stored verdicts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceId {
    /// Position in the list of devices.
    pub index: usize,
    /// Name of the OpenCL platform.
    pub platform: String,
    /// Version of the platform. It may include the version of the compiler.
    pub platform_version: String,
    /// Name of the device.
    pub name: String,
    /// Version of the driver.
    pub driver: String,
}

impl DeviceId {
    /// Returns the identity of a listed device.
    pub fn new(info: &DeviceInfo) -> Self {
        Self {
            index: info.index,
            platform: info.platform.clone(),
            platform_version: info.platform_version.clone(),
            name: info.name.clone(),
            driver: info.driver.clone(),
        }
    }

    /// Whether both are the same device, or devices of the same model with the same driver.
    pub(super) fn is_same_model(&self, other: &Self) -> bool {
        self.model() == other.model()
    }

    /// Returns platform, version of the platform, name of the device, and version of the driver. They are equal for devices of the same
    /// model with the same driver.
    pub(super) fn model(&self) -> [&str; 4] {
        [&self.platform, &self.platform_version, &self.name, &self.driver].map(String::as_str)
    }
}

impl std::fmt::Display for DeviceId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, driver {})", self.name, self.platform, self.driver)
    }
}

/// A workaround for a fault of a driver, or none. [`Workaround::candidates`] defines the order in which workarounds are tried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Workaround {
    /// No workaround: the default settings for this kind of device.
    #[default]
    None,
    /// PoCL compiles work-groups by its older method.
    Loops,
    /// PoCL compiles work-groups by its newer method.
    Cbs,
    /// Kernels for a CPU do not prefetch.
    NoPrefetches,
    /// Uses the kernels of the other kind of device: those for GPUs on a CPU, those for CPUs otherwise.
    OtherKernels,
    /// Uses the kernels for GPUs with small work-groups.
    SmallGroups,
}

impl Workaround {
    /// Returns the workarounds that apply to a device, in the order in which they are tried. The first is [`Workaround::None`].
    pub fn candidates(device: &DeviceInfo) -> Vec<Self> {
        let is_pocl = device.pocl_version().is_some();
        let applies = |workaround: &Self| match workaround {
            Self::None | Self::OtherKernels => true,
            Self::Loops | Self::Cbs => is_pocl,
            Self::NoPrefetches => Tuning::of(device).prefetches,
            Self::SmallGroups => device.kind != DeviceKind::Cpu,
        };
        let all = [
            Self::None,
            Self::Loops,
            Self::Cbs,
            Self::NoPrefetches,
            Self::SmallGroups,
            Self::OtherKernels,
        ];
        all.into_iter().filter(applies).collect()
    }

    /// Returns name and value of the environment variable that this workaround needs; `None` if it needs none.
    pub fn environment(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Loops => Some((POCL_METHOD, "loops")),
            Self::Cbs => Some((POCL_METHOD, "cbs")),
            _ => None,
        }
    }

    /// Returns the settings with which kernels are built and launched; `None` for the defaults of the device.
    pub fn tuning(self, device: &DeviceInfo) -> Option<Tuning> {
        match (self, device.kind) {
            (Self::None | Self::Loops | Self::Cbs, _) => None,
            (Self::NoPrefetches, _) => Some(Tuning {
                prefetches: false,
                ..Tuning::of(device)
            }),
            (Self::SmallGroups, _) | (Self::OtherKernels, DeviceKind::Cpu) => Some(Tuning::GPU_SMALL),
            (Self::OtherKernels, _) => Some(Tuning::CPU),
        }
    }

    /// Returns the description for reports.
    pub fn text(self) -> &'static str {
        match self {
            Self::None => "default settings",
            Self::Loops => "POCL_WORK_GROUP_METHOD=loops",
            Self::Cbs => "POCL_WORK_GROUP_METHOD=cbs",
            Self::NoPrefetches => "kernels without prefetches",
            Self::OtherKernels => "kernels of the other kind of device",
            Self::SmallGroups => "small work-groups",
        }
    }
}

/// Environment variable that selects how PoCL compiles work-groups. Users may set it too.
pub(super) const POCL_METHOD: &str = "POCL_WORK_GROUP_METHOD";

/// Names of the sample types in requests to children.
pub(super) const TYPES: [(&str, SampleType); 5] = [
    ("u8", SampleType::U8),
    ("i8", SampleType::I8),
    ("u16", SampleType::U16),
    ("i16", SampleType::I16),
    ("f32", SampleType::F32),
];

/// Returns the name of a sample type in requests. All types are in [`TYPES`].
pub(super) fn type_name(sample_type: SampleType) -> &'static str {
    let entry = TYPES.into_iter().find(|(_, other)| *other == sample_type);
    entry.map_or("f32", |(name, _)| name)
}

/// Returns the sample type of a name in a request; `None` if the name is unknown.
pub(super) fn sample_type_of(name: &str) -> Option<SampleType> {
    let entry = TYPES.into_iter().find(|(other, _)| *other == name);
    entry.map(|(_, sample_type)| sample_type)
}
