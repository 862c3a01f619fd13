//! The surface next to a position.

use crate::Pyramid;
use crate::cut::{blended_feature, importance_of};
use crate::interest::{CellBox, raise};
use isopeel_kernels::CutParams;

/// Cells along an axis, to each side of the one that holds the position.
const REACH: i64 = 2;

/// The active cell whose vertex is nearest to a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestCell {
    /// Which one.
    pub cell: [u32; 3],
    /// From the position to its vertex, world units.
    pub distance: f32,
    /// Smoothness and user feature, blended.
    pub blended: f32,
    /// Importance at its vertex.
    pub importance: f32,
    /// Another cell is equally near within rounding: a device may find that one.
    pub has_equal: bool,
}

/// Looks at the cells around a position, in index space. `vertex`: of an active cell, in index space.
pub fn nearest_cell(
    pyramid: &Pyramid,
    spacing: [f32; 3],
    params: &CutParams,
    position: [f32; 3],
    vertex: impl Fn([u32; 3]) -> [f32; 3],
) -> Option<NearestCell> {
    let centre: [i64; 3] = std::array::from_fn(|i| (position[i] as i64).min(i64::from(pyramid.dims[i]) - 2));
    let is_near = |cell: &[u32; 3]| (0..3).all(|i| (i64::from(cell[i]) - centre[i]).abs() <= REACH);
    let distance = |cell: [u32; 3]| {
        let at = vertex(cell);
        let squares = (0..3).map(|i| ((at[i] - position[i]) * spacing[i]).powi(2));
        squares.sum::<f32>().sqrt()
    };
    let near: Vec<[u32; 3]> = pyramid.cells.keys().copied().filter(is_near).collect();
    let cell = near
        .iter()
        .copied()
        .min_by(|&a, &b| distance(a).total_cmp(&distance(b)))?;
    let equals = near
        .iter()
        .filter(|&&other| distance(other) <= distance(cell) * (1.0 + 1e-5));
    let has_equal = equals.count() > 1;
    let node = &pyramid.nodes[0][&cell];
    let own = importance_of(node.s, node.f, params);
    Some(NearestCell {
        cell,
        distance: distance(cell),
        blended: blended_feature(node.s, node.f, params),
        importance: raise(own, params, CellBox::point(vertex(cell))),
        has_equal,
    })
}
