//! Dual contouring: a polygon for every minimal edge of the cut that changes sign
//! (docs/algorithm.md#65-minimal-edges-and-polygons).

use std::collections::{BTreeMap, BTreeSet};

use crate::vertices::DualVertices;
use crate::{Cut, Field, Leaf, Pyramid};

/// A vertex of the dual mesh: a leaf, which of its sheets, and, of a vertex on the border, the volume's faces that it is
/// moved onto: bit 2 axis + side.
pub type Corner = (Leaf, u8, u8);

/// An edge of a cube: level, low end in cells, axis.
pub type CubeEdge = (u8, [u32; 3], u8);

/// The polygon around each minimal edge, counter-clockwise seen from the side of lower values: three or four different
/// corners. A cube beyond the volume's end is replaced by the border vertex of its mirror image inside. If missing samples make
/// a cube around the edge inactive, there is no polygon.
pub fn polygons(
    field: &Field,
    pyramid: &Pyramid,
    vertices: &DualVertices,
    iso: f32,
    cut: &Cut,
) -> BTreeMap<CubeEdge, Vec<Corner>> {
    let mut edges = BTreeSet::new();
    for leaf in cut.leaves.keys() {
        for edge in 0..12u32 {
            let (axis, u, v) = (edge / 4, edge & 1, edge >> 1 & 1);
            let mut cube = leaf.cube;
            cube[(axis as usize + 1) % 3] += u;
            cube[(axis as usize + 2) % 3] += v;
            edges.insert((leaf.level, cube.map(|c| c << leaf.level), axis as u8));
        }
    }
    let polygon = |(level, low, axis): CubeEdge| -> Option<Vec<Corner>> {
        let (a, b, c) = (
            usize::from(axis),
            (usize::from(axis) + 1) % 3,
            (usize::from(axis) + 2) % 3,
        );
        let mut corners: Vec<Corner> = Vec::new();
        // Counter-clockwise seen from the high end.
        for [u, v] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
            let mut cube = low.map(|x| x >> level);
            let mut faces = 0;
            let mut inside = [u, v];
            for (axis, step) in [b, c].into_iter().zip(&mut inside) {
                let high = low[axis] + 1 >= field.grid.dims[axis];
                if (*step == 1 && low[axis] == 0) || (*step == 0 && high) {
                    *step = 1 - *step;
                    faces |= 1 << (2 * axis + usize::from(high));
                }
                cube[axis] -= *step;
            }
            let [u, v] = inside;
            pyramid.nodes[usize::from(level)].get(&cube)?;
            let covers = (level..=5).map(|l| Leaf {
                level: l,
                cube: cube.map(|x| x >> (l - level)),
            });
            // If no leaf covers the cube, finer ones are below: the edge is not minimal.
            let leaf = covers.into_iter().find(|l| cut.leaves.contains_key(l))?;
            let edge = 4 * a + (u + 2 * v) as usize;
            let sheet = if leaf.level == 0 {
                vertices.sheets[&cube].of_edge[edge]
            } else {
                0
            };
            corners.push((leaf, sheet, faces));
        }
        let mut end = low;
        end[a] += 1 << level;
        // Cubes at the volume's end are cut off there.
        let cut_off = |p: [u32; 3]| std::array::from_fn(|i| p[i].min(field.grid.dims[i] - 1));
        let inside = [low, end].map(|p| field.at(cut_off(p)) >= iso);
        if inside[0] == inside[1] {
            return None;
        }
        corners.dedup();
        if corners.len() > 1 && corners.first() == corners.last() {
            corners.pop();
        }
        if inside[1] {
            corners.reverse();
        }
        Some(corners)
    };
    edges.into_iter().filter_map(|e| Some((e, polygon(e)?))).collect()
}

/// Position of a leaf's border vertex, in cells from the volume's first sample: its own vertex at `position`, moved along its
/// tangent plane onto `faces` by the shortest way. It stays inside the leaf, and the sheets of a cell get different positions.
/// `normal`: a unit vector, in world lengths.
pub fn border_position(
    grid: &isopeel_kernels::Grid,
    (leaf, sheet, faces): Corner,
    position: [f32; 3],
    normal: [f32; 3],
) -> [f32; 3] {
    let face = |axis: usize| match faces >> (2 * axis) & 3 {
        0 => None,
        1 => Some(0.0),
        _ => Some((grid.dims[axis] - 1) as f32),
    };
    let n: [f32; 3] = std::array::from_fn(|i| normal[i] * grid.spacing[i]);
    let way: f32 = (0..3).filter_map(|i| Some(n[i] * (face(i)? - position[i]))).sum();
    let free: f32 = (0..3).filter(|&i| face(i).is_none()).map(|i| n[i] * n[i]).sum();
    // If the surface is almost parallel to the face, the vertex moves at most ten times its distance to the face.
    let free = free.max(0.01 * n.iter().map(|x| x * x).sum::<f32>());
    std::array::from_fn(|i| {
        face(i).unwrap_or_else(|| {
            let [low, size] = [leaf.cube[i] << leaf.level, 1 << leaf.level];
            let high = (low + size).min(grid.dims[i] - 1);
            let margin = f32::from(1 + sheet) / 32.0;
            (position[i] - n[i] * (way / free)).clamp(low as f32 + margin, high as f32 - margin)
        })
    })
}
