//! Regions of interest, which raise importance (docs/algorithm.md#44-regions-of-interest).

use isopeel_kernels::{CutParams, Interest, InterestShape};

/// A box of cells, from corner to corner in index space; a point if both corners are the same.
#[derive(Clone, Copy, Debug)]
pub struct CellBox {
    /// The corner at the origin's side.
    pub low: [f32; 3],
    /// The other one.
    pub high: [f32; 3],
}

impl CellBox {
    /// A point.
    pub fn point(at: [f32; 3]) -> Self {
        Self { low: at, high: at }
    }

    /// A cube of a level in a volume of `dims` samples, cut off at the last sample.
    pub fn cube(level: u8, cube: [u32; 3], dims: [u32; 3]) -> Self {
        let end = |i: usize| ((cube[i] + 1) << level).min(dims[i] - 1);
        Self {
            low: cube.map(|c| (c << level) as f32),
            high: std::array::from_fn(|i| end(i) as f32),
        }
    }
}

/// Whether a box meets a region of interest. In the frame of the region's unit ball or cube, the box is replaced by its bounding box along
/// the frame's axes.
pub fn meets(interest: &Interest, cells: CellBox) -> bool {
    let distance = |row: [f32; 3]| {
        let mut at = 0.0;
        let mut reach = 0.0;
        for (i, of_axis) in row.into_iter().enumerate() {
            at += of_axis * (0.5 * (cells.low[i] + cells.high[i]) - interest.centre[i]);
            reach += of_axis.abs() * (0.5 * (cells.high[i] - cells.low[i]));
        }
        (at.abs() - reach).max(0.0)
    };
    let distances = interest.rows.map(distance);
    match interest.shape {
        InterestShape::Cube => distances.iter().all(|&d| d <= 1.0),
        InterestShape::Ball => distances.iter().map(|d| d * d).sum::<f32>() <= 1.0,
    }
}

/// An importance, or that of a region of interest that the box meets, if that is greater.
pub fn raise(importance: f32, params: &CutParams, cells: CellBox) -> f32 {
    let met = params.interest.iter().filter(|interest| meets(interest, cells));
    met.fold(importance, |highest, interest| highest.max(interest.importance))
}
