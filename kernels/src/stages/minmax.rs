//! Least and greatest sample of every brick, once per volume and step.

use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::Grid;
use crate::program::brick_group;
use crate::volume::Slab;
use crate::{Result, SampleType};

/// Name of the stage.
pub const STAGE: &str = "minmax";

/// Fills the part of `table` and `missing_masks` (zero before) that `slab` serves.
pub fn run(
    cx: &Context,
    sample_type: SampleType,
    grid: &Grid,
    slab: &Slab,
    table: &Buffer<[f32; 2]>,
    missing_masks: &Buffer<[u32; 2]>,
) -> Result<()> {
    let layer = grid.regions[0] as usize * grid.regions[1] as usize;
    let first_region = (slab.layers.start as usize * layer) as u32;
    cx.launch(
        STAGE,
        cx.kernels(sample_type)?.get("minmax"),
        slab.layers.len() * layer * 16,
        brick_group(cx.found.info.kind),
        &[grid, &slab.samples, &slab.z0, &first_region, table, missing_masks],
    )
}
