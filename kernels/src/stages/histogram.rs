//! Range and 256 bins of a field or of a derived feature.

use super::args::kernel_args;
use super::{BRICK_GROUP, derive};
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::Grid;
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
        /// `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
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
        /// `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
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

/// The same where `derive` computes the values of a launch before: 64 MiB of them.
const DERIVED_SAMPLES: u64 = 1 << 24;

/// Runs of planes `(slab, first, planes)` of so many samples that together hold every sample once. Each begins at a multiple of `unit`.
fn runs(volume: &Volume, samples: u64, unit: u32) -> Vec<(&Slab, u32, u32)> {
    let grid = volume.grid;
    let plane = u64::from(grid.dims[0]) * u64::from(grid.dims[1]);
    let step = ((samples / plane) as u32 / unit * unit).max(unit);
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
            runs.push((slab, first, next - first));
            first = next;
        }
    }
    runs
}

/// What the kernels read in one launch.
struct Launch<'a> {
    grid: Grid,
    /// `FEATURE_NONE`, `FEATURE_GRADIENT` or `FEATURE_STORED`.
    kind: u32,
    slab: &'a Slab,
    first_plane: u32,
    count: u32,
    /// In place of the slab's samples.
    values: Option<Buffer<f32>>,
}

impl Launch<'_> {
    fn samples(&self) -> &dyn Arg {
        match &self.values {
            Some(values) => values,
            None => &self.slab.samples,
        }
    }
}

/// Calls `each` for every launch, with the values of `derive` where it computes the feature.
fn for_each_launch(
    cx: &Context,
    volume: &Volume,
    feature: Feature<'_>,
    mut each: impl FnMut(&Launch<'_>) -> Result<()>,
) -> Result<()> {
    let source = derive::Source::of(volume, feature);
    let plane = volume.grid.dims[0] * volume.grid.dims[1];
    let (samples, unit) = if source.is_some() {
        (DERIVED_SAMPLES, 8)
    } else {
        (LAUNCH_SAMPLES, 1)
    };
    for (slab, first, planes) in runs(volume, samples, unit) {
        let values = source
            .as_ref()
            .map(|source| derive::samples(cx, source, volume, slab, first, planes))
            .transpose()?;
        each(&Launch {
            grid: volume.layout(),
            kind: feature.kind_after_derive(volume),
            slab,
            first_plane: first,
            count: planes * plane,
            values,
        })?;
    }
    Ok(())
}

/// Range over finite values, then the bins.
pub fn run(cx: &Context, volume: &Volume, feature: Feature<'_>) -> Result<Histogram> {
    let (mut lo, mut hi) = (f32::INFINITY, f32::NEG_INFINITY);
    let ranges = cx.buffer::<[f32; 2]>(STAGE, GROUPS)?;
    for_each_launch(cx, volume, feature, |launch| {
        let args = HistogramRangeArgs {
            grid: launch.grid,
            z0: launch.slab.z0,
            kind: launch.kind,
            first_plane: launch.first_plane,
            count: launch.count,
        };
        let kernel = &cx.kernel(volume.sample_type, "histogram_range")?;
        cx.launch(STAGE, kernel, GROUPS, BRICK_GROUP, &[&args, launch.samples(), &ranges])?;
        for [low, high] in cx.read(STAGE, &ranges, GROUPS)? {
            lo = lo.min(low);
            hi = hi.max(high);
        }
        Ok(())
    })?;
    let mut bins = vec![0u64; 256];
    if lo > hi {
        return Ok(Histogram {
            range: [0.0, 0.0],
            bins,
        });
    }
    for_each_launch(cx, volume, feature, |launch| {
        let counters = cx.zeroed::<u32>(STAGE, 256)?;
        let args = HistogramBinsArgs {
            grid: launch.grid,
            z0: launch.slab.z0,
            kind: launch.kind,
            first_plane: launch.first_plane,
            count: launch.count,
            lo,
            hi,
        };
        let kernel = &cx.kernel(volume.sample_type, "histogram_bins")?;
        cx.launch(
            STAGE,
            kernel,
            GROUPS,
            BRICK_GROUP,
            &[&args, launch.samples(), &counters],
        )?;
        for (bin, count) in bins.iter_mut().zip(cx.read(STAGE, &counters, 256)?) {
            *bin += u64::from(count);
        }
        Ok(())
    })?;
    Ok(Histogram { range: [lo, hi], bins })
}
