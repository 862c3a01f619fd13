//! The connected parts of the full dual mesh, and a mesh without some of them (docs/algorithm.md#82-removed-parts).

use std::collections::BTreeSet;

use crate::tree::{FullMesh, LATTICE, NodeId, Tree};

/// The parts of a mesh. A point without triangles is of none.
#[derive(Clone, Debug)]
pub struct Parts {
    /// The first point of each point's part.
    pub firsts: Vec<Option<usize>>,
    /// The area of each point's part, world units; 0 if it belongs to none.
    pub areas: Vec<f64>,
}

/// The remaining mesh after parts were removed.
#[derive(Clone, Debug)]
pub struct Remaining {
    /// The mesh without the triangles of removed parts. It has all points.
    pub mesh: FullMesh,
    /// Of each point, whether it is of a removed part, or of none.
    pub is_removed: Vec<bool>,
    /// The nodes above these points.
    pub nodes: BTreeSet<NodeId>,
    /// How many parts were removed.
    pub parts: u64,
}

fn area(mesh: &FullMesh, [a, b, c]: [usize; 3]) -> f64 {
    let along = |to: usize| -> [f64; 3] {
        std::array::from_fn(|i| {
            f64::from(mesh.points[to].position[i] - mesh.points[a].position[i]) / f64::from(LATTICE)
                * f64::from(mesh.grid.spacing[i])
        })
    };
    let (u, v) = (along(b), along(c));
    let normal: [f64; 3] = std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        u[j] * v[k] - u[k] * v[j]
    });
    normal.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.0
}

/// The area of all triangles, world units.
pub fn total_area(mesh: &FullMesh) -> f64 {
    mesh.triangles
        .values()
        .flatten()
        .map(|&triangle| area(mesh, triangle))
        .sum()
}

/// Finds the parts, from each first point on over all triangles.
pub fn parts(mesh: &FullMesh) -> Parts {
    let triangles: Vec<[usize; 3]> = mesh.triangles.values().flatten().copied().collect();
    let mut around = vec![Vec::new(); mesh.points.len()];
    for (i, triangle) in triangles.iter().enumerate() {
        triangle.iter().for_each(|&corner| around[corner].push(i));
    }
    let mut firsts: Vec<Option<usize>> = vec![None; mesh.points.len()];
    for first in 0..mesh.points.len() {
        if firsts[first].is_some() || around[first].is_empty() {
            continue;
        }
        firsts[first] = Some(first);
        let mut reached = vec![first];
        while let Some(point) = reached.pop() {
            for &corner in around[point].iter().flat_map(|&i| &triangles[i]) {
                if firsts[corner].is_none() {
                    firsts[corner] = Some(first);
                    reached.push(corner);
                }
            }
        }
    }
    let mut sums = vec![0.0; mesh.points.len()];
    for &triangle in &triangles {
        if let Some(first) = firsts[triangle[0]] {
            sums[first] += area(mesh, triangle);
        }
    }
    let areas = firsts.iter().map(|first| first.map_or(0.0, |first| sums[first]));
    Parts {
        areas: areas.collect(),
        firsts,
    }
}

/// Parts that were chosen, by their first points.
#[derive(Clone, Debug, PartialEq)]
pub enum Chosen {
    /// These parts are removed.
    Hidden(BTreeSet<usize>),
    /// All other parts are removed.
    Kept(BTreeSet<usize>),
}

/// The parts that are removed. By default none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter {
    /// Parts of a smaller area are removed, world units; 0: none are.
    pub min_area: f64,
    /// Parts chosen by positions.
    pub chosen: Option<Chosen>,
}

impl Filter {
    fn removes(&self, parts: &Parts, point: usize) -> bool {
        if self.min_area <= 0.0 && self.chosen.is_none() {
            return false;
        }
        // A point that belongs to no part is removed too.
        let Some(first) = parts.firsts[point] else { return true };
        let is_chosen_to_go = match &self.chosen {
            None => false,
            Some(Chosen::Hidden(firsts)) => firsts.contains(&first),
            Some(Chosen::Kept(firsts)) => !firsts.contains(&first),
        };
        parts.areas[point] < self.min_area || is_chosen_to_go
    }
}

/// The first point of the part next to a position, in cells: that of the nearest vertex of a cell's first sheet, in the 5^3 cells around.
pub fn part_near(mesh: &FullMesh, parts: &Parts, position: [f32; 3]) -> Option<usize> {
    let mut seen = BTreeSet::new();
    let first_sheets = (0..mesh.points.len()).filter(|&point| seen.insert(mesh.points[point].cell));
    let centre = |axis: usize| (position[axis] as i64).min(i64::from(mesh.grid.dims[axis]) - 2);
    let is_near = |point: &usize| (0..3).all(|i| (i64::from(mesh.points[*point].cell[i]) - centre(i)).abs() <= 2);
    let distance = |point: usize| {
        let at = |i: usize| mesh.points[point].position[i] as f32 / LATTICE as f32;
        let squares = (0..3).map(|i| ((at(i) - position[i]) * mesh.grid.spacing[i]).powi(2));
        squares.sum::<f32>()
    };
    let nearest = first_sheets
        .filter(is_near)
        .min_by(|&a, &b| distance(a).total_cmp(&distance(b)))?;
    parts.firsts[nearest]
}

/// Leaves out the parts that a filter removes.
pub fn without(mesh: &FullMesh, tree: &Tree, parts: &Parts, filter: &Filter) -> Remaining {
    let is_removed: Vec<bool> = (0..mesh.points.len())
        .map(|point| filter.removes(parts, point))
        .collect();
    let is_first = |point: &usize| is_removed[*point] && parts.firsts[*point] == Some(*point);
    let count = (0..mesh.points.len()).filter(is_first).count() as u64;
    let mut mesh = mesh.clone();
    for triangles in mesh.triangles.values_mut() {
        triangles.retain(|triangle| !is_removed[triangle[0]]);
    }
    let removed_points = (0..mesh.points.len()).filter(|&point| is_removed[point]);
    let nodes = removed_points.flat_map(|point| tree.above(point)).collect();
    Remaining {
        mesh,
        is_removed,
        nodes,
        parts: count,
    }
}
