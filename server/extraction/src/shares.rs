//! Shares of memory for cached data of earlier edits that makes the next edits faster: pyramids, vertex trees, cuts and freed buffers.

use isopeel_kernels::DeviceKind;

/// Share of the device's memory for pyramids, in thousandths. Pyramids of the latest isovalues of all viewers are cached, because edits of
/// α, β and the transfer function reuse them.
const PYRAMIDS: u64 = 150;

/// Share for vertex trees, in thousandths. Trees are larger than pyramids, but are made only for viewers at rest and for surfaces that an
/// error or a budget decides.
const TREES: u64 = 100;

/// Share for cuts, in thousandths. It is small, because a cut takes one byte a node, and a pyramid 40.
const CUTS: u64 = 20;

/// Share for freed buffers, in thousandths. Reusing a buffer in the next edit is faster than allocating pages, which the system has to
/// clear.
const IDLE: u64 = 63;

/// Share of all four caches, in thousandths.
const TOTAL: u64 = PYRAMIDS + TREES + CUTS + IDLE;

/// Maximum bytes of these four caches together if the device is this machine's processors, unless `--surface-memory` sets another limit.
/// For the demo (197 × 233 × 189 samples) the caches hold pyramids of 70 isovalues and trees of eight. Without this limit, each new
/// isovalue would let the server grow, up to a third of the machine's memory, which other programs use too.
pub const PROCESSOR_BYTES: u64 = 1 << 30;

/// Maximum bytes of each cache. The most recently used entries of a cache stay even if they take more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shares {
    pub pyramids: u64,
    pub trees: u64,
    pub cuts: u64,
    pub idle: u64,
}

impl Shares {
    /// Returns the maximum bytes of all four caches together.
    pub(crate) fn total(&self) -> u64 {
        self.pyramids + self.trees + self.cuts + self.idle
    }

    /// Returns the shares of a device with `device_bytes` of memory, in a process that may hold `host_bytes`. `limit`: the value of
    /// `--surface-memory`, which limits all four caches together.
    pub(crate) fn of(kind: DeviceKind, device_bytes: u64, host_bytes: u64, limit: Option<u64>) -> Self {
        let (memory, limit) = match kind {
            // Caches shrink if the process may hold less memory than the machine has.
            DeviceKind::Cpu => (device_bytes.min(host_bytes), limit.unwrap_or(PROCESSOR_BYTES)),
            _ => (device_bytes, limit.unwrap_or(u64::MAX)),
        };
        // Divides first, because the product could overflow.
        let total = (memory / 1000 * TOTAL).min(limit);
        let share = |thousandths| total / TOTAL * thousandths;
        Self {
            pyramids: share(PYRAMIDS),
            trees: share(TREES),
            cuts: share(CUTS),
            idle: share(IDLE),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GB: u64 = 1_000_000_000;

    #[test]
    fn processors_keep_a_gibibyte_however_much_the_machine_has() {
        let large = Shares::of(DeviceKind::Cpu, 1000 * GB, 1000 * GB, None);
        assert_eq!(large, Shares::of(DeviceKind::Cpu, 24 * GB, 24 * GB, None));
        assert!(
            large.total() <= PROCESSOR_BYTES && large.total() > PROCESSOR_BYTES - 1000,
            "{large:?}"
        );
        assert!(
            large.pyramids * 2 == large.trees * 3 && large.cuts * 5 == large.trees,
            "{large:?}"
        );
    }

    #[test]
    fn a_small_machine_or_container_keeps_a_share_of_what_it_has() {
        let small = Shares::of(DeviceKind::Cpu, 24 * GB, GB, None);
        assert_eq!(
            (small.pyramids, small.trees, small.cuts),
            (GB * 15 / 100, GB / 10, GB / 50)
        );
        assert_eq!(small, Shares::of(DeviceKind::Cpu, GB, u64::MAX, None));
        // More than that is not kept, whatever was asked for.
        assert_eq!(small, Shares::of(DeviceKind::Cpu, 24 * GB, GB, Some(u64::MAX)));
    }

    #[test]
    fn a_gpu_keeps_shares_of_its_own_memory() {
        let gpu = Shares::of(DeviceKind::Gpu, 80 * GB, GB, None);
        assert_eq!((gpu.pyramids, gpu.trees), (12 * GB, 8 * GB));
        // As much as was there before there were shares, a sixteenth, and no less.
        assert!(gpu.idle >= 5 * GB, "{gpu:?}");
    }

    #[test]
    fn who_sets_a_limit_gets_it_on_every_device() {
        for kind in [DeviceKind::Cpu, DeviceKind::Gpu] {
            let more = Shares::of(kind, 80 * GB, 80 * GB, Some(4 * GB)).total();
            assert!(more <= 4 * GB && more > 4 * GB - 1000, "{kind:?}: {more}");
            assert_eq!(Shares::of(kind, 80 * GB, 80 * GB, Some(0)).total(), 0, "{kind:?}");
        }
    }
}
