//! The bricks that an isovalue touches.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "activate";

kernel_args! {}

/// 64 bits a region, bricks in Morton order.
pub fn run(cx: &Context, volume: &Volume, iso: f32) -> Result<Vec<[u32; 2]>> {
    let regions = volume.table.len() / 64;
    let masks: Buffer<[u32; 2]> = cx.buffer(STAGE, regions)?;
    let kernel = |name| cx.kernel(volume.sample_type, name);
    cx.launch(
        STAGE,
        &kernel("activate")?,
        regions,
        BRICK_GROUP,
        &[&iso, &volume.table, &masks],
    )?;
    cx.read(STAGE, &masks, regions)
}
