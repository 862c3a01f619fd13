//! Minimum and maximum sample of every brick, once per volume and step.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::Grid;
use crate::volume::Slab;
use crate::{Result, SampleType};
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "minmax";

kernel_args! {
    /// Arguments of `minmax`.
    MinmaxArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// First row of bricks' regions of this launch, counted in runs along x, then y, then z.
        first_run: u32,
    }
}

/// Number of runs of regions along x in `layers` layers of regions.
pub fn runs(cx: &Context, grid: &Grid, layers: u32) -> u32 {
    grid.regions[0].div_ceil(cx.tuning.regions_in_run as u32) * grid.regions[1] * layers
}

/// Fills the entries of `table` and `missing_masks` that belong to these runs of a slab. The masks must be zero before. Runs are
/// counted from the volume's first one.
pub fn run(
    cx: &Context,
    sample_type: SampleType,
    grid: &Grid,
    slab: &Slab,
    runs: Range<u32>,
    table: &Buffer<[f32; 2]>,
    missing_masks: &Buffer<[u32; 2]>,
) -> Result<()> {
    let args = MinmaxArgs {
        grid: *grid,
        z0: slab.z0,
        first_run: runs.start,
    };
    cx.launch(
        STAGE,
        &cx.kernel(sample_type, "minmax")?,
        runs.len() * 16,
        cx.tuning.brick_group,
        &[&args, &slab.samples, table, missing_masks],
    )
}
