//! Work-group sizes and vector width with which kernels are built and launched, chosen by the kind of device.

use crate::{DeviceInfo, DeviceKind};

/// Sizes; `cl/` knows all but the last two as `GROUP`, `WIDE_GROUP`, `BRICK_GROUP`, `LANES`, `RUN` and `PREFETCHES`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Tuning {
    /// Work-items of a group that works on one region.
    pub region_group: usize,
    /// Work-items of a group in kernels that read a region's data repeatedly: the fewer regions run at a time, the more data of each stays
    /// in a GPU's caches.
    pub wide_group: usize,
    /// Work-items of a group that works on one brick.
    pub brick_group: usize,
    /// Cells that one work-item processes together in vector registers.
    pub lanes: usize,
    /// Regions along x whose samples one work-group of `minmax` reads as one row.
    pub regions_in_run: usize,
    /// Kernels for a CPU prefetch memory by an intrinsic of the compiler.
    pub prefetches: bool,
    /// Active bricks whose nodes one launch makes. On a CPU a launch ends within about 50 ms, so that other jobs get the device soon.
    pub launch_bricks: usize,
    /// Whether the driver's compiler optimises.
    pub optimises: bool,
}

impl Tuning {
    /// A CPU runs the work-items of a group one after another and keeps their private variables in memory across barriers:
    /// one work-item with wide vectors is fastest.
    pub const CPU: Self = Self {
        region_group: 1,
        wide_group: 1,
        brick_group: 1,
        lanes: 16,
        regions_in_run: 1,
        prefetches: false,
        launch_bricks: 4096,
        optimises: true,
    };

    /// A GPU hides the latency of memory with many work-items, each of which is one lane of its hardware.
    pub const GPU: Self = Self {
        region_group: 256,
        wide_group: 512,
        brick_group: 64,
        lanes: 1,
        regions_in_run: 8,
        prefetches: false,
        launch_bricks: usize::MAX,
        optimises: true,
    };

    /// As [`Tuning::GPU`] with small work-groups, for drivers that fail with large ones.
    pub const GPU_SMALL: Self = Self {
        region_group: 64,
        wide_group: 64,
        brick_group: 64,
        ..Self::GPU
    };

    /// The setting for a device.
    pub fn of(device: &DeviceInfo) -> Self {
        match device.kind {
            DeviceKind::Cpu => Self {
                prefetches: takes_prefetches(device),
                ..Self::CPU
            },
            DeviceKind::Gpu | DeviceKind::Other => Self {
                wide_group: Self::GPU.wide_group.min(device.max_work_group),
                ..Self::GPU
            },
        }
    }

    /// As build options.
    pub(crate) fn defines(&self) -> String {
        format!(
            "-DGROUP={} -DWIDE_GROUP={} -DBRICK_GROUP={} -DLANES={} -DRUN={} -DPREFETCHES={}{}",
            self.region_group,
            self.wide_group,
            self.brick_group,
            self.lanes,
            self.regions_in_run,
            u32::from(self.prefetches),
            if self.optimises { "" } else { " -cl-opt-disable" }
        )
    }
}

/// Whether a driver's compiler is known to translate clang's prefetch intrinsic correctly. Without prefetches an edit takes 2 % longer
/// on PoCL 3.1. PoCL from version 7 on miscompiles the loops around them; Mesa's translator aborts the process.
fn takes_prefetches(device: &DeviceInfo) -> bool {
    match device.pocl_version() {
        Some(major) => major < 7,
        None => device.is_intel_runtime(),
    }
}
