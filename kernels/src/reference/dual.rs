//! Peeling with dual contouring (algorithm, section 6): a polygon for every minimal edge of the cut that changes sign.

use std::collections::{BTreeMap, BTreeSet};

use super::quadric::Vertices;
use super::{Cut, Field, Leaf, Pyramid};

/// A vertex of the dual mesh: a leaf, and which of its sheets.
pub type Corner = (Leaf, u8);

/// An edge of a cube: level, low end in cells, axis.
pub type CubeEdge = (u8, [u32; 3], u8);

/// The polygon around each minimal edge, counter-clockwise seen from the side of lower values: three or four different
/// corners. Where the volume ends, or samples are missing, a cube around the edge is not there and neither is a polygon.
pub fn polygons(
    field: &Field,
    pyramid: &Pyramid,
    vertices: &Vertices,
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
            cube[b] = cube[b].checked_sub(u)?;
            cube[c] = cube[c].checked_sub(v)?;
            pyramid.nodes[usize::from(level)].get(&cube)?;
            let covers = (level..=5).map(|l| Leaf {
                level: l,
                cube: cube.map(|x| x >> (l - level)),
            });
            // Where no leaf covers the cube, finer ones are below: the edge is not minimal.
            let leaf = covers.into_iter().find(|l| cut.leaves.contains_key(l))?;
            let edge = 4 * a + (u + 2 * v) as usize;
            let sheet = if leaf.level == 0 {
                vertices.sheets[&cube].of_edge[edge]
            } else {
                0
            };
            corners.push((leaf, sheet));
        }
        let high = (low[a] + (1 << level)).min(field.grid.dims[a] - 1);
        let mut end = low;
        end[a] = high;
        let inside = [low, end].map(|p| field.at(p) >= iso);
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
