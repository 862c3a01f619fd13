//! Positions of samples as the device knows them.

use isopeel_kernels::{Grid, RectilinearGrid};
use isopeel_volumes::VolumeStep;

use super::WorkError;

/// The grid of a dataset's samples on the device, padded by one sample on every side or not. Its unit of length is the smallest cell of the
/// dataset ([`Dataset::smallest_length`](isopeel_volumes::Dataset::smallest_length)): surfaces, errors and tolerances on the device are the same
/// whatever the spacing is, and neither squares nor inverses of it leave the range of 32 bits.
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
