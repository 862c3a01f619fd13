//! The trilinear interpolant of a cell, in f64, and the surface's crossings with the cell's edges.

use crate::quadric::Vector;
use crate::{Field, offset};
use isopeel_kernels::tables::cube;

/// Gradient per cell and value of the trilinear interpolant of eight corners.
pub(crate) fn interpolate(v: [f64; 8], t: Vector) -> (Vector, f64) {
    let weight = |corner: usize, skip: usize| -> f64 {
        let up = cube::corner_offset(corner);
        (0..3)
            .filter(|&i| i != skip)
            .map(|i| if up[i] == 1 { t[i] } else { 1.0 - t[i] })
            .product()
    };
    let gradient = std::array::from_fn(|axis| {
        (0..8)
            .map(|c| v[c] * weight(c, axis) * if c >> axis & 1 == 1 { 1.0 } else { -1.0 })
            .sum()
    });
    (gradient, (0..8).map(|c| v[c] * weight(c, 3)).sum())
}

pub(crate) fn corners(field: &Field, cell: [u32; 3]) -> [f64; 8] {
    field.cell_corners(cell).map(f64::from)
}

/// Gradient per cell and value of the volume at `x`, in cells.
pub(crate) fn field_at(field: &Field, x: Vector) -> (Vector, f64) {
    let cell = cell_at(field, x);
    interpolate(corners(field, cell), std::array::from_fn(|i| x[i] - f64::from(cell[i])))
}

/// The cell that holds `x`, in cells, or the one next to it.
pub(crate) fn cell_at(field: &Field, x: Vector) -> [u32; 3] {
    std::array::from_fn(|i| (x[i] as u32).min(field.grid.dims[i] - 2))
}

/// Crossing of an edge of a cell with the isosurface, from the cell's low corner.
pub(crate) fn crossing(v: [f64; 8], iso: f32, edge: usize) -> Vector {
    let [low, high] = cube::edge_corners(edge);
    let t = (f64::from(iso) - v[low]) / (v[high] - v[low]);
    let mut at = cube::corner_offset(low).map(|c| c as f64);
    at[cube::edge_axis(edge)] += if t.is_nan() { 0.5 } else { t.clamp(0.0, 1.0) };
    at
}

/// Slope of the samples along an axis, per cell: central difference, one-sided at the volume's border and beside a missing sample.
fn slope(field: &Field, sample: [u32; 3], axis: usize) -> f64 {
    let value = |to: Option<u32>| match to {
        Some(to) if to < field.grid.dims[axis] => {
            let mut at = sample;
            at[axis] = to;
            f64::from(field.at(at))
        }
        _ => f64::NAN,
    };
    let here = f64::from(field.at(sample));
    let (down, up) = (
        here - value(sample[axis].checked_sub(1)),
        value(sample[axis].checked_add(1)) - here,
    );
    match (down.is_nan(), up.is_nan()) {
        (false, false) => (down + up) / 2.0,
        (false, true) => down,
        (true, _) => up,
    }
}

/// Gradient per cell on an edge of a cell, at `t` of it: along the edge the difference of its ends, across it their slopes, interpolated.
/// Inside the volume this is the mean over the interpolants of the four cells around the edge.
pub(crate) fn edge_gradient(field: &Field, cell: [u32; 3], edge: usize, t: f64) -> Vector {
    let [low, high] =
        cube::edge_corners(edge).map(|corner| offset(cell, cube::corner_offset(corner).map(|d| d as u32)));
    std::array::from_fn(|axis| {
        if axis == cube::edge_axis(edge) {
            return f64::from(field.at(high)) - f64::from(field.at(low));
        }
        let (from, to) = (slope(field, low, axis), slope(field, high, axis));
        from + (to - from) * t
    })
}
