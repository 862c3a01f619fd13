//! Fields that are computed from others by an expression.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::Grid;
use crate::program::Program;
use crate::{Cancel, Result};
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "evaluate";

kernel_args! {
    /// Arguments of `evaluate`.
    EvaluateArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// First plane of this launch.
        first: u32,
        /// Planes of this launch.
        planes: u32,
        /// Samples of the first field equal to this count as NaN.
        missing_0: f32,
        /// Of the second one.
        missing_1: f32,
        /// Of the third one.
        missing_2: f32,
        /// Of the fourth one.
        missing_3: f32,
        /// Of the fifth one.
        missing_4: f32,
        /// Of the sixth one.
        missing_5: f32,
        /// Of the seventh one.
        missing_6: f32,
        /// Of the eighth one.
        missing_7: f32,
    }
}

/// Samples of one launch at most: on a CPU it ends within some 50 ms, for whoever has a turn after it.
const LAUNCH_SAMPLES: u64 = 1 << 23;

/// Fills a slab that holds `planes`. `fields`: the samples of each field in the slab, and the value of missing ones; eight of them.
pub fn run(
    cx: &Context,
    program: &Program,
    grid: &Grid,
    fields: [(&Buffer<u8>, f32); 8],
    out: &Buffer<u8>,
    planes: Range<u32>,
    cancel: &dyn Cancel,
) -> Result<()> {
    let plane = u64::from(grid.dims[0]) * u64::from(grid.dims[1]);
    let step = (LAUNCH_SAMPLES / plane).max(1) as u32;
    let missing = fields.map(|(_, missing)| missing);
    for first in planes.clone().step_by(step as usize) {
        let some = step.min(planes.end - first);
        let args = EvaluateArgs {
            grid: *grid,
            z0: planes.start,
            first,
            planes: some,
            missing_0: missing[0],
            missing_1: missing[1],
            missing_2: missing[2],
            missing_3: missing[3],
            missing_4: missing[4],
            missing_5: missing[5],
            missing_6: missing[6],
            missing_7: missing[7],
        };
        let mut all: Vec<&dyn Arg> = vec![&args];
        all.extend(fields.iter().map(|(samples, _)| *samples as &dyn Arg));
        all.push(out);
        let groups = (plane * u64::from(some)).div_ceil(BRICK_GROUP as u64) as usize;
        cx.launch(STAGE, program.get("evaluate"), groups, BRICK_GROUP, &all)?;
        cx.pause(STAGE, cancel)?;
    }
    Ok(())
}
