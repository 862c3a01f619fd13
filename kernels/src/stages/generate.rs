//! Volumes made of formulas.

use super::BRICK_GROUP;
use crate::Result;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::Grid;
use crate::program::Kernels;
use crate::synthetic::Synthetic;
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "generate";

/// Samples of one launch at most: places in a launch stay far from what drivers allow.
const LAUNCH_SAMPLES: u64 = 1 << 30;

/// Fills a slab that holds `planes`; stored is `value * factor + offset`.
pub fn run(
    cx: &Context,
    kernels: &Kernels,
    grid: &Grid,
    synthetic: &Synthetic,
    [factor, offset]: [f32; 2],
    samples: &Buffer<u8>,
    planes: Range<u32>,
) -> Result<()> {
    let plane = u64::from(grid.dims[0]) * u64::from(grid.dims[1]);
    let step = (LAUNCH_SAMPLES / plane).max(1) as u32;
    let (shape, count) = synthetic.shape.numbers();
    for first in planes.clone().step_by(step as usize) {
        let some = step.min(planes.end - first);
        cx.launch(
            STAGE,
            kernels.get("generate"),
            (plane * u64::from(some)).div_ceil(BRICK_GROUP as u64) as usize,
            BRICK_GROUP,
            &[
                grid,
                samples,
                &planes.start,
                &first,
                &some,
                &shape,
                &synthetic.period,
                &count,
                &u32::from(synthetic.closed),
                &factor,
                &offset,
            ],
        )?;
    }
    Ok(())
}
