//! Which cells the surface crosses.

use std::collections::BTreeMap;

use crate::{Field, boxes};

/// Cells of one isovalue.
#[derive(Clone, Debug)]
pub struct Classes {
    /// Active cells with their corner signs. A cell is active when none of its corners is missing and they have both
    /// signs.
    pub active: BTreeMap<[u32; 3], u8>,
    /// For each cell, x fastest: whether it touches a missing sample.
    pub missing: Vec<bool>,
}

/// Corner signs, corner 0 lowest: inside means `value >= iso`; a missing value is outside.
pub fn signs(corners: [f32; 8], iso: f32) -> u8 {
    corners
        .iter()
        .enumerate()
        .fold(0, |bits, (b, &v)| bits | u8::from(v >= iso) << b)
}

/// Looks at every cell.
pub fn classify(field: &Field, iso: f32) -> Classes {
    let mut classes = Classes {
        active: BTreeMap::new(),
        missing: Vec::new(),
    };
    for cell in boxes([0; 3], field.grid.cells()) {
        let corners = field.cell_corners(cell);
        let missing = corners.iter().any(|v| v.is_nan());
        classes.missing.push(missing);
        let signs = signs(corners, iso);
        if !missing && signs != 0 && signs != 255 {
            classes.active.insert(cell, signs);
        }
    }
    classes
}
