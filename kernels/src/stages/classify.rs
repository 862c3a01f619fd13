//! The active cells of every active brick, and the place of every node.

use super::args::kernel_args;
use super::{BRICK_GROUP, SlabWork};
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Brick, Grid, Region};
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "classify";

kernel_args! {
    /// Arguments of `classify`.
    ClassifyArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// Compact index of the first brick of this launch.
        first_brick: u32,
    }
}

/// Fills `bricks` (named by `list`: compact region times 64 plus Morton number) and the levels of `regions`.
pub fn run(
    cx: &Context,
    volume: &Volume,
    iso: f32,
    work: &[SlabWork<'_>],
    list: &Buffer<u32>,
    regions: &Buffer<Region>,
    bricks: &Buffer<Brick>,
) -> Result<()> {
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let grid = volume.layout();
    for slab in work {
        let args = ClassifyArgs {
            grid,
            z0: slab.z0,
            iso,
            first_brick: slab.bricks.start as u32,
        };
        cx.launch(
            STAGE,
            &kernel("classify")?,
            slab.bricks.len(),
            cx.tuning.brick_group,
            &[&args, slab.samples, list, regions, bricks],
        )?;
    }
    let count = regions.len() as u32;
    let groups = regions.len().div_ceil(BRICK_GROUP);
    cx.launch(
        STAGE,
        &kernel("arrange")?,
        groups,
        BRICK_GROUP,
        &[&count, regions, bricks],
    )
}
