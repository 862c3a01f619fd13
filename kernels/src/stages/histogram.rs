//! Range and 256 bins of a field or of a derived feature.

use super::args::kernel_args;
use crate::layout::Grid;
use super::BRICK_GROUP;
use crate::context::Context;
use crate::volume::Slab;
use crate::{Feature, Histogram, REGION_CELLS, Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "histogram";

kernel_args! {
    /// Arguments of `histogram_range`.
    HistogramRangeArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// `FEATURE_NONE` for the samples themselves, or the number of a derived feature.
        kind: u32,
        /// First plane of this launch.
        first_plane: u32,
        /// Samples of this launch.
        count: u32,
    }
    /// Arguments of `histogram_bins`.
    HistogramBinsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// `FEATURE_NONE` for the samples themselves, or the number of a derived feature.
        kind: u32,
        /// First plane of this launch.
        first_plane: u32,
        /// Samples of this launch.
        count: u32,
        /// Minimum of the range.
        lo: f32,
        /// Maximum of the range.
        hi: f32,
    }
}

/// Work-groups of one launch: enough for a large GPU, few enough that a CPU reads long runs.
const GROUPS: usize = 1024;

/// Samples of one launch at most, so that 32-bit counters hold.
const LAUNCH_SAMPLES: u64 = 1 << 31;

/// Runs of planes `(slab, first, samples)` that together hold every sample once.
fn runs(volume: &Volume) -> Vec<(&Slab, u32, u32)> {
    let grid = volume.grid;
    let plane = u64::from(grid.dims[0]) * u64::from(grid.dims[1]);
    let step = (LAUNCH_SAMPLES / plane).max(1) as u32;
    let mut runs = Vec::new();
    for slab in &volume.slabs {
        // The last layer also owns the planes after its last cell.
        let end = (slab.layers.end * REGION_CELLS).min(grid.dims[2]);
        let end = if slab.layers.end == grid.regions()[2] {
            grid.dims[2]
        } else {
            end
        };
        let mut first = slab.layers.start * REGION_CELLS;
        while first < end {
            let next = (first + step).min(end);
            runs.push((slab, first, ((next - first) as u64 * plane) as u32));
            first = next;
        }
    }
    runs
}

/// Range over finite values, then the bins.
pub fn run(cx: &Context, volume: &Volume, feature: Feature<'_>) -> Result<Histogram> {
    let kernels = cx.kernels(volume.sample_type)?;
    let grid = volume.layout();
    let kind = feature.kind();
    let (mut lo, mut hi) = (f32::INFINITY, f32::NEG_INFINITY);
    let ranges = cx.buffer::<[f32; 2]>(STAGE, GROUPS)?;
    for (slab, first, count) in runs(volume) {
        let args = HistogramRangeArgs {
            grid,
            z0: slab.z0,
            kind,
            first_plane: first,
            count,
        };
        let kernel = kernels.get("histogram_range");
        cx.launch(STAGE, kernel, GROUPS, BRICK_GROUP, &[&args, &slab.samples, &ranges])?;
        for [low, high] in cx.read(STAGE, &ranges, GROUPS)? {
            lo = lo.min(low);
            hi = hi.max(high);
        }
    }
    if lo > hi {
        return Ok(Histogram {
            range: [0.0, 0.0],
            bins: vec![0; 256],
        });
    }
    let mut bins = vec![0u64; 256];
    for (slab, first, count) in runs(volume) {
        let counters = cx.zeroed::<u32>(STAGE, 256)?;
        let args = HistogramBinsArgs {
            grid,
            z0: slab.z0,
            kind,
            first_plane: first,
            count,
            lo,
            hi,
        };
        cx.launch(
            STAGE,
            kernels.get("histogram_bins"),
            GROUPS,
            BRICK_GROUP,
            &[&args, &slab.samples, &counters],
        )?;
        for (bin, count) in bins.iter_mut().zip(cx.read(STAGE, &counters, 256)?) {
            *bin += u64::from(count);
        }
    }
    Ok(Histogram { range: [lo, hi], bins })
}
