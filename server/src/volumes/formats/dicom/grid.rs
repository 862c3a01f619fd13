//! What grids of images share: the elements that say where images are, and how far they may be from even places.

use super::super::header::GridFields;

/// How far an image may lie beside its place in the grid, in parts of the distance: positions are often written with one or two decimals.
pub const OFF_GRID: f64 = 0.1;

pub const POSITION: &str = "ImagePositionPatient";

pub const FIELDS: GridFields = GridFields {
    dims: "Rows, Columns",
    spacing: "PixelSpacing",
    origin: POSITION,
    direction: "ImageOrientationPatient",
};
