//! How far a dual mesh is from the surface it stands for (docs/algorithm.md#67-measured-error), in f64 and by brute force: every
//! crossing against every triangle, every sample of a triangle against points all over the surface. What a device states, which
//! searches, must not be less.

use std::collections::BTreeMap;

use crate::quadric::{Vector, dot};
use crate::trilinear::{crossing, interpolate};
use crate::{Cut, Field, boxes, offset};
use isopeel_kernels::SurfaceError;
use isopeel_kernels::tables::cube;

/// A triangle of the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Region whose mesh has it.
    pub region: [u32; 3],
    /// Its corners, world units.
    pub corners: [Vector; 3],
}

/// Samples of a square cell's area, and the divisions of a triangle's sides at most.
const SAMPLES_A_CELL: f64 = 1.0;
const DIVISIONS_MAX: f64 = 16.0;

/// Points of the surface on a lattice of half a cell are no further from any of its points than this part of a cell's diagonal.
pub(crate) const BETWEEN_POINTS: f64 = 0.25;

#[derive(Clone, Copy, Default)]
struct Distances {
    sum2: f64,
    weight: f64,
    max: f64,
}

impl Distances {
    fn add(&mut self, distance: f64, weight: f64) {
        self.join(&Self {
            sum2: weight * distance * distance,
            weight,
            max: distance,
        });
    }

    fn join(&mut self, more: &Self) {
        self.sum2 += more.sum2;
        self.weight += more.weight;
        self.max = self.max.max(more.max);
    }

    fn mean2(&self) -> f64 {
        if self.weight > 0.0 {
            self.sum2 / self.weight
        } else {
            0.0
        }
    }
}

/// Distances of crossings to the mesh, and of samples of triangles to the surface.
type Both = [Distances; 2];

fn stated(both: &Both) -> SurfaceError {
    SurfaceError {
        rms: ((both[0].mean2() + both[1].mean2()) / 2.0).sqrt() as f32,
        max: both[0].max.max(both[1].max) as f32,
    }
}

fn minus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// Distance of a point to a triangle: the nearest of its points by its weights at the corners, where all are positive, or
/// else on a side.
fn triangle_distance(p: Vector, [a, b, c]: [Vector; 3]) -> f64 {
    let side = |a: Vector, b: Vector| {
        let (along, to) = (minus(b, a), minus(p, a));
        let whole = dot(along, along);
        let t = if whole > 0.0 {
            (dot(to, along) / whole).clamp(0.0, 1.0)
        } else {
            0.0
        };
        length(std::array::from_fn(|i| to[i] - t * along[i]))
    };
    let sides = side(a, b).min(side(b, c)).min(side(c, a));
    // Least squares in the plane of u and v.
    let (u, v, to) = (minus(b, a), minus(c, a), minus(p, a));
    let (uu, uv, vv, ut, vt) = (dot(u, u), dot(u, v), dot(v, v), dot(u, to), dot(v, to));
    let whole = uu * vv - uv * uv;
    let (s, t) = ((ut * vv - vt * uv) / whole, (vt * uu - ut * uv) / whole);
    if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
        sides.min(length(std::array::from_fn(|i| to[i] - s * u[i] - t * v[i])))
    } else {
        sides
    }
}

/// The volume without its padding, if it has one: first and last sample.
fn without_padding(field: &Field, cap: bool) -> [[u32; 3]; 2] {
    let padding = u32::from(cap);
    [[padding; 3], field.grid.dims.map(|n| n - 1 - padding)]
}

/// Points of the surface in world units: where it crosses the lattice of half a cell, on whose lines the interpolant of a cell is
/// linear. In a capped volume also those points of the lattice on its faces that lie inside.
pub(crate) fn surface_points(field: &Field, iso: f32, cap: bool) -> Vec<Vector> {
    let spacing = field.grid.spacing.map(f64::from);
    let [first, last] = without_padding(field, cap);
    let world = |x: Vector| -> Vector { std::array::from_fn(|i| x[i] * spacing[i]) };
    let mut points = Vec::new();
    for cell in boxes(first, last) {
        let v = field.cell_corners(cell).map(f64::from);
        if v.iter().any(|v| v.is_nan()) {
            continue;
        }
        let at = |i: [u32; 3]| -> Vector { std::array::from_fn(|a| f64::from(cell[a]) + f64::from(i[a]) / 2.0) };
        let value = |i: [u32; 3]| interpolate(v, i.map(|i| f64::from(i) / 2.0)).1 - f64::from(iso);
        for i in boxes([0; 3], [3; 3]) {
            let (x, here) = (at(i), value(i));
            let on_face = (0..3).any(|a| x[a] == f64::from(first[a]) || x[a] == f64::from(last[a]));
            if cap && on_face && here >= 0.0 {
                points.push(world(x));
            }
            for axis in (0..3).filter(|&a| i[a] < 2) {
                let mut next = i;
                next[axis] += 1;
                let there = value(next);
                if (here >= 0.0) != (there >= 0.0) {
                    let mut x = x;
                    x[axis] += 0.5 * here / (here - there);
                    points.push(world(x));
                }
            }
        }
    }
    points
}

/// Whether samples are missing in a region or on its border.
fn has_gaps(field: &Field, region: [u32; 3]) -> bool {
    let low = region.map(|r| 32 * r);
    let high = std::array::from_fn(|i| (low[i] + 33).min(field.grid.dims[i]));
    boxes(low, high).any(|p| field.at(p).is_nan())
}

/// Full-resolution crossings with their regions, world units.
fn crossings(field: &Field, iso: f32, cap: bool, cut: &Cut) -> Vec<([u32; 3], Vector)> {
    let spacing = field.grid.spacing.map(f64::from);
    let [first, last] = without_padding(field, cap);
    let mut gaps: BTreeMap<[u32; 3], bool> = BTreeMap::new();
    let mut found = Vec::new();
    for &cell in cut.leaf_of.keys() {
        let region = cell.map(|c| c / 32);
        let gaps = *gaps.entry(region).or_insert_with(|| has_gaps(field, region));
        let v = field.cell_corners(cell).map(f64::from);
        for edge in 0..12 {
            let [start, end] = cube::edge_corners(edge);
            if (v[start] >= f64::from(iso)) == (v[end] >= f64::from(iso)) {
                continue;
            }
            // Each crossing once: by the cell at whose low corner it is, or where that may be missing by all cells around it.
            let low = offset(cell, cube::corner_offset(start).map(|c| c as u32));
            if edge % 4 != 0 && !gaps && (0..3).all(|i| low[i] + 1 < field.grid.dims[i]) {
                continue;
            }
            let at = crossing(v, iso, edge);
            let p = std::array::from_fn(|i| {
                (f64::from(cell[i]) + at[i]).clamp(f64::from(first[i]), f64::from(last[i])) * spacing[i]
            });
            found.push((region, p));
        }
    }
    found
}

/// Samples of a triangle, world units: the centroids of n² equal triangles into which it is divided.
fn samples(spacing: Vector, [a, b, c]: [Vector; 3]) -> Vec<Vector> {
    let cells = |v: Vector| -> Vector { std::array::from_fn(|i| v[i] / spacing[i]) };
    let n = (SAMPLES_A_CELL * area(cells(minus(b, a)), cells(minus(c, a))))
        .sqrt()
        .ceil();
    let n = n.clamp(1.0, DIVISIONS_MAX) as u32;
    let at = |i: u32, j: u32| -> Vector {
        let (s, t) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
        std::array::from_fn(|k| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k]))
    };
    let centroid = |corners: [Vector; 3]| std::array::from_fn(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0);
    let mut samples = Vec::new();
    for i in 0..n {
        for j in 0..n - i {
            samples.push(centroid([at(i, j), at(i + 1, j), at(i, j + 1)]));
            if i + j + 1 < n {
                samples.push(centroid([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]));
            }
        }
    }
    samples
}

fn area(u: Vector, v: Vector) -> f64 {
    let n = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    0.5 * length(n)
}

/// The minimum error that may be stated for every region that has crossings or triangles, and for the whole surface.
/// `cell_vertices`: of each active cell, world units. Those of cells that are leaves lie on mesh and surface: they all count, with no
/// distance.
pub fn minimum_errors(
    field: &Field,
    iso: f32,
    cap: bool,
    cut: &Cut,
    cell_vertices: &BTreeMap<[u32; 3], Vector>,
    triangles: &[Triangle],
) -> (BTreeMap<[u32; 3], SurfaceError>, SurfaceError) {
    let spacing = field.grid.spacing.map(f64::from);
    let mut regions: BTreeMap<[u32; 3], Both> = BTreeMap::new();
    let to_mesh = |p: Vector| {
        let distances = triangles.iter().map(|t| triangle_distance(p, t.corners));
        distances.fold(f64::INFINITY, f64::min)
    };
    for (region, p) in crossings(field, iso, cap, cut) {
        regions.entry(region).or_default()[0].add(to_mesh(p), 1.0);
    }
    for (cell, leaf) in &cut.leaf_of {
        let distance = if leaf.level == 0 {
            0.0
        } else {
            to_mesh(cell_vertices[cell])
        };
        regions.entry(cell.map(|c| c / 32)).or_default()[0].add(distance, 1.0);
    }
    let points = surface_points(field, iso, cap);
    let between = BETWEEN_POINTS * length(spacing);
    for triangle in triangles {
        let [a, b, c] = triangle.corners;
        let samples = samples(spacing, triangle.corners);
        let weight = area(minus(b, a), minus(c, a)) / samples.len() as f64;
        for p in samples {
            let nearest2 = points
                .iter()
                .map(|&q| dot(minus(p, q), minus(p, q)))
                .fold(f64::INFINITY, f64::min);
            let sums = &mut regions.entry(triangle.region).or_default()[1];
            sums.add((nearest2.sqrt() - between).max(0.0), weight);
        }
    }
    let mut whole = Both::default();
    for both in regions.values() {
        (0..2).for_each(|i| whole[i].join(&both[i]));
    }
    let by_region = regions.iter().map(|(at, both)| (*at, stated(both))).collect();
    (by_region, stated(&whole))
}
