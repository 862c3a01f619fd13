//! Samples of a plane of the volume.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::context::Context;
use crate::layout::Grid;
use crate::{REGION_CELLS, Result, Volume};
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "slice";

kernel_args! {
    /// Arguments of `slice`.
    SliceArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Axis across the plane.
        axis: u32,
        /// Of the plane along it.
        index: u32,
        /// Samples of a row.
        width: u32,
        /// The first row of this launch.
        first_row: u32,
        /// Samples of this launch.
        count: u32,
    }
}

/// Returns the bytes of the plane's samples in the order of the device: the lower of the two axes in the plane is fastest.
pub fn run(cx: &Context, volume: &Volume, axis: usize, index: u32) -> Result<Vec<u8>> {
    let [nx, ny, nz] = volume.grid.dims;
    let (width, rows) = [(ny, nz), (nx, nz), (nx, ny)][axis];
    let out = cx.buffer::<u8>(STAGE, width as usize * rows as usize * volume.sample_type.bytes())?;
    let kernel = |name| cx.kernel(volume.sample_type, name);
    for slab in &volume.slabs {
        let planes = own_planes(volume, &slab.layers);
        // For a plane across z, a slab has all rows or none.
        let rows = match axis {
            2 if planes.contains(&index) => 0..rows,
            2 => continue,
            _ => planes,
        };
        let count = width * rows.len() as u32;
        let args = SliceArgs {
            grid: volume.layout(),
            z0: slab.z0,
            axis: axis as u32,
            index,
            width,
            first_row: rows.start,
            count,
        };
        let groups = (count as usize).div_ceil(BRICK_GROUP);
        cx.launch(
            STAGE,
            &kernel("slice")?,
            groups,
            BRICK_GROUP,
            &[&args, &slab.samples, &out],
        )?;
    }
    cx.read(STAGE, &out, out.len())
}

/// Returns the planes along z that a slab owns; the last layer also owns the planes after its last cell.
pub(super) fn own_planes(volume: &Volume, layers: &Range<u32>) -> Range<u32> {
    let last = volume.grid.dims[2];
    let is_last = layers.end == volume.grid.regions()[2];
    let end = if is_last {
        last
    } else {
        (layers.end * REGION_CELLS).min(last)
    };
    layers.start * REGION_CELLS..end
}
