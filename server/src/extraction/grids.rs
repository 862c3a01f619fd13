//! Where samples are, as the device knows it.

use isopeel_kernels::{Grid, RectilinearGrid};

use super::WorkError;
use crate::volumes::VolumeStep;

/// The grid of a dataset's samples on the device, padded by one sample on every side or not.
pub(super) fn padded_grid(volume: &VolumeStep, padded: bool) -> Result<RectilinearGrid, WorkError> {
    let dataset = volume.dataset();
    let dims = dataset.geometry.dims.map(|n| if padded { n + 2 } else { n });
    let grid = Grid::new(dims, dataset.cell_lengths().map(|s| s as f32))?;
    let Some(uneven) = &dataset.uneven else {
        return Ok(grid.into());
    };
    let uneven = if padded { &uneven.padded() } else { &**uneven };
    let along = |axis: usize| {
        let spacing = dataset.geometry.spacing[axis];
        match uneven.of_axis(axis) {
            Some(even) => even
                .windows(2)
                .map(|pair| ((pair[1] - pair[0]) * spacing) as f32)
                .collect(),
            None => vec![spacing as f32; dims[axis] as usize - 1],
        }
    };
    Ok(RectilinearGrid::uneven(grid, [along(0), along(1), along(2)])?)
}
