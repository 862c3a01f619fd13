//! Distance of a dual mesh from the surface that it represents (docs/algorithm.md#67-measured-error), in f64 and by brute force: every
//! crossing of a line against every triangle, every sample of a triangle against points all over the surface. A device's
//! result is at least `low`. It exceeds `high` only if its search misses the nearest point.

use rustc_hash::FxHashSet as HashSet;
use std::collections::BTreeMap;

use crate::quadric::{Vector, dot};
use crate::trilinear::{field_at, interpolate};
use crate::{Cut, Field, boxes};
use isopeel_kernels::SurfaceError;

/// A triangle of the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Region whose mesh has it.
    pub region: [u32; 3],
    /// Its number among the triangles of all regions.
    pub number: u32,
    /// Its corners, world units.
    pub corners: [Vector; 3],
}

/// Lines of a cell along each axis that measure area: their positions along the next axis.
const INNER_LINES: [f64; 2] = [0.22, 0.78];

/// Distance from the edges of the lines that count for the maximum alone.
const INSET: f64 = 0.0625;

/// Points of a part of a triangle, three of each kind: one barycentric coordinate (the other two share the rest equally) and the weight.
const KINDS: [(f64, f64); 3] = [
    (0.816_847_572_980_459, 0.109_951_743_655_322),
    (0.108_103_018_168_070, 0.223_381_589_678_011),
    (0.04, 0.0),
];

/// Maximum area of a part of a triangle, in square cells, and maximum divisions of a triangle's sides.
const PART_CELLS: f64 = 12.0;
const DIVISIONS_MAX: f64 = 16.0;

/// Area of a triangle up to which one point of each kind is measured.
const SMALL_CELLS: f64 = 3.0;

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

/// Combines the distances of crossings to the mesh and of samples of triangles to the surface.
fn stated(to_mesh: &Distances, to_surface: &Distances) -> SurfaceError {
    SurfaceError {
        rms: ((to_mesh.mean2() + to_surface.mean2()) / 2.0).sqrt() as f32,
        max: to_mesh.max.max(to_surface.max) as f32,
    }
}

fn minus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn length2(a: Vector) -> f64 {
    dot(a, a)
}

fn length(a: Vector) -> f64 {
    length2(a).sqrt()
}

/// Distance of a point to a triangle: the nearest of its points by its weights at the corners, if all are positive, or
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

/// Points of the surface in world units: its crossings with a lattice of `steps` steps per cell, on whose lines the interpolant of a cell
/// is linear. In a capped volume also those points of the lattice on its faces that lie inside.
pub(crate) fn surface_points(field: &Field, iso: f32, cap: bool, steps: u32) -> Vec<Vector> {
    let step = 1.0 / f64::from(steps);
    let spacing = field.grid.spacing.map(f64::from);
    let [first, last] = without_padding(field, cap);
    let world = |x: Vector| -> Vector { std::array::from_fn(|i| x[i] * spacing[i]) };
    let mut points = Vec::new();
    for cell in boxes(first, last) {
        let v = field.cell_corners(cell).map(f64::from);
        if v.iter().any(|v| v.is_nan()) {
            continue;
        }
        let at = |i: [u32; 3]| -> Vector { std::array::from_fn(|a| f64::from(cell[a]) + step * f64::from(i[a])) };
        let value = |i: [u32; 3]| interpolate(v, i.map(|i| step * f64::from(i))).1 - f64::from(iso);
        for i in boxes([0; 3], [steps + 1; 3]) {
            let (x, here) = (at(i), value(i));
            let on_face = (0..3).any(|a| x[a] == f64::from(first[a]) || x[a] == f64::from(last[a]));
            if cap && on_face && here >= 0.0 {
                points.push(world(x));
            }
            for axis in (0..3).filter(|&a| i[a] < steps) {
                let mut next = i;
                next[axis] += 1;
                let there = value(next);
                if (here >= 0.0) != (there >= 0.0) {
                    let mut x = x;
                    x[axis] += step * here / (here - there);
                    points.push(world(x));
                }
            }
        }
    }
    points
}

/// Distance from `p` to a point of the surface near `start`, world units. Moves to the surface along its gradient, then along the surface
/// towards the foot of the perpendicular, alternately. Infinite if no such point is found.
fn way_to_foot(field: &Field, iso: f32, cap: bool, p: Vector, start: Vector) -> f64 {
    let spacing = field.grid.spacing.map(f64::from);
    let [first, last] = without_padding(field, cap);
    let inside = |x: Vector| -> Vector {
        std::array::from_fn(|i| x[i].clamp(f64::from(first[i]) * spacing[i], f64::from(last[i]) * spacing[i]))
    };
    let at = |x: Vector| {
        let (slope, value) = field_at(field, std::array::from_fn(|i| x[i] / spacing[i]));
        let gradient: Vector = std::array::from_fn(|i| slope[i] / spacing[i]);
        (gradient, value - f64::from(iso))
    };
    let smallest = spacing.into_iter().fold(f64::INFINITY, f64::min);
    let (mut x, mut shortest) = (start, f64::INFINITY);
    for _ in 0..8 {
        for _ in 0..8 {
            let (gradient, value) = at(x);
            let step = value / dot(gradient, gradient).max(f64::MIN_POSITIVE);
            x = inside(std::array::from_fn(|i| {
                x[i] - (step * gradient[i]).clamp(-smallest, smallest)
            }));
        }
        let (gradient, value) = at(x);
        let residual = value.abs() / length(gradient);
        if residual < 1e-3 * smallest {
            shortest = shortest.min(length(minus(x, p)) + residual);
        }
        let way = minus(x, p);
        let along = dot(way, gradient) / dot(gradient, gradient).max(f64::MIN_POSITIVE);
        x = inside(std::array::from_fn(|i| x[i] - way[i] + along * gradient[i]));
    }
    shortest
}

/// A measured point, and the area that it represents, world units.
type Weighted = (Vector, f64);

/// Crossings of lines through a cell with the surface; in the padding of a capped volume they are on its faces. `has_missing`: samples are
/// missing somewhere.
fn crossings(field: &Field, iso: f32, cap: bool, has_missing: bool, cell: [u32; 3]) -> Vec<Weighted> {
    let spacing = field.grid.spacing.map(f64::from);
    let [first, last] = without_padding(field, cap);
    let v = field.cell_corners(cell).map(|v| f64::from(v) - f64::from(iso));
    let padded: [bool; 3] = std::array::from_fn(|i| cell[i] < first[i] || cell[i] >= last[i]);
    let other_diagonal = cell.iter().sum::<u32>() % 2 == 1;
    let mut found = Vec::new();
    for axis in 0..3 {
        let across = [(axis + 1) % 3, (axis + 2) % 3];
        if across.iter().any(|&i| padded[i]) {
            continue;
        }
        let inner = INNER_LINES.map(|s| ([s, if other_diagonal { 1.0 - s } else { s }], true));
        let edges = [[false, false], [true, false], [false, true], [true, true]]
            .into_iter()
            .filter(|far| has_missing || (0..2).all(|i| !far[i] || cell[across[i]] + 1 == last[across[i]]))
            .map(|far| (far.map(|far| if far { 1.0 - INSET } else { INSET }), false));
        for (place, measures_area) in inner.into_iter().chain(edges) {
            let at = |along: f64| -> Vector {
                let mut x = [0.0; 3];
                x[axis] = along;
                (0..2).for_each(|i| x[across[i]] = place[i]);
                x
            };
            let ends = [0.0, 1.0].map(|along| interpolate(v, at(along)).1);
            let near = cell[axis] < first[axis];
            let (along, part) = if padded[axis] {
                let inside = ends[usize::from(near)] >= 0.0;
                (inside.then_some(f64::from(u8::from(near))), 1.0)
            } else if (ends[0] >= 0.0) == (ends[1] >= 0.0) {
                (None, 0.0)
            } else {
                let along = ends[0] / (ends[0] - ends[1]);
                let slope = interpolate(v, at(along)).0;
                let gradient: Vector = std::array::from_fn(|i| slope[i] / spacing[i]);
                (Some(along), gradient[axis].abs() / length(gradient))
            };
            let Some(along) = along else { continue };
            let (x, face) = (at(along), spacing[across[0]] * spacing[across[1]]);
            let p = std::array::from_fn(|i| (f64::from(cell[i]) + x[i]) * spacing[i]);
            found.push((p, if measures_area { part * face } else { 0.0 }));
        }
    }
    found
}

/// Samples of a triangle, without its corners.
fn samples(spacing: Vector, triangle: &Triangle) -> Vec<Weighted> {
    let [a, b, c] = triangle.corners;
    let cells = |v: Vector| -> Vector { std::array::from_fn(|i| v[i] / spacing[i]) };
    let in_cells = area(cells(minus(b, a)), cells(minus(c, a)));
    let whole = area(minus(b, a), minus(c, a));
    let at = |weights: Vector, [a, b, c]: [Vector; 3]| -> Vector {
        std::array::from_fn(|i| weights[0] * a[i] + weights[1] * b[i] + weights[2] * c[i])
    };
    let point = |kind: usize, which: usize| -> Vector {
        let coordinate = KINDS[kind].0;
        std::array::from_fn(|i| {
            if i == which {
                coordinate
            } else {
                (1.0 - coordinate) / 2.0
            }
        })
    };
    if in_cells <= SMALL_CELLS {
        let turn = ((u64::from((3 * triangle.number).wrapping_mul(2_654_435_761)) * 3) >> 32) as usize;
        return (0..KINDS.len())
            .map(|kind| (at(point(kind, turn), triangle.corners), 3.0 * KINDS[kind].1 * whole))
            .collect();
    }
    let n = (in_cells / PART_CELLS).sqrt().ceil().clamp(1.0, DIVISIONS_MAX) as u32;
    let corner = |i: u32, j: u32| -> Vector {
        let (s, t) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
        at([1.0 - s - t, s, t], triangle.corners)
    };
    let mut found = Vec::new();
    let mut add = |part: [Vector; 3]| {
        for (kind, &(_, weight)) in KINDS.iter().enumerate() {
            (0..3).for_each(|which| found.push((at(point(kind, which), part), weight * whole / f64::from(n * n))));
        }
    };
    for i in 0..n {
        for j in 0..n - i {
            add([corner(i, j), corner(i + 1, j), corner(i, j + 1)]);
            if i + j + 1 < n {
                add([corner(i + 1, j + 1), corner(i, j + 1), corner(i + 1, j)]);
            }
        }
    }
    found
}

fn area(u: Vector, v: Vector) -> f64 {
    let n = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    0.5 * length(n)
}

/// Bounds of the error of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// By distances to points of the surface, less the gap between these.
    pub low: SurfaceError,
    /// By distances to points of the surface.
    pub high: SurfaceError,
}

/// Distances of crossings to the mesh, and bounds of the distances of samples to the surface.
#[derive(Clone, Copy, Default)]
struct Sums {
    to_mesh: Distances,
    to_surface: [Distances; 2],
}

impl Sums {
    fn join(&mut self, more: &Self) {
        self.to_mesh.join(&more.to_mesh);
        (0..2).for_each(|i| self.to_surface[i].join(&more.to_surface[i]));
    }

    fn bounds(&self) -> Bounds {
        let [low, high] = self.to_surface.map(|to_surface| stated(&self.to_mesh, &to_surface));
        Bounds { low, high }
    }
}

/// Returns the bounds of the error of every region that has active cells or triangles, and of the whole surface.
pub fn bounds(
    field: &Field,
    iso: f32,
    cap: bool,
    cut: &Cut,
    triangles: &[Triangle],
) -> (BTreeMap<[u32; 3], Bounds>, Bounds) {
    let spacing = field.grid.spacing.map(f64::from);
    let (mut regions, has_missing) = (BTreeMap::<[u32; 3], Sums>::new(), field.has_missing());
    for cell in cut.leaf_of.keys() {
        let sums = &mut regions.entry(cell.map(|c| c / 32)).or_default().to_mesh;
        for (p, weight) in crossings(field, iso, cap, has_missing, *cell) {
            let distances = triangles.iter().map(|t| triangle_distance(p, t.corners));
            sums.add(distances.fold(f64::INFINITY, f64::min), weight);
        }
    }
    // Beside missing samples the foot of a perpendicular may lie beyond the end of the surface, so only points of the surface can be used.
    let steps = if has_missing { 5 } else { 2 };
    let points = surface_points(field, iso, cap, steps);
    let between = BETWEEN_POINTS * length(spacing);
    let mut seen = HashSet::default();
    for triangle in triangles {
        let sums = &mut regions.entry(triangle.region).or_default().to_surface;
        let corners = triangle
            .corners
            .iter()
            .filter(|p| seen.insert((triangle.region, p.map(f64::to_bits))));
        let corners = corners.map(|&p| (p, 0.0));
        for (p, weight) in samples(spacing, triangle).into_iter().chain(corners) {
            let nearest = points
                .iter()
                .map(|q| (length2(minus(p, *q)), q))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let (distance, foot) = nearest.map_or((f64::INFINITY, f64::INFINITY), |(distance2, &q)| {
                (distance2.sqrt(), way_to_foot(field, iso, cap, p, q))
            });
            sums[0].add((distance - between).max(0.0).min(foot), weight);
            sums[1].add(distance.min(foot), weight);
        }
    }
    let mut whole = Sums::default();
    regions.values().for_each(|sums| whole.join(sums));
    let by_region = regions.iter().map(|(at, sums)| (*at, sums.bounds())).collect();
    (by_region, whole.bounds())
}
