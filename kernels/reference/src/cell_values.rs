//! The data's values at a vertex of a coarser leaf: those of the active cell that holds it, or else of the nearest one next to that.

use std::collections::BTreeMap;

use crate::tree::LATTICE;

/// Smoothness and user feature of each active cell.
pub type CellValues = BTreeMap<[u32; 3], [f32; 2]>;

/// Squared distance from a position to a cell.
fn distance2(position: [i32; 3], cell: [i32; 3]) -> i32 {
    (0..3)
        .map(|axis| {
            let low = cell[axis] * LATTICE;
            let way = (low - position[axis]).max(position[axis] - low - LATTICE).max(0);
            way * way
        })
        .sum()
}

/// The values at a position. `dims`: samples of the volume along each axis; `position`: 1/[`LATTICE`] cell. `None`: no cell around is active.
pub fn at(cells: &CellValues, dims: [u32; 3], position: [i32; 3]) -> Option<[f32; 2]> {
    let centre: [i32; 3] = std::array::from_fn(|axis| (position[axis] / LATTICE).clamp(0, dims[axis] as i32 - 2));
    let value = |cell: [i32; 3]| {
        let cell = cell.map(u32::try_from);
        let [Ok(x), Ok(y), Ok(z)] = cell else { return None };
        cells.get(&[x, y, z]).copied()
    };
    if let Some(value) = value(centre) {
        return Some(value);
    }
    let around = (0..27).map(|i| [centre[0] + i % 3 - 1, centre[1] + i / 3 % 3 - 1, centre[2] + i / 9 - 1]);
    let active = around.filter_map(|cell| Some((distance2(position, cell), value(cell)?)));
    // Of several the first.
    active.min_by_key(|(distance, _)| *distance).map(|(_, value)| value)
}
