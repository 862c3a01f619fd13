//! Vertices of the dual mesher: their positions (docs/algorithm.md#63-vertex-placement), their distances from the surface that
//! they represent, and the nodes that are safe to merge (docs/algorithm.md#41-guards).

use crate::quadric::{CELL_PULL, CUBE_PULL, Quadric, Vector, dot, unit};
use crate::sheets::cell_sheets;
use crate::trilinear::{corners, crossing, edge_gradient, field_at, interpolate};
use crate::{Cell, Field, Leaf, Pyramid, boxes, construct, offset, relax};
use isopeel_kernels::tables::{cube, sheets::Sheets};
use std::collections::{BTreeMap, BTreeSet};

/// Vertices stay this far inside their cube, in cells.
pub(crate) const MARGIN: f64 = 1.0 / 32.0;
const NEWTON_STEPS: usize = 2;
/// Share of the way to the isosurface by which the vertex of a cell with several sheets moves.
const SHEET_STEP: f64 = 0.875;

/// A vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DualVertex {
    /// In cells from the volume's first sample.
    pub position: Vector,
    /// Along the field's gradient, of any length.
    pub gradient: Vector,
    /// Root mean square distance to the planes of the crossings that it represents, world units.
    pub error: f64,
    /// Maximum error of the position by rounding alone, in cells. Large if a Newton step jumps between cells.
    pub uncertainty: f64,
}

/// Data of every node for the dual mesher and the guards.
#[derive(Clone, Debug, Default)]
pub struct DualVertices {
    /// Sheets of every active cell.
    pub sheets: BTreeMap<[u32; 3], Sheets>,
    /// A vertex for every node; for a cell one for each sheet.
    pub vertices: BTreeMap<(Leaf, u8), DualVertex>,
    /// Nodes that are safe to merge.
    pub safe: BTreeSet<Leaf>,
}

/// Sums over the active cells below a cube, from which its vertex and safety are computed.
#[derive(Clone, Copy, Default)]
struct Sums {
    quadric: Quadric,
    gradient: Vector,
}

/// Computes every vertex.
pub fn vertices(field: &Field, pyramid: &Pyramid, iso: f32) -> DualVertices {
    let mut result = DualVertices::default();
    let mut sums = BTreeMap::new();
    for (&at, cell) in &pyramid.cells {
        sums.insert(at, result.add_cell(field, iso, at, cell));
    }
    relax::relax(field, iso, &mut result);
    for level in 1..=5u8 {
        let mut coarse: BTreeMap<[u32; 3], Sums> = BTreeMap::new();
        for (cube, child) in &sums {
            let sum = coarse.entry(cube.map(|c| c / 2)).or_default();
            sum.quadric.join(&child.quadric);
            (0..3).for_each(|i| sum.gradient[i] += child.gradient[i]);
        }
        for (&cube, sum) in &coarse {
            let children = (0..8)
                .map(|b| offset(cube.map(|c| 2 * c), cube::corner_offset(b).map(|d| d as u32)))
                .filter(|child| sums.contains_key(child));
            result.add_cube(field, iso, Leaf { level, cube }, sum, children);
        }
        sums = coarse;
    }
    result
}

impl DualVertices {
    /// Adds a vertex for each sheet of a cell; returns the cell's sums for the cubes above.
    fn add_cell(&mut self, field: &Field, iso: f32, at: [u32; 3], cell: &Cell) -> Sums {
        let leaf = Leaf { level: 0, cube: at };
        let sheets = cell_sheets(field, iso, at, cell.signs);
        for sheet in 0..sheets.count {
            let vertex = if sheets.count == 1 {
                cell_vertex(field, iso, at, &sheet_quadric(field, iso, at, &sheets, sheet))
            } else {
                sheet_vertex(field, iso, at, &sheets, sheet)
            };
            self.vertices.insert((leaf, sheet), vertex);
        }
        if sheets.count == 1 && sheets.joined_faces() == 0 {
            self.safe.insert(leaf);
        }
        self.sheets.insert(at, sheets);
        Sums {
            quadric: smooth_quadric(field, iso, at, cell.signs),
            gradient: construct::normalised(cell.g).map(|g| f64::from(g) * f64::from(cell.n)),
        }
    }

    /// The vertex of a cube, and whether it is safe to merge `children`, the cubes with active cells in it.
    fn add_cube(
        &mut self,
        field: &Field,
        iso: f32,
        leaf: Leaf,
        sums: &Sums,
        mut children: impl Iterator<Item = [u32; 3]>,
    ) {
        let samples = field.cube_samples(usize::from(leaf.level), leaf.cube);
        self.vertices.insert((leaf, 0), cube_vertex(field, sums, samples));
        let half = 1 << (leaf.level - 1);
        let sign = |p: [u32; 3]| {
            let at = std::array::from_fn(|i| (samples[0][i] + p[i] * half).min(samples[1][i]));
            field.at(at) >= iso
        };
        let level = leaf.level - 1;
        if children.all(|cube| self.safe.contains(&Leaf { level, cube })) && safe_signs(sign) {
            self.safe.insert(leaf);
        }
    }
}

/// Whether the signs between the corners of a cube follow from those of the corners, and its surface is one disk that crosses
/// no face twice. A sign is that of the sample at `p` half sizes, `p` in 0..3 along each axis.
fn safe_signs(sign: impl Fn([u32; 3]) -> bool) -> bool {
    let between = boxes([0; 3], [3; 3]).filter(|p| p.contains(&1)).all(|p| {
        // A midpoint of an edge, face or cube is compared with the corners of that edge, face or cube.
        let low = p.map(|c| if c == 1 { 0 } else { c });
        let high = p.map(|c| if c == 1 { 2 } else { c });
        boxes(low, offset(high, [1; 3]))
            .filter(|c| !c.contains(&1))
            .any(|c| sign(c) == sign(p))
    });
    let signs = (0..8).fold(0, |bits, b| {
        bits | u8::from(sign(cube::corner_offset(b).map(|c| 2 * c as u32))) << b
    });
    let sheets = Sheets::trace(signs, 0);
    between && sheets.count == 1 && sheets.joined_faces() == 0
}

/// Sums over the crossings of one sheet of a cell.
fn sheet_quadric(field: &Field, iso: f32, cell: [u32; 3], sheets: &Sheets, sheet: u8) -> Quadric {
    let (v, spacing) = (corners(field, cell), field.grid.spacing.map(f64::from));
    let mut q = Quadric::default();
    for edge in (0..12).filter(|&e| sheets.of_edge[e] == sheet) {
        let at = crossing(v, iso, edge);
        let (g, _) = interpolate(v, at);
        let p = std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i]);
        q.add(p, unit(std::array::from_fn(|i| g[i] / spacing[i])));
    }
    q
}

/// Sums over all crossings of a cell, for the cubes above. The normals also depend on the neighbouring cells.
fn smooth_quadric(field: &Field, iso: f32, cell: [u32; 3], signs: u8) -> Quadric {
    let (v, spacing) = (corners(field, cell), field.grid.spacing.map(f64::from));
    let mut q = Quadric::default();
    for edge in 0..12 {
        let [low, high] = cube::edge_corners(edge);
        if (signs >> low ^ signs >> high) & 1 == 0 {
            continue;
        }
        let at = crossing(v, iso, edge);
        let gradient = edge_gradient(field, cell, edge, at[cube::edge_axis(edge)]);
        let p = std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i]);
        q.add(p, unit(std::array::from_fn(|i| gradient[i] / spacing[i])));
    }
    q
}

/// How a Newton step is limited to one cell along each axis.
#[derive(Clone, Copy, PartialEq)]
enum StepLimit {
    /// Shortened, in its direction.
    Scaled,
    /// Clamped along each axis separately: used in cells, which a step hardly leaves.
    PerAxis,
}

fn newton_step((gradient, value): (Vector, f64), iso: f64, spacing: Vector, limit: StepLimit) -> Vector {
    let g: Vector = std::array::from_fn(|i| gradient[i] / spacing[i]);
    let length2 = dot(g, g);
    let step: Vector = std::array::from_fn(|i| (iso - value) / length2 * g[i] / spacing[i]);
    if step.iter().any(|s| !s.is_finite()) {
        return [0.0; 3];
    }
    if limit == StepLimit::PerAxis {
        return step.map(|s| s.clamp(-1.0, 1.0));
    }
    let longest = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
    step.map(|s| if longest > 1.0 { s / longest } else { s })
}

/// Newton steps from `start`. Returns their end point, or `start` if its value is nearer the isovalue, and the last gradient.
fn descend(field: &Field, iso: f32, start: Vector, inside: impl Fn(Vector) -> Vector) -> (Vector, Vector) {
    let (iso, spacing) = (f64::from(iso), field.grid.spacing.map(f64::from));
    let start = inside(start);
    let (mut x, mut last) = (start, field_at(field, start));
    let distance = (last.1 - iso).abs();
    for _ in 0..NEWTON_STEPS {
        let step = newton_step(last, iso, spacing, StepLimit::PerAxis);
        x = inside(std::array::from_fn(|i| x[i] + step[i]));
        last = field_at(field, x);
    }
    let better = (last.1 - iso).abs() <= distance;
    (
        if better { x } else { start },
        std::array::from_fn(|i| last.0[i] / spacing[i]),
    )
}

/// Maximum change of the end of `path`, along any axis, if it begins at the corners of a small box around `start` instead.
fn uncertainty(start: Vector, reach: f64, path: impl Fn(Vector) -> Vector) -> f64 {
    let end = path(start);
    let distance = |nudge| {
        let up = cube::corner_offset(nudge);
        let other = path(std::array::from_fn(|i| start[i] + reach * (up[i] as f64 - 0.5) * 1e-3));
        (0..3).map(|i| (other[i] - end[i]).abs()).fold(0.0, f64::max)
    };
    (0..8).map(distance).fold(0.0, f64::max)
}

/// The vertex of one sheet of a cell with several: the mean of its own crossings, moved towards the isosurface inside their
/// box. It does not move all the way, because the vertices of two sheets could meet there.
fn sheet_vertex(field: &Field, iso: f32, cell: [u32; 3], sheets: &Sheets, sheet: u8) -> DualVertex {
    let (v, spacing) = (corners(field, cell), field.grid.spacing.map(f64::from));
    let q = sheet_quadric(field, iso, cell, sheets, sheet);
    let (mut minimum, mut maximum) = ([1.0 - MARGIN; 3], [MARGIN; 3]);
    for edge in (0..12).filter(|&e| sheets.of_edge[e] == sheet) {
        let p = crossing(v, iso, edge);
        minimum = std::array::from_fn(|i| minimum[i].min(p[i]).max(MARGIN));
        maximum = std::array::from_fn(|i| maximum[i].max(p[i]).min(1.0 - MARGIN));
    }
    let mean: Vector = std::array::from_fn(|i| {
        let low = f64::from(cell[i]);
        (q.mean()[i] / spacing[i] - low).clamp(MARGIN, 1.0 - MARGIN)
    });
    let path = |start: Vector| {
        let mut x = start;
        for _ in 0..NEWTON_STEPS {
            let step = newton_step(interpolate(v, x), f64::from(iso), spacing, StepLimit::Scaled);
            x = std::array::from_fn(|i| (x[i] + step[i]).clamp(minimum[i], maximum[i]));
        }
        std::array::from_fn(|i| mean[i] + SHEET_STEP * (x[i] - mean[i]))
    };
    let at = path(mean);
    DualVertex {
        position: std::array::from_fn(|i| f64::from(cell[i]) + at[i]),
        gradient: std::array::from_fn(|i| interpolate(v, at).0[i] / spacing[i]),
        error: q.error(std::array::from_fn(|i| (f64::from(cell[i]) + at[i]) * spacing[i])),
        uncertainty: uncertainty(mean, 1.0, path),
    }
}

/// The vertex of a cell with one sheet: the quadric's best point, moved onto the isosurface.
fn cell_vertex(field: &Field, iso: f32, cell: [u32; 3], q: &Quadric) -> DualVertex {
    let spacing = field.grid.spacing.map(f64::from);
    let inside = |x: Vector| -> Vector { clamp_inside(x, [cell, offset(cell, [1; 3])]) };
    let best = q.minimum(CELL_PULL);
    let start: Vector = std::array::from_fn(|i| best[i] / spacing[i]);
    let (position, gradient) = descend(field, iso, start, inside);
    let uncertainty = uncertainty(start, 1.0, |from| descend(field, iso, from, inside).0);
    DualVertex {
        position,
        gradient,
        error: q.error(std::array::from_fn(|i| position[i] * spacing[i])),
        uncertainty,
    }
}

/// The vertex of a cube of level 1 or above, between two samples: the quadric's best point inside it.
fn cube_vertex(field: &Field, sums: &Sums, samples: [[u32; 3]; 2]) -> DualVertex {
    let spacing = field.grid.spacing.map(f64::from);
    let best = sums.quadric.minimum(CUBE_PULL);
    let position = clamp_inside(std::array::from_fn(|i| best[i] / spacing[i]), samples);
    DualVertex {
        position,
        gradient: sums.gradient,
        error: sums.quadric.error(std::array::from_fn(|i| position[i] * spacing[i])),
        uncertainty: 0.0,
    }
}

/// A point in cells, clamped to a cube less its margin.
fn clamp_inside(x: Vector, [low, high]: [[u32; 3]; 2]) -> Vector {
    std::array::from_fn(|i| x[i].clamp(f64::from(low[i]) + MARGIN, f64::from(high[i]) - MARGIN))
}
