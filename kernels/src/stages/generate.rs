//! Volumes made of formulas.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::Result;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::Grid;
use crate::program::Program;
use crate::synthetic::Synthetic;
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "generate";

kernel_args! {
    /// Arguments of `generate`.
    GenerateArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// First plane of this launch.
        first: u32,
        /// Planes of this launch.
        planes: u32,
        /// Formula, as `Shape::numbers`.
        shape: u32,
        /// Samples after which the formula repeats.
        period: f32,
        /// Balls along each axis.
        count: u32,
        /// 1: the outermost samples are below every surface.
        closed: u32,
        /// Stored is value * factor + offset.
        factor: f32,
        /// See `factor`.
        offset: f32,
    }
}

/// Maximum samples of one launch: its global size stays far below the limits of drivers.
const LAUNCH_SAMPLES: u64 = 1 << 30;

/// Fills a slab that holds `planes`; stored is `value * factor + offset`.
pub fn run(
    cx: &Context,
    program: &Program,
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
        let args = GenerateArgs {
            grid: *grid,
            z0: planes.start,
            first,
            planes: some,
            shape,
            period: synthetic.period,
            count,
            closed: synthetic.closed.into(),
            factor,
            offset,
        };
        cx.launch(
            STAGE,
            program.get("generate"),
            (plane * u64::from(some)).div_ceil(BRICK_GROUP as u64) as usize,
            BRICK_GROUP,
            &[&args, samples],
        )?;
    }
    Ok(())
}
