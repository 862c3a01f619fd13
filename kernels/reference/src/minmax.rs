//! Minimum and maximum sample of every brick of 8³ cells, and which bricks touch a missing sample.

use crate::{Field, boxes, offset};
use isopeel_kernels::BRICK_CELLS;

/// Range of one brick: its 9³ samples, cut at the volume's end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrickRange {
    /// Minimum sample that is not missing; +∞ when all are.
    pub min: f32,
    /// Maximum sample that is not missing; −∞ when all are.
    pub max: f32,
    /// Whether any sample is missing.
    pub missing: bool,
}

/// Bricks along x, y, z, the last ones cut at the volume's end.
pub fn bricks(field: &Field) -> [u32; 3] {
    field.grid.cells().map(|c| c.div_ceil(BRICK_CELLS))
}

/// One range per brick, x fastest.
pub fn minmax(field: &Field) -> Vec<BrickRange> {
    boxes([0; 3], bricks(field))
        .map(|brick| {
            // Level 3 is the brick; its high sample is shared with the next one.
            let [low, high] = field.cube_samples(3, brick);
            let mut range = BrickRange {
                min: f32::INFINITY,
                max: f32::NEG_INFINITY,
                missing: false,
            };
            for v in boxes(low, offset(high, [1; 3])).map(|p| field.at(p)) {
                range.missing |= v.is_nan();
                range.min = range.min.min(v);
                range.max = range.max.max(v);
            }
            range
        })
        .collect()
}
