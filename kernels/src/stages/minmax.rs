//! Minimum and maximum sample of every brick, once per volume and step.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::Grid;
use crate::volume::Slab;
use crate::{Result, SampleType};

/// Name of the stage.
pub const STAGE: &str = "minmax";

kernel_args! {
    /// Arguments of `minmax`.
    MinmaxArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// First layer of regions of this launch, counted in regions along z.
        first_layer: u32,
    }
}

/// Fills the part of `table` and `missing_masks` (zero before) that `slab` serves.
pub fn run(
    cx: &Context,
    sample_type: SampleType,
    grid: &Grid,
    slab: &Slab,
    table: &Buffer<[f32; 2]>,
    missing_masks: &Buffer<[u32; 2]>,
) -> Result<()> {
    let runs = (grid.regions[0] as usize).div_ceil(cx.tuning.regions_in_run) * grid.regions[1] as usize;
    let args = MinmaxArgs {
        grid: *grid,
        z0: slab.z0,
        first_layer: slab.layers.start,
    };
    cx.launch(
        STAGE,
        &cx.kernel(sample_type, "minmax")?,
        slab.layers.len() * runs * 16,
        cx.tuning.brick_group,
        &[&args, &slab.samples, table, missing_masks],
    )
}
