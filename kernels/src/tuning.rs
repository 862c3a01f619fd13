//! Work-group sizes and vector width that kernels are built and launched with: the one place where the host distinguishes a
//! CPU from a GPU.

use crate::DeviceKind;

/// Sizes; `cl/` knows all but the last as `GROUP`, `WIDE_GROUP`, `BRICK_GROUP`, `LANES` and `RUN`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning {
    /// Work-items of a group that works on one region.
    pub region_group: usize,
    /// The same where a region's data are read again and again: the fewer regions at a time, the more of each are in a GPU's caches.
    pub wide_group: usize,
    /// Work-items of a group that works on one brick.
    pub brick_group: usize,
    /// Cells that one work-item processes together in vector registers.
    pub lanes: usize,
    /// Regions along x whose samples one work-group of `minmax` reads as one row.
    pub regions_in_run: usize,
    /// Active bricks whose nodes one launch makes. On a CPU it ends within about 50 ms, for whoever waits for the device.
    pub launch_bricks: usize,
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
        launch_bricks: 4096,
    };

    /// A GPU hides the latency of memory with many work-items, each of which is one lane of its hardware.
    pub const GPU: Self = Self {
        region_group: 256,
        wide_group: 512,
        brick_group: 64,
        lanes: 1,
        regions_in_run: 8,
        launch_bricks: usize::MAX,
    };

    /// The setting for a kind of device whose work-groups have at most so many work-items.
    pub(crate) fn of(kind: DeviceKind, max_group: usize) -> Self {
        match kind {
            DeviceKind::Cpu => Self::CPU,
            DeviceKind::Gpu | DeviceKind::Other => Self {
                wide_group: Self::GPU.wide_group.min(max_group),
                ..Self::GPU
            },
        }
    }

    /// As build options.
    pub(crate) fn defines(&self) -> String {
        format!(
            "-DGROUP={} -DWIDE_GROUP={} -DBRICK_GROUP={} -DLANES={} -DRUN={}",
            self.region_group, self.wide_group, self.brick_group, self.lanes, self.regions_in_run
        )
    }
}
