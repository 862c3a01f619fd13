//! Constants of image grids: the elements that state the positions of images, and the largest allowed deviation from even positions.

use super::super::header::GridFields;

/// Maximum deviation of an image from its place in the grid, relative to the distance: positions often have only one or two decimals.
pub const OFF_GRID: f64 = 0.1;

pub const POSITION: &str = "ImagePositionPatient";

pub const FIELDS: GridFields = GridFields {
    dims: "Rows, Columns",
    spacing: "PixelSpacing",
    origin: POSITION,
    direction: "ImageOrientationPatient",
};
