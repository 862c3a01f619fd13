//! Where samples are, as the device knows it.

use isopeel_kernels::{Grid, RectilinearGrid};

use super::WorkError;
use crate::volumes::VolumeStep;

/// The grid of a dataset's samples on the device, padded by one sample on every side or not.
pub(super) fn padded_grid(volume: &VolumeStep, padded: bool) -> Result<RectilinearGrid, WorkError> {
    let dataset = volume.dataset();
    let dims = dataset.geometry.dims.map(|n| if padded { n + 2 } else { n });
    let grid = Grid::new(dims, dataset.cell_lengths().map(|s| s as f32))?;
    if dataset.uneven.is_none() {
        return Ok(grid.into());
    }
    let lengths = |along: Vec<f64>| along.windows(2).map(|pair| (pair[1] - pair[0]) as f32).collect();
    Ok(RectilinearGrid::uneven(grid, dataset.positions(padded).map(lengths))?)
}
