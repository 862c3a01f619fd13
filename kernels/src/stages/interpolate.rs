//! Values of a field at points.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::context::Context;
use crate::layout::Grid;
use crate::{Cancel, Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "interpolate";

kernel_args! {
    /// Arguments of `interpolate`.
    InterpolateArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// First layer of regions of the slab, counted in regions along z.
        first_layer: u32,
        /// Layer of regions after the last.
        end_layer: u32,
        /// The first point of this launch.
        first: u32,
        /// The point after the last.
        end: u32,
    }
}

/// Points of one launch: few enough that a cancellation is seen within 50 ms on a CPU of two cores.
const LAUNCH_POINTS: usize = 1 << 20;

/// Returns the values of a field at points in cells, trilinear between its samples; NaN beside missing samples. A point outside the volume
/// gets the value of the nearest point inside.
///
/// # Errors
/// [`crate::Error::Cancelled`], or an error of the device.
pub fn run(cx: &Context, volume: &Volume, points: &[[f32; 4]], cancel: &dyn Cancel) -> Result<Vec<f32>> {
    let kernel = cx.kernel(volume.sample_type, STAGE)?;
    let device_points = cx.upload(STAGE, points)?;
    let values = cx.buffer::<f32>(STAGE, points.len())?;
    for slab in &volume.slabs {
        for first in (0..points.len()).step_by(LAUNCH_POINTS) {
            let end = points.len().min(first + LAUNCH_POINTS);
            let args = InterpolateArgs {
                grid: volume.layout(),
                z0: slab.z0,
                first_layer: slab.layers.start,
                end_layer: slab.layers.end,
                first: first as u32,
                end: end as u32,
            };
            let groups = (end - first).div_ceil(BRICK_GROUP);
            cx.launch(
                STAGE,
                &kernel,
                groups,
                BRICK_GROUP,
                &[&args, &slab.samples, &device_points, &values],
            )?;
            cx.pause(STAGE, cancel)?;
        }
    }
    cx.read(STAGE, &values, points.len())
}
