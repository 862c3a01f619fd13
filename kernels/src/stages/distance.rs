//! Distances of points to the isosurface.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::context::Context;
use crate::layout::Grid;
use crate::{Cancel, Pyramid, Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "distance";

kernel_args! {
    /// Arguments of `distance_points`.
    DistanceArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
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
const LAUNCH_POINTS: usize = 1 << 17;

/// Returns the distances of points to the isosurface, in world units; infinite if the isosurface is not near. `points` are in cells.
///
/// # Errors
/// [`crate::Error::Cancelled`], or an error of the device.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    points: &[[f32; 4]],
    cancel: &dyn Cancel,
) -> Result<Vec<f32>> {
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let device_points = cx.upload(STAGE, points)?;
    let distances = cx.buffer::<f32>(STAGE, points.len())?;
    for slab in &volume.slabs {
        for first in (0..points.len()).step_by(LAUNCH_POINTS) {
            let end = points.len().min(first + LAUNCH_POINTS);
            let args = DistanceArgs {
                grid: volume.layout(),
                z0: slab.z0,
                iso: pyramid.iso,
                first_layer: slab.layers.start,
                end_layer: slab.layers.end,
                first: first as u32,
                end: end as u32,
            };
            cx.launch(
                STAGE,
                &kernel("distance_points")?,
                (end - first).div_ceil(BRICK_GROUP * cx.tuning.lanes),
                BRICK_GROUP,
                &[
                    &args,
                    &slab.samples,
                    &pyramid.region_index,
                    &pyramid.regions,
                    &pyramid.bricks,
                    &pyramid.vertex_records,
                    &device_points,
                    &distances,
                ],
            )?;
            cx.pause(STAGE, cancel)?;
        }
    }
    cx.read(STAGE, &distances, points.len())
}
