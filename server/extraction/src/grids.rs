//! Positions of samples as the device knows them.

use isopeel_kernels::{Grid, RectilinearGrid};
use isopeel_volumes::VolumeStep;

use super::WorkError;

/// Returns the grid of a dataset's samples on the device. `padded`: whether one sample is added on every side.
///
/// The unit of length is the smallest cell of the dataset ([`Dataset::smallest_length`](isopeel_volumes::Dataset::smallest_length)). So
/// surfaces, errors and tolerances on the device do not depend on the unit of the spacing, and neither squares nor inverses of lengths
/// leave the range of 32 bits.
///
/// # Errors
/// The kernels do not support a grid of this size.
pub fn padded_grid(volume: &VolumeStep, padded: bool) -> Result<RectilinearGrid, WorkError> {
    let dataset = volume.dataset();
    let dims = dataset.geometry.dims.map(|n| if padded { n + 2 } else { n });
    let unit = dataset.smallest_length();
    let grid = Grid::new(dims, dataset.cell_lengths().map(|length| (length / unit) as f32))?;
    if dataset.uneven.is_none() {
        return Ok(grid.into());
    }
    let lengths = |along: Vec<f64>| {
        let pairs = along.windows(2);
        pairs.map(|pair| ((pair[1] - pair[0]) / unit) as f32).collect()
    };
    Ok(RectilinearGrid::uneven(grid, dataset.positions(padded).map(lengths))?)
}
