//! Full meshes of analytic surfaces, with one point a cell, for tests of the vertex tree.

use std::collections::BTreeMap;

use isopeel_kernels::Grid;
use isopeel_reference::tree::{FullMesh, LATTICE, Point};

/// A cell. Those at z = −1 are not in the volume: their points lie on its face.
type Cell = [i32; 3];

fn step(mut cell: Cell, axis: usize, by: i32) -> Cell {
    cell[axis] += by;
    cell
}

/// The mesh of the surface at 0 in a cubic volume of `cells` cells along each axis; `value` is above 0 inside. The surface may leave the
/// volume at the face z = 0.
pub fn surface_nets(cells: i32, spacing: [f32; 3], value: impl Fn([f32; 3]) -> f32) -> FullMesh {
    surface_nets_of([cells; 3], spacing, value)
}

/// The same in a volume of `cells` cells.
pub fn surface_nets_of(cells: [i32; 3], spacing: [f32; 3], value: impl Fn([f32; 3]) -> f32) -> FullMesh {
    let mut numbers = BTreeMap::new();
    let mut quads = Vec::new();
    let [nx, ny, nz] = cells.map(|n| n + 1);
    for at in 0..nx * ny * nz {
        let sample = [at % nx, at / nx % ny, at / nx / ny];
        for axis in (0..3).filter(|&axis| sample[axis] < cells[axis]) {
            let [from, to] = [sample, step(sample, axis, 1)].map(|p| value(p.map(|x| x as f32)) > 0.0);
            if from != to {
                let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
                let beside = step(sample, b, -1);
                let mut quad = [sample, beside, step(beside, c, -1), step(sample, c, -1)];
                numbers.extend(quad.map(|cell| (order(cell), 0)));
                quad[1..].reverse();
                if from {
                    quad[1..].reverse();
                }
                quads.push((sample, quad));
            }
        }
    }
    let mut points = Vec::new();
    for (n, (key, number)) in numbers.iter_mut().enumerate() {
        *number = n;
        points.push(point([key.3, key.2, key.1], &value));
    }
    let mut triangles: BTreeMap<[u32; 3], Vec<[usize; 3]>> =
        points.iter().map(|point| (point.region, Vec::new())).collect();
    for (last_cell, quad) in quads {
        let [a, b, c, d] = quad.map(|cell| numbers[&order(cell)]);
        let of_region = triangles.entry(region(last_cell)).or_default();
        of_region.extend([[a, b, c], [a, c, d]]);
    }
    FullMesh {
        grid: Grid::new(cells.map(|n| n as u32 + 1), spacing).expect("a valid grid"),
        cap: false,
        points,
        triangles,
    }
}

/// Order of points: those on the face last.
fn order([x, y, z]: Cell) -> (bool, i32, i32, i32) {
    assert!(x >= 0 && y >= 0, "the surface leaves the volume at another face");
    (z < 0, z, y, x)
}

fn region(cell: Cell) -> [u32; 3] {
    cell.map(|c| c.max(0) as u32 / 32)
}

/// The point of a cell: the mean of the crossings of its edges.
fn point(cell: Cell, value: impl Fn([f32; 3]) -> f32) -> Point {
    let on_border = cell[2] < 0;
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for (corner, axis) in (0..8).flat_map(|corner| (0..3).map(move |axis| (corner, axis))) {
        let from: [f32; 3] = std::array::from_fn(|i| (cell[i] + (corner >> i & 1)) as f32);
        let is_on_face = axis != 2 && from[2] == 0.0;
        if corner >> axis & 1 == 1 || (on_border && !is_on_face) {
            continue;
        }
        let mut to = from;
        to[axis] += 1.0;
        let [a, b] = [from, to].map(&value);
        if (a > 0.0) != (b > 0.0) {
            let t = a / (a - b);
            (0..3).for_each(|i| sum[i] += from[i] + t * (to[i] - from[i]));
            count += 1.0;
        }
    }
    Point {
        position: sum.map(|x: f32| (x / count * LATTICE as f32).round() as i32),
        cell: cell.map(|c| c.max(0) as u32),
        region: region(cell),
        on_border,
        s: 0.0,
        f: 0.0,
    }
}
